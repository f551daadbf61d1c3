"""A whole `robotd --config` process on fakes: an LD19 on a paced pty, pictures in a folder, a motor chip on a socket.

The process is asked and told things through a bridge of an outside distribution that is laid beside the config: one
line of JSON in, one line of JSON out, over a Unix socket.
"""

from __future__ import annotations

import json
import os
import select
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from robotd_devices.lidar.ld19_fake import Ld19Fake
from robotd_devices.motor.pca9685_fake import Pca9685Fake
from robotd_devices.ports.fakes import FakeDevice
from robotd_devices.ports.i2c_fake import FakeI2cBus
from robotd_devices.ports.i2c_host import I2cHost
from robotd_devices.ports.pty_host import PtyHost

ROOT = Path(__file__).resolve().parents[2]

_BRIDGE = """
import asyncio, json
from typing import Annotated
from robotd import Bridge, Config, RuntimeLink
from robotd.authoring.bridge import Refused


class LineConfig(Config):
    path: str


class Lines(Bridge[LineConfig]):
    async def run(self, runtime: RuntimeLink) -> None:
        writers = []

        async def serve(reader, writer):
            writers.append(writer)
            while line := await reader.readline():
                name, *arguments = json.loads(line)
                try:
                    answer = getattr(runtime, name)(*arguments)
                    told = {"ok": dict(answer) if answer is not None else None}
                except Refused as refused:
                    told = {"refused": str(refused)}
                writer.write(json.dumps(told).encode() + b"\\n")
            writer.close()

        server = await asyncio.start_unix_server(serve, self.config.path)
        try:
            await server.serve_forever()
        finally:
            for writer in writers:
                writer.close()
            server.close()
"""


def lay_out_bridge(site: Path) -> None:
    """The outside distribution `lines`, as pip would lay it out."""
    told = site / "lines-0.dist-info"
    told.mkdir(parents=True)
    (site / "lines.py").write_text(_BRIDGE)
    (told / "METADATA").write_text("Metadata-Version: 2.1\nName: lines\nVersion: 0\n")
    (told / "entry_points.txt").write_text("[robotd.bridges]\nlines = lines:Lines\n")


class RobotProcess:
    """The process and its surroundings: `with RobotProcess(folder, pictures) as robot: ...`."""

    def __init__(
        self,
        folder: Path,
        pictures: Sequence[Path],
        *,
        lidar: FakeDevice | None = None,
        rate_hz: float = 20.0,
        sets: Sequence[str] = (),
        config: str = "jetbot.yaml",
    ) -> None:
        self.folder = folder
        self.bus = FakeI2cBus([Pca9685Fake()])
        self.log: list[str] = []
        shown = folder / "pictures"
        shown.mkdir()
        for picture in pictures:
            shutil.copy(picture, shown)
        lay_out_bridge(folder / "site")
        self._i2c = I2cHost(self.bus, folder / "i2c")
        self.lidar = PtyHost(lidar if lidar is not None else Ld19Fake(), folder / "lidar", baud=230_400)
        self._sets = [
            f"devices.lidar.port={folder / 'lidar'}",
            f"devices.camera.source={shown}",
            f"devices.camera.rate_hz={rate_hz}",
            f"devices.motors.bus=unix:{folder / 'i2c'}",
            f"bridges.lines={{path: {folder / 'door'}}}",
            *sets,
        ]
        self._config = config
        self._door: socket.socket | None = None

    def __enter__(self) -> RobotProcess:
        self._i2c.start()
        self.lidar.start()
        command = [sys.executable, "-m", "robotd.cli", "--config", self._config, "--headless"]
        for each in self._sets:
            command += ["--set", each]
        self.process = subprocess.Popen(
            command,
            cwd=self.folder,
            env=os.environ | {"PYTHONPATH": str(self.folder / "site")},
            stderr=subprocess.PIPE,
            text=True,
            bufsize=1,
        )
        assert self.process.stderr is not None
        os.set_blocking(self.process.stderr.fileno(), False)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._door is not None:
            self._lines.close()
            self._door.close()
        if self.process.poll() is None:
            self.process.terminate()
        try:
            self.process.communicate(timeout=5.0)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.communicate()
        self.lidar.stop()
        self._i2c.stop()

    # -------------------------------------------------------------------------------------- asking

    def ask(self, name: str, *arguments: Any) -> Any:
        """Call a method of the process's `RuntimeLink`; a refusal raises AssertionError with its reason."""
        told = self._told(name, *arguments)
        assert "refused" not in told, told["refused"]
        return told["ok"]

    def ask_or_refused(self, name: str, *arguments: Any) -> str:
        """Call a method; returns the reason of a refusal, or an empty string."""
        return str(self._told(name, *arguments).get("refused", ""))

    def _told(self, name: str, *arguments: Any) -> dict[str, Any]:
        if self._door is None:
            self.until(self._connected, "its bridge to open")
        assert self._door is not None
        self._door.sendall(json.dumps([name, *arguments]).encode() + b"\n")
        told: dict[str, Any] = json.loads(self._lines.readline())
        return told

    def _connected(self) -> bool:
        door = socket.socket(socket.AF_UNIX)
        door.settimeout(10.0)
        try:
            door.connect(str(self.folder / "door"))
        except OSError:  # not there yet, or bound and not listening yet
            door.close()
            return False
        self._door, self._lines = door, door.makefile("r")
        return True

    @property
    def reason(self) -> str:
        """Why it stands still."""
        return str(self.ask("status")["reason"])

    def device(self, name: str) -> str:
        """State of one device."""
        return str(next(d["state"] for d in self.ask("status")["devices"] if d["name"] == name))

    def until(self, holds: Callable[[], bool], what: str, within_s: float = 20.0) -> None:
        """Wait until something holds; fails with the process's log where it ends or takes too long."""
        deadline_s = time.monotonic() + within_s
        while not holds():
            self._read_log(0.005)
            assert self.process.poll() is None, f"robotd ended with {self.process.returncode}:\n" + "".join(self.log)
            assert time.monotonic() < deadline_s, f"waited {within_s:g} s for {what}:\n" + "".join(self.log)

    def _read_log(self, wait_s: float) -> None:
        assert self.process.stderr is not None
        if select.select([self.process.stderr], [], [], wait_s)[0]:
            self.log.append(self.process.stderr.read() or "")

    # -------------------------------------------------------------------------------------- motors

    def duties(self) -> tuple[int, int]:
        """Duty of the left and the right motor now, 0 to 4095, positive forward, as the chip's registers say."""
        registers = self.bus.read(0x60, 0x06, 64)  # all sixteen outputs in one transaction
        return _duty(registers, 8, 10, 9), _duty(registers, 13, 11, 12)

    def stands(self) -> bool:
        """Whether both motors are off."""
        return self.duties() == (0, 0)


def _duty(registers: bytes, pwm: int, in1: int, in2: int) -> int:
    """One bridge of the Adafruit board; forward on a JetBot is in1 off, in2 on. 0 while it changes its direction."""
    ways = _level(registers, in1), _level(registers, in2)
    sign = {(0, 4096): 1, (4096, 0): -1}.get(ways, 0)
    return sign * _level(registers, pwm)


def _level(registers: bytes, channel: int) -> int:
    """0 (off) to 4096 (full on) of one output."""
    on_low, on_high, off_low, off_high = registers[4 * channel : 4 * channel + 4]
    if off_high & 0x10:
        return 0
    if on_high & 0x10:
        return 4096
    return (off_low | off_high << 8) - (on_low | on_high << 8)
