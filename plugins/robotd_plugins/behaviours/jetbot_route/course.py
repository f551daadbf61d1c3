"""In which direction the line runs, in the frame of odometry, and how fast odometry turns away from it."""

from __future__ import annotations

import math

_KEEPS = 0.5
_SEEN_STD_RAD = 0.03
_UNKNOWN_STD_RAD = 0.3
_BEND_STD_PM = 1.5
_BEND_MAX_PM = 4.0
_WANDERS_RAD2_PM = 0.01
_WANDERS_PM2_PM = 0.05
_FRAME_RAD2 = 1e-5
_GATE_STDS = 4.0


class Course:
    """The direction of a line that may bend: the newest looks, smoothed."""

    def __init__(self) -> None:
        self.rad = 0.0
        """Direction of the line in the odometry frame, counter-clockwise."""
        self.bend_pm = 0.0
        """By how much that direction turns in odometry's frame for each metre of a straight line."""

    def begin(self, rad: float) -> None:
        """The direction is known anew: at the start, after a turn."""
        self.rad = rad

    def travel(self, driven_m: float) -> None:
        """The robot went on."""

    def see(self, rad: float) -> None:
        """A look measured the line's direction in the odometry frame."""
        self.rad += (1.0 - _KEEPS) * math.remainder(rad - self.rad, math.tau)


class StraightCourse(Course):
    """The direction of straight roads: what seems to bend is odometry, whose wheels are not equal.

    A Kalman filter over travelled metres with two states, direction and bend; the bend is a property of the wheels, so
    that it outlives a turn. Looks that are off by more than four standard deviations count as such.
    """

    def __init__(self) -> None:
        super().__init__()
        self._rad_var = _UNKNOWN_STD_RAD**2
        self._both_var = 0.0
        self._bend_var = _BEND_STD_PM**2

    def begin(self, rad: float) -> None:
        self.rad = rad
        self._rad_var, self._both_var = _UNKNOWN_STD_RAD**2, 0.0

    def travel(self, driven_m: float) -> None:
        self.rad += self.bend_pm * driven_m
        way_m = abs(driven_m)
        self._rad_var += driven_m * (2.0 * self._both_var + driven_m * self._bend_var) + _WANDERS_RAD2_PM * way_m
        self._both_var += driven_m * self._bend_var
        self._bend_var += _WANDERS_PM2_PM * way_m

    def see(self, rad: float) -> None:
        self._rad_var += _FRAME_RAD2
        off = math.remainder(rad - self.rad, math.tau)
        total = self._rad_var + _SEEN_STD_RAD**2
        limit = _GATE_STDS * math.sqrt(total)
        off = min(max(off, -limit), limit)
        rad_gain, bend_gain = self._rad_var / total, self._both_var / total
        self.rad += rad_gain * off
        self.bend_pm = min(max(self.bend_pm + bend_gain * off, -_BEND_MAX_PM), _BEND_MAX_PM)
        self._bend_var -= bend_gain * self._both_var
        self._both_var *= 1.0 - rad_gain
        self._rad_var *= 1.0 - rad_gain
