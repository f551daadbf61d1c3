"""Hosts a fake controller in memory on the loop's own time, at the real baud, with a line that can be cut or full."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from robotd.authoring.device import DeviceUnavailable
from robotd_devices.ports.fakes import FakeDevice
from robotd_devices.ports.serial_port import BITS_PER_BYTE, Backend, SerialSettings

STEP_S = 0.0005
KERNEL_BYTES = 4096


class MemoryLine:
    """The cable between a driver and a fake. `make_port` is what a `SerialMotor` takes of that name.

    Bytes to the fake take their time on the wire; bytes from it come at once. On virtual time the same bit for bit.
    """

    def __init__(self, fake: FakeDevice) -> None:
        self.fake = fake
        self.is_stuck = False
        """The adapter takes no bytes any more: they stay in the kernel's buffer, and in the driver's behind it."""
        self.writes: list[tuple[float, bytes]] = []
        """Every write of the driver, with the loop's time in seconds."""
        self._is_plugged = True
        self._port: MemoryPort | None = None

    def make_port(
        self,
        settings: SerialSettings,
        backend: Backend,
        on_data: Callable[[bytes], None],
        on_lost: Callable[[str], None],
    ) -> MemoryPort:
        """A closed port on this line, whatever the back end."""
        self._port = MemoryPort(self, settings, on_data, on_lost)
        return self._port

    @property
    def is_plugged(self) -> bool:
        """Whether the cable is in."""
        return self._is_plugged

    def unplug(self) -> None:
        """Pull the cable; the driver hears of it in the next turn."""
        self._is_plugged = False
        if self._port is not None:
            self._port.pulled()

    def plug(self) -> None:
        """Put it in again; the fake powers on when the port is opened."""
        self._is_plugged = True


class MemoryPort:
    """A `SerialPort` on a `MemoryLine`."""

    def __init__(
        self,
        line: MemoryLine,
        settings: SerialSettings,
        on_data: Callable[[bytes], None],
        on_lost: Callable[[str], None],
    ) -> None:
        self.settings = settings
        self._line = line
        self._on_data = on_data
        self._on_lost = on_lost
        self._out = bytearray()
        self._is_open = False
        self._tick: asyncio.TimerHandle | None = None
        self._moved_s = 0.0

    @property
    def unsent(self) -> int:
        return max(0, len(self._out) - KERNEL_BYTES)

    async def open(self) -> None:
        if not self._line.is_plugged:
            raise DeviceUnavailable(f"no serial port {self.settings.path}: is the cable in?")
        self._loop = asyncio.get_running_loop()
        self._is_open = True
        self._moved_s = self._loop.time()
        self._line.fake.power_on(self._now_ns())
        self._tick = self._loop.call_later(STEP_S, self._step)

    def write(self, data: bytes, *, first: bool = False) -> None:
        if not self._is_open:
            return
        self._line.writes.append((self._loop.time(), data))
        self._move()
        if first:
            self._out.clear()
        if not self._out:
            self._moved_s = self._loop.time()
        self._out += data

    async def drain(self, timeout_s: float) -> bool:
        until_s = self._loop.time() + timeout_s
        while self._out and self._is_open:
            if self._loop.time() >= until_s:
                return False
            await asyncio.sleep(STEP_S)
        return self._is_open

    def abort(self) -> None:
        self._is_open = False
        self._out.clear()
        if self._tick is not None:
            self._tick.cancel()
            self._tick = None

    def set_dtr(self, on: bool) -> bool:
        return False

    def pulled(self) -> None:
        """The cable is out."""
        if self._is_open:
            self.abort()
            self._loop.call_soon(self._on_lost, f"{self.settings.path} went away")

    def _now_ns(self) -> int:
        return round(self._loop.time() * 1e9)

    def _move(self) -> None:
        """Bytes whose time on the wire is over reach the fake."""
        byte_s = BITS_PER_BYTE / self.settings.baud
        count = int((self._loop.time() - self._moved_s) / byte_s + 1e-9)
        if self._line.is_stuck or not self._out or count == 0:
            return
        data = bytes(self._out[:count])
        del self._out[:count]
        self._moved_s += len(data) * byte_s
        self._line.fake.feed(data, self._now_ns())

    def _step(self) -> None:
        self._tick = self._loop.call_later(STEP_S, self._step)
        self._move()
        data = self._line.fake.tick(self._now_ns())
        if data and self._is_open:
            self._on_data(data)
