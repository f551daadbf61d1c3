"""The pitfalls of racing by follow-the-gap, each as something that this behaviour does not do."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from race_cars import F1TENTH, TICK_NS, S, corridor, mirrored, noisy, seen, settled

from robotd.testing import box_scan, check_behaviour, corridor_scan
from robotd.world.messages import LidarScan, Odometry, Steer
from robotd.world.robot import Robot
from robotd_plugins.behaviours.ftg_race import FtgRace, FtgRaceConfig, Sees
from robotd_plugins.behaviours.ftg_race.body import body_of
from robotd_plugins.behaviours.ftg_race.commanding import SpeedPolicy
from robotd_plugins.behaviours.ftg_race.planner_ftg import PlannerFTG
from robotd_plugins.behaviours.ftg_race.planning_types import Command, Motion
from robotd_plugins.behaviours.ftg_race.recovery import Recovery, State
from robotd_plugins.behaviours.ftg_race.way_since import WaySince

POLICY = SpeedPolicy(8.0, 0.2, 1.0, 4.0, 1.0, 9.0, 9.0, 10.0, 0.21, 0.053, 0.06)


def planned(scan: LidarScan, motion: Motion, **keys: Any) -> Command:
    race = FtgRace(FtgRaceConfig(**keys), None, F1TENTH)
    planner = race._planner
    assert isinstance(planner, PlannerFTG)
    return planner.plan(race._preprocessor.process(scan, motion))


@pytest.mark.parametrize("planner", ["ftg", "baseline"])
@pytest.mark.parametrize("profile", ["race", "seed_safe"])
def test_the_contract_of_behaviours(profile: Any, planner: Any) -> None:
    config = FtgRaceConfig(profile=profile, planner=planner)
    results = check_behaviour(
        FtgRace, config, lambda n: seen(corridor(stamp_ns=(n + 1) * TICK_NS, ahead_m=3.0), 1.0), robot=F1TENTH
    )
    assert all(isinstance(result, Steer) for result in results)


@pytest.mark.parametrize("keys", [{}, {"profile": "seed_safe", "beyond_range_is_free": True}])
def test_a_mirrored_world_gives_the_mirrored_command_bit_for_bit(keys: dict[str, Any]) -> None:
    rng = np.random.default_rng(5)
    for heading, offset in rng.uniform((-0.5, -0.3), (0.5, 0.3), (12, 2)):
        scan = noisy(corridor(heading_rad=heading, offset_m=offset, posts=[(2.5, 0.3, 0.1)]), rng)
        one, other = (FtgRace(FtgRaceConfig(**keys), None, F1TENTH) for _ in range(2))
        for step in range(3):
            at = (step + 1) * TICK_NS
            here = LidarScan(at, scan.ranges_m, scan.angles_rad, 0, 0.0, 12.0, scan.x_m)
            left = one.step(seen(here, 3.0, 0.4))
            right = other.step(seen(mirrored(here), 3.0, -0.4))
            assert isinstance(left, Steer) and isinstance(right, Steer)
            if keys:  # the seed's tie-breaks between equal bins are the only exception
                assert left.steering_rad == pytest.approx(-right.steering_rad, abs=0.03)
            else:
                assert (left.speed_mps, left.steering_rad) == (right.speed_mps, -right.steering_rad)


@pytest.mark.parametrize("what", ["a scan that comes late", "a command that must hold"])
def test_the_longer_it_takes_the_slower_it_goes(what: str) -> None:
    scan = corridor(ahead_m=4.5)
    speeds = []
    for delay in (0.0, 0.05, 0.1, 0.2):
        motion = Motion(5.0, 0.0, age_s=delay, period_s=0.025, moved=(5.0 * delay, 0.0, 0.0))
        if what.startswith("a command"):
            motion = Motion(5.0, 0.0, period_s=0.025 + delay)
        speeds.append(planned(scan, motion).speed_mps)
    assert speeds == sorted(speeds, reverse=True) and speeds[0] > speeds[-1] + 0.3, what


@pytest.mark.parametrize(("noise_m", "share"), [(0.0, 1.0), (0.04, 1.0), (0.05, 0.88), (0.5, 0.3)])
def test_where_ranges_err_by_much_less_of_the_grip_is_planned_with(noise_m: float, share: float) -> None:
    planner = FtgRace(FtgRaceConfig(), None, F1TENTH)._planner
    assert isinstance(planner, PlannerFTG)
    limits, full = planner._limits_after(0.02, noise_m), planner._limits
    for name in ("lateral_mps2", "brake_mps2", "corner_brake_mps2"):
        assert getattr(limits, name) == pytest.approx(share * getattr(full, name)), name


@pytest.mark.parametrize("speed", [2.0, 5.0, 8.0])
def test_before_a_dead_end_it_can_stop(speed: float) -> None:
    """The braking envelope: what it asks for at d metres, it can still lose before the wall."""
    for ahead in (0.8, 1.5, 3.0, 6.0):
        command = planned(corridor(ahead_m=ahead), Motion(speed, 0.0, period_s=0.025))
        left = ahead - 0.4551 - speed * 0.09
        assert command.speed_mps <= math.sqrt(2.0 * 10.29 * max(left, 0.0)) + 1e-9


def test_no_bend_is_planned_faster_than_friction_allows() -> None:
    for heading in np.linspace(-0.6, 0.6, 9):
        for speed in (2.0, 4.0, 7.0):
            command = planned(corridor(heading_rad=float(heading), ahead_m=4.0), Motion(speed, 0.0, period_s=0.025))
            assert abs(command.curvature_pm) * speed * speed <= 1.0489 * 9.81


def test_less_friction_is_slower() -> None:
    scan = corridor(heading_rad=0.4, ahead_m=4.0)
    grippy, slippery = (planned(scan, Motion(4.0, 0.0, period_s=0.025), mu=mu) for mu in (1.0, 0.5))
    assert slippery.speed_mps < grippy.speed_mps


@pytest.mark.parametrize(("rate_hz"), [10.0, 25.0, 40.0])
def test_a_ramp_is_per_second(rate_hz: float) -> None:
    plain = SpeedPolicy(8.0, 0.2, 1.0, 4.0, 1.0, 4.0, 6.0, 10.0, 0.0, 0.0, 0.06)
    told = 0.0
    for _ in range(round(rate_hz)):
        told = plain.ramp(8.0, told, told, 0.0, 1.0 / rate_hz)
    assert told == pytest.approx(4.0)
    for _ in range(round(rate_hz * 0.4)):
        told = plain.ramp(0.5, told, told, 0.0, 1.0 / rate_hz)
    assert told == pytest.approx(1.6)


def test_a_stop_waits_for_no_ramp() -> None:
    assert POLICY.ramp(0.0, 7.0, 7.0, 9.0, 0.025) == 0.0
    stopped = settled(lambda t: box_scan(0.6, 0.6, 0.6, 0.6, stamp_ns=t, beams=720, x_m=0.165), 6.0)
    assert stopped.speed_mps == 0.0


def test_what_the_tyres_hold_sideways_they_do_not_brake_with() -> None:
    straight, bend = (POLICY.ramp(1.0, 5.0, 5.0, lateral, 0.025) for lateral in (0.0, 9.5))
    assert straight < bend < 5.0


def test_the_way_that_is_steered_counts_and_not_the_sector_ahead() -> None:
    """A wall straight ahead that the arc misses does not stop it; a post beside the arc's inner side does."""
    around = planned(corridor(heading_rad=0.75, width_m=2.4), Motion(1.0, 0.0, period_s=0.025))
    assert around.speed_mps > 1.0 and around.curvature_pm < -0.1


