"""The pages of the motor controllers name every key with its default."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from robotd.authoring.config import Config
from robotd_devices.motor.arduino_bridge import ArduinoBridgeConfig
from robotd_devices.motor.mc_motors import McConfig
from robotd_devices.motor.roboclaw import RoboClawConfig
from robotd_devices.motor.rosmaster import RosmasterConfig
from robotd_devices.motor.scmd_motors import ScmdMotorsConfig
from robotd_devices.motor.vesc import VescConfig

PAGES = Path(__file__).resolve().parents[3] / "docs" / "devices"
MEANT = {"none": "null", "0x80": "128", "0x5D": "93"}


@pytest.mark.parametrize(
    ("page", "config"),
    [
        ("mc", McConfig),
        ("vesc", VescConfig),
        ("rosmaster", RosmasterConfig),
        ("roboclaw", RoboClawConfig),
        ("arduino_bridge", ArduinoBridgeConfig),
        ("scmd", ScmdMotorsConfig),
    ],
)
def test_page_names_every_key_with_its_default(page: str, config: type[Config]) -> None:
    text = (PAGES / f"{page}.md").read_text(encoding="utf-8")
    section = text.split("| key | default | meaning |", 1)[1].split("\n\n", 1)[0]
    told = dict(re.findall(r"^\| `(\w+)` \| `?([^|`]*?)`? \|", section, re.MULTILINE))
    real: dict[str, Any] = {key: field.default for key, field in config.model_fields.items()}
    assert list(told) == list(real)
    for key, default in real.items():
        said = MEANT.get(told[key], told[key])
        assert said == default if isinstance(default, str) else json.loads(said) == default, key
