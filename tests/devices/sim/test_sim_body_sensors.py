"""Inertial unit, bumper and battery of the simulated body."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from robotd.world.messages import Drive
from robotd.world.robot import Robot
from robotd_devices.sim import (
    SimBase,
    SimBaseConfig,
    SimBattery,
    SimBatteryConfig,
    SimBumper,
    SimBumperConfig,
    SimImu,
    SimImuConfig,
)
from robotd_devices.sim.maps import map_from_segments

FREE: dict[str, float] = {"lag_s": 0.0, "motor_error": 0.0, "wheel_error": 0.0, "track_error": 0.0, "slip_std": 0.0}
PERFECT = SimBaseConfig(**{**FREE, "dead_band_mps": 0.0, "encoder_ticks": 0})
QUIET = SimImuConfig(
    gyro_noise_radps=0.0,
    gyro_bias_radps=0.0,
    gyro_walk_radps=0.0,
    gyro_error=0.0,
    accel_noise_mps2=0.0,
    accel_bias_mps2=0.0,
)
ROBOT = Robot(footprint_m=((0.1, 0.05), (0.1, -0.05), (-0.1, -0.05), (-0.1, 0.05)))


def feel(rig: Any, device: tuple[type[Any], Any], seconds: float, *script: Any, **more: Any) -> Any:
    run = rig({"base": (SimBase, PERFECT), "it": device}, robot=ROBOT, **{"world_map": map_from_segments(), **more})
    return run.run(seconds, [(at_s, lambda rig, drive=drive: rig.open["base"].apply(drive)) for at_s, drive in script])


def test_a_quiet_imu_feels_turn_gravity_and_the_pull_of_a_circle(rig: Any) -> None:
    found = feel(rig, (SimImu, QUIET), 1.005, (0.0, Drive(0.5, 1.2))).messages["it"]
    assert len(found) == 100
    last = found[-1]
    assert last.wz_radps == pytest.approx(1.2, abs=1e-9)
    assert (last.wx_radps, last.wy_radps) == (0.0, 0.0)
    assert last.ax_mps2 == pytest.approx(0.0, abs=1e-3)
    assert last.ay_mps2 == pytest.approx(0.5 * 1.2, rel=1e-3)
    assert last.az_mps2 == pytest.approx(9.80665)


def test_a_start_and_a_stop_are_felt_with_the_right_sign_and_size(rig: Any) -> None:
    found = feel(rig, (SimImu, QUIET), 1.005, (0.1, Drive(0.4)), (0.6, Drive())).messages["it"]
    ahead = np.array([m.ax_mps2 for m in found]) * 0.01
    assert ahead[:60].sum() == pytest.approx(0.4)
    assert ahead[60:].sum() == pytest.approx(-0.4)


@pytest.mark.parametrize(
    ("key", "value", "axis", "spread", "offset"),
    [
        ("gyro_noise_radps", 0.02, "wz_radps", 0.02, 0.0),
        ("accel_noise_mps2", 0.3, "ax_mps2", 0.3, 0.0),
        ("gyro_bias_radps", 0.05, "wz_radps", 0.0, 0.05),
        ("accel_bias_mps2", 0.2, "ay_mps2", 0.0, 0.2),
    ],
)
def test_noise_and_bias_have_the_size_that_was_asked_for(
    rig: Any, key: str, value: float, axis: str, spread: float, offset: float
) -> None:
    offsets = []
    for seed in range(4):
        imu = (SimImu, QUIET.model_copy(update={key: value}))
        samples = np.array([getattr(m, axis) for m in feel(rig, imu, 4.0, seed=seed).messages["it"]])
        assert samples.std() == pytest.approx(spread, rel=0.15, abs=1e-12)
        offsets.append(float(samples.mean()))
    # a mean of 400 samples is off by a twentieth of their spread
    assert 0.2 * offset <= np.abs(offsets).max() < 4.0 * max(offset, spread / 20.0)


def test_the_bias_walks(rig: Any) -> None:
    imu = (SimImu, QUIET.model_copy(update={"gyro_walk_radps": 0.05}))
    rates = np.array([m.wz_radps for m in feel(rig, imu, 9.0).messages["it"]])
    steps = np.diff(rates)
    assert steps.std() == pytest.approx(0.05 * math.sqrt(0.01), rel=0.15)


@pytest.mark.parametrize(
    ("drive", "where", "closes"),
    [
        (Drive(0.5), {"bearing_rad": 0.0, "arc_rad": 1.0}, True),
        (Drive(0.5), {"bearing_rad": math.pi, "arc_rad": 3.0}, False),
        (Drive(-0.5), {"bearing_rad": math.pi, "arc_rad": 1.0}, True),
        (Drive(-0.5), {"bearing_rad": 0.0, "arc_rad": math.tau}, True),
        (Drive(-0.5), {"bearing_rad": 0.0, "arc_rad": 3.0}, False),
    ],
)
def test_a_bumper_closes_where_it_is_touched(rig: Any, drive: Drive, where: dict[str, float], closes: bool) -> None:
    walls = map_from_segments([(0.5, -1.0, 0.5, 1.0)], circles_m=[(-0.5, 0.0, 0.1)])
    device = (SimBumper, SimBumperConfig(where="front", **where))
    run = feel(rig, device, 3.0, (0.0, drive), (2.0, Drive(-drive.vx_mps)), world_map=walls)
    told = run.messages["it"]
    closed = [m.stamp_ns / 1e9 for m in told if m.closed]
    assert bool(closed) == closes
    assert {m.where for m in told} == {"front"}
    if closes:
        assert closed[-1] == pytest.approx(2.0, abs=0.03), "it opens when the robot drives away"


def test_a_battery_sags_under_load_and_empties(rig: Any) -> None:
    config = SimBatteryConfig(capacity_ah=0.01, idle_a=1.0, drive_a_per_mps=10.0, voltage_noise_v=0.0)
    run = feel(rig, (SimBattery, config), 8.5, (4.0, Drive(0.4)))
    told = run.messages["it"]
    assert [m.current_a for m in told] == pytest.approx([1.0] * 4 + [5.0] * 4)
    # one ampere for 4 s and five for 4 s out of 36 ampere seconds
    assert told[-1].charge == pytest.approx(1.0 - 24.0 / 36.0)
    volts = [m.voltage_v for m in told]
    assert volts == sorted(volts, reverse=True)
    assert volts[3] - volts[4] > 4.0 * config.resistance_ohm
    assert run.world.supply == pytest.approx(told[-1].voltage_v / 12.6)


def test_an_empty_battery_stays_empty(rig: Any) -> None:
    config = SimBatteryConfig(capacity_ah=0.001, voltage_noise_v=0.0)
    told = feel(rig, (SimBattery, config), 9.5).messages["it"]
    assert told[-1].charge == 0.0
    assert told[-1].voltage_v == pytest.approx(9.6 - 0.8 * 0.12)


def test_a_battery_fuller_than_full_is_refused() -> None:
    with pytest.raises(ValueError, match=r"full_v 9\.0 must be more than empty_v"):
        SimBatteryConfig(full_v=9.0)
