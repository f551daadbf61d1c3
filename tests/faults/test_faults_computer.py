"""What the computer itself does: another program on the port, a wall clock that jumps, a program that is held up."""

from __future__ import annotations

import asyncio
import re
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import ClassVar

import pytest
from fault_matrix import answers
from fault_robot import FaultRobot

from robotd.authoring.device import DeviceUnavailable
from robotd.testing import connected, virtual_time
from robotd.world.messages import LidarScan
from robotd_devices.lidar import rplidar
from robotd_devices.lidar.rplidar import Rplidar, RplidarConfig
from robotd_devices.lidar.rplidar_fake import RplidarFake
from robotd_devices.ports.breakable import Breakable
from robotd_devices.ports.memory_host import MemoryHost
from robotd_devices.ports.pty_host import PtyHost

ROOT = Path(__file__).resolve().parents[2]
WRITE_DATES = {"app.py", "record_file.py"}
"""The name of a recording, and its header."""
TURN_NS = 100_000_000
HOLDER = """
import fcntl, os, sys
fd = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY)
fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
print("ok", flush=True)
sys.stdin.read()
"""


class OtherProgram(Breakable):
    """One that has a port open."""

    breaks: ClassVar[Mapping[str, str]] = MappingProxyType({"port in use": "take"})

    def __init__(self, path: str) -> None:
        self._path = path
        self.process: subprocess.Popen[bytes] | None = None

    def take(self, now_ns: int) -> None:
        """Open the port and lock it."""
        command = [sys.executable, "-c", HOLDER, self._path]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        assert self.process.stdout is not None
        assert self.process.stdout.readline() == b"ok\n"

    def end(self) -> None:
        """Let go of it."""
        assert self.process is not None
        self.process.communicate()


class WallClock(Breakable):
    """The time of day, which steps."""

    breaks: ClassVar[Mapping[str, str]] = MappingProxyType({"clock step": "step"})

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self._real, self._real_ns, self._off_s = time.time, time.time_ns, 0
        monkeypatch.setattr(time, "time", lambda: self._real() + self._off_s)
        monkeypatch.setattr(time, "time_ns", lambda: self._real_ns() + self._off_s * 1_000_000_000)

    def step(self, now_ns: int) -> None:
        """An hour ahead, then two back, and so on."""
        self._off_s = 3600 if self._off_s <= 0 else -3600


@pytest.mark.skipif("sys.platform != 'linux'", reason="who holds a port is read from /proc")
@answers(12, "port in use")
async def test_a_port_that_another_program_has_is_refused_by_its_name_before_a_byte_is_written(
    tmp_path: Path, fault: str
) -> None:
    fake = RplidarFake("a1")
    with PtyHost(fake, tmp_path / "lidar", baud=115_200) as host:
        other = OtherProgram(str(host.link))
        other.inject(fault)
        assert other.process is not None
        config = RplidarConfig(port=str(host.link), baud=115_200, backend="raw")
        lidar, link = connected(Rplidar, config)
        with pytest.raises(DeviceUnavailable, match=rf"is in use by .*\(pid {other.process.pid}\): stop it"):
            await lidar.open()
        await lidar.close()
        assert fake.heard == []
        other.end()
        await lidar.open()
        await link.received(1)
        await lidar.close()


@answers(23, "clock step")
def test_a_step_of_the_wall_clock_changes_nothing(monkeypatch: pytest.MonkeyPatch, fault: str) -> None:
    clock = WallClock(monkeypatch)

    def story(*at_s: float) -> tuple[list[int], list[tuple[int, tuple[float, float, float]]]]:
        robot = FaultRobot(monkeypatch)
        robot.run(4.0, *((second, lambda: clock.inject(fault)) for second in at_s))
        assert robot.drove_at(3.99)
        assert robot.device("lidar").faults == robot.device("wheels").faults == {}
        return [scan.stamp_ns for _, scan in robot.scans], robot.wheels.told

    assert story(2.0, 2.5, 3.0) == story()


def test_nobody_asks_for_the_time_of_day_but_those_who_write_it_down() -> None:
    """Whoever measures time by it would be led astray by a step."""
    asks = re.compile(r"\btime\.(time|time_ns|gmtime|localtime)\b|\b(datetime|date)\.(now|utcnow|today)\b")
    found = {
        path.name
        for shelf in ("runtime", "devices", "plugins")
        for path in (ROOT / shelf).rglob("*.py")
        if asks.search(path.read_text(encoding="utf-8"))
    }
    assert found <= WRITE_DATES, f"{found - WRITE_DATES} look at the wall clock: take the device's clock or the loop's"


@pytest.mark.parametrize("model", ["a1", "c1", "s2"])
@answers(24, "program held up")
def test_what_piled_up_while_the_program_was_held_up_is_dated_back_and_what_is_old_is_dropped(
    monkeypatch: pytest.MonkeyPatch, model: str, fault: str
) -> None:
    fake = RplidarFake(model)
    line = MemoryHost(fake, fake.model.baud)
    monkeypatch.setattr(rplidar, "serial_port", line.port)
    lidar, link = connected(Rplidar, RplidarConfig(port="/dev/lidar", baud=fake.model.baud))

    @virtual_time
    async def story() -> None:
        await lidar.open()
        await link.received(4)
        for held_s in (0.12, 0.35, 0.73):
            line.inject(fault)
            await asyncio.sleep(held_s)
            line.mend(fault)
            await asyncio.sleep(0.5)
        await lidar.close()

    story()
    scans = link.of(LidarScan)
    dropped = [name for name, _ in link.faults]
    assert set(dropped) == {"old scan dropped"}
    assert len(dropped) >= 7, "after 0.73 s six turns are too old, after 0.35 s two"
    for scan, arrived_ns in zip(scans, link.arrived_ns, strict=True):
        assert arrived_ns - scan.stamp_ns <= TURN_NS + 2_000_000, "an old scan was given for a new one"
        # a turn ends where the fake's head passes 180 degrees, 50 ms after it passed 0
        off_ns = (scan.stamp_ns - TURN_NS // 2) % TURN_NS
        assert min(off_ns, TURN_NS - off_ns) <= 2_000_000, "the turn is not dated when the head made it"
