"""The event loop on virtual time: an asyncio loop whose waiting is the passing of time, the same bit for bit each run.

What decides the order of callbacks: timers run by (instant in integer nanoseconds, order of scheduling); what is ready
runs before time passes. Neither the wall clock nor an idle descriptor takes part. Paced by wall time, the loop waits
before it lets time pass, and does nothing else differently.

Descriptors, signals and threads belong to the world outside and happen at the virtual instant at which the loop meets
them. Two rules keep threads from making time uncertain: while a `run_in_executor` (or `asyncio.to_thread`) call is
outstanding, and inside `freeze()`, time stands still. Hence a thread that lives as long as the program must be a
`threading.Thread`, not an executor's job. A task that spins on `sleep(0)` until a timer fires spins for ever.
"""

from __future__ import annotations

import asyncio
import contextlib
import heapq
import inspect
import math
import selectors
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from contextvars import Context
from typing import Any, TypeAlias

from typing_extensions import TypeVar, TypeVarTuple, Unpack

from robotd.engine.loop_real import NS_PER_S, PreciseSelector

T = TypeVar("T")
Ts = TypeVarTuple("Ts")
Ready: TypeAlias = list[tuple[selectors.SelectorKey, int]]

_SIGNAL_POLL_NS = 2_000_000
"""Wall time between looks for signals while virtual time runs freely."""

_LAG_LIMIT_NS = 250_000_000
"""A paced loop that is later than this does not run faster to catch up: the pace begins anew from there."""

_THREAD_LOOK_S = 0.2
"""How often a loop that only threads can wake looks whether any is left."""


class VirtualDeadlock(RuntimeError):
    """Nothing is left that could ever wake the loop. The message names the tasks that wait."""


class VirtualTimer(asyncio.TimerHandle):
    """A timer at an exact instant. `when_ns`: nanoseconds of virtual time."""

    __slots__ = ("_home", "queued", "when_ns")

    def __init__(
        self,
        when_ns: int,
        callback: Callable[..., Any],
        args: tuple[Any, ...],
        loop: VirtualLoop,
        context: Context | None,
    ) -> None:
        super().__init__(when_ns / NS_PER_S, callback, args, loop, context)
        self._home = loop
        self.when_ns = when_ns
        self.queued = False

    def cancel(self) -> None:
        counts = self.queued and not self.cancelled()
        super().cancel()
        if counts:
            self._home.timer_cancelled()


class _Waiting(PreciseSelector):
    """Gives each wait to the loop, which alone knows whether it is wall time or virtual time that passes."""

    def __init__(self) -> None:
        super().__init__()
        self.wait: Callable[[float | None], Ready] = super().select
        self.count = len(self.get_map())
        """How many descriptors are registered."""

    def register(self, fileobj: Any, events: int, data: Any = None) -> selectors.SelectorKey:
        key = super().register(fileobj, events, data)
        self.count = len(self.get_map())
        return key

    def unregister(self, fileobj: Any) -> selectors.SelectorKey:
        key = super().unregister(fileobj)
        self.count = len(self.get_map())
        return key

    def select(self, timeout: float | None = None) -> Ready:
        return self.wait(timeout)

    def look(self, timeout: float | None) -> Ready:
        """The real wait."""
        return super().select(timeout)


