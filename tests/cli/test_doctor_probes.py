"""The doctor's probes: what they read of a machine, from made-up folders and from this one."""

from __future__ import annotations

import os
import pty
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from doctor_facts import PortConfig, part

from robotd.authoring.config import NoConfig
from robotd.authoring.device import Sensor
from robotd.engine.parts import DevicePart
from robotd.setup.doctor.facts import Adapter, Health, Holder
from robotd.setup.doctor.probes import SystemProbes
from robotd.world.messages import LidarScan


def test_this_machine_has_what_robotd_requires() -> None:
    probes = SystemProbes()
    requirements = probes.requirements()
    assert any(line.startswith("numpy") for line in requirements)
    assert not any("hypothesis" in line for line in requirements)
    assert probes.versions(["numpy", "no-such-distribution"]).keys() == {"numpy"}


@pytest.mark.parametrize("make", ["absent", "file", "folder", "socket", "device"])
def test_kinds_of_nodes(make: str, tmp_path: Path) -> None:
    path = tmp_path / "node"
    name = str(path)
    line: socket.socket | None = None
    match make:
        case "file":
            path.touch()
        case "folder":
            path.mkdir()
            (path / "a.JPG").touch()
            (path / "notes.txt").touch()
        case "socket":
            line = socket.socket(socket.AF_UNIX)
            line.bind(name)
        case "device":
            name = "/dev/null"
    node = SystemProbes().node(name)
    if line is not None:
        line.close()
    assert node.kind == make
    assert node.pictures == (1 if make == "folder" else 0)


