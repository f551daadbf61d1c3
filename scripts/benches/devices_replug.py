"""Cable out, cable in, 200 times: how soon the robot stops, how soon it is back, and what it leaves behind.

Each device is measured in a process of its own, so that what is left behind is its own; it tells of each cycle as soon
as it is over, so that an interrupted run goes on with the next one:

    python -m benches.devices_replug DEVICE FIRST END

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
import queue
import random
import subprocess
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
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
AT_ONCE, AT_ONCE_QUICK = 5, 8
"""Processes at a time. Each takes an eighth of a core; the Arduino's boot alone lasts 5 minutes in 200 cycles."""
_GIVE_UP_S = 5.0
_LAST_WORDS = 8


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


class LastWords(logging.Handler):
    """Keeps the last warnings, for a cycle that fails."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.lines: deque[str] = deque(maxlen=_LAST_WORDS)

    def emit(self, record: logging.LogRecord) -> None:
        self.lines.append(record.getMessage())


def cycles(device: SerialDevice, first: int, end: int, tell: Callable[[dict[str, Any]], None]) -> None:
    """Cycles `first` to `end` of a device in this process; tells of each, and of what is left behind in the end."""
    held: list[Held] = []
    warm_up = min(first + max(1, (end - first) // 10), end - 1)
    words = LastWords()
    logging.getLogger("robotd").addHandler(words)

    async def session(stand: Stand) -> None:
        await stand.drive(_GIVE_UP_S)
        for number in range(first, end):
            if number == warm_up:
                held.append(Held.now())
            rng = random.Random(f"{device.name} {number}")
            words.lines.clear()
            try:
                found = await _cycle(stand, rng)
                back = True
            except TimeoutError as late:
                found, back = {"stop_ms": 0.0, "ready_ms": 0.0, "back_ms": 0.0, "failed": [str(late)]}, False
            if found["failed"]:
                found["failed"] += words.lines
            tell({"cycle": number, **found})
            if not back:
                stand.host.plug()  # nothing happens where it is plugged in
                await stand.drive(2.0 * _GIVE_UP_S)
        held.append(Held.now())

    with (
        tempfile.TemporaryDirectory() as folder,
        Stand(device, Path(folder)).plugged() as stand,
        asyncio.Runner(loop_factory=real_loop) as runner,
    ):
        runner.run(stand.run(session))
    if len(held) == 2:
        rss_grown_mb = held[1].rss_mb - held[0].rss_mb
        tell({"cycle": None, "failed": left_behind(held[0], held[1]), "rss_grown_mb": rss_grown_mb})


class Runs:
    """Processes that go through the cycles of a few devices at a time. `with Runs(...) as runs: for ... in runs:`."""

    def __init__(self, jobs: Sequence[tuple[str, int, int]], at_once: int) -> None:
        self._jobs = list(jobs)
        self._at_once = at_once
        self._told: queue.SimpleQueue[tuple[str, dict[str, Any] | int]] = queue.SimpleQueue()
        self._running: dict[str, subprocess.Popen[str]] = {}

    def __enter__(self) -> Runs:
        return self

    def __exit__(self, *error: object) -> None:
        for process in self._running.values():
            process.kill()
            process.wait()

    def __iter__(self) -> Iterator[tuple[str, dict[str, Any]]]:
        """Names with what their processes told, as it comes in; a process that died told that it failed."""
        while self._jobs or self._running:
            while self._jobs and len(self._running) < self._at_once:
                self._start(*self._jobs.pop(0))
            name, told = self._told.get()
            if isinstance(told, dict):
                yield name, told
                continue
            del self._running[name]
            if told:
                yield name, {"cycle": None, "failed": [f"the robot did not survive its cycles (exit code {told})"]}

    def _start(self, name: str, first: int, end: int) -> None:
        self._running[name] = process = subprocess.Popen(
            [sys.executable, "-m", "benches.devices_replug", name, str(first), str(end)],
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | {"PYTHONPATH": str(Path(__file__).resolve().parents[1])},
        )

        def listen() -> None:
            assert process.stdout is not None
            for line in process.stdout:
                self._told.put((name, json.loads(line)))
            self._told.put((name, process.wait()))

        threading.Thread(target=listen, name=f"cycles of {name}", daemon=True).start()


def missing(ctx: Context, name: str, count: int) -> int:
    """The first cycle of a device that no row has, `count` where it is through and has said what it left behind."""
    done = next((i for i in range(count) if ctx.saved(f"replug {name} {i}") is None), count)
    through = ctx.saved(f"replug {name} left") is not None
    return count if through else min(done, count - 1)


def measure(ctx: Context) -> None:
    """replug_failures: cycles with a late stop, a late return or motion unarmed, and devices that left something."""
    count = 2 if ctx.quick else 200
    # the slowest first
    names = sorted(SERIAL, key=lambda name: -SERIAL[name].boot_s)
    jobs = [(name, first, count) for name in names if (first := missing(ctx, name, count)) < count]
    done = sum(first for _, first, _ in jobs) + count * (len(names) - len(jobs))
    with Runs(jobs, AT_ONCE_QUICK if ctx.quick else AT_ONCE) as runs:
        for name, told in runs:
            number = told["cycle"]
            key = f"replug {name} {'left' if number is None else number}"
            if ctx.saved(key) is None:  # the last cycle is gone through again where only the end was missing
                ctx.row({"what": "replug", "device": name, **told}, key=key)
            done += number is not None
            ctx.progress(done, count * len(names), "replug")
    _figure(ctx, names, count)


def _figure(ctx: Context, names: Sequence[str], count: int) -> None:
    rows = [row for row in ctx.rows.all if row.get("what") == "replug"]
    gone = [row for row in rows if row["cycle"] is not None]
    lost = count * len(names) - len(gone)
    for row in rows:
        if row["failed"]:
            where = "in the end" if row["cycle"] is None else f"cycle {row['cycle']}"
            ctx.note(f"replug {row['device']}, {where}: {'; '.join(row['failed'])}")
    if lost:
        ctx.note(f"replug: {lost} cycles were not gone through, and count as failures")
    worst = []
    for name in names:
        mine = [row for row in gone if row["device"] == name]
        grown = [row["rss_grown_mb"] for row in rows if row["device"] == name and "rss_grown_mb" in row]
        if mine:
            stop, back = (max(row[which] for row in mine) for which in ("stop_ms", "back_ms"))
            worst.append(f"{name} {len(mine)} {stop:.0f}/{back:.0f} " + (f"{grown[0]:.1f}" if grown else "-"))
    ctx.note(
        "replug, cycles, worst ms to stop/to be back, MB grown: "
        + ", ".join(worst)
        + f"; {RSS_GROWTH_MB:g} MB are allowed after the first tenth of the cycles"
    )
    ctx.figure("replug_failures", sum(bool(row["failed"]) for row in rows) + lost, runs=len(gone))


if __name__ == "__main__":
    logging.getLogger("robotd").propagate = False  # a cable that is pulled is no news here
    cycles(SERIAL[sys.argv[1]], int(sys.argv[2]), int(sys.argv[3]), lambda row: print(json.dumps(row), flush=True))
