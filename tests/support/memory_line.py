"""A serial line in memory on the running (virtual) event loop: one fake, and ports that open it and lose it."""

from __future__ import annotations

import asyncio
import random
from collections import deque
from collections.abc import Callable
from typing import Any

from robotd.authoring.device import DeviceUnavailable
from robotd_devices.ports.serial_port import SerialSettings

STEP_S = 0.001


class MemoryLine:
    """Stands for a cable with a fake at its end. Give `port` to a driver in place of `serial_port`.

    A port at another speed than `baud` sends nothing that the fake understands and reads noise.
    """

    def __init__(self, fake: Any, baud: int) -> None:
        self.fake = fake
        self.baud = baud
        self.plugged = True
        self.opened: list[SerialSettings] = []
        self.written = bytearray()
        self.ports: list[MemoryPort] = []

    def port(
        self, settings: SerialSettings, backend: str, on_data: Callable[[bytes], None], on_lost: Callable[[str], None]
    ) -> MemoryPort:
        return MemoryPort(self, settings, on_data, on_lost)

    def unplug(self) -> None:
        self.plugged = False
        for port in self.ports[:]:
            port.lose()

    def plug(self) -> None:
        self.plugged = True
        self.fake.power_on(self.now_ns())

    @staticmethod
    def now_ns() -> int:
        return round(asyncio.get_running_loop().time() * 1e9)


class MemoryPort:
    """A `SerialPort`."""

    unsent = 0

    def __init__(
        self,
        line: MemoryLine,
        settings: SerialSettings,
        on_data: Callable[[bytes], None],
        on_lost: Callable[[str], None],
    ) -> None:
        self.line, self.settings = line, settings
        self._on_data, self._on_lost = on_data, on_lost
        self._open = False
        self._queue: deque[tuple[float, bytes]] = deque()
        self._free_ns = 0.0
        self._noise = random.Random(1)

    async def open(self) -> None:
        line = self.line
        await asyncio.sleep(0.005)
        if not line.plugged:
            raise DeviceUnavailable(f"no serial port {self.settings.path}: is the cable in?")
        self._open = True
        line.opened.append(self.settings)
        line.ports.append(self)
        self.set_dtr(self.settings.dtr is None or self.settings.dtr)
        line.fake.tick(line.now_ns())  # old input is thrown away
        self._tick()

    def write(self, data: bytes, *, first: bool = False) -> None:
        if self._open:
            self.line.written += data
            if self.settings.baud == self.line.baud:
                self.line.fake.feed(data, self.line.now_ns())

    async def drain(self, timeout_s: float) -> bool:
        return self._open

    def abort(self) -> None:
        if self._open:
            self._open = False
            self.line.ports.remove(self)

    def set_dtr(self, on: bool) -> bool:
        if self._open and hasattr(self.line.fake, "set_dtr"):
            self.line.fake.set_dtr(on, self.line.now_ns())
        return self._open

    def lose(self) -> None:
        self.abort()
        self._on_lost(f"{self.settings.path} went away (end of file)")

    def _tick(self) -> None:
        if not self._open:
            return
        line, byte_ns = self.line, 1e10 / self.line.baud
        now_ns = line.now_ns()
        data = line.fake.tick(now_ns)
        if data:
            self._free_ns = max(self._free_ns, float(now_ns))
            self._queue.append((self._free_ns, data))
            self._free_ns += len(data) * byte_ns
        out = b""
        while self._queue:
            start_ns, data = self._queue[0]
            count = min(int((now_ns - start_ns) / byte_ns), len(data))
            if count <= 0:
                break
            out += data[:count]
            if count == len(data):
                self._queue.popleft()
            else:
                self._queue[0] = (start_ns + count * byte_ns, data[count:])
        asyncio.get_running_loop().call_later(STEP_S, self._tick)
        if out:
            self._on_data(out if self.settings.baud == line.baud else self._noise.randbytes(len(out)))
