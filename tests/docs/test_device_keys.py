"""The tables of keys in docs/devices are the configs: every key in its order, every default."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from robotd.authoring.config import Config
from robotd_devices.battery import Ina219Config
from robotd_devices.camera import CameraConfig
from robotd_devices.gamepad import GamepadConfig
from robotd_devices.imu import Mpu6050Config
from robotd_devices.lidar.ld19 import Ld19Config
from robotd_devices.lidar.rplidar import RplidarConfig
from robotd_devices.lidar.ydlidar import YdlidarConfig
from robotd_devices.motor.arduino_bridge import ArduinoBridgeConfig
from robotd_devices.motor.jetbot import JetBotMotorsConfig
from robotd_devices.motor.mc_motors import McConfig
from robotd_devices.motor.roboclaw import RoboClawConfig
from robotd_devices.motor.rosmaster import RosmasterConfig
from robotd_devices.motor.scmd_motors import ScmdMotorsConfig
from robotd_devices.motor.serial_motor import SerialMotorConfig
from robotd_devices.motor.vesc import VescConfig
from robotd_plugins.bridges.gamepad import GamepadTeleopConfig

PAGES = Path(__file__).resolve().parents[2] / "docs" / "devices"
HEAD = "| key | default | meaning |"
TABLES: list[tuple[str, int, type[Config]]] = [
    ("arduino_bridge", 1, ArduinoBridgeConfig),
    ("camera", 1, CameraConfig),
    ("gamepad", 1, GamepadConfig),
    ("gamepad", 2, GamepadTeleopConfig),
    ("imu", 1, Mpu6050Config),
    ("ina219", 1, Ina219Config),
    ("jetbot_motors", 1, JetBotMotorsConfig),
    ("ld19", 1, Ld19Config),
    ("mc", 1, McConfig),
    ("roboclaw", 1, RoboClawConfig),
    ("rosmaster", 1, RosmasterConfig),
    ("rplidar", 1, RplidarConfig),
    ("scmd", 1, ScmdMotorsConfig),
    ("serial_motors", 1, SerialMotorConfig),
    ("vesc", 1, VescConfig),
    ("ydlidar", 1, YdlidarConfig),
]
IN_WORDS = {("ina219", "cell_table"), ("serial_motors", "port")}
"""Where a default is too long for a table, or each driver's own."""


def meant(written: str, default: object) -> object:
    """The value that a table writes down: `none`, hexadecimal numbers, words without quotation marks, else JSON."""
    if isinstance(default, str):
        return written
    if written == "none":
        return None
    value = int(written, 16) if written.startswith("0x") else json.loads(written)
    return tuple(value) if isinstance(value, list) else value


@pytest.mark.parametrize(("page", "table", "config"), TABLES, ids=lambda value: getattr(value, "__name__", str(value)))
def test_page_names_every_key_with_its_default(page: str, table: int, config: type[Config]) -> None:
    rows = (PAGES / f"{page}.md").read_text(encoding="utf-8").split(HEAD)[table].split("\n\n", 1)[0]
    told = dict(re.findall(r"^\| `(\w+)` \| `?([^|`]*?)`? \|", rows, re.MULTILINE))
    real = {key: field.default for key, field in config.model_fields.items()}
    assert list(told) == list(real)
    plain = {key: default for key, default in real.items() if (page, key) not in IN_WORDS}
    assert {key: meant(told[key], default) for key, default in plain.items()} == plain


def test_every_table_of_the_pages_is_held_to_a_config() -> None:
    found = [(page.stem, n + 1) for page in sorted(PAGES.glob("*.md")) for n in range(page.read_text().count(HEAD))]
    assert found == [(page, table) for page, table, _ in TABLES]
