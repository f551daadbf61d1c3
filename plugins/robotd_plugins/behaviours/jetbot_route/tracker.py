"""What looks and odometry have told about the line so far: where it is, crossings and ends on it, metres travelled."""

from __future__ import annotations

import math
from collections.abc import Callable

from robotd import Drive, Odometry
from robotd_plugins.behaviours.jetbot_route.config import JetBotRouteConfig
from robotd_plugins.behaviours.jetbot_route.course import Course
from robotd_plugins.behaviours.jetbot_route.evidence import Place, Votes
from robotd_plugins.behaviours.jetbot_route.steer import LineAhead, curvature_pm, drive, learned_drift_pm, line_ahead
from robotd_plugins.toolkit.line_seen import LineSeen

_SIGHT_M = (0.18, 0.30)
"""Where a crossing or an end is seen in every picture, ahead of the axle."""
_ODOMETRY_JUMP_M = 0.5
_AIMED_RAD = 0.05


def _always(_: float) -> bool:
    return True


class Tracker:
    """The memory of one drive along lines. All `_m` readings are of its own odometer, `travelled_m`.

    mapped: a map confirms where crossings and ends are, so that one which was believed is held on to.
    """

    def __init__(self, config: JetBotRouteConfig, course: Course, *, mapped: bool = False) -> None:
        k, n = config.confirm_frames, config.of_frames
        self.config = config
        self.course = course
        self.line = Votes(k, n)
        self.crossing = Place(k, n, config.place_tolerance_m, _SIGHT_M, holds=mapped)
        self.end = Place(k, n, config.place_tolerance_m, _SIGHT_M, holds=mapped)
        self.odometry: Odometry | None = None
        self.travelled_m = 0.0
        self.turned_rad = 0.0
        """Sum of all turns by odometry, without wrap."""
        self.seen_m = 0.0
        """Where a line was last seen that agreed."""
        self.ahead: LineAhead | None = None
        self.both = False
        """Whether the last look showed an agreeing line in both regions."""
        self.last_left_m = 0.0
        """How far to the left of the axle the line was when it was last seen."""
        self.left_m = 0.0
        """How far to the left it should be now, by odometry since then."""
        self.drift_pm = 0.0
        self._driven_m = 0.0

    @property
    def unseen_m(self) -> float:
        """Travel since a line was last seen."""
        return self.travelled_m - self.seen_m

    def travel(self, odometry: Odometry) -> None:
        """Take in where the wheels are now."""
        before, self.odometry, self._driven_m = self.odometry, odometry, 0.0
        if before is None:
            self.course.begin(odometry.yaw_rad)
            return
        self.turned_rad += math.remainder(odometry.yaw_rad - before.yaw_rad, math.tau)
        x_m, y_m = odometry.x_m - before.x_m, odometry.y_m - before.y_m
        step_m = x_m * math.cos(odometry.yaw_rad) + y_m * math.sin(odometry.yaw_rad)
        if abs(step_m) < _ODOMETRY_JUMP_M:
            # a larger step is a base that began to count anew
            self.travelled_m += step_m
            self._driven_m = step_m
            self.course.travel(step_m)
            self.left_m += step_m * math.sin(self.course.rad - odometry.yaw_rad)

    def look(
        self,
        line: LineSeen,
        agrees: Callable[[LineAhead, float], bool],
        *,
        steady: bool,
        crossing_counts: Callable[[float], bool] = _always,
        end_counts: Callable[[float], bool] = _always,
    ) -> None:
        """Take in one picture.

        agrees: whether a line ahead may be the one that is followed, given the course in base. steady: the robot
        follows the line, so that what stays of its error is a pull of its wheels. crossing_counts, end_counts: whether
        one may be at an odometer reading.
        """
        odometry, config = self.odometry, self.config
        assert odometry is not None
        age_s = (odometry.stamp_ns - line.stamp_ns) / 1e9
        yaw_rad = odometry.yaw_rad - odometry.wz_radps * age_s
        at_m = self.travelled_m - odometry.vx_mps * age_s
        course_rad = math.remainder(self.course.rad - yaw_rad, math.tau)
        ahead = line_ahead(line, course_rad, config.picture_half_width_m)
        if ahead is not None and not agrees(ahead, course_rad):
            ahead = None
        self.ahead = ahead
        self.both = ahead is not None and line.near.is_seen and line.far.is_seen
        self.line.cast(self.both)
        if ahead is not None:
            self.seen_m = self.travelled_m
            self.last_left_m = self.left_m = ahead.left_m
            if self.both:
                self.course.see(yaw_rad + ahead.heading_rad)
                if steady:
                    self.drift_pm = learned_drift_pm(self.drift_pm, ahead, self._driven_m, config)
        bar, end = line.bar, line.end
        if bar is not None and not crossing_counts(at_m + bar.ahead_m):
            bar = None
        if end is not None and not end_counts(at_m + end.ahead_m):
            end = None
        self.crossing.look(at_m, bar.ahead_m if bar is not None else None, bar.straight if bar is not None else None)
        self.end.look(at_m, end.ahead_m if end is not None else None)

    def along(self, speed_mps: float) -> Drive:
        """The command that follows the line, or holds the course, slowly, where none is seen."""
        config, ahead = self.config, self.ahead
        assert self.odometry is not None
        if ahead is None:
            # keep the direction, without a word about the place
            off_rad = math.remainder(self.course.rad - self.odometry.yaw_rad, math.tau)
            ahead, speed_mps = LineAhead(0.0, off_rad), min(speed_mps, config.slow_speed_mps)
        curvature = curvature_pm(ahead, config) + self.drift_pm + self.course.bend_pm
        return drive(speed_mps, curvature, config)


class Search:
    """Looking about on the spot: first to the side where the line was last, then to the other, then back."""

    def __init__(self) -> None:
        self._aims: list[float] = []
        self.ended = False
        """Both sides were looked at."""

    @property
    def begun(self) -> bool:
        """Whether it is looking about."""
        return bool(self._aims)

    def command(self, tracker: Tracker) -> Drive:
        """The next turn; stands still once both sides were looked at."""
        config, odometry = tracker.config, tracker.odometry
        assert odometry is not None
        if not self._aims:
            first = math.copysign(config.search_rad, tracker.last_left_m)
            self._aims = [first, -first, 0.0]
        off_rad = math.remainder(tracker.course.rad + self._aims[0] - odometry.yaw_rad, math.tau)
        if abs(off_rad) < _AIMED_RAD:
            self._aims.pop(0)
            if not self._aims:
                self.ended = True
                return Drive()
            off_rad = math.remainder(tracker.course.rad + self._aims[0] - odometry.yaw_rad, math.tau)
        return Drive(wz_radps=math.copysign(config.turn_speed_radps, off_rad))
