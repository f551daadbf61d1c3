"""The packets of LDROBOT lidars (LD06, LD19, STL family) as a sans-IO parser: bytes in, proven packets out.

A packet is 47 bytes, little-endian, and carries 12 points:

    0  u8   0x54             4  u16  start angle, 0.01 deg, clockwise
    1  u8   0x2C             6  12 x {u16 distance mm, u8 intensity}; distance 0 = no return
    2  u16  speed, deg/s    42  u16  end angle (of the last point)
                            44  u16  timestamp, ms, wraps at 30000
                            46  u8   CRC-8 (poly 0x4D, init 0, not reflected) over bytes 0..45

Source: LDROBOT's development manuals and ldlidar_stl_sdk 3.0.3 (MIT). Where we differ from the SDK: state is kept per
instance, `54 54 2C` does not lose a packet, after a bad packet its own 47 bytes are searched again, and eight bits of
checksum are not trusted alone (see `LdParser`).
"""

from __future__ import annotations

import struct
from typing import NamedTuple

HEADER = b"\x54\x2c"
PACKET_BYTES = 47
POINTS = 12
CRC_POLYNOMIAL = 0x4D
TURN_CDEG = 36_000
CLOCK_MS = 30_000

#: Speeds and point rates beyond these are no lidar of this family (measured rates: 2.2 to 21.6 thousand points/s).
_RATE_MIN_HZ, _RATE_MAX_HZ = 1_000, 40_000
#: After a longer silence by the device's clock a packet needs a second one that continues it.
_LONGEST_STEP_MS = 60

#: Nanoseconds between packets are span (0.01 deg) * this / speed (deg/s): twelve steps, of which a span has eleven.
_PERIOD_NS = 120_000_000 / 11

_FIELDS = struct.Struct("<2xHH36sHHx")


def _crc_table() -> bytes:
    table = bytearray()
    for byte in range(256):
        for _ in range(8):
            byte = (byte << 1) ^ (0x100 | CRC_POLYNOMIAL if byte & 0x80 else 0)
        table.append(byte)
    return bytes(table)


_CRC_TABLE = _crc_table()


def crc8(data: bytes) -> int:
    """CRC-8 of this family; 0xC3 for b"123456789"."""
    crc = 0
    for byte in data:
        crc = _CRC_TABLE[crc ^ byte]
    return crc


def _parity_masks() -> tuple[int, ...]:
    """Eight masks over a whole packet read as one big-endian number: a packet is sound when each masks an even count.

    A packet with its checksum is a multiple of the CRC's polynomial, and bit j of the remainder is the parity of those
    bits whose own remainder has bit j. Eight big-integer operations replace a loop over 46 bytes.
    """
    masks = [0] * 8
    remainder = 1
    for position in range(PACKET_BYTES * 8):
        for bit in range(8):
            masks[bit] |= (remainder >> bit & 1) << position
        remainder <<= 1
        if remainder & 0x100:
            remainder ^= 0x100 | CRC_POLYNOMIAL
    return tuple(masks)


_M0, _M1, _M2, _M3, _M4, _M5, _M6, _M7 = _parity_masks()


def is_sound(packet: bytes) -> bool:
    """Whether 47 bytes end in the right checksum; equal to `crc8(packet[:46]) == packet[46]`, three times faster."""
    n = int.from_bytes(packet, "big")
    return not (
        (n & _M0).bit_count() & 1
        or (n & _M1).bit_count() & 1
        or (n & _M2).bit_count() & 1
        or (n & _M3).bit_count() & 1
        or (n & _M4).bit_count() & 1
        or (n & _M5).bit_count() & 1
        or (n & _M6).bit_count() & 1
        or (n & _M7).bit_count() & 1
    )


