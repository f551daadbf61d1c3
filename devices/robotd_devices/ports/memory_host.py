"""Hosts a fake device in memory on the loop's own time, paced at the real baud, with a line that takes every fault."""

from __future__ import annotations

import asyncio
import random
from collections import deque
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import ClassVar

from robotd.authoring.device import DeviceUnavailable
from robotd_devices.ports.breakable import Breakable
from robotd_devices.ports.fakes import Damage, FakeDevice, damage
from robotd_devices.ports.serial_port import BITS_PER_BYTE, Backend, SerialSettings

KERNEL_BYTES = 4096
"""What the kernel takes of a full line."""
OTHER_BAUD = 460_800
_LONGEST_DAMAGE = 8


class MemoryHost(Breakable):
    """The cable between a driver and a fake. `port` stands in for `serial_port`, and for a driver's `make_port`.

    Bytes take their time on the wire both ways. A port at another speed than `baud` reads noise, and what it writes is
    not understood, unless the fake has a `measures(data, baud)` by which it takes another speed over. On virtual time
    everything is the same bit for bit, with the same `seed`. step_s: how often bytes are handed over.
    """

    breaks: ClassVar[Mapping[str, str]] = MappingProxyType(
        {
            "split reads": "splits",
            "byte lost": "lose_byte",
            "byte added": "add_byte",
            "byte changed": "change_byte",
            "bytes twice": "repeat_bytes",
            "other speed": "change_speed",
            "cable out": "is_out",
            "line full": "is_stuck",
            "program held up": "is_held",
        }
    )

    def __init__(self, fake: FakeDevice, baud: int, *, seed: int = 1, step_s: float = 0.001) -> None:
        self.fake = fake
        self.baud = baud
        self.step_s = step_s
        self.splits = False
        """Each byte is a read of its own."""
        self.is_stuck = False
        """The adapter takes no bytes any more."""
        self.is_held = False
        """Bytes that come wait in the kernel; they come in one piece behind it."""
        self.opened: list[tuple[float, SerialSettings]] = []
        """Every opening, with the loop's time in seconds."""
        self.written: list[tuple[float, bytes]] = []
        """Every write of the driver, likewise."""
        self.ports: list[MemoryPort] = []
        """Those that are open."""
        self._rng = random.Random(seed)
        self._damage: Damage | None = None
        self._is_out = False

    def port(
        self,
        settings: SerialSettings,
        backend: Backend,
        on_data: Callable[[bytes], None],
        on_lost: Callable[[str], None],
    ) -> MemoryPort:
        """A closed port on this line, whatever the back end."""
        return MemoryPort(self, settings, on_data, on_lost)

    @property
    def is_out(self) -> bool:
        """Whether the cable is pulled. Put in again, the fake powers on."""
        return self._is_out

    @is_out.setter
    def is_out(self, out: bool) -> None:
        if self._is_out and not out:
            self.fake.power_on(now_ns())
        self._is_out = out
        if out:
            for port in self.ports[:]:
                port.pulled()

    def port_opened(self, settings: SerialSettings) -> None:
        """Called by a port that was opened: old input is thrown away."""
        self.fake.tick(now_ns())

    def lose_byte(self, now_ns: int) -> None:
        """One of the next bytes is lost."""
        self._damage = "drop"

    def add_byte(self, now_ns: int) -> None:
        """A byte is added to the next ones."""
        self._damage = "insert"

    def change_byte(self, now_ns: int) -> None:
        """One of the next bytes becomes another."""
        self._damage = "flip"

    def repeat_bytes(self, now_ns: int) -> None:
        """Some of the next bytes come twice."""
        self._damage = "duplicate"

    def change_speed(self, now_ns: int) -> None:
        """The device speaks at `OTHER_BAUD`."""
        self.baud = OTHER_BAUD

    def worn(self, data: bytes) -> bytes:
        """What arrives of bytes that were sent."""
        kind, self._damage = self._damage, None
        return data if kind is None else damage(data, kind, self._rng, longest=_LONGEST_DAMAGE)

    def noise(self, count: int) -> bytes:
        """What a port at another speed reads."""
        return self._rng.randbytes(count)


