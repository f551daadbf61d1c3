"""Drivers of motor controllers on fakes in memory, for the tests of each and of what they share."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial
from typing import Any

from robotd.testing import FakeLink, connected
from robotd.world.kinematics import Ackermann, Differential, Kinematics, Mecanum
from robotd.world.robot import Robot
from robotd_devices.motor.serial_motor import SerialMotor
from robotd_devices.motor.serial_motor_fake import MemoryLine
from robotd_devices.ports.fakes import FakeDevice

CAR = Ackermann(wheelbase_m=0.257, track_m=0.16, max_steering_rad=0.436)
TWO_WHEELS = Differential(track_m=0.3, wheel_radius_m=0.05)
MECANUM = Mecanum(wheelbase_m=0.16, track_m=0.17, wheel_radius_m=0.0325)

Motor = SerialMotor[Any, Any]


def motor(cls: type[Motor], fake: FakeDevice, body: Kinematics, **config: Any) -> tuple[Any, FakeLink, MemoryLine]:
    """A driver, not yet open, its link, and the line to its fake."""
    line = MemoryLine(fake)
    made, link = connected(
        partial(cls, make_port=line.make_port),
        cls.config_type.model_validate(config),
        robot=Robot(kinematics=body),
        name="motors",
    )
    return made, link, line


def now_ns() -> int:
    """The loop's time."""
    return round(asyncio.get_running_loop().time() * 1e9)


async def hold(device: Motor, command: Any, seconds: float, hz: float = 50.0) -> None:
    """Apply a command again and again, as the act tick does."""
    until_s = asyncio.get_running_loop().time() + seconds
    while asyncio.get_running_loop().time() < until_s:
        device.apply(command)
        await asyncio.sleep(1.0 / hz)


async def when(done: Callable[[], bool], within_s: float = 5.0) -> float:
    """Wait until something holds, looked at every half millisecond; returns for how long."""
    loop = asyncio.get_running_loop()
    began_s = loop.time()
    async with asyncio.timeout(within_s):
        while True:
            if done():
                return loop.time() - began_s
            await asyncio.sleep(0.0005)
