"""The car twin and the later faults of the wheeled base: kinematics exactly, each imperfection as its value says."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from robotd.authoring.device import DeviceMisconfigured
from robotd.world.kinematics import Ackermann, Differential, Mecanum, advance
from robotd.world.messages import Drive, Steer
from robotd.world.robot import Robot
from robotd_devices.sim import SimBase, SimBaseConfig, SimCar, SimCarConfig
from robotd_devices.sim.maps import map_from_segments
from robotd_devices.sim.wheels import Wheels, WheelSettings

FREE: dict[str, float] = {
    "speed_lag_s": 0.0,
    "accel_mps2": 50.0,
    "dead_band_mps": 0.0,
    "speed_error": 0.0,
    "wheel_error": 0.0,
    "slip_std": 0.0,
    "steering_lag_s": 0.0,
    "steering_rate_radps": 50.0,
    "steering_offset_rad": 0.0,
    "steering_error": 0.0,
    "encoder_step_m": 0.0,
}
CAR = Robot(kinematics=Ackermann(0.257, 0.16, 0.4), footprint_m=((0.3, 0.1), (0.3, -0.1), (-0.1, 0.1), (-0.1, -0.1)))
OPEN = map_from_segments()
STEP_NS = 5_000_000


def drive(rig: Any, seconds: float, command: Steer, seed: int = 0, world_map: Any = OPEN, **values: Any) -> Any:
    run = rig({"car": (SimCar, SimCarConfig(**{**FREE, **values}))}, robot=CAR, world_map=world_map, seed=seed)
    return run.run(seconds, [(0.0, lambda rig: rig.open["car"].apply(command)), (seconds, note)])


def note(rig: Any) -> None:
    """Keeps the velocity from before the car is closed."""
    rig.world.advance()
    rig.messages["velocity"] = [rig.world.velocity]


@pytest.mark.parametrize(("speed", "steering"), [(1.0, 0.0), (1.0, 0.3), (2.0, -0.4), (-0.5, 0.2)])
def test_a_perfect_car_drives_the_arc_of_its_steering(rig: Any, speed: float, steering: float) -> None:
    run = drive(rig, 2.0, Steer(speed, steering))
    # the first steps gain speed and angle as fast as the greatest rates allow
    along = run.world.effort_m and math.hypot(*run.world.pose()[:2])
    turned = run.world.poses(np.array([2_000_000_000]))[0, 2]
    assert run.messages["velocity"][0].wz_radps == pytest.approx(speed * math.tan(steering) / 0.257)
    if steering == 0.0:
        assert along == pytest.approx(2.0, abs=0.02)
    else:
        assert turned == pytest.approx(2.0 * speed * math.tan(steering) / 0.257, rel=0.03)
        told = run.messages["car"][-1]
        exact = advance(told.x_m, told.y_m, told.yaw_rad, run.messages["velocity"][0], 2.0 - told.stamp_ns / 1e9)
        assert run.world.pose()[:2] == pytest.approx(exact[:2], abs=1e-9)


def test_the_front_wheels_turn_no_farther_than_they_can(rig: Any) -> None:
    run = drive(rig, 1.0, Steer(1.0, 1.2))
    assert run.messages["velocity"][0].wz_radps == pytest.approx(math.tan(0.4) / 0.257)


@pytest.mark.parametrize(
    ("values", "at_s", "speed", "steering"),
    [
        ({"accel_mps2": 2.0}, 0.25, 0.5, 0.3),
        ({"speed_lag_s": 0.2}, 0.2, 1.0 - math.exp(-1.0), 0.3),
        ({"steering_rate_radps": 2.0}, 0.1, 1.0, 0.2),
        ({"steering_lag_s": 0.1}, 0.1, 1.0, 0.3 * (1.0 - math.exp(-1.0))),
        ({"dead_band_mps": 0.9}, 0.5, 1.0, 0.3),
        ({"dead_band_mps": 1.0 - 1e-9}, 0.5, 1.0, 0.3),
    ],
)
def test_motor_and_servo_lag_as_told(rig: Any, values: Any, at_s: float, speed: float, steering: float) -> None:
    run = drive(rig, at_s, Steer(1.0, 0.3), **values)
    assert run.messages["velocity"][0].vx_mps == pytest.approx(speed, abs=0.005)
    assert run.messages["velocity"][0].wz_radps == pytest.approx(speed * math.tan(steering) / 0.257, rel=0.01)


def test_a_car_told_less_than_its_dead_band_stands(rig: Any) -> None:
    assert drive(rig, 1.0, Steer(0.04, 0.1), dead_band_mps=0.05).world.pose() == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("values", "seen_on_board"),
    [
        ({"speed_error": 0.2}, True),
        ({"wheel_error": 0.2}, False),
        ({"slip_std": 0.2}, False),
        ({"steering_offset_rad": 0.1}, False),
        ({"steering_error": 0.3}, False),
    ],
)
def test_each_error_follows_from_the_seed_and_is_seen_or_not(rig: Any, values: Any, seen_on_board: bool) -> None:
    runs = [drive(rig, 2.0, Steer(1.0, 0.2), seed=seed, **values) for seed in (1, 1, 2)]
    poses = [run.world.pose() for run in runs]
    assert poses[0] == poses[1] != poses[2]
    told = runs[0].messages["car"][-1]
    true = runs[0].world.poses(np.array([told.stamp_ns]))[0]
    gap_m = math.hypot(true[0] - told.x_m, true[1] - told.y_m)
    assert (gap_m < 1e-6) == seen_on_board
    assert poses[0] != drive(rig, 2.0, Steer(1.0, 0.2), seed=1).world.pose()


def test_halt_stops_and_keeps_the_wheels_turned(rig: Any) -> None:
    run = rig({"car": (SimCar, SimCarConfig())}, robot=CAR, world_map=OPEN)
    run.run(
        4.0,
        [(0.0, lambda rig: rig.open["car"].apply(Steer(1.0, 0.3))), (2.0, lambda rig: rig.open["car"].halt())],
    )
    stopped = [m for m in run.messages["car"] if m.stamp_ns > 3_500_000_000]
    assert {m.vx_mps for m in stopped} == {0.0}
    assert len({m.x_m for m in stopped}) == 1


def test_a_wall_stops_a_car(rig: Any) -> None:
    run = drive(rig, 3.0, Steer(1.0, 0.0), world_map=map_from_segments([(1.5, -1.0, 1.5, 1.0)]))
    assert run.world.pose()[0] == pytest.approx(1.2, abs=0.01)
    assert run.world.collisions == 1


def test_car_and_base_are_refused_on_each_other_s_kinematics(rig: Any) -> None:
    with pytest.raises(DeviceMisconfigured, match=r"sim_car needs .*type: ackermann.*sim_base"):
        rig({"car": (SimCar, SimCarConfig())}, world_map=OPEN).run(0.1)
    with pytest.raises(TypeError, match="takes Steer, not Drive"):
        SimCar(SimCarConfig()).apply(Drive(1.0))  # type: ignore[arg-type]


# ------------------------------------------------------------------------------- wheels of a base, once more

PLAIN: dict[str, float] = {"lag_s": 0.0, "motor_error": 0.0, "wheel_error": 0.0, "track_error": 0.0, "slip_std": 0.0}
DIFFERENTIAL = Differential(0.12)
MECANUM = Mecanum(0.2, 0.2, 0.05)


def turned(kinematics: Any, command: Drive, steps: int, supply: float = 1.0, **values: Any) -> tuple[Wheels, Drive]:
    settings = WheelSettings(**{**PLAIN, "dead_band_mps": 0.0, "encoder_ticks": 0, **values})
    wheels = Wheels(kinematics, settings, np.random.default_rng(0), STEP_NS)
    wheels.command(command, supply)
    body = Drive()
    for _ in range(steps):
        body = wheels.step()
    return wheels, body


@pytest.mark.parametrize("kinematics", [DIFFERENTIAL, MECANUM])
@pytest.mark.parametrize(("vx", "moves"), [(0.019, False), (0.021, True), (-0.019, False), (-0.021, True)])
def test_wheels_told_less_than_the_dead_band_stand(kinematics: Any, vx: float, moves: bool) -> None:
    _, body = turned(kinematics, Drive(vx), 3, dead_band_mps=0.02)
    assert body.vx_mps == pytest.approx(vx if moves else 0.0)


@pytest.mark.parametrize("kinematics", [DIFFERENTIAL, MECANUM])
def test_encoders_tell_whole_ticks_and_lose_none(kinematics: Any) -> None:
    wheels, _ = turned(kinematics, Drive(0.2), 400, encoder_ticks=100)
    tick_m = math.tau * kinematics.wheel_radius_m / 100
    assert wheels.report().vx_mps == pytest.approx(0.2, abs=tick_m / 2.0)
    assert wheels.odometry[0] / tick_m == pytest.approx(round(wheels.odometry[0] / tick_m), abs=1e-6)
    assert 0.4 - tick_m <= wheels.odometry[0] <= 0.4 + 1e-9
    wheels.step()
    slow = wheels.report().vx_mps * 0.005 / tick_m
    assert slow == pytest.approx(round(slow), abs=1e-6), "a short look sees whole ticks"


@pytest.mark.parametrize(("share", "vx"), [(0.0, 0.5), (1.0, 0.4), (0.5, 0.45)])
def test_bare_motors_slow_down_with_the_battery(share: float, vx: float) -> None:
    assert turned(DIFFERENTIAL, Drive(0.5), 1, 0.8, battery_share=share)[1].vx_mps == pytest.approx(vx)


def test_odometry_of_the_default_base_is_coarse_but_true_to_its_wheels(rig: Any) -> None:
    config = SimBaseConfig(**{**PLAIN, "encoder_ticks": 1320})
    run = rig({"base": (SimBase, config)}, world_map=OPEN)
    run.run(3.0, [(0.0, lambda rig: rig.open["base"].apply(Drive(0.2, 0.5)))])
    told = run.messages["base"][-1]
    true = run.world.poses(np.array([told.stamp_ns]))[0]
    assert (told.x_m, told.y_m, told.yaw_rad) == pytest.approx(tuple(true), abs=2e-3)
    assert {m.vx_mps for m in run.messages["base"][5:]} != {told.vx_mps}, "its speed flickers by ticks"