class VirtualLoop(asyncio.SelectorEventLoop):
    """asyncio's loop on integer nanoseconds of virtual time.

    pace: virtual seconds per wall second, or None to run as fast as it can; order and instants are the same for all.
    start_ns: the first instant. `time()` is exact to the nanosecond up to about 50 days, `now_ns()` always.
    Raises ValueError for a pace that is not above 0; running it raises `VirtualDeadlock` instead of waiting for ever.
    """

    _ready: deque[asyncio.Handle]
    """asyncio's own queue of what runs next; the one private name that this class uses."""

    def __init__(self, pace: float | None = None, start_ns: int = 0) -> None:
        self._now_ns = start_ns
        self._pace = pace
        self._anchor_ns: tuple[int, int] | None = None
        self._timers: list[tuple[int, int, VirtualTimer]] = []
        self._scheduled_count = 0
        self._cancelled_count = 0
        self._frozen = 0
        self._outstanding = 0
        self._signals: set[int] = set()
        self._looked_ns = 0
        self._woken = False
        self._waiting = _Waiting()
        super().__init__(self._waiting)
        self._own_descriptors = self._waiting.count
        self._waiting.wait = self._wait
        if pace is not None and not (math.isfinite(pace) and pace > 0.0):
            self.close()
            raise ValueError(f"pace must be above 0 and finite, or None for as fast as it can, not {pace}")

    @property
    def pace(self) -> float | None:
        """Virtual seconds per wall second, None for no pacing."""
        return self._pace

    def now_ns(self) -> int:
        """The present instant of virtual time."""
        return self._now_ns

    def time(self) -> float:
        return self._now_ns / NS_PER_S

    # ------------------------------------------------------------------------------------------ timers

    def call_at_ns(
        self,
        when_ns: int,
        callback: Callable[[Unpack[Ts]], Any],
        *args: *Ts,
        context: Context | None = None,
    ) -> asyncio.TimerHandle:
        """Call back at an instant; equal instants run in the order of these calls. An instant in the past is now.

        Raises RuntimeError on a closed loop.
        """
        timer = self._new_timer(when_ns, callback, args, context)
        heapq.heappush(self._timers, (when_ns, self._scheduled_count, timer))
        self._scheduled_count += 1
        timer.queued = True
        return timer

    def call_at(
        self,
        when: float,
        callback: Callable[[Unpack[Ts]], Any],
        *args: *Ts,
        context: Context | None = None,
    ) -> asyncio.TimerHandle:
        if when == math.inf:
            # it can be cancelled, and never comes
            return self._new_timer(1 << 63, callback, args, context)
        return self.call_at_ns(round(when * NS_PER_S), callback, *args, context=context)

    def call_later(
        self,
        delay: float,
        callback: Callable[[Unpack[Ts]], Any],
        *args: *Ts,
        context: Context | None = None,
    ) -> asyncio.TimerHandle:
        if delay == math.inf:
            return self.call_at(delay, callback, *args, context=context)
        return self.call_at_ns(self._now_ns + round(delay * NS_PER_S), callback, *args, context=context)

    def _new_timer(
        self, when_ns: int, callback: Callable[..., Any], args: tuple[Any, ...], context: Context | None
    ) -> VirtualTimer:
        if self.is_closed():
            raise RuntimeError("Event loop is closed")
        return VirtualTimer(when_ns, callback, args, self, context)

    def timer_cancelled(self) -> None:
        """A queued timer was cancelled: when half of a long queue is dead it is built anew."""
        self._cancelled_count += 1
        if self._cancelled_count > 100 and 2 * self._cancelled_count > len(self._timers):
            self._timers = [entry for entry in self._timers if not entry[2].cancelled()]
            heapq.heapify(self._timers)
            self._cancelled_count = 0

    def _run_due(self) -> None:
        """Hands every timer that is due to asyncio, in order."""
        timers, now_ns = self._timers, self._now_ns
        while timers and timers[0][0] <= now_ns:
            timer = heapq.heappop(timers)[2]
            timer.queued = False
            if timer.cancelled():
                self._cancelled_count -= 1
            else:
                self._ready.append(timer)

    def _next_ns(self) -> int | None:
        """The instant of the next timer that is not cancelled."""
        timers = self._timers
        while timers:
            if not timers[0][2].cancelled():
                return timers[0][0]
            heapq.heappop(timers)[2].queued = False
            self._cancelled_count -= 1
        return None

    # ------------------------------------------------------------------------------------------- waiting

    def _wait(self, timeout: float | None) -> Ready:
        """Stands in for the selector: asyncio asks with 0 while something is ready, with None when nothing is."""
        events = self._glance()
        if events or timeout is not None:
            self._run_due()
            return events
        next_ns = self._next_ns()
        if next_ns is None or self._frozen or self._outstanding:
            return self._wait_for_the_world()
        if next_ns > self._now_ns:
            if self._pace is not None and (events := self._wait_for_the_wall(next_ns, self._pace)):
                return events
            self._now_ns = next_ns
        self._run_due()
        return []

    def _glance(self) -> Ready:
        """What the world has ready, without waiting; no system call where there is no world."""
        if self._woken or self._waiting.count > self._own_descriptors:
            self._woken = False
        elif self._signals:
            wall_ns = time.monotonic_ns()
            if wall_ns - self._looked_ns < _SIGNAL_POLL_NS:
                return []
            self._looked_ns = wall_ns
        else:
            return []
        return self._waiting.look(0)

    def _wait_for_the_wall(self, next_ns: int, pace: float) -> Ready:
        """Waits until wall time has come as far as `next_ns`, or until something happens."""
        wall_ns = time.monotonic_ns()
        if self._anchor_ns is None:
            self._anchor_ns = (wall_ns, self._now_ns)
        due_ns = self._anchor_ns[0] + int((next_ns - self._anchor_ns[1]) / pace)
        if wall_ns - due_ns > _LAG_LIMIT_NS:
            self._anchor_ns = (wall_ns, next_ns)
            return []
        while wall_ns < due_ns:
            if events := self._waiting.look((due_ns - wall_ns) / NS_PER_S):
                return events
            wall_ns = time.monotonic_ns()
        return []

    def _wait_for_the_world(self) -> Ready:
        """No time to pass: only a descriptor, a signal or a thread can go on."""
        if self._outstanding or self._signals or self._waiting.count > self._own_descriptors:
            return self._waiting.look(None)
        while self._threads():
            if events := self._waiting.look(_THREAD_LOOK_S):
                return events
        # a thread may have called just before it ended
        if events := self._waiting.look(0):
            return events
        raise VirtualDeadlock(self._why_stuck())

    def _threads(self) -> list[threading.Thread]:
        """Threads that might still call; the idle workers of the default executor never do."""
        here = threading.current_thread()
        return [t for t in threading.enumerate() if t is not here and not t.name.startswith("asyncio_")]

    def _why_stuck(self) -> str:
        waiting = sorted(f"{task.get_name()} in {_place(task)}" for task in asyncio.all_tasks(self))
        cause = "time is frozen" if self._frozen else "no timer is set"
        tasks = "; waiting: " + ", ".join(waiting) if waiting else ""
        return (
            f"virtual time stands at {self.time():.9g} s for ever: nothing is ready, {cause}, and no descriptor, "
            f"signal or thread could wake the loop{tasks}"
        )

    # ---------------------------------------------------------------------------------- the world outside

    @contextlib.contextmanager
    def freeze(self) -> Iterator[None]:
        """Inside, time stands still: what a thread of your own hands over arrives at this very instant."""
        self._frozen += 1
        try:
            yield
        finally:
            self._frozen -= 1

    def run_in_executor(
        self, executor: Executor | None, func: Callable[[Unpack[Ts]], T], *args: *Ts
    ) -> asyncio.Future[T]:
        future = super().run_in_executor(executor, func, *args)
        self._outstanding += 1
        future.add_done_callback(self._came_back)
        return future

    def _came_back(self, _future: asyncio.Future[Any]) -> None:
        self._outstanding -= 1

    async def shutdown_default_executor(self, *args: Any, **kwargs: Any) -> None:
        # its own time-out (Python 3.12) counts wall time, not ours
        with self.freeze():
            await super().shutdown_default_executor(*args, **kwargs)

    def call_soon_threadsafe(
        self, callback: Callable[[Unpack[Ts]], object], *args: *Ts, context: Context | None = None
    ) -> asyncio.Handle:
        handle = super().call_soon_threadsafe(callback, *args, context=context)
        self._woken = True
        return handle

    def add_signal_handler(self, sig: int, callback: Callable[[Unpack[Ts]], object], *args: *Ts) -> None:
        super().add_signal_handler(sig, callback, *args)
        self._signals.add(int(sig))

    def remove_signal_handler(self, sig: int) -> bool:
        self._signals.discard(int(sig))
        return super().remove_signal_handler(sig)

    def close(self) -> None:
        super().close()
        self._timers.clear()
        self._waiting.wait = self._waiting.look


def _place(task: asyncio.Task[Any]) -> str:
    """The innermost coroutine in which a task waits, for people."""
    awaiting: Any = task.get_coro()
    while inspect.iscoroutine(inner := getattr(awaiting, "cr_await", None)):
        awaiting = inner
    frame = getattr(awaiting, "cr_frame", None)
    if frame is None:
        return "an unknown place"
    return f"{frame.f_code.co_qualname} line {frame.f_lineno}"
