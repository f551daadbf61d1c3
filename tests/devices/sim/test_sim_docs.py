"""docs/simulator.md names every key with its default, and its example map loads."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from robotd_devices import sim
from robotd_devices.sim import load_map
from robotd_devices.sim.mujoco_devices import MujocoCamera
from robotd_devices.sim.race_car import SimRaceCar

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "simulator.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("name", "cls"),
    [
        ("flat_world", sim.FlatWorld),
        ("sim_base", sim.SimBase),
        ("sim_car", sim.SimCar),
        ("sim_race_car", SimRaceCar),
        ("sim_lidar", sim.SimLidar),
        ("sim_camera", sim.SimCamera),
        ("sim_imu", sim.SimImu),
        ("sim_bumper", sim.SimBumper),
        ("sim_battery", sim.SimBattery),
        ("mujoco_camera", MujocoCamera),
    ],
)
def test_the_table_of_keys_is_the_config(name: str, cls: Any) -> None:
    section = PAGE.split("## Keys", 1)[1].split(f"\n`{name}`", 1)[1].split("\n\n`", 1)[0]
    told = dict(re.findall(r"^\| `(\w+)` \| `?([^|`]*?)`? \|", section, re.MULTILINE))
    real = {
        key: field.default if isinstance(field.default, str) else json.dumps(field.default)
        for key, field in cls.config_type.model_fields.items()
    }
    assert told == real


def test_the_example_map_loads(tmp_path: Path) -> None:
    file = tmp_path / "example.yaml"
    file.write_text(PAGE.split("```yaml\n", 1)[1].split("```", 1)[0])
    world = load_map(str(file))
    counts = [
        len(part) for part in (world.segments_m, world.circles_m, world.lines, world.boxes, world.cards, world.people)
    ]
    assert counts == [4, 1, 1, 1, 1, 1]
