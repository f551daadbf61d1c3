"""The packets of a VESC motor controller on its UART or USB, as a sans-IO codec.

    02  length  payload  CRC-16/XMODEM of the payload, big-endian  03

The payload is big-endian and begins with a command. Packets of 256 bytes and more begin with 03; none of ours is, and
no answer that we ask for. Source: VESC firmware's protocol as f1tenth/vesc (BSD) and PyVESC speak it.
"""

from __future__ import annotations

import binascii
import struct
from typing import NamedTuple

FW_VERSION, GET_VALUES = 0x00, 0x04
SET_DUTY, SET_CURRENT, SET_BRAKE, SET_RPM, SET_SERVO, ALIVE = 0x05, 0x06, 0x07, 0x08, 0x0C, 0x1E
START, END = 0x02, 0x03
TIMEOUT_MS = 1000
"""The controller's own time limit as it is delivered (App settings, General)."""

_VALUES = struct.Struct(">hhiiiihihiiiiiiB")
_AROUND = 5

FAULTS = {
    1: "over voltage",
    2: "under voltage",
    3: "gate driver fault",
    4: "over current",
    5: "controller too hot",
    6: "motor too hot",
}


def crc16(data: bytes) -> int:
    """CRC-16/XMODEM; 0x31C3 for b"123456789"."""
    return binascii.crc_hqx(data, 0)


def encode(payload: bytes) -> bytes:
    """A packet around a payload of 1 to 255 bytes."""
    return bytes((START, len(payload))) + payload + crc16(payload).to_bytes(2, "big") + bytes((END,))


def ask_version() -> bytes:
    """Which firmware is it?"""
    return encode(bytes((FW_VERSION,)))


def ask_values() -> bytes:
    """What does it measure?"""
    return encode(bytes((GET_VALUES,)))


def set_rpm(erpm: int) -> bytes:
    """Turn at so many electrical revolutions a minute."""
    return encode(struct.pack(">Bi", SET_RPM, erpm))


def set_duty(duty: float) -> bytes:
    """Share of the battery's voltage, -1 to 1."""
    return encode(struct.pack(">Bi", SET_DUTY, round(duty * 100_000)))


def set_current(current_a: float) -> bytes:
    """Current through the motor; 0 lets it go."""
    return encode(struct.pack(">Bi", SET_CURRENT, round(current_a * 1000)))


def set_brake(current_a: float) -> bytes:
    """Braking current."""
    return encode(struct.pack(">Bi", SET_BRAKE, round(current_a * 1000)))


def set_servo(position: float) -> bytes:
    """Position of the servo, 0 to 1."""
    return encode(struct.pack(">Bh", SET_SERVO, round(position * 1000)))


def alive() -> bytes:
    """Feed the controller's time limit, and nothing else."""
    return encode(bytes((ALIVE,)))


class Values(NamedTuple):
    """The answer to GET_VALUES, as far as firmware 3.33 has it. `tachometer`: six counts an electrical revolution."""

    controller_c: float
    motor_c: float
    motor_a: float
    battery_a: float
    duty: float
    erpm: int
    voltage_v: float
    tachometer: int
    fault: int

    @property
    def fault_names(self) -> frozenset[str]:
        """The fault's name, where there is one."""
        return frozenset([FAULTS.get(self.fault, f"fault {self.fault}")]) if self.fault else frozenset()


def values_of(payload: bytes) -> Values | None:
    """The answer's content; None where the payload is another's, or too short."""
    if payload[:1] != bytes((GET_VALUES,)) or len(payload) < 1 + _VALUES.size:
        return None
    f = _VALUES.unpack_from(payload, 1)
    return Values(f[0] / 10, f[1] / 10, f[2] / 100, f[3] / 100, f[6] / 1000, f[7], f[8] / 10, f[13], f[15])


def values_payload(values: Values) -> bytes:
    """The answer of a controller; for fakes and tests."""
    return bytes((GET_VALUES,)) + _VALUES.pack(
        round(values.controller_c * 10),
        round(values.motor_c * 10),
        round(values.motor_a * 100),
        round(values.battery_a * 100),
        0,
        0,
        round(values.duty * 1000),
        values.erpm,
        round(values.voltage_v * 10),
        *(0,) * 4,
        values.tachometer,
        abs(values.tachometer),
        values.fault,
    )


class VescParser:
    """Finds packets in a stream that may begin anywhere and may be damaged; what it gives has a right checksum."""

    def __init__(self) -> None:
        self._rest = b""
        self._synced = False
        self.faults = 0
        """Runs of bytes that were no packet, since the first good one; the reader sets it back."""

    def feed(self, data: bytes) -> list[bytes]:
        """The payloads that these bytes complete, oldest first."""
        buffer, at, found = self._rest + data, 0, []
        while at < len(buffer):
            if buffer[at] != START:
                at += 1
                self._lose()
                continue
            if len(buffer) < at + 2:
                break
            size = buffer[at + 1]
            end = at + _AROUND + size
            if size and len(buffer) < end:
                break
            payload = buffer[at + 2 : at + 2 + size]
            if not size or buffer[end - 1] != END or crc16(payload) != int.from_bytes(buffer[end - 3 : end - 1], "big"):
                at += 1
                self._lose()
                continue
            found.append(payload)
            self._synced = True
            at = end
        self._rest = buffer[at:]
        return found

    def _lose(self) -> None:
        self.faults += self._synced
        self._synced = False
