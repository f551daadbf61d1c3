"""Cable out, cable in, 200 times: how soon the robot stops, how soon it is back, and what it leaves behind.

Each device is measured in a process of its own, so that what is left behind is its own:

    python -m benches.devices_replug DEVICE CYCLES

With a lidar the stop is that of the motors on another line. A motor controller whose cable is out hears no stop: there
it counts when the runtime is disarmed and its command is zero, and that what the controller hears first is a stop, so
that it stands until the robot is armed again. Back is when the motors turn again, the robot having been armed as soon
as it was ready; the fakes boot as slowly as the device (an Arduino: 1.5 s), which is not counted, and spin up at once.
"""

from __future__ import annotations

import asyncio
import contextlib
import gc
import json
import logging
import os
import random
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from benches.devices_ports import SERIAL, SerialDevice, Stand
from benches.harness import Context
from robotd.engine.loops import real_loop

STOP_WITHIN_MS, BACK_WITHIN_MS = 100.0, 1000.0
RSS_GROWTH_MB = 4.0
"""Allowed between the end of the warm-up and the end, in MB (2^20 bytes); one scan kept a cycle would be a quarter."""
OUT_S = (0.05, 0.9)
"""For how long the cable is out: shorter than the first try to reopen, to longer than the longest wait between two."""
AT_ONCE, AT_ONCE_QUICK = 4, 8
"""Processes at a time."""
_GIVE_UP_S = 5.0


class Held(NamedTuple):
    """What the process holds while the robot drives."""

    descriptors: int
    tasks: int
    threads: int
    rss_mb: float

    @classmethod
    def now(cls) -> Held:
        """Counted behind a collection of garbage."""
        gc.collect()
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        return cls(
            len(os.listdir("/proc/self/fd")),
            len(asyncio.all_tasks()),
            threading.active_count(),
            pages * os.sysconf("SC_PAGE_SIZE") / 2**20,
        )


def left_behind(before: Held, after: Held) -> list[str]:
    """What there is more of than before, in words."""
    counts = [
        f"{name} from {was} to {now}"
        for name, was, now in zip(Held._fields[:3], before[:3], after[:3], strict=True)
        if now > was
    ]
    grown_mb = after.rss_mb - before.rss_mb
    return counts + ([f"memory by {grown_mb:.1f} MB"] if grown_mb > RSS_GROWTH_MB else [])


async def _stopped(stand: Stand, since_ns: int) -> float:
    """Milliseconds since an instant until the robot's stop; see above."""
    core = stand.runtime.core
    if stand.device.moves is None:
        motors = stand.motors
        heard = await stand.until(
            lambda: next((each for each in motors.heard if each.is_stop and each.now_ns >= since_ns), None),
            _GIVE_UP_S,
            "the motors' stop",
        )
        return (heard.now_ns - since_ns) / 1e6
    await stand.until(lambda: not core.operator.armed and not core.way_down.moves, _GIVE_UP_S, "the robot's stop")
    return (time.monotonic_ns() - since_ns) / 1e6


async def _cycle(stand: Stand, rng: random.Random) -> dict[str, Any]:
    """One time out and in; `failed` says in words what was not as it must be."""
    device, core = stand.device, stand.runtime.core
    await asyncio.sleep(rng.uniform(0.0, 0.04))
    stand.motors.heard.clear()
    out_ns = time.monotonic_ns()
    stand.host.unplug()
    stop_ms = await _stopped(stand, out_ns)
    await asyncio.sleep(rng.uniform(*OUT_S))
    driven = device.moves is None and stand.moves
    in_ns = time.monotonic_ns()
    stand.host.plug()
    await stand.until(lambda: not core.not_ready, _GIVE_UP_S, "the device")
    ready_ms = (time.monotonic_ns() - in_ns) / 1e6 - 1e3 * device.boot_s
    if device.moves is not None:
        # what it heard first was a stop: it takes the line a moment to say so
        with contextlib.suppress(TimeoutError):
            await stand.until(lambda: not stand.moves, 0.05, "the motors to stand")
        driven = stand.moves
    await stand.drive(_GIVE_UP_S)
    back_ms = (time.monotonic_ns() - in_ns) / 1e6 - 1e3 * device.boot_s
    failed = [f"stop after {stop_ms:.0f} ms"] * (stop_ms > STOP_WITHIN_MS)
    failed += [f"back after {back_ms:.0f} ms"] * (back_ms > BACK_WITHIN_MS)
    failed += ["drove unarmed"] * driven
    if hasattr(stand.fake, "log"):
        stand.fake.log.clear()
    return {"stop_ms": stop_ms, "ready_ms": ready_ms, "back_ms": back_ms, "failed": failed}


