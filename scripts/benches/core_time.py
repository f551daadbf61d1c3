"""How punctual the act tick is, how old the frame behind a command is, and how fast simulated time passes."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from benches.core_robots import (
    BeatingCamera,
    BeatingLidar,
    BenchBase,
    Follow,
    Go,
    NullBase,
    OnTime,
    Slow,
    SlowConfig,
    StampedConfig,
    jetbot,
)
from benches.harness import Context
from robotd.authoring.config import NoConfig
from robotd.engine.loops import real_loop, virtual_loop
from robotd.engine.parts import BehaviourPart, DevicePart, Parts, PerceptorPart
from robotd.engine.runtime import Runtime

TICK_HZ = 50.0
CAMERA_HZ = 20.0


def _lidar_robot(cls: Any = Go, base: Any = BenchBase, hz: float = 10.0) -> Parts:
    robot, guard = jetbot()
    devices = (
        DevicePart("motors", base, base.config_type()),
        DevicePart("lidar", BeatingLidar, StampedConfig(hz=hz)),
    )
    return Parts(
        robot, devices, (), (BehaviourPart("go", cls, NoConfig(), 10, start=True),), guard=guard, arm_at_start=True
    )


def _run(runtime: Runtime, seconds_s: float, *, prepare: Callable[[Runtime], None] | None = None) -> None:
    def started(running: Runtime) -> None:
        if prepare is not None:
            prepare(running)
        asyncio.get_running_loop().call_later(seconds_s, running.stop)

    factory: Any = virtual_loop if runtime.virtual else real_loop
    with asyncio.Runner(loop_factory=factory) as runner:
        runner.run(runtime.run(started))


# -------------------------------------------------------------------------------------------- act tick


class Sleeper(threading.Thread):
    """The measure of what this machine can do: a thread that sleeps (clock_nanosleep) until each of its deadlines."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.late_ns: list[int] = []
        self.stopping = False

    def run(self) -> None:
        period_ns = round(1e9 / TICK_HZ)
        due_ns = time.monotonic_ns() + period_ns + period_ns // 2
        while not self.stopping:
            time.sleep(max(0, due_ns - time.monotonic_ns()) / 1e9)
            self.late_ns.append(time.monotonic_ns() - due_ns)
            due_ns += period_ns


def _ticks(seconds_s: float) -> list[int]:
    """Lateness of each act tick of a driving robot, in nanoseconds."""
    late_ns: list[int] = []

    def prepare(running: Runtime) -> None:
        whole = running.core.tick

        def tick(now_ns: int) -> None:
            late_ns.append(running.tick_late_ns)
            whole(now_ns)

        running.core.tick = tick  # type: ignore[method-assign]

    _run(Runtime(_lidar_robot()), seconds_s, prepare=prepare)
    return late_ns[10:]


def measure_tick(ctx: Context) -> None:
    """Against a sleeping thread in the same seconds, and beside a net and a vision library on all cores."""
    seconds_s = 10.0 if ctx.quick else 60.0
    sleeper = Sleeper()
    sleeper.start()
    ticks = _ticks(seconds_s)
    sleeper.stopping = True
    sleeper.join()
    p99, sleeper_p99 = float(np.percentile(ticks, 99)), float(np.percentile(sleeper.late_ns[10:], 99))
    ctx.figure("tick_late_over_nanosleep_p99", p99 / sleeper_p99, baseline=sleeper_p99 / 1e3, runs=len(ticks))
    ctx.row(
        {
            "what": "tick",
            "late_us_p50": float(np.median(ticks)) / 1e3,
            "late_us_p99": p99 / 1e3,
            "nanosleep_us_p50": float(np.median(sleeper.late_ns[10:])) / 1e3,
            "nanosleep_us_p99": sleeper_p99 / 1e3,
        }
    )
    model = ctx.data / "models" / "yolox_nano.onnx"
    if not model.is_file():
        ctx.figure("tick_late_busy_ms_p99", None, why="the model yolox_nano.onnx is not among the test data")
        return
    with _busy(model) as turns:
        busy = _ticks(seconds_s)
    ctx.figure("tick_late_busy_ms_p99", float(np.percentile(busy, 99)) / 1e6, runs=len(busy))
    ctx.row({"what": "tick beside a net and vision", "late_ms_p50": float(np.median(busy)) / 1e6, "work": turns})


