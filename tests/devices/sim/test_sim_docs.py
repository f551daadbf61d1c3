"""docs/simulator.md names every key with its default, and its example map loads."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from robotd_devices.sim import FlatWorld, SimBase, SimCamera, SimLidar, load_map

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "simulator.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("name", "cls"),
    [("flat_world", FlatWorld), ("sim_base", SimBase), ("sim_lidar", SimLidar), ("sim_camera", SimCamera)],
)
def test_the_table_of_keys_is_the_config(name: str, cls: Any) -> None:
    section = PAGE.split(f"\n`{name}`", 1)[1].split("\n\n`", 1)[0]
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
    assert (len(world.segments_m), len(world.circles_m), len(world.lines)) == (4, 1, 1)
