"""Robots for measuring the core: real parser, shipped guard, real encoder, stamps where a figure begins and ends."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from robotd.authoring.behaviour import Behaviour
from robotd.authoring.config import Config, NoConfig
from robotd.authoring.device import Actuator, DeviceContext, Sensor
from robotd.authoring.perceptor import Perceptor
from robotd.authoring.view import View, every, needed
from robotd.safety.settings import GuardConfig
from robotd.setup.load import load_config
from robotd.world.messages import CameraFrame, Drive, LidarScan, Message, Target
from robotd.world.robot import Robot
from robotd_devices.lidar.ld19 import Ld19, Ld19Config
from robotd_devices.lidar.ld19_fake import BoxRoom, Ld19Fake
from robotd_devices.lidar.ld_packets import encode
from robotd_devices.motor.jetbot_wheels import Base, Speeds, WheelModel, plan

ROTATION_HZ, RATE_HZ = 20.0, 9000.0
"""An LD19 at twice its pace: twice the samples in the same time, 450 points a scan all the same."""
PACKET_NS = round(12 / RATE_HZ * 1e9)
TURN_NS = round(1e9 / ROTATION_HZ)
"""A scan and a frame of all that is compared take place at fixed parts of this time, `phase`, on the loop's clock."""
ROOM = BoxRoom(front_m=2.0, back_m=1.0, left_m=1.5, right_m=0.5)
"""One wall near enough that the zones have points to look at in every scan."""


def jetbot() -> tuple[Robot, GuardConfig]:
    """Body and guard of the shipped JetBot, all zones on."""
    parts = load_config("jetbot.yaml", sim=True).parts
    return parts.robot, parts.guard


def decide(scan: LidarScan) -> Drive:
    """One cheap decision, so that the runtime's share is not hidden behind a costly step: drive, faster where freer."""
    ahead = float(np.fmin.reduce(scan.ranges_m[200:250]))
    return Drive(min(0.25, 0.3 * ahead), 0.0)


class Encoder:
    """From a command to the bytes for the motor chip; remembers what was told last, as the driver does."""

    def __init__(self, robot: Robot) -> None:
        body: Any = robot.kinematics
        self._base = Base(body, WheelModel(dead_band=0.1), WheelModel(dead_band=0.1))
        self._before: Speeds | None = None

    def __call__(self, command: Drive) -> None:
        wanted = self._base.speeds(command)
        plan(0x60, "jetbot", self._before, wanted)
        self._before = wanted

    def stop(self) -> None:
        self._before = None


class ScanView(View):
    scan: LidarScan = every(within_s=0.25)


class Go(Behaviour[NoConfig, ScanView]):
    """Drives by the scan."""

    def step(self, seen: ScanView) -> Drive | None:
        return decide(seen.scan)


class FrameView(View):
    frame: CameraFrame = every(within_s=0.25)


class Spot(Perceptor[NoConfig, FrameView, Target]):
    """The cheapest look at a picture that is still one: a few of its pixels. No two answers in a row are the same."""

    def step(self, seen: FrameView) -> Target | None:
        level = int(seen.frame.bgr[240, 320, 1])
        return Target(seen.frame.stamp_ns, 0.0, 1.0 + level / 255.0 + 0.01 * (seen.frame.sequence % 2))


class SlowConfig(Config):
    """How long the slow look takes."""

    compute_s: float = 0.1


class Slow(Perceptor[SlowConfig, FrameView, Target]):
    """A net that takes its time on a worker; `compute_ns` tells how long each look really took, by its frame."""

    offload: ClassVar[bool] = True
    compute_ns: ClassVar[dict[int, int]] = {}

    def step(self, seen: FrameView) -> Target | None:
        began = time.monotonic_ns()
        time.sleep(self.config.compute_s)
        self.compute_ns[seen.frame.stamp_ns] = time.monotonic_ns() - began
        return Target(seen.frame.stamp_ns, 0.0, 1.0)


class TargetView(View):
    target: Target = every(within_s=1.0)


class Follow(Behaviour[NoConfig, TargetView]):
    """Drives by the target."""

    def step(self, seen: TargetView) -> Drive | None:
        return Drive(0.1 * (seen.target.range_m), 0.0)


class TimedView(View, hz=20):
    scan: LidarScan = needed(within_s=0.25)


class OnTime(Behaviour[NoConfig, TimedView]):
    """Steps on time alone."""

    def step(self, seen: TimedView) -> Drive | None:
        return decide(seen.scan)


@dataclass(slots=True)
class Stamps:
    """Where a turn begins (bytes, publication) and ends (encoded), in nanoseconds; pairs of them in lists."""

    fed_ns: int = 0
    published_ns: int = 0
    from_bytes: list[int] = field(default_factory=list)
    from_publication: list[int] = field(default_factory=list)

    def encoded(self) -> None:
        now_ns = time.perf_counter_ns()
        if self.published_ns:
            self.from_publication.append(now_ns - self.published_ns)
            if self.fed_ns:
                self.from_bytes.append(now_ns - self.fed_ns)
        self.fed_ns = self.published_ns = 0


class StampedConfig(Config):
    """Where a device of the bench finds its bench."""

    model_config = Config.model_config | {"arbitrary_types_allowed": True}
    stamps: Stamps = field(default_factory=Stamps)
    hz: float = 20.0
    phase: float = 0.0
    shape: tuple[int, int] = (480, 640)
    on_apply: Callable[[], None] | None = None


