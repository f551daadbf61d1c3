"""The pages of lidars in docs/devices name every key with its default, and every fault that the drivers count."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from robotd.authoring.config import Config
from robotd_devices.lidar.rplidar import Rplidar, RplidarConfig
from robotd_devices.lidar.ydlidar import Ydlidar, YdlidarConfig

PAGES = Path(__file__).resolve().parents[3] / "docs" / "devices"


@pytest.mark.parametrize(("page", "config"), [("rplidar", RplidarConfig), ("ydlidar", YdlidarConfig)])
def test_page_names_every_key_with_its_default(page: str, config: type[Config]) -> None:
    text = (PAGES / f"{page}.md").read_text(encoding="utf-8")
    section = text.split("| key | default | meaning |", 1)[1].split("\n\n", 1)[0]
    told = dict(re.findall(r"^\| `(\w+)` \| `?([^|`]*?)`? \|", section, re.MULTILINE))
    real = {key: field.default for key, field in config.model_fields.items()}
    assert list(told) == list(real)
    for key, default in real.items():
        value = "null" if told[key] == "none" else told[key]
        assert value == default if isinstance(default, str) else json.loads(value) == default, key


@pytest.mark.parametrize(("page", "device"), [("rplidar", Rplidar), ("ydlidar", Ydlidar)])
def test_page_names_every_fault_that_the_driver_names(page: str, device: type) -> None:
    text = (PAGES / f"{page}.md").read_text(encoding="utf-8")
    assert device.__doc__ is not None
    named = re.findall(r"`([a-z][a-z ]+[a-z])`", device.__doc__)
    assert len(named) >= 10
    assert [fault for fault in named if f"`{fault}`" not in text] == []
