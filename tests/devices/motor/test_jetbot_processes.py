"""The JetBot's motors across processes: a chip behind a socket, programs that just end, nothing left behind."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
import threading
from pathlib import Path

from jetbot_board import STOP_WRITE, Board
from waiting import until

from robotd.testing import FakeLink, check_actuator, connected
from robotd.world.messages import Drive
from robotd_devices.motor.jetbot import JetBotMotors, JetBotMotorsConfig
from robotd_devices.ports.i2c_bus import EREMOTEIO
from robotd_devices.ports.i2c_host import I2cHost
from robotd_devices.ports.i2c_socket import SocketBus


def on_bus(bus: str) -> tuple[JetBotMotors, FakeLink]:
    return connected(JetBotMotors, JetBotMotorsConfig(bus=bus), name="motors")


async def test_keeps_the_contract_behind_a_socket(tmp_path: Path) -> None:
    bus = Board()
    with I2cHost(bus, tmp_path / "i2c"):
        device, _ = on_bus(f"unix:{tmp_path}/i2c")
        await check_actuator(device, written=lambda: bus.writes, is_stop=lambda write: write == STOP_WRITE)


async def test_another_process_hosts_the_chip_and_a_third_client_reads_its_registers(tmp_path: Path) -> None:
    path = tmp_path / "i2c"
    with subprocess.Popen(  # noqa: ASYNC220  # its answers are one line each, and at once
        [sys.executable, "-m", "robotd_devices.ports.i2c_host", "--socket", str(path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as host:
        assert host.stdin is not None and host.stdout is not None
        assert host.stdout.readline() == "ok\n"
        device, link = on_bus(str(path))
        await device.open()
        device.apply(Drive(0.2, 0.0))
        reader = SocketBus(str(path))
        # int(255 * (0.1 + 0.9 * 0.2)) = 71 of 255, times 16
        await until(lambda: reader.read(0x60, 0x26, 4) == bytes((0x00, 0x00, 0x70, 0x04)))
        for line, answer in [("fail nack 3", "ok"), ("dance", "unknown words 'dance'; known: fail")]:
            host.stdin.write(line + "\n")
            host.stdin.flush()
            assert host.stdout.readline().startswith(answer)
        device.halt()
        await link.until(lambda link: bool(link.losses))
        await until(lambda: reader.read(0x60, 0x29, 1) == b"\x10")  # full off
        log = reader.log()
        assert [entry.error for entry in log if entry.error] == [EREMOTEIO] * 3
        assert (log[0].address, log[0].data) == (0x60, b"\xfd\x10")
        assert reader.log(len(log) - 1)[0] == log[-1]
        await device.close()
        reader.close()
        host.stdin.write("quit\n")
        host.stdin.flush()
        assert host.wait(10.0) == 0
    assert not path.exists()


_LEAVES_WITHOUT_CLOSING = """
import asyncio, sys
from robotd.testing import connected
from robotd.world.messages import Drive
from robotd_devices.motor.jetbot import JetBotMotors, JetBotMotorsConfig

async def main():
    device, link = connected(JetBotMotors, JetBotMotorsConfig(bus=sys.argv[1], odometry_hz=200.0))
    await device.open()
    device.apply(Drive(0.2, 0.0))
    await link.until(lambda link: bool(link.messages) and link.messages[-1].vx_mps > 0.0)

asyncio.run(main())
raise SystemExit(3)
"""


async def test_program_that_ends_without_closing_stops_all_the_same(tmp_path: Path) -> None:
    bus = Board()
    with I2cHost(bus, tmp_path / "i2c"):
        program = await asyncio.create_subprocess_exec(
            sys.executable, "-c", _LEAVES_WITHOUT_CLOSING, str(tmp_path / "i2c")
        )
        assert await program.wait() == 3
        await until(lambda: bus.writes and bus.writes[-1] == STOP_WRITE)
        assert any(write.register == 0x26 for write in bus.writes)


async def test_fifty_losses_leave_nothing_behind(tmp_path: Path) -> None:
    bus = Board()
    with I2cHost(bus, tmp_path / "i2c"):
        device, link = on_bus(str(tmp_path / "i2c"))

        async def lose_and_reopen(count: int) -> None:
            await device.open()
            device.apply(Drive(0.2, 0.0))
            await until(lambda: min(bus.forward) > 0.0)
            bus.fail("nack", times=3)
            device.halt()
            await link.until(lambda link: len(link.losses) == count)
            await device.close()
            assert bus.forward == (0.0, 0.0)

        await lose_and_reopen(1)
        await until(lambda: not left_over())
        before = len(os.listdir("/dev/fd"))
        for count in range(2, 52):
            await lose_and_reopen(count)
        await until(lambda: not left_over() and len(os.listdir("/dev/fd")) <= before)


def left_over() -> list[threading.Thread]:
    """Threads of the driver, and of connections to the host, that still run."""
    return [t for t in threading.enumerate() if t.name.startswith(("i2c writer", "Thread-"))]
