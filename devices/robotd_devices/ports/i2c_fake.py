"""A fake I2C bus in memory: chips by address, a log of every transaction with its time, and faults by name."""

from __future__ import annotations

import errno
import os
import threading
import time
from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple, Protocol, get_args

from robotd_devices.ports.i2c_bus import EREMOTEIO, GENERAL_CALL, I2cWrite

BusFault = Literal["nack", "stuck", "arbitration"]
BUS_FAULTS: tuple[BusFault, ...] = get_args(BusFault)

_ERRNO: dict[BusFault, int] = {"nack": EREMOTEIO, "stuck": errno.ETIMEDOUT, "arbitration": errno.EAGAIN}
_BITS_PER_BYTE = 9


class FakeChip(Protocol):
    """A chip as its bus sees it: a state machine over the bytes of one transaction at a time, without a clock."""

    def power_on(self) -> None:
        """The supply came: all registers as after reset."""
        ...

    def answers(self, address: int) -> bool:
        """Whether it acknowledges this address now; the general call is one of them."""
        ...

    def write(self, data: bytes, address: int) -> None:
        """All bytes of one write, from the register's number to the stop condition."""
        ...

    def read(self, count: int) -> bytes:
        """Bytes from where the last write left the register pointer."""
        ...


class Transaction(NamedTuple):
    """One entry of the log. `data`: written; `read_count`: bytes read; `error`: errno, 0 where all was acknowledged."""

    now_ns: int
    address: int
    data: bytes
    read_count: int
    error: int


class FakeI2cBus:
    """Chips on one bus; an `I2cBus` that any number of threads may use, one transaction at a time.

    `clock`: nanoseconds for the log. `bit_hz`: take as long as a bus of this clock does (100 000, 400 000); 0: no time.
    """

    def __init__(
        self, chips: Sequence[FakeChip], *, clock: Callable[[], int] = time.monotonic_ns, bit_hz: int = 0
    ) -> None:
        self.chips = tuple(chips)
        self.log: list[Transaction] = []
        """Every transaction so far, the oldest first; failed ones too."""
        self._clock = clock
        self._bit_hz = bit_hz
        self._lock = threading.Lock()
        self._fault: tuple[BusFault, int | None, int | None] | None = None

    def fail(self, fault: BusFault, *, address: int | None = None, times: int | None = None) -> None:
        """From now on transactions fail: all, or those of one address; `times` of them, or until `heal`."""
        with self._lock:
            self._fault = (fault, address, times)

    def heal(self) -> None:
        """No faults from now on."""
        with self._lock:
            self._fault = None

    def power_cycle(self) -> None:
        """The supply of all chips broke down for a moment."""
        with self._lock:
            for chip in self.chips:
                chip.power_on()

    @property
    def writes(self) -> list[I2cWrite]:
        """What was written and acknowledged so far; writes that only set the register pointer are left out."""
        return [I2cWrite(e.address, e.data[0], e.data[1:]) for e in self.log[:] if not e.error and len(e.data) > 1]

    def transfer(self, address: int, data: bytes, count: int = 0) -> bytes:
        """Write `data` (where there is any), then read `count` bytes after a repeated start. Raises OSError."""
        with self._lock:
            if self._bit_hz:
                sent = (1 + len(data) if data else 0) + (1 + count if count else 0)
                time.sleep(sent * _BITS_PER_BYTE / self._bit_hz)
            number = self._failing(address)
            hearing = [chip for chip in self.chips if chip.answers(address)]
            if not number and not hearing:
                number = EREMOTEIO
            self.log.append(Transaction(self._clock(), address, data, count, number))
            if number:
                raise OSError(number, os.strerror(number))
            for chip in hearing:
                if data:
                    chip.write(data, address)
            return hearing[0].read(count) if count and address != GENERAL_CALL else b""

    def read(self, address: int, register: int, count: int) -> bytes:
        return self.transfer(address, bytes((register,)), count)

    def write(self, address: int, register: int, data: bytes) -> None:
        self.transfer(address, bytes((register,)) + data)

    def close(self) -> None:
        """The bus stays; whoever opens it next finds it as it is."""

    def _failing(self, address: int) -> int:
        if self._fault is None:
            return 0
        fault, whose, times = self._fault
        if whose is not None and whose != address:
            return 0
        if times is not None:
            self._fault = (fault, whose, times - 1) if times > 1 else None
        return _ERRNO[fault]


class SmbusStub:
    """The method names of `smbus2.SMBus` over a fake bus, so that other people's drivers run against the same chips."""

    def __init__(self, bus: FakeI2cBus) -> None:
        self._bus = bus

    def close(self) -> None:
        """As smbus2's; the fake bus stays."""

    def write_quick(self, i2c_addr: int) -> None:
        self._bus.transfer(i2c_addr, b"")

    def read_byte(self, i2c_addr: int) -> int:
        return self._bus.transfer(i2c_addr, b"", 1)[0]

    def write_byte(self, i2c_addr: int, value: int) -> None:
        self._bus.transfer(i2c_addr, bytes((value,)))

    def read_byte_data(self, i2c_addr: int, register: int) -> int:
        return self._bus.read(i2c_addr, register, 1)[0]

    def write_byte_data(self, i2c_addr: int, register: int, value: int) -> None:
        self._bus.write(i2c_addr, register, bytes((value,)))

    def read_word_data(self, i2c_addr: int, register: int) -> int:
        return int.from_bytes(self._bus.read(i2c_addr, register, 2), "little")

    def write_word_data(self, i2c_addr: int, register: int, value: int) -> None:
        self._bus.write(i2c_addr, register, value.to_bytes(2, "little"))

    def read_i2c_block_data(self, i2c_addr: int, register: int, length: int) -> list[int]:
        return list(self._bus.read(i2c_addr, register, length))

    def write_i2c_block_data(self, i2c_addr: int, register: int, data: Sequence[int]) -> None:
        self._bus.write(i2c_addr, register, bytes(data))

    def i2c_rdwr(self, *messages: _Message) -> None:
        """smbus2's messages: a write, a read, or a write and a read behind it."""
        written = b""
        address = messages[-1].addr
        for message in messages:
            if message.flags & 1:
                answer = self._bus.transfer(address, written, message.len)
                for i, value in enumerate(answer):
                    message.buf[i] = value
                return
            written += bytes(message)
        self._bus.transfer(address, written)


class _Message(Protocol):
    """What is used of `smbus2.i2c_msg`."""

    addr: int
    flags: int
    len: int
    buf: list[int]

    def __bytes__(self) -> bytes: ...
