"""The capsules of RPLIDARs (express, ultra, dense, ultra-dense) as a sans-IO parser: bytes in, proven capsules out.

    format       type  bytes  samples  header
    express      0x82     84       32  byte 0 = A | low half of the checksum, byte 1 = 5 | high half,
    ultra        0x84    132       96  u16 start angle, 1/64 degree, clockwise; bit 15: first capsule of a scan
    dense        0x85     84       40
    ultra-dense  0x86    170       64  the same, with u32 time stamp and u16 status before the start angle

The checksum is the exclusive or of all bytes from offset 2 on. A capsule says only where its first sample lies; the
others are spread evenly up to the first one of the next capsule.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from robotd_devices.lidar.arrivals import Arrivals
from robotd_devices.lidar.xor_fold import xor_fold

TURN_Q6 = 360 << 6
_FIRST = 0x80
"""Bit of the start angle's upper byte: the device began to scan."""

#: No RPLIDAR turns faster; one capsule of the coarsest mode then covers less than half a turn.
_FASTEST_HZ = 25.0
#: What the angle between two capsules may be off beside half of itself, 1/64 degree: for a motor that hardly turns.
_SLACK_Q6 = 32


@dataclass(frozen=True, slots=True)
class CapsuleFormat:
    """One kind of capsule. `angle_at`: offset of its start angle; `data_at`: of its samples."""

    kind: int
    name: str
    size: int
    samples: int
    angle_at: int = 2
    data_at: int = 4


EXPRESS = CapsuleFormat(0x82, "express", 84, 32)
ULTRA = CapsuleFormat(0x84, "ultra", 132, 96)
DENSE = CapsuleFormat(0x85, "dense", 84, 40)
ULTRA_DENSE = CapsuleFormat(0x86, "ultra-dense", 170, 64, angle_at=8, data_at=10)
FORMATS = {form.kind: form for form in (EXPRESS, ULTRA, DENSE, ULTRA_DENSE)}


def is_sound(capsule: bytes) -> bool:
    """Whether a whole capsule carries its header marks and the right checksum."""
    first, second = capsule[0], capsule[1]
    if first & 0xF0 != 0xA0 or second & 0xF0 != 0x50:
        return False
    return xor_fold(capsule[2:], 1) == first & 0x0F | (second & 0x0F) << 4


def seal(form: CapsuleFormat, start_q6: int, data: bytes, *, first: bool = False, middle: bytes = b"") -> bytes:
    """A whole capsule with marks and checksum; for fakes and tests. `middle`: time stamp and status (ultra-dense)."""
    body = middle + (start_q6 | (first << 15)).to_bytes(2, "little") + data
    if len(body) + 2 != form.size:
        raise ValueError(f"an {form.name} capsule has {form.size} bytes, not {len(body) + 2}")
    check = xor_fold(body, 1)
    return bytes((0xA0 | check & 0x0F, 0x50 | check >> 4)) + body


class Capsule(NamedTuple):
    """One capsule that proved itself.

    start_q6: angle of its first sample, 1/64 degree, clockwise; data: its samples, undecoded. arrival_ns: when its
    last byte came, on the reader's clock. chained: it is the very next one after the capsule before it.
    first: the device says that its scan begins here.
    """

    start_q6: int
    data: bytes
    arrival_ns: int = 0
    chained: bool = False
    first: bool = False


def decode_capsule(form: CapsuleFormat, capsule: bytes) -> Capsule:
    """One capsule by itself. Raises ValueError for a wrong length, marks or checksum."""
    if len(capsule) != form.size or not is_sound(capsule):
        raise ValueError(f"no sound {form.name} capsule of {form.size} bytes: {capsule[:4].hex(' ')}...")
    low, high = capsule[form.angle_at], capsule[form.angle_at + 1]
    return Capsule(low | (high & 0x7F) << 8, capsule[form.data_at :], first=bool(high & _FIRST))