def test_inside_its_margin_a_fast_car_steers_out_and_does_not_stop() -> None:
    """A wall 6 cm beside a car at 3 m/s: inside the margin, and no reason for all brakes."""
    command = planned(corridor(offset_m=-(0.9 - 0.155 - 0.06)), Motion(3.0, 0.0, period_s=0.025))
    assert not command.is_blocked and command.speed_mps > 2.0
    assert command.curvature_pm > 0.02


@pytest.mark.parametrize(("beside_m", "faster"), [(0.02, False), (0.5, True)])
def test_deep_inside_its_margin_it_does_not_speed_up(beside_m: float, faster: bool) -> None:
    command = planned(corridor(offset_m=-(0.9 - 0.155 - beside_m)), Motion(3.0, 0.0, period_s=0.025))
    assert (command.speed_mps > 3.0) is faster


def test_returns_that_noise_puts_inside_a_standing_car_do_not_hold_it() -> None:
    """A wall 7 cm beside it, ranges that err by 5 cm: some are shorter than the lidar can measure."""
    rng = np.random.default_rng(7)
    scan = corridor(offset_m=-(0.9 - 0.155 - 0.07))
    blocked = 0
    for _ in range(20):
        ranges = np.maximum(scan.ranges_m + 0.05 * rng.standard_normal(len(scan.ranges_m)), 0.0).astype(np.float32)
        here = LidarScan(1, ranges, scan.angles_rad, 0, 0.0, 12.0, scan.x_m)
        blocked += planned(here, Motion(period_s=0.025)).is_blocked
    assert ranges.min() < 0.15 and blocked < 10


