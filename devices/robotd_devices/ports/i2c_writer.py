"""The one thread that talks to an I2C chip for a driver: newest command wins, a stop overtakes, the loop is free."""

from __future__ import annotations

import atexit
import contextlib
import math
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Generic, TypeVar

from robotd.authoring.device import DeviceError, DeviceUnavailable
from robotd_devices.ports.device_thread import DeviceThread
from robotd_devices.ports.i2c_bus import I2cBus, I2cWrite

T = TypeVar("T")

FRESH_S = 0.06
"""An older command is not written any more: a program that was frozen half way through one wakes up to a stop."""
RETRIES = 2
RETRY_AFTER_S = 0.002


@dataclass(frozen=True)
class ChipPlan(Generic[T]):
    """How a driver's commands become writes: pure functions, called on the writer's thread.

    begin: gets the chip ready, its first write the stop; raises OSError or DeviceError. plan: the writes that lead from
    what was written last (None: the stop) to what is wanted. stop: the writes that stop everything, whatever the state
    of the chip. check: is the chip still as `begin` left it? Raises OSError or DeviceError; called every `check_s`.
    explain: words for an OSError of the bus.
    """

    begin: Callable[[I2cBus], None]
    plan: Callable[[T | None, T], Sequence[I2cWrite]]
    stop: Sequence[I2cWrite]
    check: Callable[[I2cBus], None]
    check_s: float
    explain: Callable[[OSError], str]


class I2cWriter(Generic[T]):
    """A mailbox for one command of type T (never None) and one stop, and a daemon thread that empties it.

    The callbacks run on the loop: `on_written(command)` after the last write of a command, None for a stop;
    `on_fault(name, detail)` for an error that a retry overcame; `on_lost(reason)` once, after `RETRIES` retries of one
    transaction or a failed check; the thread has then tried to stop, and ends. None is called after `close`.
    """

    def __init__(
        self,
        name: str,
        chip: ChipPlan[T],
        open_bus: Callable[[], I2cBus],
        *,
        on_written: Callable[[T | None], None],
        on_fault: Callable[[str, str], None],
        on_lost: Callable[[str], None],
    ) -> None:
        self._chip = chip
        self._open_bus = open_bus
        self._on_written = on_written
        self._mail = threading.Condition()
        self._wanted: T | None = None
        self._until_s = 0.0
        self._stop_due = False
        self._closing = False
        self._thread = DeviceThread(f"i2c writer {name}", self._run, on_fault=on_fault, on_lost=on_lost)

    async def open(self) -> None:
        """Start the thread, wait until the chip is ready. Raises DeviceError; safe to cancel, then call `close`."""
        atexit.register(self._at_exit)
        await self._thread.open()

    def put(self, command: T) -> None:
        """The command to write next; one that still waits is forgotten. Never blocks."""
        with self._mail:
            self._wanted = command
            self._until_s = time.monotonic() + FRESH_S
            self._mail.notify()

    def stop(self) -> None:
        """Write the stop next; a command that waits is forgotten, one half written is broken off. Never blocks."""
        with self._mail:
            self._wanted = None
            self._stop_due = True
            self._mail.notify()

    async def close(self) -> None:
        """Write the stop as the last thing and let go; a thread that a stuck bus holds is left to end by itself."""
        atexit.unregister(self._at_exit)
        self._end()
        await self._thread.close()

    def _end(self) -> None:
        with self._mail:
            self._wanted = None
            self._closing = self._stop_due = True
            self._mail.notify()

    def _at_exit(self) -> None:
        """The program ends without closing its devices: the stop all the same."""
        self._end()
        self._thread.join()

    # ------------------------------------------------------------------------------------- on the thread

    def _run(self) -> None:
        bus: I2cBus | None = None
        try:
            bus = self._open_bus()
            self._chip.begin(bus)
            self._thread.ready()
            self._serve(bus)
        except Exception as error:
            self._thread.fail(why_lost(error, self._chip.explain, "writer"))
        finally:
            if bus is not None:
                self._stop_at_last(bus)
                with contextlib.suppress(OSError):
                    bus.close()

    def _serve(self, bus: I2cBus) -> None:
        chip = self._chip
        written: T | None = None
        check_at_s = time.monotonic() + chip.check_s
        while True:
            with self._mail:
                if self._wanted is None and not self._stop_due:
                    self._mail.wait(max(0.0, check_at_s - time.monotonic()))
                if self._closing:
                    return
                stop, self._stop_due = self._stop_due, False
                wanted = None
                if not stop:
                    wanted, self._wanted = self._wanted, None
            if stop:
                for write in chip.stop:
                    self._attempt(partial(bus.write, *write))
                written = None
                self._thread.tell(self._on_written, None)
            elif wanted is not None and self._write_all(bus, chip.plan(written, wanted)):
                written = wanted
                self._thread.tell(self._on_written, wanted)
            if time.monotonic() >= check_at_s:
                self._attempt(partial(chip.check, bus))
                check_at_s = time.monotonic() + chip.check_s

    def _write_all(self, bus: I2cBus, writes: Sequence[I2cWrite]) -> bool:
        """False where a stop came in between, or time ran out: the rest is not written, the stop is next."""
        for write in writes:
            if self._stop_due:
                return False
            if not self._attempt(partial(bus.write, *write), until_s=self._until_s):
                self.stop()
                return False
        return True

    def _attempt(self, transaction: Callable[[], None], *, quiet: bool = False, until_s: float = math.inf) -> bool:
        """One transaction, again where it fails; False where it did not begin because `until_s` was over."""
        for attempt in range(RETRIES + 1):
            try:
                # looked at as late as can be: this thread may be kept waiting anywhere
                if time.monotonic() > until_s:
                    return False
                transaction()
                return True
            except OSError as error:
                if attempt == RETRIES:
                    raise
                if not quiet:
                    self._thread.fault("I2C retry", self._chip.explain(error))
                time.sleep(RETRY_AFTER_S)
        return False

    def _stop_at_last(self, bus: I2cBus) -> None:
        with contextlib.suppress(OSError):
            for write in self._chip.stop:
                self._attempt(partial(bus.write, *write), quiet=True)


def why_lost(error: Exception, explain: Callable[[OSError], str], who: str) -> DeviceError:
    """What ended a thread's work, in words for a user; anything but an OSError or a DeviceError is our own mistake."""
    if isinstance(error, OSError):
        return DeviceUnavailable(explain(error))
    if isinstance(error, DeviceError):
        return error
    return DeviceError(f"the {who} failed: {type(error).__name__}: {error}")
