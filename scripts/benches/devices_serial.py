"""Serial in to serial out: a frame written to a sensor's line until its number is read from the motors' line.

Three robots do the same in turn, a few milliseconds apart: the whole runtime with guard and guardian, a bare reader
callback in the same event loop (`devices_serial_robot.py`), and a C program (`devices_serial_robot.c`). This process is
the world at the other end of all six lines, and keeps to a core of its own where there are two: nothing at the other
end of a real line runs on the robot's core and takes its caches. All robots share the rest, so are woken alike.
"""

from __future__ import annotations

import contextlib
import os
import random
import select
import shutil
import subprocess
import sys
import tempfile
import time
import tty
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benches.devices_serial_robot import NUMBERS
from benches.harness import Context
from robotd_devices.ports.serial_port import Backend

BACKENDS: tuple[Backend, ...] = ("pyserial", "raw")
WARM_UP = 20
BLOCK, BLOCK_QUICK = 250, 120
"""Rounds of one start of the three robots; an interrupted run is taken up at the next one."""
START_WITHIN_S = 20.0
ANSWER_WITHIN_S = 1.0


class Lines:
    """One robot's two lines: a pty each."""

    def __init__(self) -> None:
        self._fds = [*os.openpty(), *os.openpty()]
        self._sensor, sensor_slave, self._motor, motor_slave = self._fds
        tty.setraw(sensor_slave)
        tty.setraw(motor_slave)
        self.paths = (os.ttyname(sensor_slave), os.ttyname(motor_slave))
        self._poll = select.poll()
        self._poll.register(self._motor, select.POLLIN)

    def close(self) -> None:
        """Both ends of both."""
        for fd in self._fds:
            os.close(fd)

    def forget(self) -> None:
        """Throw away what the motors were told so far."""
        while self._poll.poll(0):
            os.read(self._motor, 4096)

    def trip_ns(self, number: int) -> int:
        """From before the sensor's write until after the motors' read. Raises TimeoutError."""
        self.forget()
        sent, wanted, heard = b"S %d\n" % number, b"\nD %d\n" % number, b""
        began_ns = time.perf_counter_ns()
        os.write(self._sensor, sent)
        while wanted not in heard:
            if not self._poll.poll(ANSWER_WITHIN_S * 1e3):
                raise TimeoutError(f"number {number} was not echoed within {ANSWER_WITHIN_S:g} s: {heard!r}")
            heard += os.read(self._motor, 4096)
        return time.perf_counter_ns() - began_ns


def why_no_c() -> str:
    """Why there can be no C robot here; empty where there can."""
    return "" if shutil.which("cc") else "there is no C compiler (cc) here"


@contextlib.contextmanager
def world_apart() -> Iterator[set[int]]:
    """This process on one core; gives the cores for the robots, all the others. Where there is one, all share it."""
    if not hasattr(os, "sched_getaffinity"):
        yield set()
        return
    cores = os.sched_getaffinity(0)
    ours = {min(cores)}
    os.sched_setaffinity(0, ours)
    try:
        yield cores - ours or cores
    finally:
        os.sched_setaffinity(0, cores)


@contextlib.contextmanager
def _program(command: Sequence[str], cores: set[int]) -> Iterator[None]:
    """A robot in a process of its own, from its `ready` on."""
    process = subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env=os.environ | {"PYTHONPATH": str(Path(__file__).resolve().parents[1])},
    )
    assert process.stdin is not None and process.stdout is not None
    if cores:
        os.sched_setaffinity(process.pid, cores)  # of the one thread that it has so early; its threads inherit it
    try:
        if not select.select([process.stdout], [], [], START_WITHIN_S)[0] or process.stdout.readline() != b"ready\n":
            raise RuntimeError(f"{command[0]} does not begin")
        yield
    finally:
        process.stdin.close()  # what a robot in Python ends with
        try:
            process.wait(timeout=5.0 if command[0] == sys.executable else 0.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        process.stdout.close()


def _block(backend: Backend, c_robot: Path | None, rounds: int, rng: random.Random) -> dict[str, list[int]]:
    """Trips of each robot, in nanoseconds."""
    with contextlib.ExitStack() as stack:
        lines = {name: Lines() for name in ("runtime", "bare", "c")}
        for each in lines.values():
            stack.callback(each.close)
        paths = [*lines["runtime"].paths, *lines["bare"].paths]
        cores = stack.enter_context(world_apart())
        stack.enter_context(_program([sys.executable, "-m", "benches.devices_serial_robot", backend, *paths], cores))
        if c_robot is not None:
            stack.enter_context(_program([str(c_robot), *lines["c"].paths], cores))
        order = [name for name in lines if name != "c" or c_robot is not None]
        trips: dict[str, list[int]] = {name: [] for name in order}
        for turn in range(WARM_UP + rounds):
            rng.shuffle(order)
            for name in order:
                time.sleep(rng.uniform(0.001, 0.003))
                trip_ns = lines[name].trip_ns(1 + turn % (NUMBERS - 1))
                if turn >= WARM_UP:
                    trips[name].append(trip_ns)
        return trips


def measure(ctx: Context) -> None:
    """serial_over_bare_reader_p50 (the default back end; a row for each) and serial_over_c_p50."""
    blocks, rounds = (1, BLOCK_QUICK) if ctx.quick else (8, BLOCK)
    no_c = why_no_c()
    with tempfile.TemporaryDirectory() as folder:
        c_robot = None if no_c else Path(folder) / "robot"
        if c_robot is not None:
            source = Path(__file__).with_name("devices_serial_robot.c")
            subprocess.run(["cc", "-O2", "-Wall", "-o", str(c_robot), str(source)], check=True)
        for backend in BACKENDS:
            for block in range(blocks):
                key = f"serial {backend} {block}"
                ctx.progress(block, blocks, f"serial {backend}")
                if ctx.saved(key) is None:
                    trips = _block(backend, c_robot, rounds, random.Random(key))
                    ctx.row({"what": "serial", "backend": backend, "trips_ns": trips}, key=key)
    for backend in BACKENDS:
        found = [row["trips_ns"] for row in ctx.rows.all if row.get("what") == "serial" and row["backend"] == backend]
        p50: dict[str, float] = {}
        p99: dict[str, float] = {}
        for name in found[0]:
            trips_ns = np.concatenate([trips[name] for trips in found])
            p50[name], p99[name] = (float(each) / 1e3 for each in np.percentile(trips_ns, (50, 99)))
        told: dict[str, Any] = {
            f"{name}_us_{q}": each[name] for q, each in (("p50", p50), ("p99", p99)) for name in p50
        }
        ctx.say(f"serial {backend}: " + ", ".join(f"{name} {value:.0f}" for name, value in told.items()))
        ctx.note(f"serial line to serial line with `backend: {backend}`, microseconds: " + _words(p50, p99))
        if backend == BACKENDS[0]:
            runs = sum(len(trips["runtime"]) for trips in found)
            ctx.figure("serial_over_bare_reader_p50", p50["runtime"] / p50["bare"], baseline=p50["bare"], runs=runs)
            if no_c:
                ctx.figure("serial_over_c_p50", None, why=no_c)
            else:
                ctx.figure("serial_over_c_p50", p50["runtime"] / p50["c"], baseline=p50["c"], runs=runs)


def _words(p50: dict[str, float], p99: dict[str, float]) -> str:
    return ", ".join(f"{name} p50 {p50[name]:.0f} p99 {p99[name]:.0f}" for name in p50)
