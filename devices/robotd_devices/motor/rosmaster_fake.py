"""A Rosmaster board as its serial line sees it: no time limit on motion, and no ear for commands that come too soon."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar

from robotd.world.kinematics import Mecanum
from robotd.world.messages import Drive
from robotd_devices.motor import rosmaster_packets as packets
from robotd_devices.motor.rosmaster_packets import Speed
from robotd_devices.ports.breakable import Breakable

_MS = 1_000_000
_BODY = Mecanum(wheelbase_m=0.16, track_m=0.17, wheel_radius_m=0.0325)
_COUNTS_PER_RAD = 1320.0 / 6.283185307179586


class RosmasterFake(Breakable):
    """Moves as the last command said until another comes, or for ever. `dropped`: commands that came within 2 ms.

    Four reports in turn, one every 10 ms, once they are switched on (`reports`: from the start, as delivered). Speeds
    and counts are those of its wheels, of which the front left one may be stuck (`is_stuck`).
    """

    breaks: ClassVar[Mapping[str, str]] = MappingProxyType({"controller silent": "is_mute", "wheel stuck": "is_stuck"})

    def __init__(self, *, reports: bool = True) -> None:
        self.is_mute = self.is_stuck = False
        self.voltage_v = 11.8
        self.dropped = 0
        self.told: list[tuple[int, tuple[float, float, float]]] = []
        """Every velocity that it was told and heard, with its time in nanoseconds."""
        self._reports = reports
        self._speed = (0, 0, 0)
        self._counts = [0.0, 0.0, 0.0, 0.0]
        self._turned_ns = 0
        self.power_on(0)

    def power_on(self, now_ns: int) -> None:
        """The cable went in; the board hangs on the battery and goes on."""
        self._heard = b""
        self._last_ns: int | None = None
        self._next_ns = now_ns + 10 * _MS
        self._turn = 0

    @property
    def moving(self) -> float:
        """0 where it stands."""
        return float(sum(map(abs, self._speed)))

    @property
    def velocity(self) -> tuple[float, float, float]:
        """vx, vy, wz that it was told."""
        vx, vy, wz = self._speed
        return vx / 1000, vy / 1000, wz / 1000

    @property
    def wheels_radps(self) -> tuple[float, float, float, float]:
        """How its wheels turn: front left, front right, rear left, rear right."""
        vx, vy, wz = self.velocity
        front_left, front_right, rear_left, rear_right = _BODY.wheel_speeds(Drive(vx, wz, vy))
        return 0.0 if self.is_stuck else front_left, front_right, rear_left, rear_right

    def _turn_wheels(self, now_ns: int) -> None:
        passed_s = max(0, now_ns - self._turned_ns) / 1e9
        self._turned_ns = max(self._turned_ns, now_ns)
        for i, radps in enumerate(self.wheels_radps):
            self._counts[i] += radps * passed_s * _COUNTS_PER_RAD

    def feed(self, data: bytes, now_ns: int) -> None:
        self._heard += data
        while True:
            start = self._heard.find(packets.HOST[:1])
            self._heard = self._heard[start:] if start >= 0 else b""
            if len(self._heard) < 3:
                return
            size = self._heard[2] + 2
            if self._heard[1] != packets.HOST[1] or size < 5:
                self._heard = self._heard[1:]
                continue
            if len(self._heard) < size:
                return
            packet, rest = self._heard[:size], self._heard[size:]
            if (1 + sum(packet[:-1])) & 0xFF != packet[-1]:
                self._heard = self._heard[1:]
                continue
            self._heard = rest
            self._take(packet[3], packet[4:-1], now_ns)

    def _take(self, function: int, data: bytes, now_ns: int) -> None:
        last_ns, self._last_ns = self._last_ns, now_ns
        if last_ns is not None and now_ns - last_ns < packets.GAP_S * 1e9:
            self.dropped += 1
        elif function == packets.MOTION and len(data) == 7:
            self._turn_wheels(now_ns)
            self._speed = struct.unpack("<hhh", data[1:])
            self.told.append((now_ns, self.velocity))
        elif function == packets.AUTO_REPORT:
            self._reports = bool(data[0])

    def tick(self, now_ns: int) -> bytes:
        out = b""
        while self._next_ns <= now_ns:
            self._turn_wheels(self._next_ns)
            self._next_ns += 10 * _MS
            self._turn = (self._turn + 1) % 4
            if self._reports and not self.is_mute:
                out += self._report()
        return out

    def _report(self) -> bytes:
        if self._turn == 0:
            drive = _BODY.body(*self.wheels_radps)
            speed = Speed(drive.vx_mps, drive.vy_mps, drive.wz_radps, self.voltage_v)
            return packets.report(packets.SPEED, packets.speed_data(speed))
        if self._turn == 1:
            # turned round, as the board's chip sits; lying still it feels 1 g
            gyro = -round(self._speed[2] / 1000 * 3754.9)
            return packets.report(packets.MPU, struct.pack("<9h", 0, 0, gyro, 0, 0, 16395, 0, 0, 0))
        if self._turn == 2:
            return packets.report(packets.ATTITUDE, bytes(6))
        front_left, front_right, rear_left, rear_right = map(int, self._counts)
        counts = (front_left, rear_left, front_right, rear_right)
        return packets.report(packets.ENCODERS, packets.encoders_data(counts))
