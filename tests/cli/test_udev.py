"""robotd udev: rules for the ports of a robot, and for all adapters that are known."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from doctor_facts import BusConfig, FakeProbes, PortConfig, part

from robotd import cli
from robotd.setup.doctor.facts import Adapter, Node
from robotd.setup.udev import KNOWN, Port, ports_of, rules_for, rules_for_all

BY_ID = "/dev/serial/by-id/usb-Silicon_Labs_CP2102_0001-if00-port0"
CP2102 = Adapter("10c4", "ea60", "0001", "cp210x")
FTDI = Adapter("0403", "6001", "A9", "ftdi_sio", 16)

# udev(7): KEY or KEY{name}, an operator, a value in quotes; separated by commas
_PAIR = r'[A-Z_]+(?:\{[A-Za-z_]+\})?(?:==|!=|=|\+=|:=)"[^"]*"'
RULE = re.compile(rf"{_PAIR}(?:, {_PAIR})*")


def rules(lines: list[str]) -> list[str]:
    return [line for line in lines if line and not line.startswith("#")]


@pytest.mark.parametrize(
    ("port", "said"),
    [
        (Port("lidar", BY_ID, CP2102), 'SUBSYSTEM=="tty", ATTRS{idVendor}=="10c4", ATTRS{idProduct}=="ea60", ATTRS'),
        (Port("lidar", BY_ID, CP2102), 'ATTRS{serial}=="0001", GROUP="dialout", MODE="0660", SYMLINK+="robotd_lidar"'),
        (Port("lidar", BY_ID, CP2102), 'SUBSYSTEM=="usb", ATTR{idVendor}=="10c4", ATTR{idProduct}=="ea60", ENV{ID_MM'),
        (Port("lidar", BY_ID, CP2102), 'ENV{BRLTTY_BRAILLE_DRIVER}="", ENV{SYSTEMD_WANTS}=""'),
        (Port("m", "/dev/ttyUSB0", FTDI), 'DRIVER=="ftdi_sio", ATTR{latency_timer}="1"'),
        (Port("m", "/dev/ttyUSB0", Adapter("1a86", "7523")), "# it has no serial number"),
        (Port("m", "/dev/x", Adapter("1a86", "7523", 'a"\n, b')), 'ATTRS{serial}=="a??? b"'),
        (Port("front-lidar 2", BY_ID, CP2102), 'SYMLINK+="robotd_front_lidar_2"'),
        (Port("lidar", BY_ID), 'ENV{ID_SERIAL}=="Silicon_Labs_CP2102_0001", GROUP="dialout"'),
        (Port("lidar", "/dev/serial/by-id/usb-Silicon_Labs_CP210*"), 'ENV{ID_SERIAL}=="Silicon_Labs_CP210*"'),
        (Port("motors", "/dev/ttyAMA0"), 'KERNEL=="ttyAMA0", GROUP="dialout", MODE="0660", SYMLINK+="robotd_motors"'),
        (Port("motors", "/dev/ttyUSB0"), "# nothing is known of it: plug it in"),
    ],
)
def test_rules_of_a_port(port: Port, said: str) -> None:
    lines = rules_for("a.yaml", [port])
    assert any(said in line for line in lines)
    assert f"# {port.name}: {port.path}" in lines


@pytest.mark.parametrize("adapter", [CP2102, FTDI, Adapter("1a86", "55d4", "x")])
def test_only_what_an_adapter_needs(adapter: Adapter) -> None:
    text = "\n".join(rules_for("a.yaml", [Port("a", BY_ID, adapter)]))
    assert ("latency_timer" in text) is (adapter.vendor == "0403")
    assert ("BRLTTY" in text) is (adapter.vendor != "1a86")
    assert "ID_MM_DEVICE_IGNORE" in text


def test_every_rule_can_be_read_by_udev() -> None:
    ports = [Port("lidar", BY_ID, CP2102), Port("m", "/dev/a", FTDI), Port("x", BY_ID), Port("y", "/dev/ttyAMA0")]
    for line in rules([*rules_for("a.yaml", ports), *rules_for_all()]):
        assert RULE.fullmatch(line), line


def test_ports_of_a_robot() -> None:
    parts = [part(PortConfig(port="/dev/serial/*"), "lidar"), part(BusConfig(), "motors"), part(PortConfig(), "arm")]
    probes = FakeProbes({"/dev/serial/a": Node("device")}, adapters={"/dev/serial/a": CP2102})
    assert ports_of(parts, probes) == [Port("lidar", "/dev/serial/*", CP2102), Port("arm", "/dev/ttyUSB0")]


def test_all_known_adapters(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["udev"]) == 0
    out = capsys.readouterr().out
    assert out.splitlines() == rules_for_all()
    assert all(f"# {what}" in out for _, _, what in KNOWN)
    assert "robotd udev | sudo tee /etc/udev/rules.d/99-robotd.rules" in out


def test_for_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["udev", "jetbot.yaml"]) == 0
    out = capsys.readouterr().out
    assert "robotd udev jetbot.yaml | sudo tee" in out
    assert "# lidar: /dev/serial/by-id/usb-Silicon_Labs_CP210*" in out
    assert 'SUBSYSTEM=="i2c-dev", GROUP="i2c"' in out


def test_a_robot_without_ports() -> None:
    assert "# this robot names no serial port" in rules_for("a.yaml", [])
