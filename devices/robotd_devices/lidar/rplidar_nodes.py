"""The five-byte nodes of an RPLIDAR's standard scan as a sans-IO parser that holds on to their alignment.

    0  bit 0: first of a revolution, bit 1: its opposite, bits 2..7: quality
    1  bit 0: always 1; with byte 2: angle, 1/64 degree, clockwise, times 2
    3  u16 distance, 1/4 mm; 0 = no return

There is no checksum: a changed distance cannot be found out. What can be done is to notice early when the alignment is
lost, and to take it up again only where several nodes in a row make sense. Source: Slamtec's protocol manual LR001.
"""

from __future__ import annotations

import itertools
import struct
from typing import NamedTuple

from robotd_devices.lidar.arrivals import Arrivals

NODE_BYTES = 5
RELOCK_NODES = 4
"""So many nodes in a row must make sense before the alignment is believed."""

_NODE = struct.Struct("<BHH")
_HEAD = struct.Struct("<BH")
_TURN = 360 * 128
#: How far an angle may lie from the one before while locked: a triangulating lidar's beam lags behind its head by
#: up to 8 degrees, more for far points than for near ones, so angles leap (also back) where the distance does.
_LEAP = 9 * 128


class NodeRun(NamedTuple):
    """Nodes that followed each other without a gap.

    data: five bytes each. arrival_ns: when the last byte came. missing: nodes lost between the run before and this
    one: 0, a number, or -1 where only the angle can tell.
    """

    data: bytes
    arrival_ns: int
    missing: int


def encode_node(angle_q6: int, distance_q2: int, quality: int, first: bool) -> bytes:
    """One node; for fakes and tests."""
    return _NODE.pack(quality << 2 | (1 if first else 2), angle_q6 << 1 | 1, distance_q2)


def decode_node(node: bytes) -> tuple[int, int, int, bool]:
    """Angle (1/64 degree), distance (1/4 mm), quality, first of a turn. Raises ValueError for what cannot be a node."""
    if len(node) != NODE_BYTES:
        raise ValueError(f"a node has {NODE_BYTES} bytes, not {len(node)}")
    head, angle, distance = _NODE.unpack(node)
    if not (head ^ head >> 1) & 1 or not angle & 1 or angle > _TURN:
        raise ValueError(f"{node.hex(' ')} is no node: its check bits or its angle are wrong")
    return angle >> 1, distance, head >> 2, bool(head & 1)


