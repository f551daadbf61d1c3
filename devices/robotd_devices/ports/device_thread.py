"""A driver's own thread: what may block for ever happens there, and what it has to say comes out on the loop."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Callable
from typing import Generic, TypeVar

from robotd.authoring.device import DeviceError

T = TypeVar("T")

CLOSE_WITHIN_S = 0.15


class DeviceThread:
    """A daemon thread that runs `work` once, from `open` on.

    The callbacks run on the loop: `on_fault(name, detail)`, and `on_lost(reason)` where `fail` was called after
    `ready`. None is called after `close`.
    """

    def __init__(
        self,
        name: str,
        work: Callable[[], None],
        *,
        on_fault: Callable[[str, str], None],
        on_lost: Callable[[str], None],
    ) -> None:
        self.closing = threading.Event()
        """Set by `close`: the work is to come to its end."""
        self._work = work
        self._on_fault = on_fault
        self._on_lost = on_lost
        self._ready = asyncio.Event()
        self._ended = asyncio.Event()
        self._why_not: DeviceError | None = None
        self._loop = asyncio.get_running_loop()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    # --------------------------------------------------------------------------------------- on the loop

    @property
    def is_alive(self) -> bool:
        """Whether the thread still runs, or hangs."""
        return self._thread.is_alive()

    async def open(self) -> None:
        """Start, and wait until the work is ready. Raises DeviceError; safe to cancel, then call `close`."""
        self._thread.start()
        await self._ready.wait()
        if self._why_not is not None:
            raise self._why_not

    async def close(self) -> bool:
        """Let go; False where the thread hangs: it will end by itself or never."""
        self.closing.set()
        if self._thread.is_alive():
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(CLOSE_WITHIN_S):
                    await self._ended.wait()
        return self._ended.is_set() or not self._thread.is_alive()

    def join(self) -> None:
        """Block until it has ended, `CLOSE_WITHIN_S` at most; for a program that ends."""
        self._thread.join(CLOSE_WITHIN_S)

    # ------------------------------------------------------------------------------------- on the thread

    def ready(self) -> None:
        """The device is open."""
        self._call(self._ready.set)

    def fault(self, name: str, detail: str) -> None:
        """Something went wrong that the work survived."""
        self.tell(self._on_fault, name, detail)

    def fail(self, error: DeviceError) -> None:
        """The work is over: `open` raises it, or, once that has returned, the device is lost."""
        self._call(self._failed, error)

    def tell(self, call: Callable[..., None], *args: object) -> None:
        """Call this on the loop, unless `close` was called by then."""
        self._call(self._told, call, args)

    def _run(self) -> None:
        try:
            self._work()
        finally:
            self._call(self._ended.set)

    def _call(self, call: Callable[..., None], *args: object) -> None:
        with contextlib.suppress(RuntimeError):  # the loop is closed: nobody is left to hear
            self._loop.call_soon_threadsafe(call, *args)

    # --------------------------------------------------------------------------------------- on the loop

    def _told(self, call: Callable[..., None], args: tuple[object, ...]) -> None:
        if not self.closing.is_set():
            call(*args)

    def _failed(self, error: DeviceError) -> None:
        if not self._ready.is_set():
            self._why_not = error
            self._ready.set()
        elif not self.closing.is_set():
            self._on_lost(str(error))


class Newest(Generic[T]):
    """From a thread to the loop the newest value only: `on_value` gets it whenever the loop comes round to it."""

    def __init__(self, thread: DeviceThread, on_value: Callable[[T], None]) -> None:
        self.overwritten = 0
        """Values that the loop was too slow for."""
        self._thread = thread
        self._on_value = on_value
        self._slot: T | None = None
        self._lock = threading.Lock()

    def put(self, value: T) -> None:
        """On the thread: hand over a value (never None); one that still waits is forgotten."""
        with self._lock:
            is_waiting = self._slot is not None
            self._slot = value
            self.overwritten += is_waiting
        if not is_waiting:
            self._thread.tell(self._take)

    def _take(self) -> None:
        with self._lock:
            value, self._slot = self._slot, None
        if value is not None:
            self._on_value(value)
