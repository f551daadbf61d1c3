"""An LD19 as its serial line sees it, in a world that a function describes; for tests and for benches without one."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from robotd.world.messages import Float64s
from robotd_devices.lidar.ld_packets import CLOCK_MS, POINTS, TURN_CDEG, LdPacket, encode

#: Bearings in the lidar's frame (radians, counter-clockwise) to distances in metres, `inf` where nothing is.
RangeOf: TypeAlias = Callable[[Float64s], Float64s]

_STEPS = POINTS - 1


@dataclass(frozen=True, slots=True)
class BoxRoom:
    """Four walls around the lidar, distances in metres from it."""

    front_m: float = 2.0
    back_m: float = 1.0
    left_m: float = 1.5
    right_m: float = 0.8

    def __call__(self, bearing_rad: Float64s) -> Float64s:
        cos, sin = np.cos(bearing_rad), np.sin(bearing_rad)
        with np.errstate(divide="ignore"):
            along = np.where(cos > 0.0, self.front_m, -self.back_m) / cos
            across = np.where(sin > 0.0, self.left_m, -self.right_m) / sin
        return np.minimum(np.abs(along), np.abs(across))


class Ld19Fake:
    """Spins from power-on and sends a packet the moment its twelfth point is measured.

    The world is `range_of`; its distances beyond `range_max_m` are sent as 0 (no return). Angles are the device's:
    clockwise from the mark, as the reader must turn them. The device's clock starts at `first_ms`.
    """

    def __init__(
        self,
        range_of: RangeOf | None = None,
        *,
        rotation_hz: float = 10.0,
        rate_hz: float = 4500.0,
        range_max_m: float = 12.0,
        first_deg: float = 0.0,
        first_ms: int = 0,
        intensity: int = 200,
    ) -> None:
        self.range_of: RangeOf = range_of if range_of is not None else BoxRoom()
        self.rotation_hz = rotation_hz
        self._rate_hz = rate_hz
        self._range_max_m = range_max_m
        self._first_deg = first_deg
        self._first_ms = first_ms
        self._intensity = intensity
        self.power_on(0)

    def power_on(self, now_ns: int) -> None:
        self._on_ns = now_ns
        self._sent = 0
        self._angle_deg = self._first_deg

    def feed(self, data: bytes, now_ns: int) -> None:
        """An LD19 listens to nothing."""

    def ready_ns(self, packet: int) -> int:
        """When the last point of a packet (counted from power-on) is measured and its first byte goes out."""
        return self._on_ns + round((packet + 1) * POINTS / self._rate_hz * 1e9)

    def tick(self, now_ns: int) -> bytes:
        out = b""
        while self.ready_ns(self._sent) <= now_ns:
            out += encode(self.next_packet())
        return out

    def next_packet(self) -> LdPacket:
        """The next twelve points, whatever the time."""
        turn_dps = 360.0 * self.rotation_hz
        start = round(self._angle_deg * 100.0) % TURN_CDEG
        span = round(turn_dps * _STEPS / self._rate_hz * 100.0)
        self._angle_deg = (self._angle_deg + turn_dps * POINTS / self._rate_hz) % 360.0
        stamp_ms = self._first_ms + (self.ready_ns(self._sent) - self._on_ns) // 1_000_000
        self._sent += 1
        # measured exactly where the packet's own angles say, so that a reader can be held to the last digit
        bearing = -math.tau / TURN_CDEG * (start + span / _STEPS * np.arange(POINTS, dtype=np.float64))
        distance_m = self.range_of(bearing)
        seen = np.isfinite(distance_m) & (distance_m <= self._range_max_m)
        points = np.zeros(POINTS, dtype=[("mm", "<u2"), ("intensity", "u1")])
        points["mm"] = np.where(seen, np.rint(np.where(seen, distance_m, 0.0) * 1000.0), 0.0)
        points["intensity"] = np.where(seen, self._intensity, 0)
        return LdPacket(start, span, round(turn_dps), stamp_ms % CLOCK_MS, points.tobytes())
