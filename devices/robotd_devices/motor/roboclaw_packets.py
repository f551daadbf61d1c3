"""The packet serial mode of a RoboClaw motor controller, as a sans-IO codec.

    a command   address  command  arguments  CRC-16/XMODEM of them all     is answered by FF
    a question  address  command                                           is answered by data and the CRC of
                                                                           address, command and data
Everything is big-endian; addresses are 80 to 87. After 10 ms without a byte the controller begins anew.
Source: Basicmicro, RoboClaw user manual (packet serial), and its Python library as tcr-roboclaw has it.
"""

from __future__ import annotations

import binascii
import struct
from typing import NamedTuple

SET_TIMEOUT, GET_TIMEOUT = 14, 15
ENCODER_1, ENCODER_2, RESET_ENCODERS, VERSION, BATTERY = 16, 17, 20, 21, 24
DUTY, SPEED, CURRENTS, STATUS = 34, 37, 49, 90
ANSWER_BYTES = {GET_TIMEOUT: 1, ENCODER_1: 5, ENCODER_2: 5, BATTERY: 2, CURRENTS: 4, STATUS: 4}
"""Data bytes of each answer; a version is text up to a zero byte, 48 at most."""
LONGEST = 12
"""Bytes of the longest command of ours."""
ACKNOWLEDGED = 0xFF
_ACK = bytes((ACKNOWLEDGED,))
_VERSION_BYTES = 48
_LONGEST_REST = 128
_MOST_LATE = 4

FAULTS = {
    0x000001: "emergency stop input",
    0x000002: "too hot",
    0x000004: "second sensor too hot",
    0x000008: "main voltage too high",
    0x000010: "logic voltage too high",
    0x000020: "logic voltage too low",
    0x000040: "M1 driver fault",
    0x000080: "M2 driver fault",
    0x000100: "M1 speed error",
    0x000200: "M2 speed error",
    0x001000: "M1 current error",
    0x002000: "M2 current error",
    0x010000: "M1 over current",
    0x020000: "M2 over current",
    0x040000: "main voltage high",
    0x080000: "main voltage low",
    0x100000: "hot",
    0x200000: "second sensor hot",
}


def crc16(data: bytes) -> int:
    """CRC-16/XMODEM."""
    return binascii.crc_hqx(data, 0)


def _sealed(body: bytes) -> bytes:
    return body + crc16(body).to_bytes(2, "big")


def question(address: int, command: int) -> bytes:
    """Ask for something."""
    return bytes((address, command))


def speed(address: int, m1_qpps: int, m2_qpps: int) -> bytes:
    """Turn at so many counts of a quadrature encoder a second, by the controller's own PID."""
    return _sealed(struct.pack(">BBii", address, SPEED, m1_qpps, m2_qpps))


def duty(address: int, m1: int, m2: int) -> bytes:
    """Share of the voltage, -32767 to 32767; 0 stops whatever mode was on."""
    return _sealed(struct.pack(">BBhh", address, DUTY, m1, m2))


def set_timeout(address: int, tenths: int) -> bytes:
    """Stop both motors after so many tenths of a second without a byte; 0: never. Lasts until it is switched off."""
    return _sealed(bytes((address, SET_TIMEOUT, tenths)))


def answer(address: int, command: int, data: bytes) -> bytes:
    """The bytes of an answer; for fakes and tests."""
    return data + crc16(bytes((address, command)) + data).to_bytes(2, "big")


def count_of(data: bytes) -> int:
    """The count of an encoder's answer, signed; its status byte is left out."""
    return int.from_bytes(data[:4], "big", signed=True)


def fault_names(status: int) -> frozenset[str]:
    """Names of the bits of a STATUS answer that are faults or warnings of the motors and supplies."""
    return frozenset(name for bit, name in FAULTS.items() if status & bit)


class Answer(NamedTuple):
    """An answer that came whole."""

    command: int
    data: bytes


class RoboClawReader:
    """Finds the answer to the one open question. `asked` opens it; one at a time.

    Answers have no header, and what stands before one has none either: acknowledgements of commands, one byte FF each,
    a late answer to a question that was given up, or half of one. So the answer is looked for from every byte on, and
    its checksum decides; the wrong bytes pass it once in 65536 places.
    """

    def __init__(self, address: int) -> None:
        self._address = address
        self._open: int | None = None
        self._rest = b""
        self._late = 0
        self.acknowledged = 0
        """Commands that were answered, as far as they can be told from the answer to a question."""
        self.faults = 0
        """Runs of bytes that were neither; the reader sets it back."""

    @property
    def open(self) -> int | None:
        """The command of the open question; None where there is none."""
        return self._open

    def asked(self, command: int) -> None:
        """A question was written."""
        self._open, self._rest = command, b""

    def give_up(self) -> None:
        """The answer is not waited for any more; where it comes all the same, it is passed over."""
        self._open, self._rest = None, b""
        self._late = min(self._late + 1, _MOST_LATE)

    def feed(self, data: bytes) -> Answer | None:
        """The answer that these bytes complete."""
        if self._open is None:
            acks = data.count(ACKNOWLEDGED)
            self.acknowledged += acks
            self._strange(len(data) - acks)
            return None
        if not data.strip(_ACK):
            self.acknowledged += len(data)
        self._rest += data
        for at in range(len(self._rest)):
            end = self._end(at)
            if end is None or end + 2 > len(self._rest):
                continue
            found = self._rest[at:end]
            if self._rest[at : end + 2] == answer(self._address, self._open, found):
                command, before, behind = self._open, self._rest[:at], self._rest[end + 2 :]
                self._strange(len(before) - before.count(ACKNOWLEDGED))
                self._open, self._rest = None, b""
                self.feed(behind)
                return Answer(command, found)
        if len(self._rest) > _LONGEST_REST:
            self._strange(_LONGEST_REST)
            self._rest = self._rest[-_VERSION_BYTES - 1 :]
        return None

    def _strange(self, count: int) -> None:
        """So many bytes were neither; behind questions that were given up they are their late answers."""
        if count and self._late:
            self._late -= 1
        elif count:
            self.faults += 1

    def _end(self, at: int) -> int | None:
        """Where the data of an answer that begins there would end; None where that cannot be said."""
        assert self._open is not None
        if self._open != VERSION:
            return at + ANSWER_BYTES[self._open]
        end = self._rest.find(b"\0", at, at + _VERSION_BYTES) + 1
        return end or None
