"""The seed's steps on made-up scans (wall, corridor, diagonal, posts), its parameters and its two widths."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from race_cars import TT02D, corridor, settled

from robotd.testing import box_scan, corridor_scan, open_scan
from robotd_plugins.behaviours.ftg_race import FtgRaceConfig, gap
from robotd_plugins.behaviours.ftg_race.body import body_of
from robotd_plugins.behaviours.ftg_race.commanding import (
    SpeedPolicy,
    SteeringSmoother,
    iir_time_constant_s,
    steering_rad,
)
from robotd_plugins.behaviours.ftg_race.free_space import HALF, FreeSpace

STEP = math.radians(1.0)
SEED: dict[str, Any] = {"profile": "seed_safe", "robot": TT02D, "steps": 30}
# section 8 of the seed, in our units
INITIAL = {
    "fov_rad": math.pi / 2.0, "angle_step_rad": STEP, "vehicle_width_m": 0.190, "safety_margin_m": 0.030,
    "range_min_m": 0.150, "range_max_m": 6.0, "free_threshold_m": 0.700, "bubble_radius_m": 0.250,
    "disparity_threshold_m": 0.300, "stop_distance_m": 0.300, "front_sector_rad": math.radians(15.0),
    "steer_iir_beta": 0.25,
}  # fmt: skip


def test_seed_safe_has_the_initial_values() -> None:
    config = FtgRaceConfig(profile="seed_safe")
    assert {name: getattr(config, name) for name in INITIAL} == pytest.approx(INITIAL)
    assert config.accel_mps2 > 0.0 and config.steer_slowdown_mps_per_rad > 0.0


def test_a_profile_is_where_the_others_start_from() -> None:
    assert FtgRaceConfig(profile="seed_safe", vehicle_width_m=0.182).vehicle_width_m == 0.182
    assert FtgRaceConfig().method == "free_space"
    dumped = FtgRaceConfig(profile="seed_safe").model_dump()
    assert FtgRaceConfig.model_validate(dumped) == FtgRaceConfig(profile="seed_safe")


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"range_min_m": 0.5, "range_max_m": 1.01, "reach_m": 2.0, "bends_m": (3.0,)}, "before reach_m"),
        ({"bends_m": (2.0, 1.0)}, "must rise"),
        ({"planner": "best"}, "ftg"),
    ],
)
def test_senseless_parameters_are_refused(wrong: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        FtgRaceConfig(**wrong)


@pytest.mark.parametrize(
    ("place", "scan", "side"),
    [
        ("a corridor", lambda t: corridor(stamp_ns=t), 0),
        ("a corridor seen askew, its end to the left", lambda t: corridor(stamp_ns=t, heading_rad=-0.4), 1),
        ("a corridor seen askew, its end to the right", lambda t: corridor(stamp_ns=t, heading_rad=0.4), -1),
        ("a wall ahead, open to the left", lambda t: box_scan(2.0, 5.0, 2.0, 0.6, stamp_ns=t), 1),
        ("a wall ahead, open to the right", lambda t: box_scan(2.0, 0.6, 2.0, 5.0, stamp_ns=t), -1),
        ("a post to the left of the way", lambda t: corridor(stamp_ns=t, posts=[(2.0, 0.12, 0.1)]), -1),
    ],
)
@pytest.mark.parametrize("keys", [{**SEED, "beyond_range_is_free": True}, {}], ids=["seed", "race"])
def test_where_it_steers(place: str, scan: Any, side: int, keys: dict[str, Any]) -> None:
    command = settled(scan, 1.0, **keys)
    assert command.speed_mps > 0.0
    if side:
        assert command.steering_rad * side > 0.02, place
    else:
        assert abs(command.steering_rad) < 0.05, place


def test_the_straight_ahead_is_a_wall_to_the_literal_seed() -> None:
    """Six metres of range and no echo for an obstacle: the trap of the seed, which `race` does not have."""
    long = lambda t: corridor_scan(1.8, stamp_ns=t, ahead_m=9.0, range_max_m=12.0)  # noqa: E731
    literal = settled(long, 1.0, **SEED)
    freed = settled(long, 1.0, **{**SEED, "beyond_range_is_free": True})
    race = settled(long, 1.0)
    assert literal.speed_mps <= freed.speed_mps < race.speed_mps


@pytest.mark.parametrize("ahead_m", [0.29, 0.2, 0.1])
def test_within_the_stopping_distance_it_stops_at_once(ahead_m: float) -> None:
    command = settled(lambda t: box_scan(ahead_m, stamp_ns=t), 1.5, **SEED)
    assert command.speed_mps == 0.0


def test_four_millimetres_to_each_side_decide() -> None:
    """182 mm against 190 mm with 30 mm beside: a post blocks two bins less, and a gate of 246 mm is open to one."""
    post = np.full(61, 4.0)
    post[30] = 1.4
    gate = np.array([[1.5, 8.0, 8.0, 1.5], [-0.123, -0.3, 0.3, 0.123]])
    blocked, free = [], []
    for width in (0.182, 0.190):
        half = width / 2.0 + 0.03
        blocked.append(int((gap.inflated(post, half, STEP) < 4.0).sum()))
        free.append(FreeSpace().profile(gate[0], gate[1], np.ones(4, dtype=bool), half, 6.0)[HALF])
    assert blocked == [9, 11]
    assert free[0] == 6.0 and free[1] < 1.5


def test_bubble_and_disparity() -> None:
    ranges = np.full(61, 4.0)
    ranges[30] = 1.0
    holed = gap.bubbled(ranges, 0.25, STEP)
    k = int(math.atan2(0.25, 1.0) / STEP)
    assert np.flatnonzero(holed == 0.0).tolist() == list(range(30 - k, 31 + k))
    step = np.concatenate((np.full(30, 1.0), np.full(31, 4.0)))
    wide = gap.extended(step, 0.3, 0.125, STEP)
    k = int(math.atan2(0.125, 1.0) / STEP)
    assert np.flatnonzero(wide < 4.0).tolist() == list(range(30 + k))
    assert gap.extended(step, 5.0, 0.125, STEP).tolist() == step.tolist()


@pytest.mark.parametrize(
    ("what", "found", "kept", "best"),
    [
        ("none", [], None, None),
        ("the widest", [(0, 10), (20, 50)], None, (20, 50)),
        ("of equals the one ahead", [(0, 10), (40, 50), (80, 90)], None, (40, 50)),
        ("the last one, if it is nearly as wide", [(0, 10), (20, 32)], 5, (0, 10)),
        ("not the last one, if it is much narrower", [(0, 5), (20, 50)], 3, (20, 50)),
    ],
)
def test_which_gap(what: str, found: list[gap.Gap], kept: int | None, best: gap.Gap | None) -> None:
    assert gap.best_gap(found, 45, kept) == best, what


def test_the_aim_is_the_farthest_pulled_to_the_middle() -> None:
    ranges = np.linspace(1.0, 5.0, 21)
    assert gap.aim(ranges, (0, 21), 0.0, None, 0) == 20
    assert gap.aim(ranges, (0, 21), 0.5, None, 0) == 15
    two = np.array([1.0, 4.0, 1.0, 1.0, 1.0, 4.05, 1.0])
    assert [gap.aim(two, (0, 7), 0.0, kept, 0) for kept in (None, 1)] == [5, 1]


POLICY = SpeedPolicy(2.0, 0.3, 1.5, 4.0, 0.8, 0.5, 2.0, 8.0, 0.0, 0.0, 0.06)


@pytest.mark.parametrize(
    ("limited_by", "target_m", "front_m", "steering", "speed"),
    [
        ("the target", 1.0, 6.0, 0.0, 0.8),
        ("what is ahead", 6.0, 0.9, 0.0, 0.9),
        ("the steering", 6.0, 6.0, 0.4, 0.4),
        ("V_MAX", 6.0, 6.0, 0.0, 2.0),
        ("nearer than the stopping distance", 6.0, 0.2, 0.0, 0.0),
    ],
)
def test_the_seeds_speeds(limited_by: str, target_m: float, front_m: float, steering: float, speed: float) -> None:
    assert POLICY.by_gains(target_m, front_m, steering) == pytest.approx(speed), limited_by


def test_the_filter_takes_the_seeds_share_in_one_of_its_cycles_and_as_much_in_ten_tenths() -> None:
    tau = iir_time_constant_s(0.25, 0.1)
    once, often = (SteeringSmoother(body_of(TT02D), tau, 0.0) for _ in range(2))
    assert once.step(0.4, 0.1) == pytest.approx(0.1)
    assert [often.step(0.4, 0.01) for _ in range(10)][-1] == pytest.approx(0.1)


def test_the_steering_rate_is_per_second() -> None:
    for rate_hz in (10.0, 40.0):
        smoother = SteeringSmoother(body_of(TT02D), 0.0, 1.0)
        angles = [smoother.step(0.4, 1.0 / rate_hz) for _ in range(round(rate_hz / 5.0))]
        assert angles[-1] == pytest.approx(0.2)


def test_a_curvature_is_ackermann_at_rest_and_more_at_speed() -> None:
    body = body_of(TT02D)
    assert math.tan(steering_rad(1.0, 0.0, body, 0.003)) == pytest.approx(0.257)
    assert steering_rad(0.5, 4.0, body, 0.003) - steering_rad(0.5, 0.0, body, 0.003) == pytest.approx(0.024)


def test_the_baseline_turns_from_the_nearest_and_is_chosen_by_name() -> None:
    near_left = settled(lambda t: corridor(stamp_ns=t, offset_m=0.3), 1.0, planner="baseline")
    near_right = settled(lambda t: corridor(stamp_ns=t, offset_m=-0.3), 1.0, planner="baseline")
    assert near_left.steering_rad < 0.0 < near_right.steering_rad
    assert settled(lambda t: open_scan(stamp_ns=t), 1.0, planner="baseline").steering_rad == 0.0
