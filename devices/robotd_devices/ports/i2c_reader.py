"""The one thread that reads an I2C sensor at a steady beat: the newest reading goes to the loop, which never waits."""

from __future__ import annotations

import asyncio
import contextlib
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Generic, TypeVar

from robotd.authoring.device import DeviceError, DeviceUnavailable
from robotd.world.clock import Clock
from robotd_devices.ports.i2c_bus import I2cBus
from robotd_devices.ports.i2c_writer import RETRIES, RETRY_AFTER_S

T = TypeVar("T")
S = TypeVar("S")

_CLOSE_WITHIN_S = 0.15


@dataclass(frozen=True)
class SensorPlan(Generic[T]):
    """How a sensor is read: functions that block, called on the reader's thread.

    begin: gets the chip ready. read: one reading. Both raise OSError or DeviceError. explain: words for an OSError.
    """

    begin: Callable[[I2cBus], None]
    read: Callable[[I2cBus], T]
    period_s: float
    explain: Callable[[OSError], str]


class I2cReader(Generic[T]):
    """A daemon thread that reads every `period_s`; beats that are over are left out, never caught up.

    The callbacks run on the loop: `on_reading(reading, read_ns)` with the newest reading and the instant before it was
    asked for; `on_fault(name, detail)` for an error that a retry overcame; `on_lost(reason)` once, after `RETRIES`
    retries of one reading or where `read` raised a DeviceError. None is called after `close`.
    """

    def __init__(
        self,
        name: str,
        sensor: SensorPlan[T],
        open_bus: Callable[[], I2cBus],
        clock: Clock,
        *,
        on_reading: Callable[[T, int], None],
        on_fault: Callable[[str, str], None],
        on_lost: Callable[[str], None],
    ) -> None:
        self._sensor = sensor
        self._open_bus = open_bus
        self._clock = clock
        self._on_reading = on_reading
        self._on_fault = on_fault
        self._on_lost = on_lost
        self._slot: tuple[T, int] | None = None
        self._lock = threading.Lock()
        self._stopping = threading.Event()
        self._ready = asyncio.Event()
        self._ended = asyncio.Event()
        self._why_not: DeviceError | None = None
        self._loop = asyncio.get_running_loop()
        self._thread = threading.Thread(target=self._run, name=f"i2c reader {name}", daemon=True)

    async def open(self) -> None:
        """Start the thread, wait until the chip is ready. Raises DeviceError; safe to cancel, then call `close`."""
        self._thread.start()
        await self._ready.wait()
        if self._why_not is not None:
            raise self._why_not

    async def close(self) -> None:
        """Let go; a thread that a stuck bus holds is left to end by itself."""
        self._stopping.set()
        if self._thread.is_alive():
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(_CLOSE_WITHIN_S):
                    await self._ended.wait()

    # ------------------------------------------------------------------------------------- on the thread

    def _run(self) -> None:
        bus: I2cBus | None = None
        try:
            bus = self._open_bus()
            self._attempt(partial(self._sensor.begin, bus))
            self._tell(self._ready.set)
            self._read(bus)
        except Exception as error:
            self._give_up(error)
        finally:
            if bus is not None:
                with contextlib.suppress(OSError):
                    bus.close()
            self._tell(self._ended.set)

    def _read(self, bus: I2cBus) -> None:
        next_s = time.monotonic()
        while not self._stopping.wait(max(0.0, next_s - time.monotonic())):
            read_ns, reading = self._attempt(lambda: (self._clock.now_ns(), self._sensor.read(bus)))
            with self._lock:
                asked = self._slot is not None
                self._slot = reading, read_ns
            if not asked:
                self._tell(self._take)
            next_s = max(next_s + self._sensor.period_s, time.monotonic())

    def _attempt(self, transaction: Callable[[], S]) -> S:
        for _ in range(RETRIES):
            try:
                return transaction()
            except OSError as error:
                self._tell(self._fault, "I2C retry", self._sensor.explain(error))
                time.sleep(RETRY_AFTER_S)
        return transaction()

    def _give_up(self, error: Exception) -> None:
        if isinstance(error, OSError):
            told: DeviceError = DeviceUnavailable(self._sensor.explain(error))
        elif isinstance(error, DeviceError):
            told = error
        else:
            told = DeviceError(f"the reader failed: {type(error).__name__}: {error}")
        self._tell(self._lose, told)

    def _tell(self, call: Callable[..., None], *args: object) -> None:
        with contextlib.suppress(RuntimeError):  # the loop is closed: nobody is left to hear
            self._loop.call_soon_threadsafe(call, *args)

    # --------------------------------------------------------------------------------------- on the loop

    def _take(self) -> None:
        with self._lock:
            slot, self._slot = self._slot, None
        if slot is not None and not self._stopping.is_set():
            self._on_reading(*slot)

    def _fault(self, name: str, detail: str) -> None:
        if not self._stopping.is_set():
            self._on_fault(name, detail)

    def _lose(self, error: DeviceError) -> None:
        if not self._ready.is_set():
            self._why_not = error
            self._ready.set()
        elif not self._stopping.is_set():
            self._on_lost(str(error))
