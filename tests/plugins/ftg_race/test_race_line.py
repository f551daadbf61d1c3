"""The learned line: inside the walls, no tighter than the car, no faster than tyres hold; place and tracking."""

from __future__ import annotations

import math

import numpy as np
import pytest
import stadium
from hypothesis import given, settings
from hypothesis import strategies as st
from race_cars import F1TENTH

from robotd_plugins.behaviours.ftg_race.body import body_of
from robotd_plugins.behaviours.ftg_race.line import LearnedLine, LineLimits, WallField, learned_line
from robotd_plugins.behaviours.ftg_race.line.on_line import TrackLine
from robotd_plugins.behaviours.ftg_race.line.profile import lap_s, speeds_mps
from robotd_plugins.behaviours.ftg_race.line.solver import box_programme
from robotd_plugins.behaviours.ftg_race.line.tracker import Tracker
from robotd_plugins.behaviours.ftg_race.line.tyre_lag import TyreLag

BODY = body_of(F1TENTH)
LIMITS = LineLimits(8.0, 8.0, 6.0, 6.0, 9.0)
MARGIN_M = 0.2


def line_of(straight_m: float, radius_m: float, width_m: float) -> tuple[LearnedLine, WallField]:
    field = stadium.walls(straight_m, radius_m, width_m)
    return learned_line(stadium.middle(straight_m, radius_m), field, BODY, LIMITS, MARGIN_M), field


@pytest.mark.parametrize(
    ("straight_m", "radius_m", "width_m"), [(10.0, 1.5, 1.8), (10.0, 1.5, 1.0), (3.0, 4.0, 2.2), (20.0, 1.2, 1.6)]
)
def test_the_line_is_closed_inside_the_walls_and_quicker_than_the_middle(
    straight_m: float, radius_m: float, width_m: float
) -> None:
    line, field = line_of(straight_m, radius_m, width_m)
    steps = np.hypot(np.roll(line.x_m, -1) - line.x_m, np.roll(line.y_m, -1) - line.y_m)
    np.testing.assert_allclose(steps, line.length_m / len(line.s_m), rtol=0.03)
    assert field.at(line.x_m, line.y_m).min() >= BODY.half_width_m + MARGIN_M - 0.02
    assert np.abs(line.curvature_pm).max() <= 0.9 / BODY.least_radius_m
    # once round to the left: the curvatures sum up to a whole turn
    assert line.curvature_pm.sum() * line.length_m / len(line.s_m) == pytest.approx(math.tau, rel=0.02)
    middle_pm = np.where(np.abs(stadium.middle(straight_m, radius_m)[:, 0]) > straight_m / 2.0, 1.0 / radius_m, 0.0)
    assert line.lap_s < lap_s(speeds_mps(middle_pm, 0.25, LIMITS), 0.25)


def test_a_mirrored_track_has_the_mirrored_line() -> None:
    line, field = line_of(10.0, 1.5, 1.8)
    path = stadium.middle(10.0, 1.5)
    rows = field.distance_m.shape[0]
    turned = WallField(
        field.distance_m[::-1].copy(), field.resolution_m, (field.origin_m[0], -field.origin_m[1] - rows * 0.05)
    )
    other = learned_line(path * (1.0, -1.0, -1.0), turned, BODY, LIMITS, MARGIN_M)
    np.testing.assert_allclose(other.y_m, -line.y_m, atol=1e-4)
    np.testing.assert_allclose(other.curvature_pm, -line.curvature_pm, atol=1e-3)


@pytest.mark.parametrize(
    ("straight_m", "radius_m", "width_m", "told"),
    [(10.0, 1.5, -1.0, "no room beside the path at"), (10.0, 0.6, 0.9, "tighter than the car's")],
)
def test_no_line_has_its_reason(straight_m: float, radius_m: float, width_m: float, told: str) -> None:
    with pytest.raises(ValueError, match=told):
        line_of(straight_m, radius_m, width_m)


