"""docs/behaviours/ftg_race.md names every key with both defaults, and every class of the seed with its place."""

from __future__ import annotations

import importlib
import json
import re
from pathlib import Path
from typing import Any

import pytest

from robotd import Config
from robotd_plugins.behaviours.ftg_race import FtgRaceConfig
from robotd_plugins.behaviours.ftg_race.config import SEED_SAFE
from robotd_plugins.perception.race_track.config import RaceTrackConfig
from robotd_plugins.perception.track_position.config import TrackPositionConfig
from robotd_plugins.perception.track_survey.config import TrackSurveyConfig

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "behaviours" / "ftg_race.md").read_text(encoding="utf-8")
HOME = "robotd_plugins.behaviours.ftg_race"


def written(value: Any) -> str:
    """A value as the table writes it."""
    return value if isinstance(value, str) else json.dumps(round(value, 6) if isinstance(value, float) else value)


def test_the_table_of_keys_is_the_config() -> None:
    section = PAGE.split("## Parameters", 1)[1].split("\n## ", 1)[0]
    told = re.findall(r"^\| `(\w+)` \| `([^`]*)` \| (?:`([^`]*)`)? \|", section, re.MULTILINE)
    expected = [
        (key, written(field.default), written(SEED_SAFE[key]) if key in SEED_SAFE else "")
        for key, field in FtgRaceConfig.model_fields.items()
    ]
    assert told == expected


@pytest.mark.parametrize("name", sorted(set(re.findall(r"`(\w+\.[A-Za-z]\w+)`", PAGE.split("## The seed")[1]))))
def test_what_the_page_names_is_there(name: str) -> None:
    module, _, attribute = name.partition(".")
    if attribute not in ("py", "h", "yaml", "md"):
        assert hasattr(importlib.import_module(f"{HOME}.{module}"), attribute)


@pytest.mark.parametrize("config", [TrackSurveyConfig, RaceTrackConfig, TrackPositionConfig])
def test_the_tables_of_the_perceptors_are_their_configs(config: type[Config]) -> None:
    section = PAGE.split("## Parameters of the three perceptors", 1)[1].split("\n## ", 1)[0]
    tables = [re.findall(r"^\| `(\w+)` \| `([^`]*)` \|", part, re.MULTILINE) for part in section.split("| key |")[1:]]
    assert [(key, written(field.default)) for key, field in config.model_fields.items()] in tables
    assert len(tables) == 3
