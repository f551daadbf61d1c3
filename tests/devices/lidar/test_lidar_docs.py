"""The pages of lidars in docs/devices name every fault that the drivers count."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from robotd_devices.lidar.rplidar import Rplidar
from robotd_devices.lidar.ydlidar import Ydlidar

PAGES = Path(__file__).resolve().parents[3] / "docs" / "devices"


@pytest.mark.parametrize(("page", "device"), [("rplidar", Rplidar), ("ydlidar", Ydlidar)])
def test_page_names_every_fault_that_the_driver_names(page: str, device: type) -> None:
    text = (PAGES / f"{page}.md").read_text(encoding="utf-8")
    assert device.__doc__ is not None
    named = re.findall(r"`([a-z][a-z ]+[a-z])`", device.__doc__)
    assert len(named) >= 10
    assert [fault for fault in named if f"`{fault}`" not in text] == []
