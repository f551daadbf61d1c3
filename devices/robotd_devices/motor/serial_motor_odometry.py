"""Where a base is by what its controller measured: speeds or wheel counts, added up exactly on the plane."""

from __future__ import annotations

from robotd.world.clock import NS_PER_S
from robotd.world.kinematics import Differential, advance
from robotd.world.messages import Drive, Odometry

_LONGEST_GAP_S = 0.5
"""Over a longer pause between two reports nothing is added: nobody knows what happened in between."""


class PoseSum:
    """Adds up body velocities. The frame starts at 0, 0, 0 and goes on over a reconnect."""

    def __init__(self) -> None:
        self._pose = (0.0, 0.0, 0.0)
        self._before_ns: int | None = None

    def start(self) -> None:
        """After opening: what moved meanwhile is unknown."""
        self._before_ns = None

    def speed(self, drive: Drive, now_ns: int) -> Odometry:
        """The base moved with this velocity since the last report, which ends at `now_ns`."""
        if self._before_ns is not None:
            passed_s = (now_ns - self._before_ns) / NS_PER_S
            if 0.0 < passed_s <= _LONGEST_GAP_S:
                self._pose = advance(*self._pose, drive, passed_s)
        self._before_ns = now_ns
        return self._odometry(drive, now_ns)

    def way(self, way: Drive, drive: Drive, now_ns: int) -> Odometry:
        """The base went this way (metres, radians: a velocity times its time) and now has this velocity."""
        self._pose = advance(*self._pose, way, 1.0)
        return self._odometry(drive, now_ns)

    def _odometry(self, drive: Drive, now_ns: int) -> Odometry:
        return Odometry(now_ns, *self._pose, drive.vx_mps, drive.vy_mps, drive.wz_radps)


class CountOdometry:
    """Two wheels with counters of 32 bits, left and right; counts forward are positive.

    A step that no wheel of this base can make (`fastest_mps` on its rim) is a counter that was reset, or a byte that a
    checksum does not see: it is left out, and `jumps` counts it.
    """

    def __init__(self, pose: PoseSum, body: Differential, m_per_count: float, fastest_mps: float) -> None:
        self._pose = pose
        self._body = body
        self._m_per_count = m_per_count
        self._fastest_mps = fastest_mps
        self._before: tuple[int, int, int] | None = None  # left, right, when
        self.jumps = 0

    def counts(self, left: int, right: int, now_ns: int) -> Odometry | None:
        """Odometry of a reading; None for the first one, for one without time since the last, and for a jump."""
        before = self._before
        if before is not None and now_ns <= before[2]:
            return None
        self._before = (left, right, now_ns)
        if before is None:
            return None
        passed_s = (now_ns - before[2]) / NS_PER_S
        left_m = wrapped(left - before[0]) * self._m_per_count
        right_m = wrapped(right - before[1]) * self._m_per_count
        if max(abs(left_m), abs(right_m)) > self._fastest_mps * passed_s + 2.0 * self._m_per_count:
            self.jumps += 1
            return None
        way = self._body.body(left_m, right_m)
        return self._pose.way(way, Drive(way.vx_mps / passed_s, way.wz_radps / passed_s), now_ns)


def wrapped(difference: int) -> int:
    """The difference of two readings of a counter of 32 bits that may have run over in between."""
    return (difference + (1 << 31)) % (1 << 32) - (1 << 31)
