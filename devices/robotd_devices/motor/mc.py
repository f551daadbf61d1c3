"""The MC protocol, version 1: frames between a computer and the ESP32 of a TT-02D car, as a sans-IO codec.

A frame is COBS(header, payload, CRC) and a delimiter 0x00. All fields are little-endian:

    0  u8 x2  4D 43 "MC"         5  u16  sequence
    2  u8     version, 1         7  u16  length of the payload, 64 at most
    3  u8     type               9       payload
    4  u8     flags, bit 0: acknowledge      u16  CRC-16/CCITT-FALSE over header and payload

Source: TetsuroAndo/robo-racer (MIT), docs/proto/overview.md and its firmware; the vehicle of seed 004 (`seriald`).
STATUS has 10 bytes in its text and 14 in its code: both are taken.
"""

from __future__ import annotations

import binascii
import struct
from enum import IntEnum
from typing import NamedTuple

DELIMITER = b"\x00"
MAGIC, VERSION = b"MC", 1
MOST_PAYLOAD = 64
ACK_REQUEST = 0x01
STEER_CDEG = 2500
SPEED_MM_S = 5000
TTL_MS = (10, 2000)
HEARTBEAT_MS = 200
"""Without a PING for this long the controller stops the motor."""
CREEP_MM_S = 220
"""What some builds of the firmware make of a fresh DRIVE with speed 0 or less: the car does not stop by it."""

_HEADER = struct.Struct("<2sBBBHH")
_CRC = struct.Struct("<H")
_DRIVE = struct.Struct("<hhHH")
_STATUS = struct.Struct("<BBHhhH")
_IMU = struct.Struct("<hhHhHB")
_LONGEST = 256


class Kind(IntEnum):
    """Types of frames."""

    DRIVE = 0x01
    KILL = 0x02
    MODE_SET = 0x03
    PING = 0x04
    LOG = 0x10
    STATUS = 0x11
    IMU = 0x13
    TSD20 = 0x14
    ACK = 0x80


class McFrame(NamedTuple):
    """One frame. `kind`: a `Kind`, or a number that is none."""

    kind: int
    payload: bytes = b""
    seq: int = 0
    flags: int = 0


class Status(NamedTuple):
    """STATUS: the controller's state. `age_ms`: since the last DRIVE, 65535 where there was none."""

    seq_applied: int
    auto: int
    faults: int
    speed_mm_s: int
    steer_cdeg: int
    age_ms: int

    @property
    def fault_names(self) -> frozenset[str]:
        """Names of the faults that are set."""
        return frozenset(name for bit, name in _FAULTS.items() if self.faults & bit)


KILL_LATCHED, HEARTBEAT_LOST, TTL_EXPIRED, NOT_AUTO = 1, 2, 4, 8
_FAULTS = {
    KILL_LATCHED: "kill latched",
    HEARTBEAT_LOST: "heartbeat timed out",
    TTL_EXPIRED: "command timed out",
    NOT_AUTO: (WITHOUT_AUTO := "command without auto mode"),
}


class ImuStatus(NamedTuple):
    """IMU_STATUS: along the car and about its vertical axis. `flags`: bit 0 valid, 1 calibrated, 2 brakes pulse."""

    accel_mm_s2: int
    speed_mm_s: int
    brake_mm_s2: int
    yaw_ddps: int
    age_ms: int
    flags: int

    @property
    def is_valid(self) -> bool:
        """Whether it was measured with a calibrated sensor."""
        return self.flags & 0x03 == 0x03


def cobs_encode(data: bytes) -> bytes:
    """Consistent overhead byte stuffing (Cheshire and Baker, 1999): no zero byte is left; without the delimiter."""
    out = bytearray()
    for block in data.split(b"\x00"):
        while len(block) >= 254:
            out += b"\xff" + block[:254]
            block = block[254:]
        out.append(len(block) + 1)
        out += block
    return bytes(out)