def cycles(device: SerialDevice, count: int) -> dict[str, Any]:
    """All cycles of a device in this process, and what it held before and after."""
    found: list[dict[str, Any]] = []
    held: list[Held] = []
    warm_up = max(1, count // 10)
    rng = random.Random(device.name)

    async def session(stand: Stand) -> None:
        await stand.drive(_GIVE_UP_S)
        for number in range(count):
            if number == warm_up:
                held.append(Held.now())
            try:
                found.append(await _cycle(stand, rng))
            except TimeoutError as late:
                found.append({"stop_ms": 0.0, "ready_ms": 0.0, "back_ms": 0.0, "failed": [str(late)]})
                stand.host.plug()  # nothing happens where it is plugged in
                await stand.drive(2.0 * _GIVE_UP_S)
        held.append(Held.now())

    with (
        tempfile.TemporaryDirectory() as folder,
        Stand(device, Path(folder)).plugged() as stand,
        asyncio.Runner(loop_factory=real_loop) as runner,
    ):
        runner.run(stand.run(session))
    left = left_behind(held[0], held[1])
    return {
        "cycles": count,
        "failures": sum(bool(cycle["failed"]) for cycle in found) + bool(left),
        "failed": [f"cycle {i}: {', '.join(cycle['failed'])}" for i, cycle in enumerate(found) if cycle["failed"]],
        "left_behind": left,
        "rss_grown_mb": held[1].rss_mb - held[0].rss_mb,
        **{f"{name}_max": max(cycle[name] for cycle in found) for name in ("stop_ms", "ready_ms", "back_ms")},
    }


def _start(name: str, count: int) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "benches.devices_replug", name, str(count)],
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": str(Path(__file__).resolve().parents[1])},
    )


def _all(ctx: Context, names: Sequence[str], count: int) -> None:
    """A row for each device, as they come in; a few of them at a time."""
    waiting = list(names)
    running: dict[str, subprocess.Popen[str]] = {}
    try:
        while waiting or running:
            while waiting and len(running) < (AT_ONCE_QUICK if ctx.quick else AT_ONCE):
                running[waiting[0]] = _start(waiting[0], count)
                waiting.pop(0)
            for name, process in list(running.items()):
                try:
                    told, _ = process.communicate(timeout=0.1)
                except subprocess.TimeoutExpired:
                    ctx.progress(len(names) - len(waiting) - len(running), len(names), "replug")
                    continue
                del running[name]
                if process.returncode != 0:
                    raise RuntimeError(f"{name}: the robot did not survive its cycles (exit code {process.returncode})")
                ctx.row({"what": "replug", "device": name, **json.loads(told)}, key=f"replug {name}")
    finally:
        for process in running.values():
            process.kill()
            process.wait()


def measure(ctx: Context) -> None:
    """replug_failures: cycles with a late stop, a late return or motion unarmed, and devices that left something."""
    # the slowest first
    names = sorted(SERIAL, key=lambda name: -SERIAL[name].boot_s)
    _all(ctx, [name for name in names if ctx.saved(f"replug {name}") is None], 2 if ctx.quick else 200)
    rows = [row for row in ctx.rows.all if row.get("what") == "replug"]
    for row in rows:
        for words in (*row["failed"], *row["left_behind"]):
            ctx.note(f"replug {row['device']}: {words}")
    ctx.note(
        "replug, worst ms to stop/to be back and MB grown: "
        + ", ".join(
            f"{row['device']} {row['stop_ms_max']:.0f}/{row['back_ms_max']:.0f} {row['rss_grown_mb']:.1f}"
            for row in rows
        )
        + f"; {RSS_GROWTH_MB:g} MB are allowed after the first tenth of the cycles"
    )
    ctx.figure("replug_failures", sum(row["failures"] for row in rows), runs=sum(row["cycles"] for row in rows))


if __name__ == "__main__":
    logging.getLogger("robotd").setLevel(os.environ.get("ROBOTD_BENCH_LOG", "CRITICAL"))
    print(json.dumps(cycles(SERIAL[sys.argv[1]], int(sys.argv[2]))))