@given(st.integers(0, 10_000), st.integers(3, 30))
@settings(max_examples=40, deadline=None)
def test_the_programme_ends_where_no_coordinate_can_do_better(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(n, n))
    hessian, gradient = root.T @ root, rng.normal(size=n) * 3.0
    least = -rng.uniform(0.01, 2.0, n)
    most = rng.uniform(0.01, 2.0, n)
    x = box_programme(hessian, gradient, least, most)
    assert (x > least).all() and (x < most).all()
    slope = hessian @ x + gradient
    scale = float(np.abs(slope).max()) + float(np.abs(gradient).max())
    # one step down the slope, cut at the bounds, leads nowhere
    step = np.clip(x - slope / scale, least, most) - x
    assert np.abs(step).max() < 2e-3


curvatures = st.lists(st.floats(-1.2, 1.2), min_size=8, max_size=60).map(
    lambda knots: np.interp(np.arange(4 * len(knots)) / 4.0, np.arange(len(knots) + 1), [*knots, knots[0]])
)


@given(curvatures, st.floats(2.0, 10.0), st.floats(1.0, 9.0), st.floats(1.0, 9.0), st.floats(0.5, 1.0))
@settings(max_examples=100, deadline=None)
def test_no_speed_asks_for_more_than_tyres_motor_and_brakes_have(
    kappa: np.ndarray, top: float, accel: float, brake: float, share: float
) -> None:
    limits = LineLimits(top, 9.0 * share, accel, brake, 9.0)
    step = 0.25
    v = speeds_mps(kappa, step, limits)
    assert (v > 0.0).all() and (v <= top + 1e-9).all()
    assert (v * v * np.abs(kappa) <= limits.lateral_mps2 + 1e-9).all()
    along = (np.roll(v, -1) ** 2 - v * v) / (2.0 * step)
    bend = np.maximum(np.abs(kappa), np.abs(np.roll(kappa, -1)))
    slower = np.minimum(v, np.roll(v, -1))
    left = np.array([limits.along_mps2(float(a)) for a in slower * slower * bend])
    assert (along <= np.minimum(left, accel) + 1e-6).all()
    rows = zip((slower * slower * bend).tolist(), slower.tolist(), strict=True)
    left = np.array([limits.braking_mps2(a, at) for a, at in rows])
    assert (-along <= np.minimum(left, brake) + 1e-6).all()


def test_pedals_have_less_the_more_the_bend_takes() -> None:
    left = [LIMITS.along_mps2(a) for a in (0.0, 3.0, 6.0, 9.0, 12.0)]
    assert left == sorted(left, reverse=True)
    assert left[0] == pytest.approx(9.0) and left[3:] == [0.0, 0.0]
    assert LIMITS.along_mps2(-6.0) == left[2]
    # into a bend, the less the faster the car is
    into = [LIMITS.braking_mps2(6.0, v) for v in (2.0, 4.0, 6.0, 8.0, 20.0)]
    assert into == sorted(into, reverse=True) and into[-1] > 0.0
    assert LIMITS.braking_mps2(0.0, 8.0) == pytest.approx(9.0)


