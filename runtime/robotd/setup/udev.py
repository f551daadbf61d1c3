"""Rules for udev: who may use a robot's ports, a lasting name for each, no delay, and no other program that meddles.

Facts: ModemManager leaves alone what has ID_MM_DEVICE_IGNORE; brltty starts for USB devices that its own rules gave
BRLTTY_BRAILLE_DRIVER and SYSTEMD_WANTS; only FTDI's driver has a latency timer, 16 ms unless set.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from robotd.engine.parts import DevicePart
from robotd.setup.doctor.devices import needs
from robotd.setup.doctor.facts import Adapter, Probes

FILE = "/etc/udev/rules.d/99-robotd.rules"
"""99: after the rules of the system and of brltty, so that ours hold."""

KNOWN: Sequence[tuple[str, str, str]] = (
    ("10c4", "ea60", "Silicon Labs CP210x (RPLIDAR, YDLIDAR and LDROBOT kits)"),
    ("1a86", "7523", "QinHeng CH340"),
    ("1a86", "55d3", "QinHeng CH343"),
    ("1a86", "55d4", "QinHeng CH9102"),
    ("0403", "6001", "FTDI FT232R"),
    ("0403", "6010", "FTDI FT2232"),
    ("0403", "6014", "FTDI FT232H"),
    ("0403", "6015", "FTDI FT231X"),
    ("067b", "2303", "Prolific PL2303"),
    ("0483", "5740", "STMicroelectronics virtual port (VESC, YDLIDAR)"),
    ("03eb", "2404", "RoboClaw"),
    ("303a", "1001", "Espressif ESP32 with USB"),
    ("2341", "*", "Arduino"),
)
"""USB vendor, product, and what it is."""
_BRAILLE = {("10c4", "ea60"), ("1a86", "7523"), ("0403", "6001")}
"""Adapters that brltty takes for a braille display."""

_HEAD = (
    "# Rules of robotd. Install them with",
    f"#   robotd udev{{words}} | sudo tee {FILE}",
    "#   sudo udevadm control --reload-rules && sudo udevadm trigger",
    "# and let the user into the groups: sudo usermod -aG dialout,i2c,video $USER, then log out and in again.",
)


@dataclass(frozen=True, slots=True)
class Port:
    """A serial port of a config: the device that has it, its path, and the adapter behind it, if it is there now."""

    name: str
    path: str
    adapter: Adapter | None = None


def ports_of(parts: Iterable[DevicePart], probes: Probes) -> list[Port]:
    """The serial ports that a robot's devices name; a pattern stands for the one path that it fits."""
    ports: list[Port] = []
    for part in parts:
        for need in needs(part.config):
            if need.kind == "serial port":
                fitting = probes.fitting(need.path)
                path = fitting[0] if len(fitting) == 1 else need.path
                ports.append(Port(part.name, need.path, probes.adapter(path)))
    return ports


def rules_for(file: str, ports: Sequence[Port]) -> list[str]:
    """Lines of a rules file for the ports of one robot."""
    lines = [line.format(words=f" {file}") for line in _HEAD]
    for port in ports:
        lines += ["", f"# {port.name}: {port.path}", *_port_rules(port)]
    return [*lines, "", *_bus_rules()] if ports else [*lines, "", "# this robot names no serial port", *_bus_rules()]


def rules_for_all() -> list[str]:
    """Lines of a rules file for every adapter that robotd knows."""
    lines = [line.format(words="") for line in _HEAD]
    for vendor, product, what in KNOWN:
        lines += ["", f"# {what}", *_adapter_rules(vendor, product)]
    return [*lines, "", *_bus_rules()]


def _port_rules(port: Port) -> list[str]:
    link = "robotd_" + re.sub(r"[^A-Za-z0-9_]", "_", port.name)
    adapter = port.adapter
    if adapter is not None:
        match = f'ATTRS{{idVendor}}=="{adapter.vendor}", ATTRS{{idProduct}}=="{adapter.product}"'
        notes = []
        if adapter.serial:
            match += f', ATTRS{{serial}}=="{_quoted(adapter.serial)}"'
        else:
            notes = ["# it has no serial number: two of this kind cannot be told apart, use /dev/serial/by-path"]
        return [
            *notes,
            f'SUBSYSTEM=="tty", {match}, GROUP="dialout", MODE="0660", SYMLINK+="{link}"',
            *_calm(adapter.vendor, adapter.product),
        ]
    if by_id := re.match(r"/dev/serial/by-id/usb-(.+?)(?:-if[0-9?*]+.*)?\Z", port.path):
        return [
            "# not plugged in now: matched by its name",
            f'SUBSYSTEM=="tty", ENV{{ID_SERIAL}}=="{_quoted(by_id[1])}", GROUP="dialout", MODE="0660", '
            f'ENV{{ID_MM_DEVICE_IGNORE}}="1", SYMLINK+="{link}"',
        ]
    if (tty := os.path.basename(port.path)).startswith(("ttyAMA", "ttyTHS", "ttyS", "serial")):
        return [
            "# a port of the computer itself",
            f'SUBSYSTEM=="tty", KERNEL=="{tty}", GROUP="dialout", MODE="0660", SYMLINK+="{link}"',
        ]
    return ["# nothing is known of it: plug it in and run this again, or name it by /dev/serial/by-id"]


def _adapter_rules(vendor: str, product: str) -> list[str]:
    match = f'ATTRS{{idVendor}}=="{vendor}", ATTRS{{idProduct}}=="{product}"'
    return [f'SUBSYSTEM=="tty", {match}, GROUP="dialout", MODE="0660"', *_calm(vendor, product)]


def _calm(vendor: str, product: str) -> list[str]:
    """Nobody else speaks to this adapter, and it does not wait."""
    usb = f'SUBSYSTEM=="usb", ATTR{{idVendor}}=="{vendor}", ATTR{{idProduct}}=="{product}"'
    lines = [f'{usb}, ENV{{ID_MM_DEVICE_IGNORE}}="1"']
    if (vendor, product) in _BRAILLE:
        lines.append(f'{usb}, ENV{{BRLTTY_BRAILLE_DRIVER}}="", ENV{{SYSTEMD_WANTS}}=""')
    if vendor == "0403":
        lines.append('ACTION=="add", SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", ATTR{latency_timer}="1"')
    return lines


def _bus_rules() -> list[str]:
    return [
        "# I2C buses, cameras, gamepads",
        'SUBSYSTEM=="i2c-dev", GROUP="i2c", MODE="0660"',
        'SUBSYSTEM=="video4linux", GROUP="video", MODE="0660"',
        'SUBSYSTEM=="input", KERNEL=="event*", GROUP="input", MODE="0660"',
    ]


def _quoted(text: str) -> str:
    """Fit to stand between a rule's quotes: what could end the text, or the line, becomes `?`, which fits any sign."""
    return re.sub(r"[^A-Za-z0-9 ._:*?+-]", "?", text)
