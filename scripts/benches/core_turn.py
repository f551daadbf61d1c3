"""From bytes to command through the whole runtime, beside the same functions called by hand in one asyncio task."""

from __future__ import annotations

import asyncio
import time
from statistics import median
from typing import Any

import numpy as np

from benches.core_robots import (
    BeatingCamera,
    BeatingLidar,
    BenchBase,
    Encoder,
    FedLidar,
    FedLidarConfig,
    Follow,
    Go,
    Line,
    Spot,
    StampedConfig,
    Stamps,
    decide,
    jetbot,
)
from benches.harness import Context
from robotd.authoring.config import NoConfig
from robotd.engine.loops import real_loop
from robotd.engine.parts import BehaviourPart, DevicePart, Parts, PerceptorPart
from robotd.engine.runtime import Runtime
from robotd.safety.guard import Guard
from robotd.world.messages import Drive, LidarScan
from robotd_devices.lidar.ld_packets import LdParser
from robotd_devices.lidar.ld_sweep import LdSweep
from robotd_devices.ports.serial_port import SerialSettings

WARM_UP = 20


class Plain:
    """The task that somebody would write without a runtime: parse, step, guard, encode, one after the other."""

    def __init__(self) -> None:
        robot, guard = jetbot()
        self.whole: list[int] = []
        self.bare_min: list[int] = []
        self._guard = Guard(robot, guard)
        self._encode = Encoder(robot)
        settings = SerialSettings("bench", 230_400)
        self._parser = LdParser(settings.byte_ns)
        self._sweep = LdSweep(byte_ns=settings.byte_ns, range_min_m=0.02, range_max_m=12.0, mount=robot.mount("lidar"))

    async def run(self) -> None:
        queue: asyncio.Queue[bytes] = asyncio.Queue()
        line = Line(0.5, queue.put_nowait)
        line.start()
        previous, before_ns = Drive(), time.monotonic_ns()
        try:
            while True:
                data = await queue.get()
                began_ns = time.perf_counter_ns()
                now_ns = time.monotonic_ns()
                for packet in self._parser.feed(data, now_ns):
                    scan = self._sweep.add(packet)
                    if scan is None:
                        continue
                    wanted = decide(scan)
                    sensed = self._guard.sense("lidar_scan", scan)
                    guarded = self._guard.limit(
                        wanted,
                        by="plain",
                        previous=previous,
                        dt_s=(now_ns - before_ns) / 1e9,
                        sensed=[sensed],
                    )
                    assert isinstance(guarded.command, Drive)
                    self._encode(guarded.command)
                    ended_ns = time.perf_counter_ns()
                    previous, before_ns = guarded.command, now_ns
                    self.whole.append(ended_ns - began_ns)
                    self.bare_min.append(_bare_min(scan))
        finally:
            line.stop()


def _bare_min(scan: LidarScan) -> int:
    began_ns = time.perf_counter_ns()
    float(np.min(scan.ranges_m))
    return time.perf_counter_ns() - began_ns


def _scan_robot(stamps: Stamps) -> Parts:
    robot, guard = jetbot()
    devices = (
        DevicePart("motors", BenchBase, StampedConfig(stamps=stamps)),
        DevicePart("lidar", FedLidar, FedLidarConfig(rotation_hz=20.0, stamps=stamps)),
    )
    return Parts(
        robot, devices, (), (BehaviourPart("go", Go, NoConfig(), 10, start=True),), guard=guard, arm_at_start=True
    )


def _frame_robot(stamps: Stamps) -> Parts:
    robot, guard = jetbot()
    devices = (
        DevicePart("motors", BenchBase, StampedConfig(stamps=stamps)),
        DevicePart("lidar", BeatingLidar, StampedConfig(hz=10.0)),
        DevicePart("camera", BeatingCamera, StampedConfig(hz=20.0, stamps=stamps)),
    )
    return Parts(
        robot,
        devices,
        (PerceptorPart("spot", Spot, NoConfig()),),
        (BehaviourPart("follow", Follow, NoConfig(), 10, start=True),),
        guard=guard,
        arm_at_start=True,
    )


async def _side_by_side(scans: Stamps, frames: Stamps, plain: Plain, seconds_s: float) -> None:
    loop: Any = asyncio.get_running_loop()
    robots = [Runtime(_scan_robot(scans)), Runtime(_frame_robot(frames))]

    def stop(running: Runtime) -> None:
        loop.call_later(seconds_s, running.stop)

    task = asyncio.create_task(plain.run())
    try:
        async with asyncio.TaskGroup() as group:
            for robot in robots:
                group.create_task(robot.run(stop))
    finally:
        task.cancel()


def measure(ctx: Context) -> None:
    """Three programs in one loop and one run, each a few milliseconds away from the others, so that all are cold."""
    seconds_s = 14.0 if ctx.quick else 120.0
    scans, frames, plain = Stamps(), Stamps(), Plain()
    with asyncio.Runner(loop_factory=real_loop) as runner:
        runner.run(_side_by_side(scans, frames, plain, seconds_s))
    whole = scans.from_bytes[WARM_UP:]
    by_hand, bare_min = plain.whole[WARM_UP:], plain.bare_min[WARM_UP:]
    if len(whole) < 100 or len(by_hand) < 100 or len(frames.from_publication) < 100:
        raise RuntimeError(
            f"too few samples: runtime {len(whole)}, by hand {len(by_hand)}, frames {len(frames.from_publication)}"
        )
    p50, by_hand_p50 = median(whole), median(by_hand)
    frame_p50, published_p50 = median(frames.from_publication[WARM_UP:]), median(scans.from_publication[WARM_UP:])
    ctx.figure("scan_to_command_ratio_p50", p50 / by_hand_p50, baseline=by_hand_p50 / 1e3, runs=len(whole))
    ctx.figure("scan_to_command_over_min_p50", p50 / median(bare_min), baseline=median(bare_min) / 1e3, runs=len(whole))
    ctx.figure(
        "frame_to_scan_ratio_p50",
        frame_p50 / published_p50,
        baseline=published_p50 / 1e3,
        runs=len(frames.from_publication),
    )
    ctx.row(
        {
            "what": "turn",
            "scan_to_command_us_p50": p50 / 1e3,
            "scan_to_command_us_p99": float(np.percentile(whole, 99)) / 1e3,
            "by_hand_us_p50": by_hand_p50 / 1e3,
            "by_hand_us_p99": float(np.percentile(by_hand, 99)) / 1e3,
            "from_publication_us_p50": published_p50 / 1e3,
            "frame_us_p50": frame_p50 / 1e3,
        }
    )
