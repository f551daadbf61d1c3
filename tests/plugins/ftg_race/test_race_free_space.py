"""Free distance, the fan and the swept outline, each against a slow and plain computation."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robotd.world.kinematics import advance
from robotd.world.messages import Drive
from robotd_plugins.behaviours.ftg_race.body import Body, swept_free_m
from robotd_plugins.behaviours.ftg_race.free_space import BEARINGS, HALF, STEP_RAD, FreeSpace
from robotd_plugins.behaviours.ftg_race.race_line import Fan, RaceLimits

BODY = Body(0.33, 0.4189, 0.455, -0.125, 0.155)
LIMITS = RaceLimits(8.0, 8.5, 7.0, 6.0, 6.5, 10.0)


@given(st.integers(0, 10_000))
@settings(max_examples=25, deadline=None)
def test_a_bearing_is_as_free_as_the_nearest_return_that_blocks_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, reach, most = 120, 0.25, 10.0
    bearing = np.linspace(-2.3, 2.3, n) + rng.uniform(-0.01, 0.01, n)
    # one smooth wall: no edge hides anything
    r = 2.0 + np.cumsum(rng.uniform(-0.002, 0.002, n))
    free = FreeSpace().profile(r * np.cos(bearing), r * np.sin(bearing), np.ones(n, dtype=bool), reach, most)
    at = (np.arange(BEARINGS) - HALF) * STEP_RAD
    slow = np.full(BEARINGS, most)
    for b, distance in zip(bearing, r, strict=True):
        blocks = np.abs(at - b) <= math.asin(reach / distance)
        slow[blocks] = np.minimum(slow[blocks], distance - reach)
    inside = (at > bearing[0]) & (at < bearing[-1])
    assert np.all(free[inside] <= slow[inside] + 1e-9)
    # between two returns it may take one of both; never farther apart than the wall is rough
    assert np.all(free[inside] >= slow[inside] - 0.05)


def test_behind_an_edge_nothing_is_free() -> None:
    bearing = np.radians(np.arange(-90.0, 91.0))
    r = np.where(bearing < 0.0, 1.0, 8.0)
    # the car looks from half a metre farther on, so that the edge opens a strip that no beam has seen
    x, y = r * np.cos(bearing) - 0.5, r * np.sin(bearing)
    free = FreeSpace().profile(x, y, np.ones(len(r), dtype=bool), 0.2, 10.0)
    edge = math.atan2(0.0, 0.5)
    opened = range(HALF + round(edge / STEP_RAD), HALF + 2)
    assert all(free[k] < 1.0 for k in opened)


def test_beside_a_wall_inside_the_margin_the_way_along_it_is_free_for_a_while() -> None:
    x = np.arange(-2.0, 6.0, 0.03)
    y = np.full(len(x), -0.22)
    hit = np.ones(len(x), dtype=bool)
    strict = FreeSpace().profile(x, y, hit, 0.28, 10.0)
    soft = FreeSpace().profile(x, y, hit, 0.28, 10.0, near_m=0.21)
    assert strict[HALF] < 0.05
    # straight on for a while, but not for long; away from the wall as far as one looks
    assert 0.2 < soft[HALF] < 2.0 and soft[HALF + round(0.3 / STEP_RAD)] == 10.0
    # and into it no farther than without a margin
    assert soft[HALF - round(math.pi / 2.0 / STEP_RAD)] < 0.03


@pytest.mark.parametrize("over_m", [1.5, 2.0, 3.0])
def test_what_a_path_gains_is_measured_the_way_the_quickest_one_heads(over_m: float) -> None:
    fan = Fan(0.75, 10.0, 8, (1.0, 2.0))
    straight, bent = 8, 12
    assert fan.k1_pm[straight] == 0.0
    times = np.ones(len(fan))
    times[straight] = 0.9
    gained = fan._gained_s(times, np.full(len(fan), 4.0), np.full(len(fan), 9.0), over_m)
    ahead = math.sin(fan.k1_pm[bent] * over_m) / fan.k1_pm[bent]
    assert gained[straight] == 0.0
    assert gained[bent] == pytest.approx(max((ahead - over_m) / 2.0, -0.2))
    # a path that ends before gains nothing and loses nothing by it: its time says enough
    assert fan._gained_s(times, np.full(len(fan), 4.0), np.full(len(fan), 0.5), over_m).tolist() == [0.0] * len(fan)


def test_the_fan_is_mirrored_exactly() -> None:
    fan = Fan(0.75, 10.0, 6, (1.0, 2.0))
    rng = np.random.default_rng(3)
    profile = rng.uniform(0.5, 10.0, BEARINGS)
    there, back = fan.free_m(profile), fan.free_m(profile[::-1].copy())
    order = {(a, b, c): i for i, (a, b, c) in enumerate(zip(fan.k1_pm, fan.k2_pm, fan._first_m, strict=True))}
    twin = [order[(-a, -b, c)] for a, b, c in order]
    assert there.tolist() == back[twin].tolist()


@pytest.mark.parametrize(
    ("what", "first", "second"),
    [
        ("a long way is quicker than one that ends", (0.0, 9.0), (0.0, 4.0)),
        ("a wide bend is quicker than a tight one", (0.3, 9.0), (1.2, 9.0)),
    ],
)
def test_which_path_is_quicker(what: str, first: tuple[float, float], second: tuple[float, float]) -> None:
    fan = Fan(0.75, 10.0, 8, (1.0, 2.0))

    def path(curvature: float) -> int:
        return int(np.abs(fan.k1_pm[:17] - curvature).argmin())

    def cost(case: tuple[float, float]) -> float:
        free = np.full(len(fan), case[1])
        times, _ = fan.times_s(free, 5.0, LIMITS, 4.0, 0.2)
        return float(times[path(case[0])])

    assert cost(first) < cost(second), what


@given(
    st.floats(-1.3, 1.3),
    st.floats(0.3, 2.5),
    st.floats(-1.2, 1.2),
    st.booleans(),
)
@settings(max_examples=60, deadline=None)
def test_the_swept_outline_meets_a_point_where_a_step_by_step_car_does(
    curvature: float, ahead: float, aside: float, back: bool
) -> None:
    x, y = (-ahead if back else ahead) + (0.165), aside
    free = swept_free_m(np.array([x]), np.array([y]), curvature, BODY, 1.5, back)
    step = 0.004
    way, pose, drive = 0.0, (0.0, 0.0, 0.0), Drive(-step if back else step, (-step if back else step) * curvature)
    while way < 1.5:
        dx, dy = x - pose[0], y - pose[1]
        u = math.cos(pose[2]) * dx + math.sin(pose[2]) * dy
        v = -math.sin(pose[2]) * dx + math.cos(pose[2]) * dy
        if BODY.rear_m < u < BODY.front_m and abs(v) < BODY.half_width_m:
            break
        pose = advance(*pose, drive, 1.0)
        way += step
    # a corner that only grazes may be seen by one and not by the other
    wide = swept_free_m(np.array([x]), np.array([y]), curvature, BODY.wider(0.01), 1.5, back)
    assert min(wide, free) - 0.02 <= way
    if free < 1.5:
        narrow = swept_free_m(np.array([x]), np.array([y]), curvature, BODY.wider(-0.01), 1.5, back)
        assert way <= max(narrow, free) + 0.02