@contextmanager
def _busy(model: Path) -> Iterator[dict[str, int]]:
    """A net and a vision library, each busy in a thread without a pause; tells how much each did."""
    import cv2
    import onnxruntime

    turns = {"onnxruntime": 0, "cv2": 0}
    stopping = threading.Event()
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(str(model), options, providers=["CPUExecutionProvider"])
    name = session.get_inputs()[0].name
    picture = np.random.default_rng(1).integers(0, 256, (480, 640, 3), np.uint8)

    def net() -> None:
        tensor = np.zeros((1, 3, 416, 416), np.float32)
        while not stopping.is_set():
            session.run(None, {name: tensor})
            turns["onnxruntime"] += 1

    def vision() -> None:
        while not stopping.is_set():
            cv2.GaussianBlur(cv2.resize(picture, (1280, 960)), (9, 9), 2.0)
            turns["cv2"] += 1

    threads = [threading.Thread(target=work, daemon=True) for work in (net, vision)]
    with ExitStack() as stack:
        for thread in threads:
            thread.start()
            stack.callback(thread.join)
        stack.callback(stopping.set)
        yield turns


# ------------------------------------------------------------------------------------------- staleness


def measure_staleness(ctx: Context) -> None:
    """A perceptor of 100 ms on a worker, a camera at 20 Hz: how old is the frame behind a fresh command?"""
    robot, guard = jetbot()
    ages: list[tuple[int, int]] = []
    Slow.compute_ns.clear()

    def applied() -> None:
        winner = runtime.core.way_down.verdict.winner
        if winner is not None and (not ages or ages[-1][0] != winner.oldest_ns):
            ages.append((winner.oldest_ns, time.monotonic_ns() - winner.oldest_ns))

    devices = (
        DevicePart("motors", BenchBase, StampedConfig(on_apply=applied)),
        DevicePart("lidar", BeatingLidar, StampedConfig(hz=10.0)),
        DevicePart("camera", BeatingCamera, StampedConfig(hz=CAMERA_HZ)),
    )
    parts = Parts(
        robot,
        devices,
        (PerceptorPart("slow", Slow, SlowConfig()),),
        (BehaviourPart("follow", Follow, NoConfig(), 10, start=True),),
        guard=guard,
        arm_at_start=True,
    )
    runtime = Runtime(parts)
    _run(runtime, 10.0 if ctx.quick else 60.0)
    excess = _excess_periods(ages, Slow.compute_ns)
    ctx.figure("staleness_excess_p99", float(np.percentile(excess, 99)), runs=len(excess))
    ctx.row({"what": "staleness", "excess_periods_p50": float(np.median(excess)), "excess_periods_max": max(excess)})


def _excess_periods(ages: Sequence[tuple[int, int]], compute_ns: dict[int, int]) -> list[float]:
    """Age less compute time in periods of the camera, for each frame that led to a command."""
    period_ns = 1e9 / CAMERA_HZ
    excess = [(age_ns - compute_ns[stamp]) / period_ns for stamp, age_ns in ages[3:] if stamp in compute_ns]
    if len(excess) < 30:
        raise RuntimeError(f"only {len(excess)} commands from {len(compute_ns)} looks")
    return excess


# --------------------------------------------------------------------------------------- simulated time


def measure_sim(ctx: Context) -> None:
    """A scan at 40 Hz and a behaviour at 20 Hz through the whole runtime on virtual time, without ray casting."""
    seconds_s = 300.0 if ctx.quick else 2000.0
    speeds = [_sim_speed(seconds_s) for _ in range(3)]
    ctx.figure("sim_seconds_per_second", float(np.median(speeds)), runs=len(speeds))
    ctx.row({"what": "sim", "seconds_per_second": speeds})


def _sim_speed(seconds_s: float) -> float:
    began: list[float] = []
    runtime = Runtime(_lidar_robot(OnTime, NullBase, hz=40.0), virtual=True)
    _run(runtime, seconds_s, prepare=lambda _: began.append(time.perf_counter()))
    return seconds_s / (time.perf_counter() - began[0])
