"""The one thread that reads an I2C sensor at a steady beat: the newest reading goes to the loop, which never waits."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Generic, TypeVar

from robotd.world.clock import Clock
from robotd_devices.ports.device_thread import DeviceThread, Newest
from robotd_devices.ports.i2c_bus import I2cBus
from robotd_devices.ports.i2c_writer import RETRIES, RETRY_AFTER_S, why_lost

T = TypeVar("T")
S = TypeVar("S")


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
        self._thread = DeviceThread(f"i2c reader {name}", self._run, on_fault=on_fault, on_lost=on_lost)
        self._newest = Newest[tuple[T, int]](self._thread, lambda newest: on_reading(*newest))

    async def open(self) -> None:
        """Start the thread, wait until the chip is ready. Raises DeviceError; safe to cancel, then call `close`."""
        await self._thread.open()

    async def close(self) -> None:
        """Let go; a thread that a stuck bus holds is left to end by itself."""
        await self._thread.close()

    # ------------------------------------------------------------------------------------- on the thread

    def _run(self) -> None:
        bus: I2cBus | None = None
        try:
            bus = self._open_bus()
            self._attempt(partial(self._sensor.begin, bus))
            self._thread.ready()
            self._read(bus)
        except Exception as error:
            self._thread.fail(why_lost(error, self._sensor.explain, "reader"))
        finally:
            if bus is not None:
                with contextlib.suppress(OSError):
                    bus.close()

    def _read(self, bus: I2cBus) -> None:
        next_s = time.monotonic()
        while not self._thread.closing.wait(max(0.0, next_s - time.monotonic())):
            read_ns, reading = self._attempt(lambda: (self._clock.now_ns(), self._sensor.read(bus)))
            self._newest.put((reading, read_ns))
            next_s = max(next_s + self._sensor.period_s, time.monotonic())

    def _attempt(self, transaction: Callable[[], S]) -> S:
        for _ in range(RETRIES):
            try:
                return transaction()
            except OSError as error:
                self._thread.fault("I2C retry", self._sensor.explain(error))
                time.sleep(RETRY_AFTER_S)
        return transaction()
