"""Serial devices to be measured within the whole runtime: each driver, its fake on a pty, and a robot around it."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from benches.guardian_line import LineFake, LineMotors, LineMotorsConfig
from robotd.authoring.behaviour import Behaviour
from robotd.authoring.config import Config, NoConfig
from robotd.authoring.device import Device
from robotd.authoring.view import View, every
from robotd.engine.parts import BehaviourPart, DevicePart, Parts
from robotd.engine.runtime import Runtime
from robotd.safety.operator import Arm
from robotd.safety.settings import GuardConfig, Zones
from robotd.world.kinematics import Ackermann, Differential, Kinematics, Mecanum
from robotd.world.messages import Drive, LidarScan, Steer
from robotd.world.robot import Limits, Robot
from robotd_devices.lidar.ld19 import Ld19, Ld19Config
from robotd_devices.lidar.ld19_fake import Ld19Fake
from robotd_devices.lidar.rplidar import Rplidar, RplidarConfig
from robotd_devices.lidar.rplidar_fake import RplidarFake
from robotd_devices.lidar.ydlidar import Ydlidar, YdlidarConfig
from robotd_devices.lidar.ydlidar_fake import YdlidarFake
from robotd_devices.motor.arduino_bridge import ArduinoBridge, ArduinoBridgeConfig
from robotd_devices.motor.arduino_bridge_fake import ArduinoBridgeFake
from robotd_devices.motor.mc_fake import McFake
from robotd_devices.motor.mc_motors import McConfig, McMotors
from robotd_devices.motor.roboclaw import RoboClaw, RoboClawConfig
from robotd_devices.motor.roboclaw_fake import RoboClawFake
from robotd_devices.motor.rosmaster import Rosmaster, RosmasterConfig
from robotd_devices.motor.rosmaster_fake import RosmasterFake
from robotd_devices.motor.vesc import Vesc, VescConfig
from robotd_devices.motor.vesc_fake import VescFake
from robotd_devices.ports.pty_host import PtyHost

T = TypeVar("T")

ARDUINO_BOOT_S = 1.5
"""The boot loader of an Arduino, which the opening of its port starts."""
_CAR = Ackermann(wheelbase_m=0.257, track_m=0.16, max_steering_rad=0.4)
_WHEELS = Differential(track_m=0.3, wheel_radius_m=0.05)
_MECANUM = Mecanum(wheelbase_m=0.16, track_m=0.17, wheel_radius_m=0.0325)


@dataclass(frozen=True, slots=True)
class SerialDevice:
    """One driver on its fake. `moves`: whether the fake's motors turn at an instant; None for a lidar.

    boot_s: how long the device itself takes until it can answer.
    """

    name: str
    cls: type[Device[Any]]
    config: Callable[[str], Config]
    fake: Callable[[], Any]
    baud: int
    body: Kinematics = _WHEELS
    moves: Callable[[Any, int], bool] | None = None
    boot_s: float = 0.0


LIDARS = (
    SerialDevice("ld19", Ld19, lambda port: Ld19Config(port=port), Ld19Fake, 230_400),
    SerialDevice("rplidar", Rplidar, lambda port: RplidarConfig(port=port), lambda: RplidarFake("a2"), 256_000),
    SerialDevice("ydlidar", Ydlidar, lambda port: YdlidarConfig(port=port), YdlidarFake, 128_000),
)
MOTORS = (
    SerialDevice(
        "mc", McMotors, lambda port: McConfig(port=port), McFake, 921_600, _CAR,
        lambda fake, now_ns: fake.speed_mm_s(now_ns) != 0,
    ),
    SerialDevice(
        "vesc", Vesc, lambda port: VescConfig(port=port), VescFake, 115_200, _CAR,
        lambda fake, now_ns: fake.erpm(now_ns) != 0,
    ),
    SerialDevice(
        "rosmaster", Rosmaster, lambda port: RosmasterConfig(port=port), RosmasterFake, 115_200, _MECANUM,
        lambda fake, now_ns: fake.moving != 0,
    ),
    SerialDevice(
        "roboclaw", RoboClaw, lambda port: RoboClawConfig(port=port), RoboClawFake, 38_400, _WHEELS,
        lambda fake, now_ns: any(fake.speed_qpps(now_ns)),
    ),
    SerialDevice(
        "arduino_bridge", ArduinoBridge, lambda port: ArduinoBridgeConfig(port=port), ArduinoBridgeFake, 57_600,
        _WHEELS, lambda fake, now_ns: any(fake.ticks(now_ns)), boot_s=ARDUINO_BOOT_S,
    ),
)  # fmt: skip
SERIAL = {device.name: device for device in (*LIDARS, *MOTORS)}


class Beat(View, hz=30):
    """Steps on time alone, and not together with the act tick: then a command that the line did not take waits."""


class Roll(Behaviour[NoConfig, Beat]):
    """Never asks for the same twice, so that every step is written to the line."""

    _turn = 0

    def step(self, seen: Beat) -> Drive:
        self._turn += 1
        return Drive(0.2 + 0.1 * (self._turn % 2))


class RollCar(Behaviour[NoConfig, Beat]):
    """The same for a car."""

    emits = Steer
    _turn = 0

    def step(self, seen: Beat) -> Steer:
        self._turn += 1
        return Steer(0.4 + 0.1 * (self._turn % 2), 0.0)


class SeesScan(View):
    scan: LidarScan = every(within_s=1.0)


class Look(Behaviour[NoConfig, SeesScan]):
    """Drives as long as it sees."""

    _turn = 0

    def step(self, seen: SeesScan) -> Drive:
        self._turn += 1
        return Drive(0.2 + 0.1 * (self._turn % 2))


class Stand:
    """A robot around one serial device, armed by hand; a lidar's robot has the motors of the guardian's bench.

    config: what the device's config has other than the defaults.
    """

    def __init__(self, device: SerialDevice, folder: Path, **config: Any) -> None:
        self.device = device
        self._config = config
        self.fake = device.fake()
        self.host = PtyHost(self.fake, folder / device.name, baud=device.baud)
        self.motors = LineFake()
        self._motor_host = PtyHost(self.motors, folder / "motors", baud=115_200) if device.moves is None else None
        self.runtime = Runtime(self._parts())

    def _parts(self) -> Parts:
        device = self.device
        config = device.config(str(self.host.link)).model_copy(update=self._config)
        parts = [DevicePart(device.name, device.cls, config)]
        behaviour: type[Behaviour[Any, Any, Any]] = RollCar if isinstance(device.body, Ackermann) else Roll
        if self._motor_host is not None:
            parts.append(DevicePart("motors", LineMotors, LineMotorsConfig(path=str(self._motor_host.link))))
            behaviour = Look
        return Parts(
            Robot(kinematics=device.body, limits=Limits(accel_mps2=1e6, decel_mps2=1e6)),
            tuple(parts),
            behaviours=(BehaviourPart("go", behaviour, NoConfig(), 1, start=True),),
            guard=GuardConfig(zones=Zones(off="wheels in the air")),
        )

    @contextlib.contextmanager
    def plugged(self) -> Iterator[Stand]:
        """With the fakes on their lines."""
        with contextlib.ExitStack() as stack:
            stack.enter_context(self.host)
            if self._motor_host is not None:
                stack.enter_context(self._motor_host)
            yield self

    async def run(self, session: Callable[[Stand], Any]) -> None:
        """The robot, and beside it what is done to it; ends with that."""
        tasks: list[asyncio.Task[Any]] = []

        def started(runtime: Runtime) -> None:
            tasks.append(asyncio.get_running_loop().create_task(session(self)))
            tasks[0].add_done_callback(lambda task: runtime.stop())

        await self.runtime.run(started)
        await tasks[0]

    @property
    def moves(self) -> bool:
        """Whether the motors turn, on the fake's side of their line."""
        if self.device.moves is not None:
            return self.device.moves(self.fake, time.monotonic_ns())
        return bool(self.motors.heard) and not self.motors.heard[-1].is_stop

    async def until(self, holds: Callable[[], T], within_s: float, what: str) -> T:
        """Look every millisecond until something holds. Raises TimeoutError naming what did not."""
        try:
            async with asyncio.timeout(within_s):
                while not (found := holds()):  # noqa: ASYNC110 (a fake in another thread tells nobody)
                    await asyncio.sleep(0.001)
                return found
        except TimeoutError:
            core = self.runtime.core
            raise TimeoutError(
                f"{self.device.name}: waited {within_s:g} s for {what}; {core.not_ready or core.standing_reason}"
            ) from None

    async def drive(self, within_s: float) -> None:
        """Arm as soon as the robot is ready, and wait until its motors turn. Raises TimeoutError."""
        core = self.runtime.core
        await self.until(lambda: not core.not_ready, within_s, "all devices")
        refused = core.request(Arm("bench"), time.monotonic_ns())
        if refused:
            raise RuntimeError(f"{self.device.name}: not armed: {refused}")
        await self.until(lambda: self.moves, within_s, "motion")
