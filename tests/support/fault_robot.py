"""A whole robot of real drivers on faked lines, on virtual time: a lidar, a mecanum base, and a driver."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import pytest

from robotd.authoring.behaviour import Behaviour
from robotd.authoring.config import NoConfig
from robotd.authoring.device import DeviceContext
from robotd.authoring.view import View, every
from robotd.engine.loops import virtual_loop
from robotd.engine.parts import BehaviourPart, DevicePart, Parts
from robotd.engine.runtime import Runtime
from robotd.safety.operator import Arm
from robotd.safety.settings import GuardConfig, Zones
from robotd.world.kinematics import Mecanum
from robotd.world.messages import Drive, LidarScan
from robotd.world.robot import Limits, Robot
from robotd_devices.lidar import rplidar
from robotd_devices.lidar.rplidar import Rplidar, RplidarConfig
from robotd_devices.lidar.rplidar_fake import RplidarFake
from robotd_devices.motor.rosmaster import Rosmaster, RosmasterConfig
from robotd_devices.motor.rosmaster_fake import RosmasterFake
from robotd_devices.ports.memory_host import MemoryHost

BODY = Robot(
    kinematics=Mecanum(wheelbase_m=0.16, track_m=0.17, wheel_radius_m=0.0325),
    limits=Limits(vx_mps=1.0, wz_radps=3.0, accel_mps2=1e6, decel_mps2=1e6, angular_accel_radps2=1e6),
)
BLIND_DRIVER = GuardConfig(zones=Zones(off="the drivers are tested here, not the guard"))
STALE_S = 0.25


class Sees(View):
    scan: LidarScan = every(within_s=STALE_S)


class Onward(Behaviour[NoConfig, Sees]):
    """Drives on as long as it sees anything."""

    def step(self, seen: Sees) -> Drive:
        return Drive(0.3, 0.4)


class FaultRobot:
    """The two fakes, the lines that they hang on, and the runtime above."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, model: str = "a1", guard: GuardConfig = BLIND_DRIVER) -> None:
        self.lidar = RplidarFake(model)
        self.wheels = RosmasterFake()
        self.lidar_line = MemoryHost(self.lidar, self.lidar.model.baud)
        self.wheel_line = line = MemoryHost(self.wheels, 115_200)
        self.scans: list[tuple[int, LidarScan]] = []
        """Every scan that was published, with the time at which it was."""
        monkeypatch.setattr(rplidar, "serial_port", self.lidar_line.port)
        taken = self.scans

        class Wheels(Rosmaster):
            def __init__(self, config: RosmasterConfig, context: DeviceContext | None = None) -> None:
                super().__init__(config, context, make_port=line.port)

        class Lidar(Rplidar):
            def publish(self, message: LidarScan) -> None:
                taken.append((self.context.clock.now_ns(), message))
                super().publish(message)

        devices = (
            DevicePart("wheels", Wheels, RosmasterConfig(port="/dev/wheels")),
            DevicePart("lidar", Lidar, RplidarConfig(port="/dev/lidar", baud=self.lidar.model.baud)),
        )
        onward = BehaviourPart("onward", Onward, NoConfig(), 10, start=True)
        parts = Parts(BODY, devices, (), (onward,), guard=guard, arm_at_start=True)
        self.runtime = Runtime(parts, virtual=True)

    def run(self, duration_s: float, *events: tuple[float, Callable[[], object]]) -> None:
        """Run; `events` are (instant in seconds, what to do then)."""

        def started(running: Runtime) -> None:
            loop: Any = asyncio.get_running_loop()
            for at_s, do in events:
                loop.call_at(at_s, do)
            loop.call_at(duration_s, running.stop)

        with asyncio.Runner(loop_factory=virtual_loop) as runner:
            runner.run(self.runtime.run(started))

    def arm(self) -> None:
        """Somebody arms the robot."""
        loop: Any = asyncio.get_running_loop()
        self.runtime.core.request(Arm("somebody"), loop.now_ns())

    def device(self, name: str) -> Any:
        """A device as the runtime keeps it: state, faults, losses."""
        return next(kept for kept in self.runtime.devices if kept.name == name)

    def drove_at(self, at_s: float) -> bool:
        """Whether the wheels were told to turn at an instant: what their controller heard last."""
        told = [velocity for ns, velocity in self.wheels.told if ns <= at_s * 1e9]
        return bool(told) and any(told[-1])

    def stood_after(self, at_s: float) -> float:
        """Seconds from an instant to the stop that the wheels' controller heard; it must have driven until then."""
        assert self.drove_at(at_s), "the wheels did not turn when the fault came"
        return next(ns for ns, velocity in self.wheels.told if ns > at_s * 1e9 and not any(velocity)) / 1e9 - at_s