@pytest.mark.skipif(not Path("/proc/locks").exists(), reason="needs Linux's /proc")
def test_a_port_in_use_names_its_holder() -> None:
    ours, theirs = pty.openpty()
    name = os.ttyname(theirs)
    code = (
        "import fcntl, os, sys\n"
        "port = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY)\n"
        "fcntl.flock(port, fcntl.LOCK_EX)\n"
        "print('held', flush=True)\n"
        "sys.stdin.read()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code, name], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "held\n"
        assert SystemProbes().node(name).holders[0].pid == other.pid
    assert SystemProbes().node(name).holders == ()
    os.close(ours)
    os.close(theirs)


def test_holders_are_read_from_locks_and_descriptors(tmp_path: Path) -> None:
    node = tmp_path / "node"
    node.touch()
    status = os.stat(node)
    where = f"{os.major(status.st_dev):02x}:{os.minor(status.st_dev):02x}:{status.st_ino}"
    (tmp_path / "locks").write_text(
        f"1: FLOCK  ADVISORY  WRITE 41 {where} 0 EOF\n2: -> FLOCK ADVISORY WRITE 42 {where} 0 EOF\n"
        f"3: FLOCK  ADVISORY  WRITE 43 00:00:1 0 EOF\n4: OFDLCK ADVISORY WRITE -1 {where} 0 EOF\nbroken\n"
    )
    for pid, opened in ((44, node), (45, tmp_path / "other")):
        (tmp_path / str(pid) / "fd").mkdir(parents=True)
        (tmp_path / str(pid) / "fd" / "3").symlink_to(opened)
    (tmp_path / "44" / "comm").write_text("minicom\n")
    holders = SystemProbes(proc=tmp_path).holders(str(node), status)
    assert holders == (Holder(41, ""), Holder(44, "minicom"))


def test_candidates_name_each_device_once_and_lastingly(tmp_path: Path) -> None:
    (tmp_path / "serial" / "by-id").mkdir(parents=True)
    for name in ("ttyUSB0", "ttyUSB1", "video0"):
        (tmp_path / name).touch()
    link = tmp_path / "serial" / "by-id" / "usb-lidar"
    link.symlink_to(tmp_path / "ttyUSB0")
    probes = SystemProbes(dev=tmp_path)
    assert probes.candidates("serial port") == [str(link), str(tmp_path / "ttyUSB1")]
    assert probes.candidates("camera") == [str(tmp_path / "video0")]
    assert probes.candidates("file") == []
    assert probes.lasting_name(str(tmp_path / "ttyUSB0")) == str(link)
    assert probes.lasting_name(str(tmp_path / "ttyUSB1")) == ""


@pytest.mark.parametrize(
    ("throttled", "alarm", "milli_celsius", "health"),
    [
        ("", "", "", Health()),
        ("0", "0", "54000", Health()),
        ("50005", "", "60500", Health(True, True, 60.5)),  # as a Raspberry Pi prints it: weak and throttled, now
        ("50000", "", "60500", Health(False, True)),
        ("80008", "", "81000", Health(False, False, 81.0)),
        ("", "1", "", Health(True)),
        ("", "", "91000", Health(celsius=91.0)),
        ("no hex", "", "hot", Health()),
    ],
)
def test_health_of_a_raspberry_pi(
    tmp_path: Path, throttled: str, alarm: str, milli_celsius: str, health: Health
) -> None:
    firmware = tmp_path / "devices" / "platform" / "soc" / "soc:firmware"
    monitor, zone = tmp_path / "class" / "hwmon" / "hwmon1", tmp_path / "class" / "thermal" / "thermal_zone0"
    for folder in (firmware, monitor, zone):
        folder.mkdir(parents=True)
    (firmware / "get_throttled").write_text(f"{throttled}\n")
    (monitor / "name").write_text("rpi_volt\n")
    (monitor / "in0_lcrit_alarm").write_text(f"{alarm}\n")
    (zone / "temp").write_text(f"{milli_celsius}\n")
    assert SystemProbes(sys_folder=tmp_path, here=str(tmp_path / "gone")).health() == health


def test_free_space_of_this_folder() -> None:
    free_mb = SystemProbes(sys_folder=Path("/nowhere")).health().free_mb
    assert free_mb is not None and free_mb >= 0


def usb_port(sys_folder: Path, tty: str, ids: dict[str, str], latency: str = "") -> None:
    """A serial adapter as it stands in /sys: the device, its interface, its port, and the tty that points there."""
    device = sys_folder / "devices" / "usb1" / "1-2"
    port = device / "1-2:1.0" / tty
    port.mkdir(parents=True)
    for name, text in ids.items():
        (device / name).write_text(f"{text}\n")
    if latency:
        (port / "latency_timer").write_text(f"{latency}\n")
    (sys_folder / "ftdi_sio").mkdir()
    (port / "driver").symlink_to(sys_folder / "ftdi_sio")
    (sys_folder / "class" / "tty" / tty).mkdir(parents=True)
    (sys_folder / "class" / "tty" / tty / "device").symlink_to(port)


@pytest.mark.parametrize(
    ("ids", "latency", "adapter"),
    [
        (
            {"idVendor": "0403", "idProduct": "6001", "serial": "A9"},
            "16",
            Adapter("0403", "6001", "A9", "ftdi_sio", 16),
        ),
        ({"idVendor": "1a86", "idProduct": "7523"}, "", Adapter("1a86", "7523", "", "ftdi_sio", None)),
        ({}, "", None),
    ],
)
def test_adapter(tmp_path: Path, ids: dict[str, str], latency: str, adapter: Adapter | None) -> None:
    usb_port(tmp_path, "ttyUSB3", ids, latency)
    assert SystemProbes(sys_folder=tmp_path).adapter("/dev/ttyUSB3") == adapter
    assert SystemProbes(sys_folder=tmp_path).adapter("/dev/ttyUSB4") is None


def test_consoles_and_programs(tmp_path: Path) -> None:
    (tmp_path / "cmdline").write_text("console=serial0,115200 root=/dev/mmcblk0p2 console=tty1 quiet\n")
    (tmp_path / "serial0").symlink_to(tmp_path / "ttyAMA0")
    (tmp_path / "12").mkdir()
    (tmp_path / "12" / "comm").write_text("brltty\n")
    probes = SystemProbes(dev=tmp_path, proc=tmp_path)
    assert probes.consoles() == ["ttyAMA0", "tty1"]
    assert probes.running(["brltty", "ModemManager"]) == {"brltty"}


@pytest.mark.parametrize(("size", "head"), [(0, b""), (100, b"x" * 64)])
def test_head_of_a_file(tmp_path: Path, size: int, head: bytes) -> None:
    (tmp_path / "model").write_bytes(b"x" * size)
    assert SystemProbes().node(str(tmp_path / "model")).head == head


def test_reachable() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        assert SystemProbes().reachable("127.0.0.1", port) == ""
    assert SystemProbes().reachable("127.0.0.1", port) != ""


def test_account() -> None:
    account = SystemProbes().account()
    assert account.user
    assert account.groups


def test_load_error() -> None:
    class Heavy(Sensor[NoConfig, LidarScan]):
        @classmethod
        def load(cls, config: Any) -> None:
            raise ModuleNotFoundError("No module named 'x'", name="x")

    assert isinstance(SystemProbes().load_error(DevicePart("lidar", Heavy, NoConfig())), ModuleNotFoundError)
    assert SystemProbes().load_error(part(PortConfig())) is None