@given(st.floats(0.0, 110.0), st.floats(-0.4, 0.4), st.floats(-0.6, 0.6))
@settings(max_examples=100, deadline=None)
def test_the_place_of_a_car_beside_its_line(s: float, aside: float, turned: float) -> None:
    track = stadium.learned()
    line = TrackLine(track, LIMITS)
    at = s / line.step_m
    i = int(at)
    x, y, yaw = (float(np.interp(at, [i, i + 1], [a[i], a[i + 1]])) for a in (track.x_m, track.y_m, track.yaw_rad))
    jump_pm = abs(float(track.curvature_pm[i + 1] - track.curvature_pm[i]))
    found = line.place(x - aside * math.sin(yaw), y + aside * math.cos(yaw), yaw + turned)
    off = (found.s_m - s + line.length_m / 2.0) % line.length_m - line.length_m / 2.0
    assert abs(off) < 0.05
    assert found.aside_m == pytest.approx(aside, abs=0.02)
    # where a straight becomes a bend the curvature jumps between two points of the line, and yaw is bent there
    assert found.turned_rad == pytest.approx(turned, abs=0.02 + 0.25 * line.step_m * jump_pm)
    ahead = line.ahead(found, 6.0, 0.15, 1.5)
    # the line is followed from where the car is, and is as long as it says
    assert math.hypot(ahead.x_m[0], ahead.y_m[0]) < ahead.way_m[0] + 0.15
    assert 5.0 < ahead.way_m[-1] <= 6.0 + line.step_m
    # its direction is that of its points, seen from the car's own course
    course = np.arctan2(np.diff(ahead.y_m), np.diff(ahead.x_m))
    off = np.remainder(course - ahead.turned_rad[1:] + math.pi, math.tau) - math.pi
    assert np.abs(off).max() < 0.15 + 0.6 * abs(aside)


@pytest.mark.parametrize("speed", [2.0, 5.0, 8.0])
@pytest.mark.parametrize(("aside", "turned"), [(0.2, 0.0), (-0.2, 0.1), (0.0, 0.3), (0.0, -0.3), (0.8, 0.0)])
def test_a_car_that_does_as_told_comes_back_to_its_line(speed: float, aside: float, turned: float) -> None:
    line, tracker = TrackLine(stadium.learned(), LIMITS), Tracker()
    x, y, yaw = -15.0, aside, turned
    worst = steepest = 0.0
    while x < 10.0:
        place = line.place(x, y, yaw)
        worst, steepest = max(worst, abs(place.aside_m)), max(steepest, abs(place.turned_rad))
        curvature = tracker.curvature_pm(line, place, speed)
        x, y, yaw = x + 0.02 * math.cos(yaw), y + 0.02 * math.sin(yaw), yaw + 0.02 * curvature
    assert abs(y) < 0.01 and abs(yaw) < 0.01
    assert worst < abs(aside) + 0.25
    # from however far, at a gentle angle
    assert steepest < abs(turned) + 0.2


def test_slip_that_has_to_build_up_is_missing_at_first() -> None:
    lag, grip = TyreLag(0.2, 10.0), 10.0
    steady_rad = 0.2 * 6.0 * 1.0 / grip
    assert lag.missing_rad(6.0, 0.0, 0, 0.0) == 0.0
    missing = [lag.missing_rad(6.0, 1.0, ms * 1_000_000, 0.0) for ms in range(1, 1001)]
    assert 0.9 * steady_rad < missing[0] < steady_rad
    # an e-th part is left after speed x slip / grip: 0.12 s
    assert missing[119] == pytest.approx(steady_rad / math.e, rel=0.01)
    assert missing == sorted(missing, reverse=True) and missing[-1] < 1e-3 * steady_rad


@given(st.lists(st.tuples(st.floats(0.0, 8.0), st.floats(-6.0, 6.0)), min_size=1, max_size=20), st.floats(0.0, 0.2))
@settings(max_examples=50, deadline=None)
def test_missing_slip_is_mirrored_and_no_more_than_the_slip_that_changed(
    driven: list[tuple[float, float]], after_s: float
) -> None:
    left, right, most_rad = TyreLag(0.2, 10.0), TyreLag(0.2, 10.0), 0.0
    for k, (v, w) in enumerate(driven):
        most_rad = max(most_rad, abs(0.2 * v * w / 10.0))
        missing = left.missing_rad(v, w, k * 25_000_000, after_s)
        assert right.missing_rad(v, -w, k * 25_000_000, after_s) == -missing
        assert abs(missing) <= 2.0 * most_rad + 1e-12
        assert v >= 1.0 or missing == 0.0
