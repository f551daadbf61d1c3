"""Robots worth recording, built on `small_robot`, and the way from a run to its recording and to a replay."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from small_robot import FakeBase, FakeLidar, FakeOdometry, S, ScriptConfig, _Scripted, behaviour, perceptor, run

from robotd import (
    Behaviour,
    Bridge,
    Config,
    Done,
    Drive,
    Goal,
    LidarScan,
    NoConfig,
    Odometry,
    Perceptor,
    Plan,
    Sensor,
    Sequence,
    Target,
    Topic,
    View,
    every,
    latest,
    needed,
)
from robotd.authoring.behaviour import StepResult
from robotd.engine.codec import decode
from robotd.engine.journal import FORMAT, RunJournal
from robotd.engine.loops import real_loop
from robotd.engine.parts import DevicePart, Parts
from robotd.engine.record_file import RecordWriter, read_record
from robotd.engine.replay import ReplayReport, known_classes, replay
from robotd.engine.runtime import Runtime
from robotd.safety.settings import GuardConfig, SlowZone, StopZone, Zones
from robotd.world.messages import Applied, CameraFrame
from robotd.world.robot import Limits, Robot

NEAR = Topic("near_target", Target)
GUARDED = GuardConfig(zones=Zones(stop=StopZone(), slow=SlowZone(margin_m=0.6)), scan_within_s=0.3)
HEAVY = Robot(limits=Limits(vx_mps=0.8, wz_radps=2.0, accel_mps2=0.7, decel_mps2=1.3, angular_accel_radps2=2.5))


class NoisyLidar(FakeLidar):
    """Walls that come and go, with a noise of its own."""

    def message(self, now_ns: int) -> LidarScan:
        noise = np.random.default_rng(self._count)
        ranges = (self.config.range_m + 0.4 * np.sin(now_ns / 4e8) + noise.normal(0.0, 0.05, 72)).astype(np.float32)
        ranges[::9] = np.inf
        ranges[5] = np.nan
        return LidarScan(now_ns, ranges, np.linspace(-np.pi, np.pi, 72, endpoint=False, dtype=np.float32))


class FakeCamera(_Scripted, Sensor[ScriptConfig, CameraFrame]):
    def message(self, now_ns: int) -> CameraFrame:
        return CameraFrame(now_ns, np.full((12, 16, 3), self._count % 200, np.uint8), self._count, "fake")


class SeesScan(View):
    scan: LidarScan = every(within_s=0.25)


class SeesFrame(View):
    frame: CameraFrame = every(within_s=0.3)


class Nearest(Perceptor[NoConfig, SeesScan, Target]):
    """A quick perceptor with a memory."""

    _before = 0.0

    def step(self, seen: SeesScan) -> Target | None:
        ranges = np.where(np.isfinite(seen.scan.ranges_m), seen.scan.ranges_m, np.inf)
        i = int(np.argmin(ranges))
        self._before = 0.7 * self._before + 0.3 * float(np.tanh(seen.scan.angles_rad[i]))
        return Target(seen.scan.stamp_ns, self._before, float(ranges[i]))


class Bright(Perceptor[NoConfig, SeesFrame, Odometry]):
    """Sees frames: replayed from what it made, unless they were kept. Blind on every third, breaks on `breaks_at`."""

    breaks_at: ClassVar[int] = 10**9

    def step(self, seen: SeesFrame) -> Odometry | None:
        if seen.frame.sequence >= self.breaks_at:
            raise ZeroDivisionError("too bright")
        level = float(seen.frame.bgr.mean()) / 50.0
        return None if seen.frame.sequence % 3 == 0 else Odometry(seen.frame.stamp_ns, level, 0.0, 0.0)


class Slow(Perceptor[NoConfig, SeesScan, Target]):
    """Offloaded; stamps its output with the present, which makes nothing fresher."""

    offload: ClassVar[bool] = True
    sim_latency_s: ClassVar[float] = 0.13
    _count = 0

    def step(self, seen: SeesScan) -> Target | None:
        self._count += 1
        return None if self._count % 4 == 0 else Target(seen.now_ns, 0.02 * self._count)


class GainConfig(Config):
    gain: float = 0.5
    late_gain: float = 0.5
    """From the third second on."""


class SeesNear(View):
    scan: LidarScan = every(within_s=0.25)
    target: Target | None = latest(within_s=0.3)
    slow: Target | None = latest(NEAR, within_s=0.5)
    level: Odometry | None = latest(within_s=0.4)


class Follow(Behaviour[GainConfig, SeesNear]):
    """Steers by everything there is."""

    blind_after_s: ClassVar[float | None] = 0.8

    def step(self, seen: SeesNear) -> StepResult:
        gain = self.config.gain if seen.now_ns < 3 * S else self.config.late_gain
        turn = sum(t.bearing_rad for t in (seen.target, seen.slow) if t is not None)
        level = seen.level.x_m if seen.level is not None else 0.1
        return Drive(0.2 + 0.1 * float(np.sin(level)), gain * float(turn))


class TourGoal(Goal):
    speed_mps: float = 0.3


class Tour(Sequence[NoConfig, SeesScan, TourGoal]):
    """A goal that ends by itself, with pauses."""

    def plan(self, seen: SeesScan) -> Plan[SeesScan]:
        for i in range(4):
            yield Drive(self.goal.speed_mps * (i + 1) / 4)
            yield None
        return Done("round")


class OnTime(View, hz=7):
    scan: LidarScan | None = latest(within_s=0.2)
    slow: Target | None = latest(NEAR, within_s=0.5)


class Idle(Behaviour[NoConfig, OnTime]):
    """Drives when nothing else does; its view steps on time and expires."""

    def step(self, seen: OnTime) -> StepResult:
        return Drive(0.05 if seen.scan is not None else 0.0, 0.1 if seen.slow is not None else 0.2)


class Breaks(Behaviour[NoConfig, SeesScan]):
    def step(self, seen: SeesScan) -> StepResult:
        if seen.now_ns > 3 * S // 2:
            raise ZeroDivisionError("one over nothing")
        return Drive(0.6)


class SeesBoth(View):
    scan: LidarScan = every(within_s=0.25)
    odometry: Odometry = needed(within_s=0.3)


class Needs(Behaviour[NoConfig, SeesBoth]):
    def step(self, seen: SeesBoth) -> StepResult:
        return Drive(0.1 + 0.01 * (seen.odometry.x_m % 7.0))


def rich(
    *,
    lidar: ScriptConfig | None = None,
    gain: GainConfig | None = None,
    timeout_s: float | None = None,
    base: type[FakeBase] = FakeBase,
) -> Parts:
    """Two scan behaviours and one on time; quick, frame and offloaded perceptors; guard with zones; ramps."""
    follow = replace(behaviour(Follow, 50, timeout_s=timeout_s), config=gain or GainConfig())
    return Parts(
        HEAVY,
        (
            DevicePart("base", base, NoConfig()),
            DevicePart("lidar", NoisyLidar, lidar or ScriptConfig(range_m=1.1)),
            DevicePart("camera", FakeCamera, ScriptConfig(hz=8.0)),
        ),
        (perceptor(Nearest), perceptor(Bright), perceptor(Slow, topic=NEAR.name)),
        (follow, replace(behaviour(Tour, 70), start=False), behaviour(Idle, 5), behaviour(Breaks, 60)),
        guard=GUARDED,
        arm_at_start=True,
    )


def plain(**more: Any) -> Parts:
    """Lidar and odometry, one behaviour that needs both."""
    devices = (
        DevicePart("base", FakeBase, NoConfig()),
        DevicePart("lidar", NoisyLidar, ScriptConfig(range_m=1.0)),
        DevicePart("odometry", FakeOdometry, ScriptConfig(hz=20.0, **more)),
    )
    return Parts(HEAVY, devices, (), (behaviour(Needs), behaviour(Idle, 5)), guard=GUARDED, arm_at_start=True)


class PostConfig(Config):
    host: str
    password: str


class Post(Bridge[PostConfig]):
    """Has a secret."""


Event = tuple[float, Callable[[Runtime], object]]


def asks(at_s: float, request: object) -> Event:
    """An operator's request at an instant."""
    return at_s, lambda runtime: runtime.core.request(request, round(at_s * S))  # type: ignore[arg-type]


