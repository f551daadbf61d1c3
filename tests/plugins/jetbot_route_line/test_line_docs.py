"""docs/behaviours/jetbot_route.md names every key with its default, every state, and where the seed's names went."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from robotd import Config
from robotd_plugins.behaviours.jetbot_route import JetBotRouteConfig
from robotd_plugins.behaviours.jetbot_route.states import State
from robotd_plugins.perception.floor_line import FloorLineConfig
from robotd_plugins.toolkit.floor_view import LensConfig

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "behaviours" / "jetbot_route.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("name", "config"), [("floor_line", FloorLineConfig), ("jetbot_route", JetBotRouteConfig), ("lens", LensConfig)]
)
def test_the_table_of_keys_is_the_config(name: str, config: Any) -> None:
    section = PAGE.split("## Parameters", 1)[1].split(f"\n`{name}`", 1)[1].split("\n\n`", 1)[0].split("\n## ", 1)[0]
    told = dict(re.findall(r"^\| `(\w+)` \| `?([^|`]*?)`? \|", section, re.MULTILINE))
    assert told == {
        key: _written(field.get_default(call_default_factory=True)) for key, field in config.model_fields.items()
    }


def _written(default: Any) -> str:
    """A default as the tables write it; a group of keys stands in a table of its own."""
    if isinstance(default, Config):
        return "{}"
    return default if isinstance(default, str) else json.dumps(default)


def test_every_state_is_told() -> None:
    section = PAGE.split("## States", 1)[1].split("\n## ", 1)[0]
    assert re.findall(r"^\| `(\w+)` \|", section, re.MULTILINE) == [state.value for state in State]


@pytest.mark.parametrize(
    "name",
    ["LOOKAHEAD_ROI", "EXECUTION_ROI", "ROI_CENTER_WIDTH_PERCENT", "BASE_SPEED", "TURN_SPEED", "CORRECTION_GAIN",
     "MAX_CORRECTION_ADJ", "SAFE_ZONE_PERCENT", "SCAN_PIXEL_THRESHOLD"],
)  # fmt: skip
def test_a_name_of_the_seed_leads_to_keys_that_exist(name: str) -> None:
    section = PAGE.split("## Where the seed's names are", 1)[1].split("\n## ", 1)[0]
    row = next(line for line in section.splitlines() if line.startswith("|") and f"`{name}`" in line)
    keys = {word for word in re.findall(r"`(\w+)`", row.split("|")[2]) if word.islower()}
    assert keys
    assert keys <= {*FloorLineConfig.model_fields, *JetBotRouteConfig.model_fields}
