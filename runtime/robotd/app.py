"""The composition root: a config that was read and checked goes in, a running robot comes out."""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import logging
import math
import os
import signal
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robotd.engine.armed_mark import ArmedMark
from robotd.engine.console import View
from robotd.engine.loops import RealLoop, VirtualLoop, real_loop, virtual_loop
from robotd.engine.runtime import Runtime
from robotd.setup.load import Loaded
from robotd.world.clock import ns

log = logging.getLogger("robotd")

LOOK_S = 0.2
"""How often people see the state, in wall seconds."""
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@dataclass(frozen=True, slots=True)
class Options:
    """What the command line says beside the config. `speed`: None is real time, infinity as fast as it can."""

    sim: bool = False
    headless: bool = False
    arm: bool = False
    duration_s: float | None = None
    speed: float | None = None
    record: Path | None = None
    verbosity: int = 0
    log_json: bool = False


def run(loaded: Loaded, options: Options, view: View) -> int:
    """Drive this robot until somebody stops it, its `duration_s` is over, or something ends it; returns 0.

    `view` is shown the state about five times a second. The motors have been stopped when this returns or raises.
    Raises what ended the robot: an ExceptionGroup of DeviceError, Unavailable and the like; robotd.cli knows their
    exit codes.
    """
    # a simulated robot arms itself unless its file says otherwise; --arm says so for any
    mark = None if options.sim else ArmedMark(_mark_of(loaded))
    runtime = Runtime(loaded.parts, virtual=options.sim, arm=True if options.arm else None, mark=mark)
    with asyncio.Runner(loop_factory=lambda: _loop(options)) as runner:
        runner.run(_drive(runtime, loaded, options, view))
    return 0


def _mark_of(loaded: Loaded) -> Path:
    """Where it is remembered that this robot is armed: one file for each config."""
    import platformdirs

    file = str(loaded.file.resolve())
    return platformdirs.user_state_path("robotd") / "armed" / hashlib.sha256(file.encode()).hexdigest()[:16]


def _loop(options: Options) -> RealLoop | VirtualLoop:
    if not options.sim:
        return real_loop()
    pace = 1.0 if options.speed is None else options.speed
    return virtual_loop(None if math.isinf(pace) else pace)


async def _drive(runtime: Runtime, loaded: Loaded, options: Options, view: View) -> None:
    loop: Any = asyncio.get_running_loop()
    loop.set_exception_handler(_unhandled)
    pace = options.speed if options.speed is not None and math.isfinite(options.speed) else 1.0
    watch = _Watch(runtime, view, loop, ns(LOOK_S * max(pace, 1e-3)))

    def started(running: Runtime) -> None:
        if options.duration_s is not None:
            loop.call_at_ns(running.started_ns + ns(options.duration_s), running.stop)
        watch.look()

    with _signals(loop, runtime), _recorded(runtime, loaded, options, loop.now_ns()):
        try:
            await runtime.run(started)
        finally:
            watch.end()


class _Watch:
    """Shows the state to people: a beat of the loop's own time, thinned by wall time where virtual time races."""

    def __init__(self, runtime: Runtime, view: View, loop: Any, period_ns: int) -> None:
        self._runtime = runtime
        self._view = view
        self._loop = loop
        self._period_ns = period_ns
        self._shown_s = -math.inf
        self._timer: asyncio.TimerHandle | None = None

    def look(self) -> None:
        self._timer = self._loop.call_at_ns(self._loop.now_ns() + self._period_ns, self.look)
        wall_s = time.monotonic()
        if wall_s - self._shown_s >= 0.75 * LOOK_S:
            self._shown_s = wall_s
            self._show()

    def end(self) -> None:
        """The last look, at how it ended."""
        if self._timer is not None:
            self._timer.cancel()
            self._show()

    def _show(self) -> None:
        handle = self._runtime.handle
        handle.explanations()  # asking is what makes behaviours say what they do
        self._view.update(handle.snapshot())


@contextlib.contextmanager
def _signals(loop: Any, runtime: Runtime) -> Iterator[None]:
    """INT, TERM and HUP end the run in good order, a second Ctrl-C does not wait; TSTP stops the motors first."""
    before = {number: signal.getsignal(number) for number in (*SIGNALS, signal.SIGTSTP)}

    def stop(number: signal.Signals) -> None:
        log.info("%s: stopping", number.name)
        runtime.stop()
        loop.remove_signal_handler(signal.SIGINT)  # the next one raises KeyboardInterrupt

    for number in SIGNALS:
        loop.add_signal_handler(number, stop, number)
    loop.add_signal_handler(signal.SIGTSTP, runtime.suspend)
    try:
        yield
    finally:
        for number in before:
            loop.remove_signal_handler(number)
            signal.signal(number, before[number])


@contextlib.contextmanager
def _recorded(runtime: Runtime, loaded: Loaded, options: Options, start_ns: int) -> Iterator[None]:
    """With a recording where the command line or the config asks for one."""
    path = options.record
    if path is None and loaded.recorder.folder is not None:
        folder = loaded.recorder.folder
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / f"{loaded.parts.robot.name}-{time.strftime('%Y%m%dT%H%M%SZ', time.gmtime())}-{os.getpid()}.mcap"
    if path is None:
        yield
        return
    from robotd.setup.recording import open_journal

    journal = open_journal(path, loaded, start_ns=start_ns)
    runtime.journal = journal
    try:
        yield
    finally:
        journal.close()
        log.info("recorded %s", path)


def _unhandled(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """A callback that raised (a driver's timer, most likely): said aloud; what it fed becomes stale, and that stops."""
    error = context.get("exception")
    log.error("unhandled in the event loop: %s", context.get("message", "?"), exc_info=error)