class BenchBase(Actuator[StampedConfig, Drive]):
    """Encodes as the JetBot's driver does, and writes nowhere."""

    def __init__(self, config: StampedConfig, context: DeviceContext | None = None) -> None:
        super().__init__(config, context)
        self._encode = Encoder(self.context.robot)

    def apply(self, command: Drive) -> None:
        self._encode(command)
        self.config.stamps.encoded()
        if self.config.on_apply is not None:
            self.config.on_apply()

    def halt(self) -> None:
        self._encode.stop()


class NullBase(Actuator[NoConfig, Drive]):
    """Takes commands and does nothing with them."""

    def apply(self, command: Drive) -> None:
        pass

    def halt(self) -> None:
        pass


class FedLidarConfig(Ld19Config):
    """An LD19 whose bytes come from the bench."""

    model_config = Ld19Config.model_config | {"arbitrary_types_allowed": True}
    stamps: Stamps = field(default_factory=Stamps)
    phase: float = 0.0


class FedLidar(Ld19):
    """The shipped driver without its port: the bench hands it the bytes of an LD19, packet by packet."""

    config: FedLidarConfig

    async def open(self) -> None:
        self._prepare()
        self._line = Line(self.config.phase, self._take)
        self._line.start()

    async def close(self) -> None:
        self._line.stop()

    def _take(self, data: bytes) -> None:
        self.config.stamps.fed_ns = time.perf_counter_ns()
        self.feed(data)
        self.config.stamps.fed_ns = 0

    def publish(self, message: LidarScan) -> None:
        self.config.stamps.published_ns = time.perf_counter_ns()
        super().publish(message)


FedLidar.config_type = FedLidarConfig


def first_due_ns(now_ns: int, phase: float) -> int:
    """The next instant that lies `phase` of a turn behind a whole number of turns on the loop's clock."""
    phase_ns = round(phase * TURN_NS)
    return now_ns + (phase_ns - now_ns) % TURN_NS


class Line:
    """The bytes of an LD19, a packet at a time, when they would come; revolutions end at `phase` of a turn.

    What came while the loop was held up is handed over in one piece, as a kernel's line buffer does.
    """

    def __init__(self, phase: float, take: Callable[[bytes], None]) -> None:
        fake = Ld19Fake(ROOM, rotation_hz=ROTATION_HZ, rate_hz=RATE_HZ, first_deg=180.0)
        self._next = fake.next_packet
        self._take = take
        self._phase = phase
        self._handle: asyncio.TimerHandle | None = None

    def start(self) -> None:
        loop: Any = asyncio.get_running_loop()
        self._loop = loop
        self._due_ns = first_due_ns(loop.now_ns(), self._phase) + PACKET_NS
        self._schedule()

    def stop(self) -> None:
        if self._handle is not None:
            self._handle.cancel()

    def _schedule(self) -> None:
        self._handle = self._loop.call_at_ns(self._due_ns, self._deliver)

    def _deliver(self) -> None:
        data = encode(self._next())
        self._due_ns += PACKET_NS
        while self._due_ns <= self._loop.now_ns():
            data += encode(self._next())
            self._due_ns += PACKET_NS
        self._schedule()
        self._take(data)


class _Beating:
    """A sensor that publishes at a steady rate, stamped now."""

    config: Any
    context: Any

    async def open(self) -> None:
        loop: Any = asyncio.get_running_loop()
        self._loop = loop
        self._period_ns = round(1e9 / self.config.hz)
        self._due_ns = first_due_ns(loop.now_ns(), self.config.phase) - self._period_ns
        self._prepare()
        self._schedule()

    async def close(self) -> None:
        self._handle.cancel()

    def _prepare(self) -> None:
        pass

    def _schedule(self) -> None:
        self._due_ns += self._period_ns
        self._handle = self._loop.call_at_ns(self._due_ns, self._beat)

    def _beat(self) -> None:
        self._schedule()
        message = self.message(self.context.clock.now_ns())
        self.config.stamps.published_ns = time.perf_counter_ns()
        self.context.link.publish(message)

    def message(self, now_ns: int) -> Message:
        raise NotImplementedError


class BeatingCamera(_Beating, Sensor[StampedConfig, CameraFrame]):
    """Pictures of nothing."""

    def _prepare(self) -> None:
        self._picture = np.zeros((*self.config.shape, 3), np.uint8)
        self._picture.flags.writeable = False
        self._sequence = 0

    def message(self, now_ns: int) -> CameraFrame:
        self._sequence += 1
        return CameraFrame(now_ns, self._picture, self._sequence)


class BeatingLidar(_Beating, Sensor[StampedConfig, LidarScan]):
    """The same room over and over, 450 beams, nothing within reach; no ray casting."""

    def _prepare(self) -> None:
        angles = np.linspace(-np.pi, np.pi, 450, endpoint=False)
        self._angles = angles.astype(np.float32)
        self._ranges = BoxRoom()(angles).astype(np.float32)
        self._angles.flags.writeable = self._ranges.flags.writeable = False

    def message(self, now_ns: int) -> LidarScan:
        return LidarScan(now_ns, self._ranges, self._angles, range_min_m=0.02, range_max_m=12.0)

    def _beat(self) -> None:
        self._schedule()
        self.context.link.publish(self.message(self.context.clock.now_ns()))