class CapsuleParser:
    """Finds capsules in a stream that may begin anywhere and may be damaged.

    Eight bits of checksum alone let one in 256 chance frames through. A capsule is accepted when its checksum is right
    and a header stands behind it whose angle lies one capsule further, as far as the last ones lay apart (within half
    of that). Before two capsules have shown how far that is, and after anything odd, the capsule behind must be whole
    and sound. So a stream without damage is read with a delay of one header (4 to 10 bytes).
    What is accepted depends on the bytes alone, never on how they were cut into chunks.

    byte_ns: time of a byte on the wire; sample_ns: time between two samples.
    """

    def __init__(self, form: CapsuleFormat, byte_ns: float, sample_ns: float) -> None:
        self.form = form
        self._period_ns = form.samples * sample_ns
        self._widest_q6 = min(TURN_Q6 // 2, round(_FASTEST_HZ * TURN_Q6 * self._period_ns / 1e9))
        self._arrivals = Arrivals(byte_ns)
        self._rest = b""
        self._last_q6 = -1
        """Start of the last accepted capsule; -1 where the next one cannot be chained to it."""
        self._step_q6 = 0
        """Angle between two capsules; 0 where it is not known."""
        self._next_at = -1
        """Where in the buffer a chained capsule must begin."""
        self._synced = False
        self.trouble = ""
        """Name of the last disturbance, for a reader that sees no capsules at all."""
        self.packets = 0
        """Capsules accepted so far."""
        self.faults: list[str] = []
        """Names of what went wrong, one a disturbance; the reader takes them out."""

    def feed(self, data: bytes, now_ns: int) -> list[Capsule]:
        """The capsules that these bytes prove, oldest first. `now_ns`: when the bytes were read."""
        form = self.form
        size, ahead = form.size, form.angle_at + 2
        buffer = self._rest + data if self._rest else data
        self._arrivals.read(len(data), now_ns)
        end, at = len(buffer), 0
        if end < size + ahead:
            self._rest = buffer
            return []
        found: list[Capsule] = []
        while end - at >= size + ahead:
            if buffer[at] & 0xF0 != 0xA0 or buffer[at + 1] & 0xF0 != 0x50:
                at = self._header(buffer, at)
                continue
            whole = buffer[at : at + size]
            if not is_sound(whole):
                self._disturbed("bad checksum")
                at += 1
                continue
            high = whole[form.angle_at + 1]
            start, first = whole[form.angle_at] | (high & 0x7F) << 8, high & _FIRST != 0
            if start >= TURN_Q6:
                self._disturbed("impossible angle")
                at += 1
                continue
            gap = self._gap(buffer, at, start)
            if gap is None and not self._step_q6:
                if end - at < 2 * size:
                    break  # nothing known yet: wait for the whole capsule behind
                behind = buffer[at + size : at + 2 * size]
                gap = self._first_gap(behind, start) if is_sound(behind) else None
            if gap is None:
                self._disturbed("no packet behind a packet" if self._step_q6 else self._still(buffer, at, start))
                self._step_q6 = 0
                at += 1
                continue
            chained = at == self._next_at and self._last_q6 >= 0 and not first
            arrival_ns = self._arrivals.of(end - at - size, size, self._period_ns)
            found.append(Capsule(start, whole[form.data_at :], arrival_ns, chained, first))
            self.packets += 1
            self._synced = True
            self._last_q6, self._step_q6 = start, gap
            at += size
            self._next_at = at
        self._rest = buffer[at:]
        self._next_at -= at
        self._arrivals.done(len(self._rest))
        return found

    def _header(self, buffer: bytes, at: int) -> int:
        """Where the next header may begin; the end (or the last byte, if it may be half a header) where none does."""
        start, end = at, len(buffer)
        while at < end:
            if buffer[at] & 0xF0 == 0xA0 and (at + 1 >= end or buffer[at + 1] & 0xF0 == 0x50):
                break
            at += 1
        if at > start:
            self._disturbed("stray bytes")
        return at

    def _gap(self, buffer: bytes, at: int, start: int) -> int | None:
        """Angle to the header behind, where it fits the angle between the capsules before; else None."""
        step = self._step_q6
        if not step:
            return None
        behind = at + self.form.size
        gap = self._angle_gap(buffer, behind, start)
        return gap if gap is not None and 2 * abs(gap - step) <= step + 2 * _SLACK_Q6 else None

    def _angle_gap(self, buffer: bytes, behind: int, start: int) -> int | None:
        if buffer[behind] & 0xF0 != 0xA0 or buffer[behind + 1] & 0xF0 != 0x50:
            return None
        angle_at = behind + self.form.angle_at
        angle = buffer[angle_at] | (buffer[angle_at + 1] & 0x7F) << 8
        return (angle - start) % TURN_Q6 if angle < TURN_Q6 else None

    def _first_gap(self, behind: bytes, start: int) -> int | None:
        gap = self._angle_gap(behind, 0, start)
        return gap if gap is not None and 0 < gap <= self._widest_q6 else None

    def _still(self, buffer: bytes, at: int, start: int) -> str:
        """Why no angle between capsules was found: a head that stands still says the same angle again."""
        gap = self._angle_gap(buffer, at + self.form.size, start)
        return "not turning" if gap == 0 else "no packet behind a packet"

    def _disturbed(self, name: str) -> None:
        """Count what ended a good run; what follows until the next good capsule belongs to the same disturbance."""
        if self._synced or name != "stray bytes":  # which come behind every other disturbance
            self.trouble = name
        self._next_at = -1
        if self._synced:
            self._synced = False
            self.faults.append(name)
