"""How the car moved between and during scans: what its wheels told, and beams of a turning lidar put to one instant."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from robotd.world.clock import NS_PER_S
from robotd.world.kinematics import advance, steer_to_drive
from robotd.world.messages import Command, Drive, Float64s, LidarScan, Odometry, Steer

_KEPT = 1024
"""Enough for ten seconds at 100 Hz."""


class ToldMotion:
    """Forward speeds and yaw rates as they were told, each held until the next.

    lag_s: the car follows by this time constant; for commands, not for what was measured.
    """

    def __init__(self, lag_s: float = 0.0) -> None:
        self._lag_s = lag_s
        self._told: deque[tuple[int, float, float]] = deque(maxlen=_KEPT)

    def add(self, at_ns: int, speed_mps: float, yaw_rate_radps: float) -> None:
        """What is true from `at_ns` on; what is not newer than the last is left out."""
        if self._told:
            last_ns, v, w = self._told[-1]
            if at_ns <= last_ns:
                return
            if self._lag_s > 0.0:
                keep = math.exp(-(at_ns - last_ns) / NS_PER_S / self._lag_s)
                speed_mps += keep * (v - speed_mps)
                yaw_rate_radps += keep * (w - yaw_rate_radps)
        self._told.append((at_ns, speed_mps, yaw_rate_radps))

    def between(self, then_ns: int, now_ns: int) -> tuple[float, float, float]:
        """Base at `now_ns` seen in base at `then_ns`; zeros where nothing was told."""
        pose = (0.0, 0.0, 0.0)
        for v, w, passed_s in reversed(self._pieces(then_ns, now_ns)):
            pose = advance(*pose, Drive(v, w), passed_s)
        return pose

    def way_m(self, then_ns: int, now_ns: int) -> float:
        """How far base has gone, forwards positive."""
        return sum(v * passed_s for v, _, passed_s in self._pieces(then_ns, now_ns))

    def _pieces(self, then_ns: int, now_ns: int) -> list[tuple[float, float, float]]:
        """Speed, yaw rate and for how long, the newest first; before the first that was told it went as then."""
        pieces = []
        until_ns = now_ns
        for at_ns, v, w in reversed(self._told):
            from_ns = max(at_ns, then_ns)
            if from_ns < until_ns:
                pieces.append((v, w, (until_ns - from_ns) / NS_PER_S))
                until_ns = from_ns
            if at_ns <= then_ns:
                break
        if self._told and until_ns > then_ns:
            _, v, w = self._told[0]
            pieces.append((v, w, (until_ns - then_ns) / NS_PER_S))
        return pieces


class CarMotion:
    """The car's motion by its odometry; without one by its commands, which it follows with a lag.

    wheelbase_m: of a car that takes `Steer`; inf for another base.
    """

    def __init__(self, wheelbase_m: float, command_lag_s: float) -> None:
        self._wheelbase_m = wheelbase_m
        self._wheels, self._commands = ToldMotion(), ToldMotion(command_lag_s)
        self.is_measured = False
        """Whether it is what wheels measure."""

    def hear(self, now_ns: int, odometry: Odometry | None, command: Command | None) -> None:
        """What is known at `now_ns`; call it at least as often as scans come."""
        self.is_measured = odometry is not None
        if odometry is not None:
            self._wheels.add(odometry.stamp_ns, odometry.vx_mps, odometry.wz_radps)
        if command is not None:
            drive = drive_of(command, self._wheelbase_m)
            self._commands.add(now_ns, drive.vx_mps, drive.wz_radps)

    def between(self, then_ns: int, now_ns: int) -> tuple[float, float, float]:
        """Base at `now_ns` seen in base at `then_ns`; zeros where nothing is known."""
        return self._known.between(then_ns, now_ns)

    def way_m(self, then_ns: int, now_ns: int) -> float:
        """How far base has gone, forwards positive."""
        return self._known.way_m(then_ns, now_ns)

    @property
    def _known(self) -> ToldMotion:
        return self._wheels if self.is_measured else self._commands


def drive_of(command: Command, wheelbase_m: float) -> Drive:
    """The body velocity that a command asks for."""
    return steer_to_drive(command, wheelbase_m) if isinstance(command, Steer) else command


def twist_of(moved: tuple[float, float, float], passed_s: float) -> tuple[float, float, float]:
    """The constant velocity (vx, vy, wz of base in its own frame) that moves base by `moved` in `passed_s`.

    The logarithm on SE(2); zeros where no time has passed.
    """
    if passed_s <= 0.0:
        return 0.0, 0.0, 0.0
    x, y, yaw = moved
    half = yaw / 2.0
    # half / tan(half), which is 1 at 0
    a = 1.0 - half * half / 3.0 if abs(half) < 1e-3 else half / math.tan(half)
    return (a * x + half * y) / passed_s, (a * y - half * x) / passed_s, yaw / passed_s


@dataclass(frozen=True, slots=True)
class Beams:
    """Some beams of one lidar, as base sees them while it stands.

    index: which, (n,); cos, sin: of their bearings in base, (n,); share: when in the sweep each is measured, 0 to 1.
    """

    index: np.ndarray[tuple[int], np.dtype[np.intp]]
    cos: Float64s
    sin: Float64s
    share: Float64s
    x_m: float
    y_m: float

    @classmethod
    def of(cls, scan: LidarScan, count: int) -> Beams:
        """At most `count` beams of a scan's layout, evenly over its bearings."""
        n = len(scan.angles_rad)
        index = np.unique(np.linspace(0, n - 1, min(count, n)).astype(np.intp))
        bearing = scan.angles_rad[index].astype(np.float64) + scan.yaw_rad
        share = index / max(n - 1, 1)
        return cls(index, np.cos(bearing), np.sin(bearing), share, scan.x_m, scan.y_m)

    def points(
        self, scan: LidarScan, twist: tuple[float, float, float], most_m: float
    ) -> tuple[Float64s, Float64s, np.ndarray[tuple[int], np.dtype[np.bool_]]]:
        """x and y of the returns in base at the end of the sweep, (m,) each, and which of the beams they are, (n,).

        twist: vx, vy, wz of base during the sweep. Returns nearer than `range_min_m` or not nearer than `most_m` and
        beams without one are left out.
        """
        ranges = scan.ranges_m.take(self.index)
        # nan compares false
        seen = (ranges < min(most_m, scan.range_max_m)) & (ranges > max(scan.range_min_m, 0.05))
        ranges = ranges[seen].astype(np.float64)
        x = ranges * self.cos[seen] + self.x_m
        y = ranges * self.sin[seen] + self.y_m
        sweep_s = (scan.stamp_ns - scan.start_ns) / NS_PER_S if scan.start_ns else 0.0
        if sweep_s <= 0.0 or twist == (0.0, 0.0, 0.0):
            return x, y, seen
        if scan.beam_ns is None:
            before_s = (1.0 - self.share[seen]) * sweep_s
        else:
            before_s = (scan.stamp_ns - scan.beam_ns.take(self.index)[seen]) / NS_PER_S
        return (*deskewed(x, y, before_s, twist), seen)


def deskewed(
    x_m: Float64s, y_m: Float64s, before_s: Float64s, twist: tuple[float, float, float]
) -> tuple[Float64s, Float64s]:
    """Points that base saw `before_s` ago, as base sees them now; base has moved with a constant twist since."""
    vx, vy, wz = twist
    turn = -wz * before_s
    cos, sin = np.cos(turn), np.sin(turn)
    # where base was: half the turn is the direction of the chord, which is as good as the arc for so short a time
    half_cos, half_sin = np.cos(0.5 * turn), np.sin(0.5 * turn)
    at_x = -before_s * (vx * half_cos - vy * half_sin)
    at_y = -before_s * (vx * half_sin + vy * half_cos)
    return cos * x_m - sin * y_m + at_x, sin * x_m + cos * y_m + at_y
