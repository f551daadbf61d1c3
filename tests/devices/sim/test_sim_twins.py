"""Every simulated device can be named in a config by itself: a file that names all of them is good, and they open."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest

from robotd.authoring.device import Actuator, Sensor
from robotd_devices import sim
from robotd_devices.sim.mujoco_devices import MujocoCamera, MujocoLidar

PROJECT = tomllib.loads((Path(__file__).resolve().parents[3] / "pyproject.toml").read_text())["project"]
TWINS = [
    sim.SimBase,
    sim.SimCar,
    sim.SimLidar,
    sim.SimCamera,
    sim.SimImu,
    sim.SimBumper,
    sim.SimBattery,
    MujocoCamera,
    MujocoLidar,
]


@pytest.mark.parametrize("cls", TWINS)
def test_a_simulated_device_is_its_own_twin_under_its_entry_point(cls: Any) -> None:
    module, _, name = PROJECT["entry-points"]["robotd.devices"][cls.sim_twin].partition(":")
    assert name == cls.__name__
    assert cls.__module__.startswith(module)
    assert issubclass(cls, Sensor | Actuator)
    assert cls.emits


@pytest.mark.parametrize("cls", TWINS)
def test_it_says_how_often_it_publishes(cls: Any) -> None:
    config = cls.config_type()
    rate_hz = config.odometry_hz if hasattr(config, "odometry_hz") else config.rate_hz
    assert cls.publish_period_s(config) == pytest.approx(1.0 / rate_hz)
