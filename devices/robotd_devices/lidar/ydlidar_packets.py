"""The packets of YDLIDAR's triangle family as a sans-IO parser: bytes in, proven packets out.

    0  AA 55                         4  u16  angle of the first sample, 1/64 degree, clockwise, times 2 plus 1
    2  u8  bit 0: a turn begins      6  u16  angle of the last sample, likewise
       (then bits 7..1: 0.1 Hz)      8  u16  check: exclusive or of all other words
    3  u8  number of samples        10  samples of 2 bytes, or of 3 (of which the first counts as a word of its own)

A packet with which a turn begins holds one sample. `AA 66` begins a time stamp of eight bytes on newer models.
Sources: YDLIDAR's development manuals and YDLidar-SDK 1.2.20 (MIT). Where we differ from the SDK: the width of samples
belongs to the model and is never guessed, and a right check alone is not enough (see `YdParser`).
"""

from __future__ import annotations

import struct
from typing import NamedTuple

from robotd_devices.lidar.arrivals import Arrivals
from robotd_devices.lidar.xor_fold import xor_fold

HEADER, STAMP_HEADER = b"\xaa\x55", b"\xaa\x66"
HEADER_BYTES = 10
_STAMP_BYTES = 8
MOST_SAMPLES = 80
TURN_Q6 = 360 << 6

_FIELDS = struct.Struct("<2xBBHHH")
#: No model turns slower or faster.
_SLOWEST_HZ, _FASTEST_HZ = 1.0, 20.0


class YdPacket(NamedTuple):
    """One packet, in device units.

    first_q6: angle of the first sample, 1/64 degree, clockwise; span_q6: from there to the last sample; samples: how
    many; data: these, undecoded. begins: a turn begins with it. speed_dhz: revolutions in 10 s, 0 = not said.
    arrival_ns: when the last byte came, on the reader's clock. chained: it stands right behind the packet before it.
    """

    first_q6: int
    span_q6: int
    samples: int
    data: bytes
    begins: bool = False
    speed_dhz: int = 0
    arrival_ns: int = 0
    chained: bool = False

    @property
    def last_q6(self) -> int:
        """Angle of the last sample."""
        return (self.first_q6 + self.span_q6) % TURN_Q6


def check(packet: bytes, sample_bytes: int) -> int:
    """Exclusive or of all words of a whole packet, its own check among them: 0 for a sound one."""
    head, data = packet[:HEADER_BYTES], packet[HEADER_BYTES:]
    if sample_bytes == 2:
        return xor_fold(packet, 2)
    low = xor_fold(data[0::3], 1) ^ xor_fold(data[1::3], 1)
    return xor_fold(head, 2) ^ low ^ xor_fold(data[2::3], 1) << 8


def encode(packet: YdPacket, sample_bytes: int) -> bytes:
    """The bytes of a packet, header and check included; for fakes and tests."""
    kind = packet.speed_dhz << 1 | packet.begins
    angles = (angle << 1 | 1 for angle in (packet.first_q6, packet.last_q6))
    head = HEADER + struct.pack("<BBHH", kind, packet.samples, *angles)
    value = check(head + b"\0\0" + packet.data, sample_bytes)
    return head + struct.pack("<H", value) + packet.data


def decode(packet: bytes, sample_bytes: int) -> YdPacket:
    """One packet by itself. Raises ValueError for a wrong length, header, marks or check."""
    if len(packet) < HEADER_BYTES or not packet.startswith(HEADER):
        raise ValueError(f"a packet begins with aa 55 and has at least {HEADER_BYTES} bytes: {packet[:4].hex(' ')}...")
    fields = _fields(packet, 0)
    if fields is None:
        raise ValueError(f"no number of samples or no angles: {packet[:8].hex(' ')}")
    size = HEADER_BYTES + fields.samples * sample_bytes
    if len(packet) != size or check(packet, sample_bytes):
        raise ValueError(f"a packet of {fields.samples} samples has {size} bytes and a right check")
    return fields._replace(data=packet[HEADER_BYTES:])


def _fields(buffer: bytes, at: int) -> YdPacket | None:
    """The header at a place; None where its marks or values cannot be."""
    kind, count, first, last, _ = _FIELDS.unpack_from(buffer, at)
    begins = bool(kind & 1)
    if (
        not 0 < count <= MOST_SAMPLES
        or not first & last & 1
        or max(first, last) > 2 * TURN_Q6
        or (begins and count != 1)
        or (count == 1 and first != last)
    ):
        return None
    return YdPacket((first >> 1) % TURN_Q6, ((last >> 1) - (first >> 1)) % TURN_Q6, count, b"", begins, kind >> 1)


