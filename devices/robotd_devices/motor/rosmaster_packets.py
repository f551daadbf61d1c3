"""The packets of Yahboom's Rosmaster expansion board on its USB serial line, as a sans-IO codec.

    to the board    FF FC length function data sum    length: all bytes but the sum, less 1; sum: (1 + all bytes) & FF
    from the board  FF FB length type     data sum    length: likewise; sum: (length + type + data) & FF

Integers are little-endian. Eight bits of sum say little, so a packet must also have the length of its type, and what
follows it in the same read must be a header. Source: Yahboom's Rosmaster_Lib 3.3 for the X3.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

HOST, BOARD = b"\xff\xfc", b"\xff\xfb"
AUTO_REPORT, BEEP, MOTORS, MOTION, CAR_TYPE = 0x01, 0x02, 0x10, 0x12, 0x15
SPEED, MPU, ATTITUDE, ENCODERS, ICM = 0x0A, 0x0B, 0x0C, 0x0D, 0x0E
SAVE = 0x5F
"""Behind a setting: keep it in flash."""
SIZES = {SPEED: 7, MPU: 18, ATTITUDE: 6, ENCODERS: 16, ICM: 18}
"""Data bytes of each report."""
GAP_S = 0.002
"""The board's processor loses what comes sooner after the last command."""
LONGEST = 12
"""Bytes of the longest command of ours."""

_MOTION = struct.Struct("<Bhhh")
_SPEED = struct.Struct("<hhhB")
_ENCODERS = struct.Struct("<iiii")
_SIX = struct.Struct("<hhhhhh")
_MPU_GYRO = 1.0 / 3754.9  # 500 deg/s at full scale
_MPU_ACCEL = 1.0 / 1671.84  # 2 g at full scale
_ICM = 1.0 / 1000.0


class Report(NamedTuple):
    """One packet from the board."""

    kind: int
    data: bytes


class Speed(NamedTuple):
    """What the wheels' encoders say of the base, and the battery."""

    vx_mps: float
    vy_mps: float
    wz_radps: float
    voltage_v: float


def encode(function: int, data: bytes) -> bytes:
    """A command to the board."""
    body = HOST + bytes((len(data) + 3, function)) + data
    return body + bytes(((1 + sum(body)) & 0xFF,))


def motion(car: int, vx_mps: float, vy_mps: float, wz_radps: float) -> bytes:
    """Drive at a velocity of the base."""
    return encode(MOTION, _MOTION.pack(car, round(vx_mps * 1000), round(vy_mps * 1000), round(wz_radps * 1000)))


def car_type(car: int) -> bytes:
    """Which car it is, kept in flash: for a tool, not for every start."""
    return encode(CAR_TYPE, bytes((car, SAVE)))


def auto_report(on: bool) -> bytes:
    """Send a report every 10 ms, of four kinds in turn, until the board is switched off."""
    return encode(AUTO_REPORT, bytes((on, 0)))


def report(kind: int, data: bytes) -> bytes:
    """A packet from the board; for fakes and tests."""
    body = bytes((len(data) + 3, kind)) + data
    return BOARD + body + bytes((sum(body) & 0xFF,))


def speed_of(data: bytes) -> Speed:
    """The content of a SPEED report."""
    vx, vy, wz, voltage = _SPEED.unpack(data)
    return Speed(vx / 1000, vy / 1000, wz / 1000, voltage / 10)


def speed_data(speed: Speed) -> bytes:
    """The data of a SPEED report; for fakes and tests."""
    vx, vy, wz = (round(value * 1000) for value in speed[:3])
    return _SPEED.pack(vx, vy, wz, round(speed.voltage_v * 10))


def encoders_of(data: bytes) -> tuple[int, int, int, int]:
    """The content of an ENCODERS report: counts of motors M1 to M4, 32 bits each, which run over."""
    one, two, three, four = _ENCODERS.unpack(data)
    return one, two, three, four


def encoders_data(counts: tuple[int, int, int, int]) -> bytes:
    """The data of an ENCODERS report; for fakes and tests."""
    return _ENCODERS.pack(*((count + (1 << 31)) % (1 << 32) - (1 << 31) for count in counts))


def imu_of(report: Report) -> tuple[float, float, float, float, float, float]:
    """Angular velocity (rad/s) and specific force (m/s^2) of an MPU or ICM report, x, y, z each.

    The vendor's library turns two axes of the MPU's gyroscope round, none of its accelerometer's; so do we.
    """
    gx, gy, gz, ax, ay, az = _SIX.unpack_from(report.data)
    if report.kind == MPU:
        return (
            gx * _MPU_GYRO, -gy * _MPU_GYRO, -gz * _MPU_GYRO, ax * _MPU_ACCEL, ay * _MPU_ACCEL, az * _MPU_ACCEL
        )  # fmt: skip
    return gx * _ICM, gy * _ICM, gz * _ICM, ax * _ICM, ay * _ICM, az * _ICM


class RosmasterParser:
    """Finds reports in a stream that may begin anywhere and may be damaged."""

    def __init__(self) -> None:
        self._rest = b""
        self._synced = False
        self.faults = 0
        """Runs of bytes that were no report, since the first good one; the reader sets it back."""

    def feed(self, data: bytes) -> list[Report]:
        """The reports that these bytes complete, oldest first."""
        buffer, at, found = self._rest + data, 0, []
        while True:
            start = buffer.find(BOARD[:1], at)
            if start != at:
                self._lose(start >= 0 or at < len(buffer))
                at = start if start >= 0 else len(buffer)
            if len(buffer) < at + 4:
                break
            size = SIZES.get(buffer[at + 3])
            if buffer[at + 1] != BOARD[1] or (size is not None and buffer[at + 2] != size + 3):
                self._lose(True)
                at += 1
                continue
            # of a kind that we do not know, the length is believed, within reason
            end = at + 2 + max(2, buffer[at + 2])
            if len(buffer) < end:
                break
            follows = buffer[end : end + 1]
            if sum(buffer[at + 2 : end - 1]) & 0xFF != buffer[end - 1] or (follows and follows != BOARD[:1]):
                self._lose(True)
                at += 1
                continue
            found.append(Report(buffer[at + 3], buffer[at + 4 : end - 1]))
            self._synced = True
            at = end
        self._rest = buffer[at:]
        return found

    def _lose(self, really: bool) -> None:
        if really:
            self.faults += self._synced
            self._synced = False