class LdPacket(NamedTuple):
    """Twelve points of one packet, in device units.

    start_cdeg: angle of the first point, 0.01 degrees, clockwise; span_cdeg: from the first to the twelfth point.
    points: 36 bytes, 12 x {u16 mm, u8}. arrival_ns: when the last byte came, on the reader's clock.
    chained: whether it follows the packet before it in one unbroken count of the device's clock (some may be missing
    between them); False for the first one and after a jump of that clock.
    """

    start_cdeg: int
    span_cdeg: int
    speed_dps: int
    device_ms: int
    points: bytes
    arrival_ns: int = 0
    chained: bool = False

    @property
    def end_cdeg(self) -> int:
        """Angle of the last point, 0.01 degrees."""
        return (self.start_cdeg + self.span_cdeg) % TURN_CDEG

    @property
    def distances_mm(self) -> tuple[int, ...]:
        """Twelve distances in millimetres; 0 = no return."""
        return struct.unpack("<" + "Hx" * POINTS, self.points)

    @property
    def intensities(self) -> tuple[int, ...]:
        """Twelve intensities, 0..255."""
        return tuple(self.points[2::3])


def decode(packet: bytes) -> LdPacket:
    """One packet by itself. Raises ValueError for a wrong length, header or checksum."""
    if len(packet) != PACKET_BYTES or not packet.startswith(HEADER):
        raise ValueError(f"an LD packet has {PACKET_BYTES} bytes and begins with 54 2c, not {packet[:4].hex(' ')}...")
    if not is_sound(packet):
        raise ValueError(f"checksum {packet[-1]:02x}, computed {crc8(packet[:-1]):02x}")
    speed, start, points, end, stamp = _FIELDS.unpack(packet)
    return LdPacket(start, (end - start) % TURN_CDEG, speed, stamp, points)


def encode(packet: LdPacket) -> bytes:
    """The 47 bytes of a packet, header and checksum included; for fakes and tests."""
    body = HEADER + struct.pack(
        "<HH36sHH", packet.speed_dps, packet.start_cdeg, packet.points, packet.end_cdeg, packet.device_ms
    )
    return body + bytes((crc8(body),))


