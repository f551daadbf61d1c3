"""Motor drivers on a real serial line, a pty, through every back end: motion, the stop, unplug and replug, no leaks."""

from __future__ import annotations

import asyncio
import os
import sys
import time
from pathlib import Path

import pytest
from waiting import until

from robotd.authoring.device import DeviceUnavailable, SerialStop
from robotd.testing import FakeLink, check_actuator, connected
from robotd.world.kinematics import Ackermann
from robotd.world.messages import Imu, Steer
from robotd.world.robot import Robot
from robotd_devices.motor.mc import Kind
from robotd_devices.motor.mc_fake import McFake
from robotd_devices.motor.mc_motors import McConfig, McMotors
from robotd_devices.ports.pty_host import PtyHost
from robotd_devices.ports.serial_port import Backend

BAUD = 921_600
CAR = Robot(kinematics=Ackermann(wheelbase_m=0.257, track_m=0.16, max_steering_rad=0.436))


def motors(path: Path, backend: Backend) -> tuple[McMotors, FakeLink]:
    return connected(McMotors, McConfig(port=str(path), backend=backend), robot=CAR, name="motors")


@pytest.mark.parametrize("backend", ["pyserial", "serialx", "raw"])
async def test_on_a_pty(tmp_path: Path, backend: Backend) -> None:
    fake = McFake()
    with PtyHost(fake, tmp_path / "usb-Maker_car", baud=BAUD) as host:
        device, link = motors(tmp_path / "usb-Maker_*", backend)

        def written() -> list[Kind]:
            return [Kind(frame.kind) for _, frame in fake.log if frame.kind in (Kind.DRIVE, Kind.MODE_SET)]

        def command_or_stop() -> list[bool]:
            return [
                frame.kind == Kind.MODE_SET
                for _, frame in list(fake.log)
                if frame.kind == Kind.DRIVE or frame.payload == b"\x00"
            ]

        await check_actuator(device, written=command_or_stop, is_stop=bool, command=Steer(0.5, 0.1))
        assert written()[0] is Kind.MODE_SET

        await device.open()
        stop = device.stop_line()
        assert isinstance(stop, SerialStop)
        assert stop.path == str(host.link)  # the one that the pattern fitted
        device.apply(Steer(1.0, 0.0))
        await until(lambda: fake.speed_mm_s(time.monotonic_ns()) == 1000)
        await link.until(lambda link: bool(link.of(Imu)))
        device.halt()
        await until(lambda: not fake.auto)

        for i in range(3):
            host.unplug()
            await link.until(lambda link, i=i: len(link.losses) == i + 1, 0.3)  # type: ignore[misc]
            await device.close()
            with pytest.raises(DeviceUnavailable):
                await device.open()
            await device.close()
            host.plug()
            count = len(fake.log)
            await device.open()
            await until(lambda count=count: len(fake.log) > count)
            assert (fake.log[count][1].kind, fake.log[count][1].payload) == (Kind.MODE_SET, b"\x00")
        await device.close()
        assert not fake.auto
        assert link.faults == []


@pytest.mark.skipif(sys.platform != "linux", reason="counts descriptors in /proc")
@pytest.mark.parametrize("backend", ["pyserial", "serialx", "raw"])
async def test_nothing_stays_behind(tmp_path: Path, backend: Backend) -> None:
    with PtyHost(McFake(), tmp_path / "car", baud=BAUD) as host:
        device, _ = motors(tmp_path / "car", backend)

        async def cycle() -> None:
            await device.open()
            device.apply(Steer(1.0, 0.0))
            host.unplug()
            host.plug()
            await device.close()
            await asyncio.sleep(0.01)

        await cycle()
        descriptors, tasks = len(os.listdir("/proc/self/fd")), len(asyncio.all_tasks())
        for _ in range(5):
            await cycle()
        assert len(os.listdir("/proc/self/fd")) == descriptors
        assert len(asyncio.all_tasks()) == tasks
