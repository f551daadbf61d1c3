"""From bytes to command through the whole runtime, beside the same functions called by hand in one asyncio task."""

from __future__ import annotations

import asyncio
import gc
import time
from typing import Any

import numpy as np

from benches.core_robots import (
    ROTATION_HZ,
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

BLOCKS, BLOCK_S = 12, 10.0
BLOCKS_QUICK, BLOCK_QUICK_S = 4, 3.0
"""Starts of all three programs, and how long they run: an even number, so that places are changed equally often."""
WARM_UP = 10


class Plain:
    """The task that somebody would write without a runtime: parse, step, guard, encode, one after the other."""

    def __init__(self, phase: float) -> None:
        robot, guard = jetbot()
        self.whole: list[int] = []
        self.bare_min: list[int] = []
        self._phase = phase
        self._guard = Guard(robot, guard)
        self._encode = Encoder(robot)
        settings = SerialSettings("bench", 230_400)
        self._parser = LdParser(settings.byte_ns)
        self._sweep = LdSweep(byte_ns=settings.byte_ns, range_min_m=0.02, range_max_m=12.0, mount=robot.mount("lidar"))

    async def run(self) -> None:
        queue: asyncio.Queue[bytes] = asyncio.Queue()
        line = Line(self._phase, queue.put_nowait)
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


def _scan_robot(stamps: Stamps, phase: float) -> Parts:
    robot, guard = jetbot()
    devices = (
        DevicePart("motors", BenchBase, StampedConfig(stamps=stamps)),
        DevicePart("lidar", FedLidar, FedLidarConfig(rotation_hz=ROTATION_HZ, stamps=stamps, phase=phase)),
    )
    return Parts(
        robot, devices, (), (BehaviourPart("go", Go, NoConfig(), 10, start=True),), guard=guard, arm_at_start=True
    )


def _frame_robot(stamps: Stamps) -> Parts:
    """A frame a quarter of a turn behind each scan, a scan of its own in the middle between two frames."""
    robot, guard = jetbot()
    devices = (
        DevicePart("motors", BenchBase, StampedConfig(stamps=stamps)),
        DevicePart("lidar", BeatingLidar, StampedConfig(hz=ROTATION_HZ / 2.0, phase=0.75)),
        DevicePart("camera", BeatingCamera, StampedConfig(hz=ROTATION_HZ, phase=0.25, stamps=stamps)),
    )
    return Parts(
        robot,
        devices,
        (PerceptorPart("spot", Spot, NoConfig()),),
        (BehaviourPart("follow", Follow, NoConfig(), 10, start=True),),
        guard=guard,
        arm_at_start=True,
    )


async def _side_by_side(phase: float, seconds_s: float) -> dict[str, list[int]]:
    """What each took, in nanoseconds. phase: when the runtime's scans end; the plain task's end half a turn later."""
    loop: Any = asyncio.get_running_loop()
    scans, frames, plain = Stamps(), Stamps(), Plain((phase + 0.5) % 1.0)
    robots = [Runtime(_scan_robot(scans, phase)), Runtime(_frame_robot(frames))]

    def stop(running: Runtime) -> None:
        loop.call_later(seconds_s, running.stop)

    task = asyncio.create_task(plain.run())
    try:
        async with asyncio.TaskGroup() as group:
            for robot in robots:
                group.create_task(robot.run(stop))
    finally:
        task.cancel()
    times = {
        "scan_to_command": scans.from_bytes,
        "by_hand": plain.whole,
        "bare_min": plain.bare_min,
        "from_publication": scans.from_publication,
        "frame": frames.from_publication,
    }
    return {name: taken[WARM_UP:] for name, taken in times.items()}


def measure(ctx: Context) -> None:
    """Three programs in one loop and one run, each a quarter of a turn (12.5 ms) away from its neighbours.

    What a turn costs depends on what ran just before it: right behind another robot's turn everything is in the
    caches, after some idle milliseconds little is, and twice the time is nothing unusual. So every scan and every
    frame has its fixed place on the loop's clock, the same time after its predecessor, and the runtime and the plain
    task change places from one start to the next: both are equally cold. Over many starts the runtime's own act tick,
    which keeps it warm on a robot too, lies at all distances from its scans.
    """
    blocks, seconds_s = (BLOCKS_QUICK, BLOCK_QUICK_S) if ctx.quick else (BLOCKS, BLOCK_S)
    for block in ctx.each(range(blocks), "turn"):
        key = f"turn {block}"
        if ctx.saved(key) is None:
            with asyncio.Runner(loop_factory=real_loop) as runner:
                taken_ns = runner.run(_side_by_side(0.5 * (block % 2), seconds_s))
            gc.unfreeze()
            ctx.row({"what": "turns", "taken_ns": taken_ns}, key=key)
    found = [row["taken_ns"] for row in ctx.rows.all if row.get("what") == "turns"]
    us = {name: np.concatenate([taken[name] for taken in found]) / 1e3 for name in found[0]}
    p50 = {name: float(np.median(taken)) for name, taken in us.items()}
    if min(map(len, us.values())) < 100:
        raise RuntimeError(f"too few samples: {', '.join(f'{name} {len(taken)}' for name, taken in us.items())}")
    for figure, of, over in (
        ("scan_to_command_ratio_p50", "scan_to_command", "by_hand"),
        ("scan_to_command_over_min_p50", "scan_to_command", "bare_min"),
        ("frame_to_scan_ratio_p50", "frame", "from_publication"),
    ):
        ctx.figure(figure, p50[of] / p50[over], baseline=p50[over], runs=len(us[of]))
    p99 = {f"{name}_us_p99": float(np.percentile(us[name], 99)) for name in ("scan_to_command", "by_hand")}
    ctx.row({"what": "turn"} | {f"{name}_us_p50": value for name, value in p50.items()} | p99)
    each = [np.median(taken["scan_to_command"]) / np.median(taken["by_hand"]) for taken in found]
    ctx.note(f"runtime over by hand in each start: {' '.join(f'{ratio:.2f}' for ratio in each)}")