class LdParser:
    """Finds packets in a stream that may begin anywhere and may be damaged.

    A packet is accepted when its checksum is right and either
      - it continues the one before it: the first angle one step after the last one, like span, like time; or
      - the next packet's header follows it and span and time fit the last good packet.
    After a jump of the device's clock, two packets that continue each other are needed. So no packet that a single
    flipped, lost, added or repeated byte (or run of bytes) made is accepted, and an undamaged stream is not delayed.
    What is accepted depends on the bytes alone, never on how they were cut into chunks.

    byte_ns: time of a byte on the wire, to tell when a packet came that sat in a buffer behind others.
    """

    def __init__(self, byte_ns: int = 43_403) -> None:
        self._byte_ns = byte_ns
        self._rest = b""
        self._read_ns = 0
        self._last: LdPacket | None = None
        self._doubtful: LdPacket | None = None
        self._synced = False
        self.trouble = ""
        """Name of the last disturbance, for a reader that sees no packets at all."""
        self.packets = 0
        """Packets accepted so far."""
        self.faults: list[str] = []
        """Names of what went wrong, one a disturbance; the reader takes them out."""

    def feed(self, data: bytes, now_ns: int) -> list[LdPacket]:
        """The packets that these bytes complete, oldest first. `now_ns`: when the bytes were read."""
        old = len(self._rest)
        buffer = self._rest + data if old else data
        size = len(buffer)
        at = 0
        found: list[LdPacket] = []
        while True:
            if not buffer.startswith(HEADER, at):
                header = buffer.find(HEADER, at)
                if header < 0:
                    header = size - 1 if size > at and buffer[-1] == HEADER[0] else size
                if header > at:
                    self._disturbed("stray bytes")
                at = header
            after = size - at - PACKET_BYTES
            if after < 0:
                break
            whole = buffer[at : at + PACKET_BYTES]
            if not is_sound(whole):
                self._disturbed("bad checksum")
                at += 1
                continue
            speed, start, points, end, stamp = _FIELDS.unpack(whole)
            span = (end - start) % TURN_CDEG
            # 1100 = 11 steps, 0.01 degrees: the point rate in Hz is 1100 * speed / span
            if span == 0 or not _RATE_MIN_HZ * span <= 1100 * speed <= _RATE_MAX_HZ * span:
                self._disturbed("not turning" if span == 0 or speed == 0 else "speed and angles disagree")
                at += 1
                continue
            last = self._last
            if last is not None and start == last.start_cdeg and stamp == last.device_ms and points == last.points:
                self.faults.append("repeated packet")
                at += PACKET_BYTES
                continue
            if last is None or not _continues(start, span, speed, stamp, last):
                if after < len(HEADER):
                    break  # not continuing: wait for the two bytes that tell
                if not buffer.startswith(HEADER, at + PACKET_BYTES):
                    self._disturbed("no packet behind a packet")
                    at += 1
                    continue
                chained = last is not None and _follows(span, speed, stamp, last)
                if last is not None and not chained:
                    doubtful = self._doubtful
                    if doubtful is None or not _continues(start, span, speed, stamp, doubtful):
                        self._doubtful = LdPacket(start, span, speed, stamp, points)
                        self._disturbed("jump of the device's clock or speed")
                        at += 1
                        continue
            else:
                chained = True
            arrival_ns = self._arrival_ns(after, size - old, now_ns, int(span * _PERIOD_NS / speed))
            packet = LdPacket(start, span, speed, stamp, points, arrival_ns, chained)
            self._last, self._doubtful, self._synced = packet, None, True
            self.packets += 1
            found.append(packet)
            at += PACKET_BYTES
        self._rest = buffer[at:]
        self._read_ns = now_ns
        return found

    def _disturbed(self, name: str) -> None:
        """Count what ended a good run; what follows until the next good packet belongs to the same disturbance."""
        if self._synced or name != "stray bytes":  # which come behind every other disturbance
            self.trouble = name
        if self._synced:
            self._synced = False
            self.faults.append(name)

    def _arrival_ns(self, after: int, fresh: int, now_ns: int, period_ns: int) -> int:
        """When a packet's last byte came, with `after` bytes behind it in a buffer whose last `fresh` came just now."""
        if after < fresh:
            earliest_ns = self._read_ns
        else:
            after, now_ns, earliest_ns = after - fresh, self._read_ns, 0
        if after < PACKET_BYTES:
            return max(earliest_ns, now_ns - after * self._byte_ns)
        # a backlog: whole packets behind this one were sent one a period, not back to back
        packets, rest = divmod(after, PACKET_BYTES)
        return max(earliest_ns, now_ns - packets * max(period_ns, PACKET_BYTES * self._byte_ns) - rest * self._byte_ns)


def _continues(start: int, span: int, speed: int, stamp: int, last: LdPacket) -> bool:
    """Whether a packet is the very next one: angle within a step of where it must be, like span, like time."""
    gap = (start - last.end_cdeg) % TURN_CDEG
    # a packet covers 12/11 of its span; half of that again and two ticks are allowed on the device's clock
    return (
        5 * gap <= span
        and 4 * abs(span - last.span_cdeg) <= span + 80
        and ((stamp - last.device_ms) % CLOCK_MS - 2) * speed * 11 <= 180 * span
    )


def _follows(span: int, speed: int, stamp: int, last: LdPacket) -> bool:
    """Whether a packet may come some packets after another: within 60 ms of the device's clock, at a like speed.

    And within three quarters of a turn, so that the angle between the two says how much is missing.
    """
    step_ms = (stamp - last.device_ms) % CLOCK_MS
    return (
        step_ms <= _LONGEST_STEP_MS
        and 40 * step_ms * speed <= 3 * TURN_CDEG * 100
        and 4 * abs(span - last.span_cdeg) <= span + 80
    )