def test_with_its_wheels_at_their_stop_it_hardly_speeds_up() -> None:
    """Full lock round a corner: the tyres would hold more than the steering can follow."""
    command = planned(corridor(heading_rad=1.2, offset_m=-0.4, ahead_m=2.2), Motion(2.3, 0.0, period_s=0.025))
    assert abs(command.steering_rad) > 0.4189 and command.speed_mps == pytest.approx(2.45)


@pytest.mark.parametrize(("at", "faster"), [(0.75, True), (0.85, False)])
def test_with_its_wheels_near_their_stop_it_hardly_speeds_up(
    monkeypatch: pytest.MonkeyPatch, at: float, faster: bool
) -> None:
    """Or it runs wide into the wall that it has just backed off from."""
    most_rad = F1TENTH.kinematics.max_steering_rad  # type: ignore[union-attr]
    monkeypatch.setattr(PlannerFTG, "steered_rad", lambda *_: at * most_rad)
    command = planned(corridor(ahead_m=9.0), Motion(1.5, 0.0, period_s=0.025))
    assert (command.speed_mps > 2.0) is faster


def test_the_outline_matters_and_not_the_lidars_place() -> None:
    """The same room, seen from the nose and from the middle, gives almost the same command."""
    commands = [
        planned(corridor(heading_rad=0.3, x_m=x_m), Motion(3.0, 0.0, period_s=0.025)) for x_m in (0.0, 0.165, 0.3)
    ]
    for command in commands[1:]:
        assert command.curvature_pm == pytest.approx(commands[0].curvature_pm, abs=0.12)
        assert command.speed_mps == pytest.approx(commands[0].speed_mps, rel=0.12)


def test_a_wider_body_needs_a_wider_gate() -> None:
    posts = [(2.5, 0.30, 0.05), (2.5, -0.30, 0.05)]
    scan = corridor_scan(0.9, posts=posts, beams=1080, x_m=0.165)
    free = [planned(scan, Motion(period_s=0.025), vehicle_width_m=w, safety_margin_m=0.03).free_m for w in (0.19, 0.5)]
    assert free[0] > 5.0 > 2.6 > free[1]


def test_a_smear_of_the_sweep_is_taken_out() -> None:
    """A lidar that turns while the car does sees a bent wall; with the time of each beam it is straight again."""
    scan = corridor(heading_rad=0.2)
    still = planned(scan, Motion(4.0, 0.0, period_s=0.025))
    race = FtgRace(FtgRaceConfig(), None, F1TENTH)
    planner = race._planner
    assert isinstance(planner, PlannerFTG)
    binned = race._preprocessor.process(scan, Motion(4.0, 1.5, sweep_s=0.1))
    x, y = planner.points(binned)
    binned = race._preprocessor.process(scan, Motion(4.0, 1.5))
    x0, y0 = planner.points(binned)
    gone = np.hypot(x - x0, y - y0)
    # the beams go round from right to left: the last ones were sent just now
    assert gone[-10] < 0.05 < gone[10] and still.speed_mps > 0.0


