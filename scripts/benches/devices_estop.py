"""An e-stop while the motors' line is stuck and full: how soon its bytes are through, before all that waited.

Beside it, in turn, the same stop written to the same port by a bare callback of the same event loop: what is left then
is the machine, above all its scheduler where it is busy. So the figure is taken under SCHED_FIFO where that is
permitted (as root, or with LimitRTPRIO), robot and measuring side alike, and the same e-stops under the ordinary
scheduler are told beside it. A pty hands bytes over in a kernel thread of the ordinary scheduler, which a serial port
does not: so it is also told when the kernel had taken all bytes of the stop.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import os
import select
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benches.devices_ports import MOTORS, SerialDevice, Stand
from benches.harness import Context
from robotd.engine.loops import real_loop
from robotd.safety.operator import EStop, ResetEStop

FIFO, ORDINARY = "SCHED_FIFO", "the ordinary scheduler"
_JUNK = b"\x55" * 4096
_FULL_WITHIN_S, _SILENT_S = 0.25, 3.0
"""For how long the line may take to become full, and the silence after which a driver opens its port anew."""
_WITHIN_S = 1.0


class NotFull(Exception):
    """The line did not become full in time, or its driver opened it anew meanwhile: no e-stop was pulled."""


class Trial:
    """One e-stop, or bare stop, carried out in a thread while the loop goes on driving."""

    def __init__(self, stand: Stand, loop: asyncio.AbstractEventLoop, *, bare: bool = False) -> None:
        self._stand = stand
        self._loop = loop
        self._driver: Any = stand.runtime.devices[0].device
        self._stop: bytes = self._driver.stop_bytes()
        self._write = self._bare_stop if bare else self._estop
        self._written = threading.Event()
        self._written_ns: int | None = None

    def run(self) -> tuple[float | None, float]:
        """Milliseconds from the request until the kernel has the stop's bytes, and until the line's other end has them.

        The first is None where the kernel did not take them in the same call.
        Nobody reads the line until the runtime has done with the request. Raises NotFull, and TimeoutError where the
        stop does not come.
        """
        stand = self._stand
        with stand.host.stuck() as master:
            filler = os.open(stand.host.link, os.O_WRONLY | os.O_NOCTTY | os.O_NONBLOCK)
            try:
                self._fill(filler)
                began_ns = time.monotonic_ns()
                self._loop.call_soon_threadsafe(self._write)
                if not self._written.wait(_WITHIN_S):
                    raise TimeoutError("the runtime did not take the e-stop")
                self._read_until(master, self._stop)
                read_ns = time.monotonic_ns()
                taken_ms = None if self._written_ns is None else (self._written_ns - began_ns) / 1e6
                return taken_ms, (read_ns - began_ns) / 1e6
            finally:
                os.close(filler)

    def _fill(self, filler: int) -> None:
        """Until the kernel takes nothing more and the driver holds bytes that it could not write."""
        until_s = time.monotonic() + _FULL_WITHIN_S
        while time.monotonic() < until_s:
            fresh = 0
            try:
                while True:
                    fresh += os.write(filler, _JUNK)
            except BlockingIOError:
                pass
            line = self._driver._line
            if line is None:
                break
            if not fresh and line._port.unsent:
                return
            time.sleep(0.0002)
        raise NotFull

    def _estop(self) -> None:
        self._stand.runtime.core.request(EStop("bench", "a button"), time.monotonic_ns())
        self._done()

    def _bare_stop(self) -> None:
        self._driver._line._port.write(self._stop, first=True)
        self._done()

    def _done(self) -> None:
        if not self._driver._line._port.unsent:
            self._written_ns = time.monotonic_ns()
        self._written.set()

    @staticmethod
    def _read_until(master: int, wanted: bytes) -> None:
        poll = select.poll()
        poll.register(master, select.POLLIN)
        heard = b""
        while wanted not in heard:
            if not poll.poll(_WITHIN_S * 1e3):
                raise TimeoutError(f"no stop among {len(heard)} bytes")
            heard += os.read(master, 65_536)


def _block(device: SerialDevice, count: int) -> dict[str, list[float | None]]:
    """So many e-stops of one robot, and as many bare stops, in milliseconds."""
    found: dict[str, list[float | None]] = {"bare_ms": [], "ms": [], "bare_taken_ms": [], "taken_ms": []}

    async def session(stand: Stand) -> None:
        loop = asyncio.get_running_loop()
        core = stand.runtime.core
        for turn in range(3 * count):
            if len(found["ms"]) == count:
                return
            await stand.drive(5.0)
            await asyncio.sleep(0.03)
            bare = len(found["bare_ms"]) == len(found["ms"])
            try:
                taken_ms, ms = await asyncio.to_thread(Trial(stand, loop, bare=bare).run)
            except NotFull:
                if turn + 1 == 3 * count:
                    raise
            else:
                found["bare_ms" if bare else "ms"].append(ms)
                found["bare_taken_ms" if bare else "taken_ms"].append(taken_ms)
            core.request(EStop("bench", "the next one"), time.monotonic_ns())  # nothing new where there was one
            await stand.until(lambda: not stand.moves, 1.0, "the motors to stand")
            core.request(ResetEStop("bench"), time.monotonic_ns())

    with (
        tempfile.TemporaryDirectory() as folder,
        Stand(device, Path(folder), silent_s=_SILENT_S).plugged() as stand,
        asyncio.Runner(loop_factory=real_loop) as runner,
    ):
        runner.run(stand.run(session))
    return found


@contextlib.contextmanager
def scheduled(kind: str) -> Iterator[None]:
    """Under this scheduler, threads begun meanwhile too. Raises OSError where that is not permitted."""
    before, parameter = os.sched_getscheduler(0), os.sched_getparam(0)
    if kind == FIFO:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    try:
        yield
    finally:
        os.sched_setscheduler(0, before, parameter)


def schedulers() -> tuple[str, ...]:
    """What is permitted here; the figure is taken under the first one."""
    try:
        with scheduled(FIFO):
            return FIFO, ORDINARY
    except OSError:
        return (ORDINARY,)


def measure(ctx: Context) -> None:
    """estop_ms_p99 over all serial motor controllers; a row for each and each scheduler."""
    count = 5 if ctx.quick else 100
    kinds = schedulers()[: 1 if ctx.quick else 2]
    for kind, device in ctx.each([(kind, device) for kind in kinds for device in MOTORS], "e-stop"):
        key = f"estop {device.name} {kind}"
        if ctx.saved(key) is None:
            with scheduled(kind):
                found = _block(device, count)
            ctx.row({"what": "estop", "device": device.name, "scheduler": kind, **found}, key=key)
    for kind in kinds:
        rows = [row for row in ctx.rows.all if row.get("what") == "estop" and row["scheduler"] == kind]
        stops, bare, taken, bare_taken = (
            np.array([math.nan if ms is None else ms for row in rows for ms in row[which]])
            for which in ("ms", "bare_ms", "taken_ms", "bare_taken_ms")
        )
        p99, bare_p99 = (float(np.percentile(each, 99)) for each in (stops, bare))
        if kind == kinds[0]:
            ctx.figure("estop_ms_p99", p99, baseline=bare_p99, runs=len(stops))
        worst = ", ".join(f"{row['device']} {np.median(row['ms']):.2f}/{max(row['ms']):.2f}" for row in rows)
        ctx.note(
            f"e-stop on a full line under {kind}, ms p50/p99/worst: {_spread(stops)}, a bare callback that writes the "
            f"same stop {_spread(bare)}: the p99 is {p99 / bare_p99:.1f} times that; taken by the kernel after "
            f"{_spread(taken)}, bare {_spread(bare_taken)}; p50/worst by device: {worst}"
        )


def _spread(ms: NDArray[np.float64]) -> str:
    known = ms[np.isfinite(ms)]
    late = f" ({len(ms) - len(known)} not at once)" if len(known) < len(ms) else ""
    return "/".join(f"{value:.2f}" for value in (*np.percentile(known, (50, 99)), known.max())) + late
