"""The two event loops behind one small interface: real time with punctual timers, and virtual time."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any, Protocol

from typing_extensions import TypeVarTuple, Unpack

from robotd.engine.loop_real import PreciseSelector, RealLoop
from robotd.engine.loop_virtual import VirtualDeadlock, VirtualLoop

Ts = TypeVarTuple("Ts")


class RobotLoop(Protocol):
    """What the runtime asks of its event loop; also a `Clock`."""

    def now_ns(self) -> int:
        """Nanoseconds of the loop's own time; `time()` is the same clock in seconds."""
        ...

    def call_at_ns(self, when_ns: int, callback: Callable[[Unpack[Ts]], Any], *args: *Ts) -> asyncio.TimerHandle:
        """Call back at an instant, never earlier."""
        ...


def virtual_loop(pace: float | None = None, start_ns: int = 0) -> VirtualLoop:
    """A new loop on virtual time; `asyncio.Runner(loop_factory=virtual_loop)` runs as fast as it can."""
    return VirtualLoop(pace, start_ns)


def real_loop() -> RealLoop:
    """A new loop on real time, for `asyncio.Runner(loop_factory=real_loop)`."""
    return RealLoop()


def running_loop() -> RealLoop | VirtualLoop:
    """The running loop. Raises RuntimeError where it is not one of the two, naming what to start instead."""
    loop = asyncio.get_running_loop()
    if isinstance(loop, RealLoop | VirtualLoop):
        return loop
    raise RuntimeError(
        f"robotd needs its own event loop, this is {type(loop).__name__}: use asyncio.Runner(loop_factory=real_loop) "
        "or, in a test, robotd.testing.run_virtual"
    )


__all__ = [
    "PreciseSelector",
    "RealLoop",
    "RobotLoop",
    "VirtualDeadlock",
    "VirtualLoop",
    "real_loop",
    "running_loop",
    "virtual_loop",
]
