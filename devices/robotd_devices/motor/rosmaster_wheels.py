"""Whether the four wheels of a mecanum base turn as four wheels on one body do: a stuck or a slipping one does not.

Of a body that moves without slip, front left + front right = rear left + rear right (the rollers leave three degrees of
freedom to four wheels). What is left over is in proportion to how wrong one wheel is.
"""

from __future__ import annotations

from typing import TypeAlias

from robotd_devices.motor.serial_motor_odometry import wrapped

Counts: TypeAlias = tuple[int, int, int, int]
"""Encoder counts in the board's order M1 to M4: front left, rear left, front right, rear right."""

SHARE = 0.15
"""What may be left over, of the way of the fastest wheel."""
_FEWEST = 20
"""Where the fastest wheel made fewer counts since the last reading, their rounding says too much."""
_LONGEST_GAP_NS = 250_000_000


class WheelWatch:
    """Judges reading after reading. slip_ns: for how long wheels must disagree, always to the same side."""

    def __init__(self, slip_ns: int) -> None:
        self._slip_ns = slip_ns
        self._before: tuple[Counts, int] | None = None
        self._side = 0
        self._since_ns = 0

    def disagree(self, counts: Counts, now_ns: int) -> float | None:
        """Take a reading; the share that was left over in it, where that has lasted for `slip_ns`, else None."""
        before, self._before = self._before, (counts, now_ns)
        if before is None or not 0 < now_ns - before[1] <= _LONGEST_GAP_NS:
            self._side = 0
            return None
        way = [wrapped(new - old) for new, old in zip(counts, before[0], strict=True)]
        front_left, rear_left, front_right, rear_right = way
        left_over, fastest = front_left + front_right - rear_left - rear_right, max(map(abs, way))
        if fastest < _FEWEST or abs(left_over) <= SHARE * fastest:
            self._side = 0
            return None
        side = 1 if left_over > 0 else -1
        if side != self._side:
            self._side, self._since_ns = side, before[1]
        return abs(left_over) / fastest if now_ns - self._since_ns >= self._slip_ns else None
