"""An e-stop while the motors' line is stuck and full: how soon its bytes are through, before all that waited."""

from __future__ import annotations

import asyncio
import os
import select
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

from benches.devices_ports import MOTORS, SerialDevice, Stand
from benches.harness import Context
from robotd.engine.loops import real_loop
from robotd.safety.operator import EStop, ResetEStop

_JUNK = b"\x55" * 4096
_FULL_WITHIN_S = 0.25
"""Less than the silence after which a driver opens its port anew."""
_WITHIN_S = 1.0


class Trial:
    """One e-stop, carried out in a thread while the loop goes on driving."""

    def __init__(self, stand: Stand, loop: asyncio.AbstractEventLoop) -> None:
        self._stand = stand
        self._loop = loop
        self._estopped = threading.Event()

    def run(self) -> float:
        """Milliseconds from the e-stop's request until its bytes are read at the line's other end.

        Nobody reads the line until the runtime has done with the request. Raises TimeoutError where the line does not
        become full, or where the stop does not come.
        """
        stand = self._stand
        stop: bytes = stand.runtime.devices[0].device.stop_bytes()  # type: ignore[attr-defined]
        with stand.host.stuck() as master:
            filler = os.open(stand.host.link, os.O_WRONLY | os.O_NOCTTY | os.O_NONBLOCK)
            try:
                self._fill(filler)
                began_ns = time.monotonic_ns()
                self._loop.call_soon_threadsafe(self._estop)
                if not self._estopped.wait(_WITHIN_S):
                    raise TimeoutError("the runtime did not take the e-stop")
                self._read_until(master, stop)
                return (time.monotonic_ns() - began_ns) / 1e6
            finally:
                os.close(filler)

    def _fill(self, filler: int) -> None:
        """Until the kernel takes nothing more and the driver holds bytes that it could not write."""
        line: Any = self._stand.runtime.devices[0].device
        until_s = time.monotonic() + _FULL_WITHIN_S
        while time.monotonic() < until_s:
            fresh = 0
            try:
                while True:
                    fresh += os.write(filler, _JUNK)
            except BlockingIOError:
                pass
            if not fresh and line._line._port.unsent:
                return
            time.sleep(0.0002)
        raise TimeoutError("the line did not become full")

    def _estop(self) -> None:
        self._stand.runtime.core.request(EStop("bench", "a button"), time.monotonic_ns())
        self._estopped.set()

    @staticmethod
    def _read_until(master: int, wanted: bytes) -> None:
        poll = select.poll()
        poll.register(master, select.POLLIN)
        heard = b""
        while wanted not in heard:
            if not poll.poll(_WITHIN_S * 1e3):
                raise TimeoutError(f"no stop among {len(heard)} bytes")
            heard += os.read(master, 65_536)


def _block(device: SerialDevice, count: int) -> list[float]:
    """So many e-stops of one robot, in milliseconds."""
    found: list[float] = []

    async def session(stand: Stand) -> None:
        loop = asyncio.get_running_loop()
        core = stand.runtime.core
        for _ in range(count):
            await stand.drive(5.0)
            await asyncio.sleep(0.03)
            found.append(await asyncio.to_thread(Trial(stand, loop).run))
            await stand.until(lambda: not stand.moves, 1.0, "the motors to stand")
            core.request(ResetEStop("bench"), time.monotonic_ns())

    with (
        tempfile.TemporaryDirectory() as folder,
        Stand(device, Path(folder)).plugged() as stand,
        asyncio.Runner(loop_factory=real_loop) as runner,
    ):
        runner.run(stand.run(session))
    return found


def measure(ctx: Context) -> None:
    """estop_ms_p99 over all serial motor controllers; a row for each."""
    count = 8 if ctx.quick else 100
    for device in ctx.each(MOTORS, "e-stop"):
        key = f"estop {device.name}"
        if ctx.saved(key) is None:
            ctx.row({"what": "estop", "device": device.name, "ms": _block(device, count)}, key=key)
    rows = [row for row in ctx.rows.all if row.get("what") == "estop"]
    every = [ms for row in rows for ms in row["ms"]]
    ctx.figure("estop_ms_p99", float(np.percentile(every, 99)), baseline=float(np.median(every)), runs=len(every))
    worst = ", ".join(f"{row['device']} {np.median(row['ms']):.2f}/{max(row['ms']):.2f}" for row in rows)
    ctx.note(f"e-stop on a full line, ms p50/worst: {worst}; the baseline is the p50 of all")
