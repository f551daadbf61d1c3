"""docs/behaviours/route_maps.md names every key with its default, and every module and class that is there."""

from __future__ import annotations

import importlib
import json
import re
from pathlib import Path

import pytest

from robotd import Config
from robotd_plugins.behaviours.jetbot_route.intersection_cues import OpenSpaceConfig, OppositeMarkersConfig
from robotd_plugins.behaviours.jetbot_route.route_plan import PlanCosts

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "behaviours" / "route_maps.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("before", "config"),
    [
        ("`PlanCosts`, in", PlanCosts),
        ("`opposite_markers` (", OppositeMarkersConfig),
        ("`open_space` (", OpenSpaceConfig),
    ],
)
def test_the_tables_of_keys_are_the_configs(before: str, config: type[Config]) -> None:
    section = PAGE.split(f"\n{before}", 1)[1]
    table = section[section.index("| key |") :].split("\n\n", 1)[0]
    told = re.findall(r"^\| `(\w+)` \| `(.+?)` \| (.+?) \|$", table, re.MULTILINE)
    assert told == [(key, json.dumps(field.default), field.description) for key, field in config.model_fields.items()]


def test_the_table_of_modules_is_true() -> None:
    table = PAGE[PAGE.index("| module |") :].split("\n\n", 1)[0]
    rows = re.findall(r"^\| `(\w+)` \| (.+?) \|$", table, re.MULTILINE)
    assert len(rows) == 7
    for module, holds in rows:
        home = importlib.import_module(f"robotd_plugins.behaviours.jetbot_route.{module}")
        names = re.findall(r"`(\w+)`", holds)
        assert [name for name in names if not hasattr(home, name)] == []