class MemoryPort:
    """A `SerialPort` on a `MemoryHost`."""

    def __init__(
        self,
        host: MemoryHost,
        settings: SerialSettings,
        on_data: Callable[[bytes], None],
        on_lost: Callable[[str], None],
    ) -> None:
        self.settings = settings
        self._host = host
        self._on_data = on_data
        self._on_lost = on_lost
        self._is_open = False
        self._timer: asyncio.TimerHandle | None = None
        self._out = bytearray()
        self._out_s = 0.0
        # what is on its way from the fake: when its first byte's transmission begins, and the bytes
        self._coming: deque[tuple[float, bytes]] = deque()
        self._free_s = 0.0
        self._waiting = b""

    @property
    def unsent(self) -> int:
        return max(0, len(self._out) - KERNEL_BYTES)

    async def open(self) -> None:
        host = self._host
        await asyncio.sleep(0.005)
        if host.is_out:
            raise DeviceUnavailable(f"no serial port {self.settings.path}: is the cable in?")
        self._loop = asyncio.get_running_loop()
        self._is_open = True
        host.opened.append((self._loop.time(), self.settings))
        host.ports.append(self)
        self._modem(self.settings.dtr is None or self.settings.dtr)
        host.port_opened(self.settings)
        self._timer = self._loop.call_later(self._host.step_s, self._step)

    def write(self, data: bytes, *, first: bool = False) -> None:
        if not self._is_open:
            return
        self._host.written.append((self._loop.time(), data))
        self._send()
        if first:
            self._out.clear()
        if not self._out:
            self._out_s = self._loop.time()
        self._out += data

    async def drain(self, timeout_s: float) -> bool:
        loop = asyncio.get_running_loop()
        until_s = loop.time() + timeout_s
        while self._out and self._is_open:
            if loop.time() >= until_s:
                return False
            await asyncio.sleep(self._host.step_s)
        return self._is_open

    def abort(self) -> None:
        if self._is_open:
            self._is_open = False
            self._host.ports.remove(self)
        self._out.clear()
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def set_dtr(self, on: bool) -> bool:
        return self._is_open and self._modem(on)

    def _modem(self, on: bool) -> bool:
        move = getattr(self._host.fake, "set_dtr", None)
        if move is not None:
            move(on, now_ns())
        return move is not None

    def pulled(self) -> None:
        """The cable is out."""
        self.abort()
        self._loop.call_soon(self._on_lost, f"{self.settings.path} went away (end of file)")

    # ---------------------------------------------------------------------------------------- the wire

    def _step(self) -> None:
        self._timer = self._loop.call_later(self._host.step_s, self._step)
        self._send()
        data = self._receive()
        if self._host.splits:
            for i in range(len(data)):
                if self._is_open:
                    self._on_data(data[i : i + 1])
        elif data:
            self._on_data(data)

    def _send(self) -> None:
        """Bytes whose time on the wire is over reach the fake."""
        byte_s = BITS_PER_BYTE / self.settings.baud
        count = int((self._loop.time() - self._out_s) / byte_s + 1e-9)
        if self._host.is_stuck or not self._out or count == 0:
            return
        data = bytes(self._out[:count])
        del self._out[:count]
        self._out_s += len(data) * byte_s
        host, measures = self._host, getattr(self._host.fake, "measures", None)
        if self.settings.baud == host.baud:
            host.fake.feed(data, now_ns())
        elif measures is not None and measures(data, self.settings.baud):
            host.baud = self.settings.baud

    def _receive(self) -> bytes:
        """Bytes whose time on the wire is over, as they are read."""
        host, now_s, byte_s = self._host, self._loop.time(), BITS_PER_BYTE / self._host.baud
        data = host.fake.tick(now_ns())
        if data:
            self._free_s = max(self._free_s, now_s)
            self._coming.append((self._free_s, data))
            self._free_s += len(data) * byte_s
        while self._coming:
            start_s, data = self._coming[0]
            count = min(int((now_s - start_s) / byte_s + 1e-9), len(data))
            if count <= 0:
                break
            self._waiting += data[:count]
            if count == len(data):
                self._coming.popleft()
            else:
                self._coming[0] = (start_s + count * byte_s, data[count:])
        if host.is_held or not self._waiting:
            return b""
        arrived, self._waiting = self._waiting, b""
        return host.worn(arrived) if self.settings.baud == host.baud else host.noise(len(arrived))


def now_ns() -> int:
    """The running loop's time."""
    return round(asyncio.get_running_loop().time() * 1e9)
