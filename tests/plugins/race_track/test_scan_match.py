"""Laying scans on walls: motion between scans, sweeps put to one instant, Gauss-Newton, key frames."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robotd.testing import box_scan, corridor_scan
from robotd.world.geometry import compose, inverse
from robotd.world.kinematics import advance
from robotd.world.messages import Drive, LidarScan, Odometry, Steer
from robotd_plugins.perception.track_survey.key_frame import KeyFrame, key_frame
from robotd_plugins.toolkit.scan_match import FAR_M, align, prior_of
from robotd_plugins.toolkit.scan_motion import Beams, CarMotion, ToldMotion, deskewed, twist_of

S = 1_000_000_000
LOOSE = prior_of(1.0, 1.0, 1.0)
STILL = (0.0, 0.0, 0.0)
speeds = st.floats(-8.0, 8.0)
turns = st.floats(-6.0, 6.0)


@given(speeds, speeds, turns, st.floats(0.01, 0.3))
def test_a_twist_comes_out_of_the_motion_that_it_makes(vx: float, vy: float, wz: float, passed_s: float) -> None:
    moved = advance(0.0, 0.0, 0.0, Drive(vx, wz, vy), passed_s)
    assert twist_of(moved, passed_s) == pytest.approx((vx, vy, wz), abs=1e-5)


def test_without_time_there_is_no_twist() -> None:
    assert twist_of((1.0, 0.0, 0.0), 0.0) == STILL


@given(st.lists(st.tuples(st.integers(1, S // 10), speeds, turns), min_size=1, max_size=8), st.integers(1, S // 10))
def test_motion_over_two_stretches_is_the_one_after_the_other(
    told: list[tuple[int, float, float]], after_ns: int
) -> None:
    motion, now_ns = ToldMotion(), 0
    for passed_ns, v, w in told:
        now_ns += passed_ns
        motion.add(now_ns, v, w)
    end_ns = now_ns + after_ns
    middle_ns = end_ns // 2
    whole = compose(motion.between(0, middle_ns), motion.between(middle_ns, end_ns))
    assert motion.between(0, end_ns) == pytest.approx(whole, abs=1e-6)
    ways = motion.way_m(0, middle_ns) + motion.way_m(middle_ns, end_ns)
    assert motion.way_m(0, end_ns) == pytest.approx(ways, abs=1e-6)


def test_commands_stand_in_for_odometry_with_a_lag() -> None:
    motion = CarMotion(wheelbase_m=0.33, command_lag_s=0.1)
    for at in range(1, 101):
        motion.hear(at * S // 100, None, Steer(2.0, 0.2))
    assert not motion.is_measured
    x, _, yaw = motion.between(S - S // 100, S)
    assert x == pytest.approx(0.02, rel=0.01) and yaw == pytest.approx(0.02 * math.tan(0.2) / 0.33, rel=0.01)
    lagging = CarMotion(0.33, 0.1)
    lagging.hear(0, None, Steer(0.0))
    lagging.hear(S // 10, None, Steer(2.0))
    assert lagging.between(S // 10, 2 * S // 10)[0] == pytest.approx(0.2 * (1.0 - math.exp(-1.0)))


def test_odometry_goes_before_commands() -> None:
    motion = CarMotion(0.33, 0.1)
    motion.hear(0, Odometry(0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.5), Steer(5.0))
    assert motion.is_measured
    assert motion.between(0, S // 10)[0] == pytest.approx(0.1, rel=0.01)


@given(st.floats(-6.0, 6.0), st.floats(-1.0, 1.0), st.floats(-4.0, 4.0), st.floats(0.0, 0.1))
def test_what_was_seen_before_stands_still_while_the_car_goes_on(
    vx: float, vy: float, wz: float, before_s: float
) -> None:
    wall = (3.0, 1.5, 0.0)
    moved = advance(0.0, 0.0, 0.0, Drive(vx, wz, vy), before_s)
    x, y = deskewed(np.array([wall[0]]), np.array([wall[1]]), np.array([before_s]), (vx, vy, wz))
    true = compose(inverse(moved), wall)
    assert (x[0], y[0]) == pytest.approx(true[:2], abs=0.01)


def test_beams_without_a_return_or_too_near_are_left_out() -> None:
    ranges = np.array([1.0, math.nan, math.inf, 0.01, 2.0], dtype=np.float32)
    angles = np.linspace(-1.0, 1.0, 5).astype(np.float32)
    scan = LidarScan(S, ranges, angles, range_min_m=0.1, range_max_m=10.0)
    x, _, seen = Beams.of(scan, 5).points(scan, STILL, 12.0)
    assert seen.tolist() == [True, False, False, False, True] and len(x) == 2


# ------------------------------------------------------------------------------------------------ walls


def room(x_m: float = 0.0, y_m: float = 0.0, noise_m: float = 0.0, seed: int = 0) -> LidarScan:
    """A room of 5 by 4 m about (0, 0), seen by a lidar on base, which stands at x_m, y_m."""
    scan = box_scan(3.0 - x_m, 2.0 - y_m, 2.0 + x_m, 2.0 + y_m, beams=720, stamp_ns=S)
    noise = noise_m * np.random.default_rng(seed).standard_normal(720)
    return LidarScan(S, (scan.ranges_m + noise).astype(np.float32), scan.angles_rad, range_max_m=12.0)


def frame_of(scan: LidarScan) -> KeyFrame:
    x, y, _ = Beams.of(scan, 1440).points(scan, STILL, 14.0)
    return key_frame(x, y, scan.x_m, scan.y_m)


@settings(max_examples=30)
@given(st.floats(-0.4, 0.4), st.floats(-0.3, 0.3), st.floats(-0.15, 0.15))
def test_a_scan_finds_its_place_in_a_room(x_m: float, y_m: float, expected_rad: float) -> None:
    scan = room(x_m, y_m)
    x, y, _ = Beams.of(scan, 120).points(scan, STILL, 12.0)
    match = align(x, y, (0.0, 0.0, expected_rad), LOOSE, frame_of(room()), 0.02, 0.6, 10)
    assert match.pose == pytest.approx((x_m, y_m, 0.0), abs=0.006)
    assert match.explained_share > 0.9


@pytest.mark.parametrize("noise_m", [0.01, 0.03, 0.05])
def test_noise_averages_out(noise_m: float) -> None:
    errors = []
    for seed in range(10):
        scan = room(0.2, -0.1, noise_m, seed)
        x, y, _ = Beams.of(scan, 120).points(scan, STILL, 12.0)
        match = align(x, y, STILL, LOOSE, frame_of(room(0.0, 0.0, noise_m, seed + 100)), noise_m, 0.4, 8)
        errors.append(np.abs(np.array(match.pose) - (0.2, -0.1, 0.0)))
    assert np.mean(errors, axis=0).max() < 0.4 * noise_m


def test_along_a_corridor_the_way_comes_from_what_was_expected() -> None:
    """And its information says so: nothing along, much across."""
    near, scan = (corridor_scan(2.0, offset_m=at, beams=720, range_max_m=12.0) for at in (0.0, 0.1))
    x, y, _ = Beams.of(scan, 120).points(scan, STILL, 10.0)
    match = align(x, y, (0.3, 0.0, 0.0), prior_of(0.02, 0.2, 0.1), frame_of(near), 0.02, 0.4, 6)
    assert match.pose[0] == pytest.approx(0.3, abs=0.005)
    assert abs(match.pose[1]) == pytest.approx(0.1, abs=0.005)
    assert match.information[0, 0] < 0.01 * match.information[1, 1]


def test_returns_without_a_wall_leave_the_expected_pose() -> None:
    class Nowhere:
        def look(self, x_m: object, y_m: object) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # type: ignore[type-arg]
            return np.full(50, FAR_M), np.zeros(50), np.zeros(50)

    match = align(np.ones(50), np.ones(50), (1.0, 2.0, 0.3), LOOSE, Nowhere(), 0.02, 0.4)
    assert match.pose == pytest.approx((1.0, 2.0, 0.3)) and match.explained_share == 0.0


def test_a_frame_of_nothing_knows_no_walls() -> None:
    distance, _, _ = key_frame(np.zeros(0), np.zeros(0), 0.0, 0.0).look(np.ones(3), np.ones(3))
    assert (distance == FAR_M).all()