class YdParser:
    """Finds packets in a stream that may begin anywhere and may be damaged.

    An exclusive or is blind to words that changed places or came twice. A packet is accepted when its check is right,
    its angles fit its number of samples at a possible speed, *and* a header stands behind it; so a stream without
    damage is read two bytes late. What is accepted depends on the bytes alone, never on how they were cut into chunks.

    byte_ns: time of a byte on the wire; sample_ns: time between two samples; sample_bytes: width of a sample.
    """

    def __init__(self, sample_bytes: int, byte_ns: float, sample_ns: float) -> None:
        self._sample_bytes = sample_bytes
        self._sample_ns = sample_ns
        self._least_q6 = _SLOWEST_HZ * TURN_Q6 * sample_ns / 1e9
        self._most_q6 = _FASTEST_HZ * TURN_Q6 * sample_ns / 1e9
        self._arrivals = Arrivals(byte_ns)
        self._rest = b""
        self._next_at = -1
        """Where in the buffer the next packet must begin to stand right behind the last one."""
        self._last = b""
        self._synced = False
        self.trouble = ""
        """Name of the last disturbance, for a reader that sees no packets at all."""
        self.packets = 0
        """Packets accepted so far."""
        self.faults: list[str] = []
        """Names of what went wrong, one a disturbance; the reader takes them out."""

    def feed(self, data: bytes, now_ns: int) -> list[YdPacket]:
        """The packets that these bytes prove, oldest first. `now_ns`: when the bytes were read."""
        buffer = self._rest + data if self._rest else data
        self._arrivals.read(len(data), now_ns)
        end, at = len(buffer), 0
        found: list[YdPacket] = []
        while True:
            if at == self._next_at and buffer.startswith(STAMP_HEADER, at):
                if end - at < _STAMP_BYTES:
                    break
                at += _STAMP_BYTES
                self._next_at = at
                continue
            at = self._header(buffer, at)
            if end - at < HEADER_BYTES:
                break
            fields = _fields(buffer, at)
            if fields is None:
                self._disturbed("senseless header")
                at += 1
                continue
            size = HEADER_BYTES + fields.samples * self._sample_bytes
            behind = at + size
            if end - behind < len(HEADER):
                break
            whole = buffer[at:behind]
            if check(whole, self._sample_bytes):
                self._disturbed("bad checksum")
                at += 1
                continue
            trouble = self._trouble(fields, buffer, behind)
            if trouble:
                self._disturbed(trouble)
                at += 1
                continue
            if whole == self._last and at == self._next_at:
                self.faults.append("repeated packet")
                self._next_at = at = behind
                continue
            arrival_ns = self._arrivals.of(end - behind, size, fields.samples * self._sample_ns)
            chained = at == self._next_at
            found.append(fields._replace(data=whole[HEADER_BYTES:], arrival_ns=arrival_ns, chained=chained))
            self.packets += 1
            self._synced, self._last = True, whole
            self._next_at = at = behind
        self._rest = buffer[at:]
        self._next_at -= at
        self._arrivals.done(len(self._rest))
        return found

    def _header(self, buffer: bytes, at: int) -> int:
        """Where the next packet may begin; the end, or a last byte that may be half a header, where none does."""
        if buffer.startswith(HEADER, at):
            return at
        header = buffer.find(HEADER, at)
        if header < 0:
            header = len(buffer) - 1 if len(buffer) > at and buffer[-1] == HEADER[0] else len(buffer)
        if header > at:
            self._disturbed("stray bytes")
        return header

    def _trouble(self, packet: YdPacket, buffer: bytes, behind: int) -> str:
        steps = packet.samples - 1
        if steps and not self._least_q6 * steps - 1.0 <= packet.span_q6 <= self._most_q6 * steps + 1.0:
            return "not turning" if packet.span_q6 == 0 else "impossible angles"
        if not buffer.startswith(HEADER, behind) and not buffer.startswith(STAMP_HEADER, behind):
            return "no packet behind a packet"
        return ""

    def _disturbed(self, name: str) -> None:
        """Count what ended a good run; what follows until the next good packet belongs to the same disturbance."""
        if self._synced or name != "stray bytes":  # which come behind every other disturbance
            self.trouble = name
        self._next_at = -1
        if self._synced:
            self._synced = False
            self.faults.append(name)
