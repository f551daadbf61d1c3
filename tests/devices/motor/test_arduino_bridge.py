"""ros_arduino_bridge: its commands, its boot, its wheels and signs, its two seconds, odometry, a reset in mid-drive."""

from __future__ import annotations

import asyncio
import math
from statistics import fmean

import pytest
from serial_motors import TWO_WHEELS, hold, motor, now_ns, when

from robotd.authoring.device import DeviceUnavailable
from robotd.testing import virtual_time
from robotd.world.messages import Drive, Odometry
from robotd_devices.motor import arduino_bridge_lines as lines
from robotd_devices.motor.arduino_bridge import ArduinoBridge
from robotd_devices.motor.arduino_bridge_fake import ArduinoBridgeFake

PER_FRAME = 1000 / (math.tau * 0.05) / 30
"""Counts a frame at 1 m/s with the defaults and the tests' wheels: about 106."""


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (b"m 20 -20\r", lines.motors(20, -20)),
        (b"e\r", lines.encoders()),
        (b"u 20:12:0:50\r", lines.gains(20, 12, 0, 50)),
        (b"\rm 0 0\r", lines.STOP),
    ],
)
def test_commands(text: bytes, line: bytes) -> None:
    assert line == text


@pytest.mark.parametrize(
    ("line", "counts"),
    [
        (b"12 -34", (12, -34)),
        (b"-2147483648 2147483647", (-(2**31), 2**31 - 1)),
        (b"OK", None),
        (b"12", None),
        (b"1 2 3", None),
        (b"1 x", None),
        (b"1 1-2", None),
        (b"1 99999999999999", None),
        (b"", None),
    ],
)
def test_counts(line: bytes, counts: tuple[int, int] | None) -> None:
    assert lines.counts_of(line) == counts


def test_lines_in_pieces() -> None:
    reader = lines.LineReader()
    found = [line for byte in b"OK\r\n1 2\r\n" for line in reader.feed(bytes((byte,)))]
    assert found == [b"OK", b"1 2"]
    for _ in range(100):
        assert reader.feed(b"x" * 100) == []
    assert len(reader.feed(b"\n")[0]) <= lines.LONGEST_LINE


# ---------------------------------------------------------------------------------------------- driver


@pytest.mark.parametrize(
    ("config", "drive", "left", "right"),
    [
        ({}, Drive(0.3, 0.0), 0.3, 0.3),
        ({}, Drive(0.3, 0.5), 0.225, 0.375),
        ({"right_reversed": True}, Drive(0.3, 0.5), 0.225, -0.375),
        ({"left_reversed": True}, Drive(-0.3, 0.0), 0.3, -0.3),
        ({}, Drive(0.5, 1.0), 0.35 / 1.3, 0.5),
        ({"frames_hz": 60.0}, Drive(0.3, 0.0), 0.15, 0.15),
    ],
)
@virtual_time
async def test_wheels(config: dict[str, object], drive: Drive, left: float, right: float) -> None:
    fake = ArduinoBridgeFake()
    device, link, _ = motor(ArduinoBridge, fake, TWO_WHEELS, **config)
    await device.open()
    await hold(device, drive, 0.2)
    assert fake.ticks(now_ns()) == (round(left * PER_FRAME), round(right * PER_FRAME))
    assert link.faults == []
    await device.close()


@virtual_time
async def test_boot_is_waited_for_and_gains_are_written() -> None:
    for gains in (None, (10, 5, 1, 40)):
        fake = ArduinoBridgeFake(boot_ms=1800)
        device, _, _ = motor(ArduinoBridge, fake, TWO_WHEELS, gains=gains)
        began_s = asyncio.get_running_loop().time()
        await device.open()
        assert 1.8 <= asyncio.get_running_loop().time() - began_s < 2.1
        await asyncio.sleep(0.05)
        assert fake.gains == (gains or (20, 12, 0, 50))
        await device.close()


@virtual_time
async def test_something_else_on_the_port() -> None:
    class Other(ArduinoBridgeFake):
        def _run(self, now_ns: int) -> None:
            self._say("Invalid Command")

    device, _, _ = motor(ArduinoBridge, Other(), TWO_WHEELS)
    with pytest.raises(DeviceUnavailable, match="built with USE_BASE"):
        await device.open()
    await device.close()


@virtual_time
async def test_firmware_stops_two_seconds_after_the_last_command() -> None:
    fake = ArduinoBridgeFake()
    device, link, _ = motor(ArduinoBridge, fake, TWO_WHEELS)
    await device.open()
    await hold(device, Drive(0.3, 0.0), 0.2)
    assert await when(lambda: fake.ticks(now_ns()) == (0, 0)) == pytest.approx(2.0, abs=0.03)
    assert link.losses == []
    assert ArduinoBridge.watchdog.timeout_ms == 2000
    await device.close()


@virtual_time
async def test_odometry() -> None:
    fake = ArduinoBridgeFake()
    device, link, _ = motor(ArduinoBridge, fake, TWO_WHEELS, right_reversed=True)
    await device.open()
    await hold(device, Drive(0.3, 0.3), 5.0)
    device.halt()
    await asyncio.sleep(0.2)
    last = link.of(Odometry)[-1]
    # whole counts a frame, 27 and 37 of them, make 0.302 m/s and 0.314 rad/s of it
    v_mps, wz_radps = 32 / PER_FRAME, 10 / PER_FRAME / 0.3
    yaw_rad = 5.0 * wz_radps
    assert last.yaw_rad == pytest.approx(yaw_rad, abs=0.02)
    assert last.x_m == pytest.approx(v_mps / wz_radps * math.sin(yaw_rad), abs=0.02)
    assert last.y_m == pytest.approx(v_mps / wz_radps * (1.0 - math.cos(yaw_rad)), abs=0.02)
    assert (last.vx_mps, last.wz_radps) == (0.0, 0.0)
    assert fmean(m.vx_mps for m in link.of(Odometry)[10:90]) == pytest.approx(0.3, abs=0.01)
    await device.close()


@virtual_time
async def test_reset_in_mid_drive_is_one_jump() -> None:
    fake = ArduinoBridgeFake(boot_ms=0)
    device, link, _ = motor(ArduinoBridge, fake, TWO_WHEELS)
    await device.open()
    await hold(device, Drive(0.3, 0.0), 2.0)
    x_m = link.of(Odometry)[-1].x_m
    fake.power_on(now_ns())
    await hold(device, Drive(0.3, 0.0), 0.5)
    assert [name for name, _ in link.faults] == ["encoder jumped"]
    assert link.of(Odometry)[-1].x_m == pytest.approx(x_m + 0.13, abs=0.03)
    device.received(b"4\xff2 x\r\n", now_ns())
    assert link.faults[-1][0] == "garbled line"
    await device.close()
