"""A robot small enough for a test: scripted sensors on the virtual loop, a base that writes down what it gets."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from robotd.authoring.config import Config, NoConfig
from robotd.authoring.device import Actuator, DeviceUnavailable, Sensor
from robotd.engine.loops import virtual_loop
from robotd.engine.parts import BehaviourPart, DevicePart, Parts, PerceptorPart
from robotd.engine.runtime import Runtime
from robotd.safety.settings import GuardConfig, Zones
from robotd.world.messages import Command, Drive, LidarScan, Message, Odometry
from robotd.world.robot import Limits, Robot

S = 1_000_000_000
ANGLES = np.linspace(-np.pi, np.pi, 72, endpoint=False).astype(np.float32)
OFF = GuardConfig(zones=Zones(off="a test without obstacles"))
QUICK = Robot(limits=Limits(vx_mps=1.0, wz_radps=3.0, accel_mps2=1e6, decel_mps2=1e6, angular_accel_radps2=1e6))


class ScriptConfig(Config):
    """When a scripted sensor speaks."""

    hz: float = 10.0
    silent_after_s: float = 1e9
    lost_at_s: float = 1e9
    back_after_s: float = 1e9
    range_m: float = 2.0


class _Scripted:
    config: ScriptConfig
    context: Any
    _count = 0
    _opened = 0

    async def open(self) -> None:
        loop: Any = asyncio.get_running_loop()
        now_ns = loop.now_ns()
        if self._opened and now_ns < (self.config.lost_at_s + self.config.back_after_s) * S:
            raise DeviceUnavailable("still unplugged")
        self._opened += 1
        self._timer = loop.call_at_ns(now_ns + round(S / self.config.hz), self._speak)

    def _speak(self) -> None:
        loop: Any = asyncio.get_running_loop()
        now_ns = loop.now_ns()
        if self._opened == 1 and now_ns >= self.config.lost_at_s * S:
            self.lost("unplugged")  # type: ignore[attr-defined]
            return
        if now_ns < self.config.silent_after_s * S:
            self._count += 1
            self.context.link.publish(self.message(now_ns))
        self._timer = loop.call_at_ns(now_ns + round(S / self.config.hz), self._speak)

    def message(self, now_ns: int) -> Message:
        raise NotImplementedError

    async def close(self) -> None:
        self._timer.cancel()


class FakeLidar(_Scripted, Sensor[ScriptConfig, LidarScan]):
    def message(self, now_ns: int) -> LidarScan:
        return LidarScan(now_ns, np.full(72, self.config.range_m, dtype=np.float32), ANGLES)


class FakeOdometry(_Scripted, Sensor[ScriptConfig, Odometry]):
    def message(self, now_ns: int) -> Odometry:
        return Odometry(now_ns, float(self._count), 0.0, 0.0)


class FakeBase(Actuator[NoConfig, Drive]):
    """Writes down (time, command or 'halt')."""

    def __init__(self, config: NoConfig, context: Any = None) -> None:
        super().__init__(config, context)
        self.log: list[tuple[int, Command | str]] = []

    def apply(self, command: Drive) -> None:
        self.log.append((self.context.clock.now_ns(), command))

    def halt(self) -> None:
        self.log.append((self.context.clock.now_ns(), "halt"))

    def at(self, time_s: float) -> Command | str:
        """What the base was doing at an instant."""
        return [what for ns, what in self.log if ns <= time_s * S][-1]


def robot(
    *behaviours: BehaviourPart,
    perceptors: Sequence[PerceptorPart] = (),
    lidar: ScriptConfig | None = None,
    odometry: ScriptConfig | None = None,
    guard: GuardConfig = OFF,
    body: Robot = QUICK,
) -> Parts:
    devices = [DevicePart("base", FakeBase, NoConfig()), DevicePart("lidar", FakeLidar, lidar or ScriptConfig())]
    if odometry is not None:
        devices.append(DevicePart("odometry", FakeOdometry, odometry))
    return Parts(body, tuple(devices), tuple(perceptors), behaviours, guard=guard, arm_at_start=True)


def behaviour(cls: type[Any], priority: int = 10, **more: Any) -> BehaviourPart:
    return BehaviourPart(cls.__name__.lower(), cls, cls.config_type(), priority, start=True, **more)


def perceptor(cls: type[Any], **more: Any) -> PerceptorPart:
    return PerceptorPart(cls.__name__.lower(), cls, cls.config_type(), **more)


def run(
    parts: Parts,
    duration_s: float,
    *events: tuple[float, Callable[[Runtime], object]],
    journal: Any = None,
    pace: float | None = None,
) -> tuple[Runtime, FakeBase]:
    """Run in virtual time; `events` are (instant in seconds, what to do then)."""
    runtime = Runtime(parts, virtual=True, journal=journal)

    def started(running: Runtime) -> None:
        loop: Any = asyncio.get_running_loop()
        for at_s, do in events:
            loop.call_at_ns(round(at_s * S), do, running)
        loop.call_at_ns(round(duration_s * S), running.stop)

    with asyncio.Runner(loop_factory=lambda: virtual_loop(pace)) as runner:
        runner.run(runtime.run(started))
    base = next(kept.device for kept in runtime.devices if kept.name == "base")
    assert isinstance(base, FakeBase)
    return runtime, base