def test_between_slow_scans_the_car_follows_its_own_way() -> None:
    race = FtgRace(FtgRaceConfig(), None, F1TENTH)
    answers = []
    for tick in range(26):
        now = (tick + 1) * S // 50
        scan = corridor(stamp_ns=now - now % (S // 10), heading_rad=0.25, ahead_m=5.0)
        odometry = Odometry(now, 0.0, 0.0, 0.0, 4.0, 0.0, 0.3)
        answers.append(race.step(Sees(now_ns=now, scan=scan, odometry=odometry, track=None, located=None)))
    late = [answer.steering_rad for answer in answers[20:25] if isinstance(answer, Steer)]
    assert len(set(late)) == 5


def test_dead_reckoning_from_what_was_told() -> None:
    way = WaySince()
    assert way.since(0, S) == (0.0, 0.0, 0.0)
    for tenth in range(11):
        way.add(tenth * S // 10, 2.0, math.pi / 2.0)
    x, y, yaw = way.since(0, S)
    # a quarter turn at 2 m/s in one second
    radius = 2.0 / (math.pi / 2.0)
    assert (x, y, yaw) == pytest.approx((radius, radius, math.pi / 2.0))
    assert way.since(S // 2, S)[2] == pytest.approx(math.pi / 4.0)


# ------------------------------------------------------------------------------------------------ recovery


def walled(stamp_ns: int, behind_m: float = 3.0) -> LidarScan:
    """The nose 10 cm before a wall, more room to the left."""
    return box_scan(0.555, 1.2, behind_m, 0.5, stamp_ns=stamp_ns, beams=1080, x_m=0.165)


def recovered(behind_m: float = 3.0, robot: Robot = F1TENTH, seconds: float = 1.0, **keys: Any) -> tuple[Any, FtgRace]:
    race = FtgRace(FtgRaceConfig(**keys), None, robot)
    result: Any = None
    for step in range(round(seconds * 40)):
        result = race.step(seen(walled((step + 1) * TICK_NS, behind_m)))
    return result, race


def test_before_a_wall_it_backs_off_and_turns_its_nose_to_the_free_side() -> None:
    result, race = recovered()
    assert race._recovery.state is State.REVERSE
    assert result.speed_mps < 0.0 and result.steering_rad < 0.0


@pytest.mark.parametrize(
    ("why", "keys"),
    [("the car cannot", {"can_reverse": False}), ("it must not", {"recover": False})],
)
def test_it_stands_where(why: str, keys: dict[str, Any]) -> None:
    result, race = recovered(**keys)
    assert (result.speed_mps, race._recovery.state) == (0.0, State.STUCK), why


def test_it_looks_behind_first() -> None:
    result, _ = recovered(behind_m=0.15)
    assert result.speed_mps == 0.0


def test_without_eyes_behind_it_goes_back_less_far() -> None:
    """A lidar of 270 degrees: after `reverse_blind_m` it stops."""
    config = FtgRaceConfig()
    recovery = Recovery(config, body_of(F1TENTH))
    race = FtgRace(config, None, F1TENTH)
    scan = walled(1)
    ahead = np.abs(scan.angles_rad) < 2.3
    front = LidarScan(1, scan.ranges_m[ahead], scan.angles_rad[ahead], range_max_m=8.0, x_m=0.165)
    gone = 0.0
    for _ in range(200):
        speed = -0.5 if recovery.state is State.REVERSE else 0.0
        binned = race._preprocessor.process(front, Motion(speed, period_s=0.025))
        command = recovery.step(binned, Command(0.0, 0.0, is_blocked=True))
        if gone and recovery.state is not State.REVERSE:
            break
        gone += max(-command.speed_mps, 0.0) * 0.025
    assert 0.0 < gone <= config.reverse_blind_m + 0.1


def test_after_too_many_tries_the_goal_fails() -> None:
    result, race = recovered(behind_m=0.15, seconds=6.0, retries=2)
    assert race._recovery.state is State.FAILED
    assert "stuck" in result.reason
