"""A RoboClaw as its serial line sees it: two motors that reach their speed at once, encoders, a time limit, faults."""

from __future__ import annotations

import struct

from robotd_devices.motor import roboclaw_packets as packets

_BETWEEN_BYTES_NS = 10_000_000
_ARGUMENTS = {packets.SET_TIMEOUT: 1, packets.RESET_ENCODERS: 0, packets.DUTY: 4, packets.SPEED: 8, 22: 4, 23: 4}
_AT_FULL_DUTY_QPPS = 8000


class RoboClawFake:
    """Answers at `address`; a command whose checksum is wrong is not answered. `faults`: bits of its status.

    Any byte feeds the time limit, a question's too. The limit is forgotten when its supply is switched off, which the
    serial cable is not.
    """

    def __init__(self, address: int = 0x80) -> None:
        self.address = address
        self.is_mute = False
        self.battery_v = 12.3
        self.status = 0
        self.timeout_tenths = 0
        self.current_a = (0.5, 0.7)
        self._speed = (0, 0)
        self._counts = [0.0, 0.0]
        self._now_ns = self._fed_ns = 0
        self.power_on(0)

    def power_on(self, now_ns: int) -> None:
        """The cable went in; the controller hangs on its battery and goes on."""
        self._heard = b""
        self._out = b""

    def speed_qpps(self, now_ns: int) -> tuple[int, int]:
        """What the motors make now, in counts a second."""
        limit_ns = self.timeout_tenths * 100_000_000
        return (0, 0) if limit_ns and now_ns - self._fed_ns > limit_ns else self._speed

    def feed(self, data: bytes, now_ns: int) -> None:
        self._turn(now_ns)
        if now_ns - self._fed_ns > _BETWEEN_BYTES_NS:
            self._heard = b""
        if now_ns - self._fed_ns > self.timeout_tenths * 100_000_000 > 0:
            self._speed = (0, 0)
        self._fed_ns = now_ns
        self._heard += data
        while self._heard and self._take():
            pass

    def tick(self, now_ns: int) -> bytes:
        self._turn(now_ns)
        out, self._out = self._out, b""
        return b"" if self.is_mute else out

    def _turn(self, now_ns: int) -> None:
        passed_s = max(0, now_ns - self._now_ns) / 1e9
        for i, speed in enumerate(self.speed_qpps(now_ns)):
            self._counts[i] += speed * passed_s
        self._now_ns = max(self._now_ns, now_ns)

    def _take(self) -> bool:
        """One packet, or one byte that begins none; False where more must come."""
        if self._heard[0] != self.address:
            self._heard = self._heard[1:]
            return True
        if len(self._heard) < 2:
            return False
        command = self._heard[1]
        if command in _ARGUMENTS:
            size = 4 + _ARGUMENTS[command]
            if len(self._heard) < size:
                return False
            body, sealed = self._heard[: size - 2], self._heard[size - 2 : size]
            self._heard = self._heard[size:]
            if sealed == packets.crc16(body).to_bytes(2, "big"):
                self._obey(command, body[2:])
                self._out += bytes((packets.ACKNOWLEDGED,))
            return True
        data = self._answer(command)
        self._heard = self._heard[2:] if data is not None else self._heard[1:]
        if data is not None:
            self._out += packets.answer(self.address, command, data)
        return True

    def _obey(self, command: int, data: bytes) -> None:
        if command == packets.SET_TIMEOUT:
            self.timeout_tenths = data[0]
        elif command == packets.SPEED:
            self._speed = struct.unpack(">ii", data)
        elif command == packets.DUTY:
            m1, m2 = struct.unpack(">hh", data)
            self._speed = (m1 * _AT_FULL_DUTY_QPPS // 32767, m2 * _AT_FULL_DUTY_QPPS // 32767)
        elif command == packets.RESET_ENCODERS:
            self._counts = [0.0, 0.0]
        else:
            self._counts[command - 22] = float(int.from_bytes(data, "big", signed=True))

    def _answer(self, command: int) -> bytes | None:
        match command:
            case packets.VERSION:
                return b"USB Roboclaw 2x7a v4.1.34\n\0"
            case packets.GET_TIMEOUT:
                return bytes((self.timeout_tenths,))
            case packets.ENCODER_1 | packets.ENCODER_2:
                i = command - packets.ENCODER_1
                count = round(self._counts[i]) & 0xFFFFFFFF
                return count.to_bytes(4, "big") + bytes((2 if self._speed[i] < 0 else 0,))
            case packets.BATTERY:
                return round(self.battery_v * 10).to_bytes(2, "big")
            case packets.CURRENTS:
                return struct.pack(">hh", *(round(current * 100) for current in self.current_a))
            case packets.STATUS:
                return self.status.to_bytes(4, "big")
        return None