class NodeParser:
    """Finds nodes in a stream that may begin anywhere and may be damaged.

    A node is accepted when its check bits and its angle make sense *and* those of the node behind it do. One senseless
    node between good ones is dropped by itself; after two the alignment is given up, with the node before them, and
    looked for anew: four nodes in a row whose angles advance by at most three usual steps.
    What is accepted depends on the bytes alone, never on how they were cut into chunks.

    byte_ns: time of a byte on the wire; sample_ns: time between nodes; step_deg: usual angle between nodes.
    """

    def __init__(self, byte_ns: float, sample_ns: float, step_deg: float) -> None:
        self._sample_ns = sample_ns
        self._leap = max(_LEAP, round(3 * 128 * step_deg))
        self._lock_step = max(8, round(3 * 128 * step_deg))
        self._arrivals = Arrivals(byte_ns)
        self._rest = b""
        self._last = 0
        """Angle of the last accepted node, as it stands in its bytes."""
        self._locked = False
        self._missing = -1
        self.trouble = ""
        """Name of the last disturbance, for a reader that sees no nodes at all."""
        self.packets = 0
        """Nodes accepted so far."""
        self.faults: list[str] = []
        """Names of what went wrong, one a disturbance; the reader takes them out."""

    def feed(self, data: bytes, now_ns: int) -> list[NodeRun]:
        """The nodes that these bytes prove, oldest first. `now_ns`: when the bytes were read."""
        buffer = self._rest + data if self._rest else data
        self._arrivals.read(len(data), now_ns)
        end, at = len(buffer), 0
        found: list[NodeRun] = []
        while True:
            if not self._locked:
                at = self._align(buffer, at)
                if not self._locked:
                    break
            whole = (end - at) // NODE_BYTES
            good, last_but_one, last = self._plausible(buffer, at, whole)
            if good == whole:
                # the last one waits for the one behind it
                self._accept(found, buffer, at, max(0, good - 1), last_but_one)
                at += max(0, good - 1) * NODE_BYTES
                break
            if whole < good + 3:
                self._accept(found, buffer, at, max(0, good - 1), last_but_one)
                at += max(0, good - 1) * NODE_BYTES
                break
            behind = at + (good + 1) * NODE_BYTES
            if good and self._follows(buffer, behind, last):
                self._accept(found, buffer, at, good, last)
                self._missing = 1
                at = behind
                self._disturbed("senseless node")
            else:
                self._accept(found, buffer, at, max(0, good - 1), last_but_one)
                at += max(0, good - 1) * NODE_BYTES + 1
                self._locked = False
                self._missing = -1
                self._disturbed("lost alignment")
        self._rest = buffer[at:]
        self._arrivals.done(len(self._rest))
        return found

    def _accept(self, found: list[NodeRun], buffer: bytes, at: int, count: int, last: int) -> None:
        if not count:
            return
        end = at + count * NODE_BYTES
        arrival_ns = self._arrivals.of(len(buffer) - end, NODE_BYTES, self._sample_ns)
        found.append(NodeRun(buffer[at:end], arrival_ns, self._missing))
        self._last, self._missing = last, 0
        self.packets += count

    def _plausible(self, buffer: bytes, at: int, whole: int) -> tuple[int, int, int]:
        """How many nodes make sense from here on, and the angles of the last but one and the last of these."""
        leap, turn_less = self._leap, _TURN - self._leap
        before = last = self._last
        good = 0
        for head, angle, _ in _NODE.iter_unpack(buffer[at : at + whole * NODE_BYTES]):
            step = angle - last
            if (
                not (head ^ head >> 1) & 1
                or not angle & 1
                or angle > _TURN
                or (not -leap <= step <= leap and -turn_less < step < turn_less)
            ):
                break
            before, last = last, angle
            good += 1
        return good, before, last

    def _follows(self, buffer: bytes, at: int, last: int) -> bool:
        """Whether two nodes that make sense stand here."""
        for offset in (at, at + NODE_BYTES):
            angle = _angle(buffer, offset)
            if angle < 0 or not -self._leap <= _difference(angle, last) <= self._leap:
                return False
            last = angle
        return True

    def _align(self, buffer: bytes, at: int) -> int:
        """The next place where four nodes in a row advance evenly; the end of what was looked at where none does."""
        last_at = len(buffer) - RELOCK_NODES * NODE_BYTES
        while at <= last_at:
            angles = [_angle(buffer, at + k * NODE_BYTES) for k in range(RELOCK_NODES)]
            if min(angles) >= 0 and all(
                -self._lock_step <= 3 * _difference(b, a) and _difference(b, a) <= self._lock_step
                for a, b in itertools.pairwise(angles)
            ):
                self._locked = True
                self._last = angles[0]
                return at
            at += 1
        if self.trouble == "" and at > 0:
            self.trouble = "lost alignment"
        return at

    def _disturbed(self, name: str) -> None:
        self.trouble = name
        self.faults.append(name)


def _angle(buffer: bytes, at: int) -> int:
    """A node's angle as it stands in its bytes; -1 where its check bits or the angle are wrong."""
    head, angle = _HEAD.unpack_from(buffer, at)
    return angle if (head ^ head >> 1) & 1 and angle & 1 and angle <= _TURN else -1


def _difference(angle: int, last: int) -> int:
    return (angle - last + _TURN // 2) % _TURN - _TURN // 2
