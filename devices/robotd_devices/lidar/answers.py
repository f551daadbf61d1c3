"""Answers of lidars that are asked (Slamtec, YDLIDAR): a descriptor of seven bytes and what it announces.

A descriptor is `A5 5A`, u32 (size in the low 30 bits, in the top two 0 = one answer, 1 = a stream), u8 type.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

SYNC = b"\xa5\x5a"
DESCRIPTOR_BYTES = 7
_SIZE_MASK = (1 << 30) - 1
_LONGEST_ANSWER = 255


class Descriptor(NamedTuple):
    """What follows: `size` bytes of an answer (of each packet where `stream`) of type `kind`."""

    size: int
    stream: bool
    kind: int


def encode_descriptor(size: int, kind: int, *, stream: bool = False) -> bytes:
    """The seven bytes before an answer; for fakes and tests."""
    return SYNC + struct.pack("<IB", size | (1 << 30 if stream else 0), kind)


def decode_descriptor(data: bytes) -> Descriptor:
    """Raises ValueError for bytes that are no descriptor."""
    if len(data) != DESCRIPTOR_BYTES or not data.startswith(SYNC):
        raise ValueError(f"a descriptor has {DESCRIPTOR_BYTES} bytes and begins with a5 5a, not {data.hex(' ')}")
    word, kind = struct.unpack("<IB", data[2:])
    return Descriptor(word & _SIZE_MASK, word >> 30 == 1, kind)


class AnswerReader:
    """Waits for one answer in a stream that may still carry measurements, boot text or other answers.

    kind: the wanted type, or None for any stream (a scan that began). `answer` is its data once it is there; of a
    stream it is empty, and `rest` holds what came behind the descriptor. Depends on the bytes, not on their chunks.
    """

    def __init__(self, kind: int | None) -> None:
        self._kind = kind
        self._buffer = b""
        self.descriptor: Descriptor | None = None
        self.answer: bytes | None = None
        self.rest = b""

    def feed(self, data: bytes) -> bool:
        """Take bytes; whether the answer is complete."""
        if self.answer is not None:
            self.rest += data
            return True
        self._buffer += data
        while self.answer is None:
            at = self._buffer.find(SYNC)
            if at < 0:
                self._buffer = self._buffer[-1:] if self._buffer.endswith(SYNC[:1]) else b""
                return False
            self._buffer = self._buffer[at:]
            if len(self._buffer) < DESCRIPTOR_BYTES:
                return False
            descriptor = decode_descriptor(self._buffer[:DESCRIPTOR_BYTES])
            if not self._wanted(descriptor):
                self._buffer = self._buffer[1:]
                continue
            end = DESCRIPTOR_BYTES + (0 if descriptor.stream else descriptor.size)
            if len(self._buffer) < end:
                return False
            self.descriptor = descriptor
            self.answer, self.rest = self._buffer[DESCRIPTOR_BYTES:end], self._buffer[end:]
        return True

    def _wanted(self, descriptor: Descriptor) -> bool:
        if self._kind is None:
            return descriptor.stream and 0x80 < descriptor.kind < 0x90
        return not descriptor.stream and descriptor.kind == self._kind and descriptor.size <= _LONGEST_ANSWER
