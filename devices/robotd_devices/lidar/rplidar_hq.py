"""The HQ packets of an RPLIDAR (type 0x83) as a sans-IO parser: 96 nodes behind a checksum of 32 bits.

    0  A5                    9  96 nodes of 8 bytes: u16 angle, 90/16384 degree, clockwise; u32 distance, 1/4 mm;
    1  u64 time stamp                                u8 quality; u8 flag, bit 0: first of a turn
                           777  u32 CRC-32 (as zlib's) of all bytes before it and three zeros

Integers are little-endian. Source: Slamtec's rplidar_sdk 2.1.0 (BSD-2), which pads to a multiple of four.
"""

from __future__ import annotations

import zlib

from robotd_devices.lidar.arrivals import Arrivals
from robotd_devices.lidar.rplidar_nodes import NodeRun

HQ = 0x83
NODES = 96
NODE_BYTES = 8
PACKET_BYTES = 781

_SYNC = b"\xa5"
_HEADER_BYTES = 9
_CRC_AT = 777
_PAD = bytes(3)


def seal(stamp: int, nodes: bytes) -> bytes:
    """A whole packet; for fakes and tests. Raises ValueError for another number of nodes than 96."""
    if len(nodes) != NODES * NODE_BYTES:
        raise ValueError(f"a packet has {NODES} nodes of {NODE_BYTES} bytes, not {len(nodes)} bytes")
    body = _SYNC + stamp.to_bytes(8, "little") + nodes
    return body + zlib.crc32(body + _PAD).to_bytes(4, "little")


def is_sound(packet: bytes) -> bool:
    """Whether a whole packet carries its mark and the right checksum."""
    told = int.from_bytes(packet[_CRC_AT:], "little")
    return packet.startswith(_SYNC) and zlib.crc32(packet[:_CRC_AT] + _PAD) == told


class HqParser:
    """Finds packets in a stream that may begin anywhere and may be damaged.

    With 32 bits of checksum nothing more has to be asked of a packet, and none has to be waited for behind it. What is
    accepted depends on the bytes alone, never on how they were cut into chunks. byte_ns: time of a byte on the wire;
    sample_ns: time between two nodes.
    """

    def __init__(self, byte_ns: float, sample_ns: float) -> None:
        self._period_ns = NODES * sample_ns
        self._arrivals = Arrivals(byte_ns)
        self._rest = b""
        self._last = b""
        self._missing = -1
        self.trouble = ""
        """Name of the last disturbance, for a reader that sees no packets at all."""
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
            start = buffer.find(_SYNC, at)
            if start != at and at < end:
                self._disturbed("stray bytes")
            at = start if start >= 0 else end
            if end - at < PACKET_BYTES:
                break
            packet = buffer[at : at + PACKET_BYTES]
            if not is_sound(packet):
                self._disturbed("bad checksum")
                at += 1
                continue
            at += PACKET_BYTES
            if packet == self._last:
                self.faults.append("repeated packet")
                continue
            arrival_ns = self._arrivals.of(end - at, PACKET_BYTES, self._period_ns)
            found.append(NodeRun(packet[_HEADER_BYTES:_CRC_AT], arrival_ns, self._missing))
            self._last, self._missing = packet, 0
            self.packets += NODES
        self._rest = buffer[at:]
        self._arrivals.done(len(self._rest))
        return found

    def _disturbed(self, name: str) -> None:
        """Count what ended a good run; what follows until the next good packet belongs to the same disturbance."""
        if self._missing == 0 or name != "stray bytes":  # which come behind every other disturbance
            self.trouble = name
        if self._missing == 0:
            self._missing = -1
            self.faults.append(name)
