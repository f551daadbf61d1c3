"""What is said to a Slamtec RPLIDAR and what it answers, apart from measurements: requests, descriptors, replies.

A request is `A5 cmd`, or with a payload `A5 cmd length payload xor`; answers begin with a descriptor (`answers`).
All numbers are little-endian. Sources: Slamtec's protocol manual LR001 and rplidar_sdk 2.1.0 (BSD-2).
"""

from __future__ import annotations

import struct
from typing import NamedTuple

from robotd_devices.lidar.xor_fold import xor_fold

STOP, RESET, SCAN, FORCE_SCAN = 0x25, 0x40, 0x20, 0x21
EXPRESS_SCAN = 0x82
GET_INFO, GET_HEALTH, GET_SAMPLE_RATE, GET_CONF = 0x50, 0x52, 0x59, 0x84
SET_PWM, SET_RPM, GET_BOARD_FLAG = 0xF0, 0xA8, 0xFF
CONFIRM_BAUD = 0x90

INFO, HEALTH, SAMPLE_RATE, CONF, BOARD_FLAG = 0x04, 0x06, 0x15, 0x20, 0xFF
"""Types of answers."""

MODE_COUNT, MODE_US_PER_SAMPLE, MODE_MAX_DISTANCE, MODE_ANSWER, MODE_TYPICAL, MODE_NAME = (
    0x70, 0x71, 0x74, 0x75, 0x7C, 0x7F,
)  # fmt: skip
"""Entries of the device's own table of scan modes."""

#: A device with firmware 1.30 or later measures the speed of a line on which this comes again and again.
MEASURE_ME = b"\x41" * 16
_CONFIRMED = 0x5F5F

#: Pulse width of the A2's and A3's motor: the SDK's default of 0..1023.
DEFAULT_PWM = 660


def request(command: int, payload: bytes = b"") -> bytes:
    """The bytes of a request; commands from 0x80 on always carry a length and a checksum."""
    head = bytes((0xA5, command))
    if not command & 0x80:
        return head
    body = head + bytes((len(payload),)) + payload
    return body + bytes((xor_fold(body, 1),))


def express_scan(mode: int) -> bytes:
    """Starts the scan mode of that number; 0 on an A1 or A2 with old firmware is its only express mode."""
    return request(EXPRESS_SCAN, struct.pack("<BHH", mode, 0, 0))


def conf(entry: int, mode: int | None = None) -> bytes:
    """Asks for an entry of the device's table, of one scan mode where it belongs to a mode."""
    return request(GET_CONF, struct.pack("<I", entry) + (b"" if mode is None else struct.pack("<H", mode)))


def motor_pwm(pwm: int) -> bytes:
    """Sets the motor's pulse width, 0..1023; 0 stops it."""
    return request(SET_PWM, struct.pack("<H", pwm))


def motor_rpm(rpm: int) -> bytes:
    """Sets the motor's speed in revolutions a minute; 0 stops it."""
    return request(SET_RPM, struct.pack("<H", rpm))


def confirm_baud(baud: int) -> bytes:
    """Tells the device to stay at the speed that it measured. There is no answer."""
    return request(CONFIRM_BAUD, struct.pack("<HIH", _CONFIRMED, baud, 0))


class Info(NamedTuple):
    """Who it is. `model`: family in the upper four bits (1 A1, 2 A2, 3 A3, 4 C1, 6 S1, 7 S2, 8 S3)."""

    model: int
    firmware: int
    hardware: int
    serial: str

    @property
    def family(self) -> int:
        """Upper four bits of the model."""
        return self.model >> 4

    @property
    def version(self) -> str:
        """Firmware as the vendor writes it."""
        return f"{self.firmware >> 8}.{self.firmware & 0xFF:02d}"


def decode_info(data: bytes) -> Info:
    """Twenty bytes of a GET_INFO answer."""
    model, firmware, hardware, serial = struct.unpack("<BHB16s", data)
    return Info(model, firmware, hardware, serial.hex().upper())


def encode_info(info: Info) -> bytes:
    """For fakes."""
    return struct.pack("<BHB16s", info.model, info.firmware, info.hardware, bytes.fromhex(info.serial))


class Health(NamedTuple):
    """`status` 0 is well, 1 a warning, 2 the protection stop, out of which only a reset leads; `code` says why."""

    status: int
    code: int


def decode_health(data: bytes) -> Health:
    """Three bytes of a GET_HEALTH answer. (Several Python libraries read the code with its bytes swapped.)"""
    return Health(*struct.unpack("<BH", data))
