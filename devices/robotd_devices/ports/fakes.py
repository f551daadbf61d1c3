"""What a fake device is: a state machine over bytes on a virtual clock, with no input or output of its own."""

from __future__ import annotations

import random
from collections.abc import Sequence
from typing import Literal, Protocol, get_args


class FakeDevice(Protocol):
    """A device as its line sees it. Times are integer nanoseconds of whatever clock the host keeps; they never go back.

    Hosts: a test that calls it (virtual time), `PtyHost` (a pty, paced in real time).
    """

    def power_on(self, now_ns: int) -> None:
        """The cable went in: begin anew."""
        ...

    def feed(self, data: bytes, now_ns: int) -> None:
        """Bytes that the other side wrote."""
        ...

    def tick(self, now_ns: int) -> bytes:
        """Bytes that the device began to send since the last call."""
        ...


Damage = Literal["flip", "drop", "insert", "burst", "duplicate"]
DAMAGES: tuple[Damage, ...] = get_args(Damage)


def damage(data: bytes, kind: Damage, rng: random.Random, longest: int = 100) -> bytes:
    """The same bytes with one fault at a random place.

    flip: one byte becomes another; drop: one is lost; insert: one is added; burst: a run of up to `longest` is lost;
    duplicate: a run of up to `longest` comes twice.
    """
    if not data:
        return data
    at = rng.randrange(len(data))
    end = min(len(data), at + rng.randint(1, longest))
    if kind == "flip":
        return data[:at] + bytes((data[at] ^ rng.randint(1, 255),)) + data[at + 1 :]
    if kind == "drop":
        return data[:at] + data[at + 1 :]
    if kind == "insert":
        return data[:at] + bytes((rng.randrange(256),)) + data[at:]
    if kind == "burst":
        return data[:at] + data[end:]
    return data[:end] + data[at:end] + data[end:]


class Faulty:
    """A fake whose line is bad: one fault in so many bytes on average, the same ones for the same seed."""

    def __init__(self, inner: FakeDevice, *, seed: int, every_bytes: int, kinds: Sequence[Damage] = DAMAGES) -> None:
        self._inner = inner
        self._rng = random.Random(seed)
        self._every_bytes = every_bytes
        self._kinds = tuple(kinds)
        self.injected = 0
        """Faults so far."""

    def power_on(self, now_ns: int) -> None:
        self._inner.power_on(now_ns)

    def feed(self, data: bytes, now_ns: int) -> None:
        self._inner.feed(data, now_ns)

    def tick(self, now_ns: int) -> bytes:
        data = self._inner.tick(now_ns)
        if data and self._rng.random() < len(data) / self._every_bytes:
            self.injected += 1
            data = damage(data, self._rng.choice(self._kinds), self._rng)
        return data