def cobs_decode(data: bytes) -> bytes:
    """The bytes back, for blocks of less than 254. Raises ValueError where a block runs over the end."""
    out = bytearray()
    at = 0
    while at < len(data):
        code = data[at]
        if code == 0 or at + code > len(data):
            raise ValueError("COBS block over the end")
        out += data[at + 1 : at + code]
        at += code
        if code < 0xFF and at < len(data):
            out.append(0)
    return bytes(out)


def crc16(data: bytes) -> int:
    """CRC-16/CCITT-FALSE; 0x29B1 for b"123456789"."""
    return binascii.crc_hqx(data, 0xFFFF)


def encode(frame: McFrame) -> bytes:
    """The bytes of a frame with its delimiter behind it."""
    body = _HEADER.pack(MAGIC, VERSION, frame.kind, frame.flags, frame.seq & 0xFFFF, len(frame.payload)) + frame.payload
    return cobs_encode(body + _CRC.pack(crc16(body))) + DELIMITER


def decode(block: bytes) -> McFrame:
    """A frame from what stands between two delimiters. Raises ValueError."""
    body = cobs_decode(block)
    if len(body) < _HEADER.size + _CRC.size:
        raise ValueError("too short")
    if _CRC.unpack(body[-2:])[0] != crc16(body[:-2]):
        raise ValueError("bad checksum")
    magic, version, kind, flags, seq, size = _HEADER.unpack_from(body)
    payload = body[_HEADER.size : -2]
    if magic != MAGIC or version != VERSION or size != len(payload) or size > MOST_PAYLOAD:
        raise ValueError("no frame of this protocol")
    return McFrame(kind, payload, seq, flags)


def drive(steer_cdeg: int, speed_mm_s: int, ttl_ms: int, seq: int) -> bytes:
    """A command with the time for which it holds."""
    return encode(McFrame(Kind.DRIVE, _DRIVE.pack(steer_cdeg, speed_mm_s, ttl_ms, 0), seq))


def mode_set(auto: bool, seq: int = 0) -> bytes:
    """Obey DRIVE from now on, or no more. The controller acknowledges it."""
    return encode(McFrame(Kind.MODE_SET, bytes((auto,)), seq, ACK_REQUEST))


def ping(seq: int) -> bytes:
    """The heartbeat; always acknowledged."""
    return encode(McFrame(Kind.PING, b"", seq))


def kill(seq: int = 0) -> bytes:
    """Stop for good: only a restart of the controller ends it."""
    return encode(McFrame(Kind.KILL, b"", seq, ACK_REQUEST))


STOP = DELIMITER + mode_set(False)
"""A delimiter for a frame that was cut in two, then auto mode off. Never DRIVE with speed 0, see `CREEP_MM_S`."""


def status_of(frame: McFrame) -> Status | None:
    """The content of a STATUS frame; None where it is shorter than the protocol's 10 bytes."""
    return Status(*_STATUS.unpack_from(frame.payload)) if len(frame.payload) >= _STATUS.size else None


def imu_of(frame: McFrame) -> ImuStatus | None:
    """The content of an IMU_STATUS frame; None where it is too short."""
    return ImuStatus(*_IMU.unpack_from(frame.payload)) if len(frame.payload) >= _IMU.size else None


class McParser:
    """Finds frames in a stream that may begin anywhere and may be damaged; what it accepts has a right checksum."""

    def __init__(self) -> None:
        self._rest = b""
        self._synced = False
        self.faults = 0
        """Blocks that were no frame, since the first good one; the reader sets it back."""

    def feed(self, data: bytes) -> list[McFrame]:
        """The frames that these bytes complete, oldest first."""
        *blocks, rest = (self._rest + data).split(DELIMITER)
        # what grows longer than any frame is none; its end is found by the next delimiter
        self._rest = rest[-_LONGEST:]
        found: list[McFrame] = []
        for block in blocks:
            if not block:
                continue
            try:
                found.append(decode(block))
                self._synced = True
            except ValueError:
                self.faults += self._synced
        return found
