"""Resident memory of a whole `robotd` process that drives by an LD19 on a pty and motors behind a socket.

Beside it stands the floor: a process that only imports what every robot's config, messages and loop are made of.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from importlib.metadata import entry_points
from pathlib import Path

from benches.core_robots import ROOM
from benches.harness import Context
from robotd_devices.lidar.ld19_fake import Ld19Fake
from robotd_devices.motor.pca9685_fake import Pca9685Fake
from robotd_devices.ports.i2c_fake import FakeI2cBus
from robotd_devices.ports.i2c_host import I2cHost
from robotd_devices.ports.pty_host import PtyHost

_CONFIG = """
robot:
  kinematics: {{type: differential, track_m: 0.118}}
  footprint_m: [[0.06, 0.065], [0.06, -0.065], [-0.12, -0.065], [-0.12, 0.065]]
devices:
  lidar: {{use: ld19, port: {folder}/lidar}}
  motors: {{use: jetbot_motors, bus: "unix:{folder}/i2c"}}
behaviours:
  bench_go: {{priority: 10, start: true}}
operator: {{arm_at_start: true}}
{bridges}
"""
_PLUGIN = """
from robotd import Behaviour, Drive, LidarScan, NoConfig, View, every

class Sees(View):
    scan: LidarScan = every(within_s=0.25)

class Go(Behaviour[NoConfig, Sees]):
    def step(self, seen: Sees) -> Drive | None:
        return Drive(0.05)
"""
_SETTLE_S = 3.0
_FLOOR = """
import asyncio
import sys
import numpy
import pydantic

class Settings(pydantic.BaseModel):
    hz: float = 10.0

async def wait():
    print("ready", flush=True)
    await asyncio.get_running_loop().run_in_executor(None, sys.stdin.read)

asyncio.run(wait())
"""


def measure(ctx: Context) -> None:
    """Without anything else, and with the page; the baseline is the floor."""
    floor_mb = _floor_mb()
    ctx.note(f"resident memory of asyncio, numpy and pydantic alone, without a robot: {floor_mb:.1f} MB")
    ctx.figure("rss_lidar_robot_mb", _resident_mb(""), baseline=floor_mb)
    if entry_points(group="robotd.bridges", name="dashboard"):
        ctx.figure("rss_with_page_mb", _resident_mb("bridges: {dashboard: {port: 0}}"), baseline=floor_mb)
    else:
        ctx.figure("rss_with_page_mb", None, why="there is no page yet")


def _floor_mb() -> float:
    """VmRSS of an idle process that has imported asyncio, numpy and pydantic, and made one model."""
    process = subprocess.Popen([sys.executable, "-c", _FLOOR], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdin is not None and process.stdout is not None
    with process:
        process.stdout.readline()
        return _vm_rss_mb(process.pid)


def _resident_mb(bridges: str) -> float:
    """VmRSS after the robot has driven for a few seconds."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _install(folder / "site")
        (folder / "robot.yaml").write_text(_CONFIG.format(folder=folder, bridges=bridges))
        bus = FakeI2cBus([Pca9685Fake()])
        with I2cHost(bus, folder / "i2c"), PtyHost(Ld19Fake(ROOM), folder / "lidar", baud=230_400):
            command = [sys.executable, "-m", "robotd.cli", "--config", str(folder / "robot.yaml"), "--headless"]
            process = subprocess.Popen(
                command, env={"PYTHONPATH": str(folder / "site"), "PATH": "/usr/bin:/bin"}, stderr=subprocess.PIPE
            )
            try:
                return _once_driving(process, bus)
            finally:
                process.terminate()
                process.communicate(timeout=5.0)


def _once_driving(process: subprocess.Popen[bytes], bus: FakeI2cBus) -> float:
    deadline_s = time.monotonic() + 20.0
    while not any(0x26 <= write.register < 0x46 for write in bus.writes):
        if process.poll() is not None or time.monotonic() > deadline_s:
            process.kill()
            told = process.communicate()[1].decode(errors="replace")
            raise RuntimeError(f"the robot does not drive: {told.strip() or 'it says nothing'}")
        time.sleep(0.05)
    time.sleep(_SETTLE_S)
    return _vm_rss_mb(process.pid)


def _vm_rss_mb(pid: int) -> float:
    """Resident memory in MB (2^20 bytes, as ps and top count)."""
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1]) / 1024.0
    raise RuntimeError("this system does not tell a process's resident memory")


def _install(site: Path) -> None:
    """A distribution with one behaviour, as an outside author's."""
    told = site / "bench_go-0.dist-info"
    told.mkdir(parents=True)
    (site / "bench_go.py").write_text(_PLUGIN)
    (told / "METADATA").write_text("Metadata-Version: 2.1\nName: bench-go\nVersion: 0\n")
    (told / "entry_points.txt").write_text("[robotd.behaviours]\nbench_go = bench_go:Go\n")
