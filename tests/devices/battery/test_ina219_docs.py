"""The page in docs/devices names every key with its default."""

from __future__ import annotations

import json
import re
from pathlib import Path

from robotd_devices.battery import Ina219Config

PAGE = Path(__file__).resolve().parents[3] / "docs" / "devices" / "ina219.md"


def test_page_names_every_key_with_its_default() -> None:
    section = PAGE.read_text(encoding="utf-8").split("| key | default | meaning |")[1].split("\n\n", 1)[0]
    told = dict(re.findall(r"^\| `(\w+)` \| `?([^|`]*?)`? \|", section, re.MULTILINE))
    meant = {"none": "null", "0x40": "64", "0x68": "104"}
    real = {key: field.default for key, field in Ina219Config.model_fields.items()}
    assert list(told) == list(real)
    for key, default in real.items():
        if key == "cell_table":
            continue  # told in words
        text = meant.get(told[key], told[key])
        if isinstance(default, tuple):
            default = list(default)
        assert text == default if isinstance(default, str) else json.loads(text) == default, key