def record(
    path: Path, parts: Parts, duration_s: float, *events: Event, pace: float | None = None, frames: bool = False
) -> list[Applied]:
    """Record a run in virtual time and return what was written to the base."""
    writer = RecordWriter(path, {"format": FORMAT, "frames": frames}, synchronous=True)
    journal = RunJournal(writer, frames=frames)
    try:
        run(parts, duration_s, *events, journal=journal, pace=pace)
    finally:
        assert journal.close()
    return commands(path, parts)


def record_real(path: Path, parts: Parts, duration_s: float) -> list[Applied]:
    """The same on the real loop, with worker threads and the writing thread."""
    journal = RunJournal(RecordWriter(path, {"format": FORMAT}, synchronous=False))
    runtime = Runtime(parts, journal=journal)

    def started(running: Runtime) -> None:
        loop: Any = asyncio.get_running_loop()
        loop.call_at_ns(loop.now_ns() + round(duration_s * S), running.stop)

    with asyncio.Runner(loop_factory=real_loop) as runner:
        runner.run(runtime.run(started))
    assert journal.close() and journal.dropped == 0
    return commands(path, parts)


def commands(path: Path, parts: Parts) -> list[Applied]:
    """The commands that a recording holds."""
    classes = known_classes(parts)
    return [decode(entry.payload, classes) for entry in read_record(path) if entry.kind == "command"]


def again(path: Path, parts: Parts, tolerance: float = 0.0) -> ReplayReport:
    """Replay through a robot of the same parts."""
    return replay(read_record(path), parts, tolerance)
