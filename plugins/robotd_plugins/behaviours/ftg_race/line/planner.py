"""Planning on the line: the tracked command, held to the same free space and stopping distance as any other."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from robotd.world.clock import NS_PER_S
from robotd.world.geometry import compose
from robotd.world.messages import Float64s
from robotd_plugins.behaviours.ftg_race.body import Body, swept_free_m
from robotd_plugins.behaviours.ftg_race.commanding import GRAVITY_MPS2, SpeedPolicy, steering_rad
from robotd_plugins.behaviours.ftg_race.config import FtgRaceConfig
from robotd_plugins.behaviours.ftg_race.free_space import HALF, STEP_RAD, FreeSpace
from robotd_plugins.behaviours.ftg_race.line.on_line import Ahead, Place, TrackLine
from robotd_plugins.behaviours.ftg_race.line.profile import LineLimits
from robotd_plugins.behaviours.ftg_race.line.tracker import Tracker
from robotd_plugins.behaviours.ftg_race.line.tyre_lag import TyreLag
from robotd_plugins.behaviours.ftg_race.planner_ftg import PlannerFTG
from robotd_plugins.behaviours.ftg_race.planning_types import FREE, Command, Motion, Scan

Pose = tuple[float, float, float]
_TURNED_RAD = 0.5
_JOIN_SHARE = 0.6
_PULL = 1.2
"""In so many times what a command takes to act, and no faster, the car can be brought back to its line."""
_JOIN_GRIP, _GRIP = 0.85, 1.5
"""What coming back to the line may ask of the tyres; more is not there, and the car would run wide."""
_HOLD = 0.95
"""Of the grip: it drives no faster than this holds the curvature that is asked for."""
_OVER = 1.12
_OVER_MPS = 0.3
"""So much faster than the line allows where the car is now, it is left."""
_SLOWED = 0.7
_SETTLE_S = 0.06
_NEAR_M = 0.03
"""Clearance of the real outline."""
_ARC_M, _ARC_S = 0.1, 0.12
"""On the arc that is steered, for the way until another command can act."""
_FAR_M, _FAR_S = 0.3, 0.1
_TIGHT_PM = 0.15
"""In gentler bends the disc about the middle holds the corners."""
_SLOW_MPS = 1.0
_STALE_NS = NS_PER_S // 20
_MOST_RAD = 0.12


class LinePlanner:
    """A command on the line, or the reason why there is none now. Keeps what was asked last, and how far the tyres'
    slip is behind.
    """

    def __init__(self, config: FtgRaceConfig, body: Body, policy: SpeedPolicy, planner: PlannerFTG) -> None:
        self._config, self._body, self._policy, self._planner = config, body, policy, planner
        self._space = FreeSpace()
        self._tracker = Tracker(pull_s=_PULL * config.actuation_s)
        grip = self._grip_mps2 = config.mu * GRAVITY_MPS2
        self._brake_mps2 = min(config.line_stop_share * grip, config.brake_mps2)
        self.limits = LineLimits(
            config.v_max_mps,
            config.line_lateral_share * grip,
            min(config.line_accel_share * grip, config.accel_mps2),
            min(config.line_brake_share * grip, config.brake_mps2),
            config.line_grip_share * grip,
        )
        self._understeer_rad_per_mps2 = config.understeer_rad / grip
        self._slip_rad_per_mps2 = config.rear_slip_rad / grip
        self._lag = TyreLag(config.rear_slip_rad, grip)
        self._outline = body.wider(_NEAR_M)
        self._asked: deque[tuple[int, float]] = deque(maxlen=16)
        self.place = Place(0.0, 0.0, 0.0)
        self.free_m = 0.0

    def plan(self, scan: Scan, line: TrackLine, base_track: Pose, now_ns: int, joins: bool = False) -> Command | str:
        """base_track: base at the sweep's end, seen in track. joins: the car was not on the line and must be nearer."""
        config, motion, planner = self._config, scan.motion, self._planner
        v = motion.speed_mps
        x, y = planner.points(scan)
        at = compose(compose(base_track, (self._body.middle_m, 0.0, 0.0)), planner.frame)
        late = self._lag.missing_rad(v, motion.yaw_rate_radps, now_ns, config.actuation_s)
        place = self.place = line.place(*compose(at, (0.0, late * max(v, 0.0) * config.actuation_s, late)))
        share = _JOIN_SHARE if joins else 1.0
        if abs(place.aside_m) > share * config.line_bound_m or abs(place.turned_rad) > share * _TURNED_RAD:
            return f"{place.aside_m:.2f} m and {place.turned_rad:.2f} rad off the line"
        wanted = self._tracker.speed_mps(line, place, v)
        if v > _OVER * line.speed_mps(place.s_m - v * config.actuation_s) + _OVER_MPS:
            return f"too fast for the line: {v:.1f} m/s"
        asked = self._tracker.curvature_pm(line, place, v)
        used = abs(asked) * v * v / self._grip_mps2
        if used > (_JOIN_GRIP if joins else _GRIP):
            return f"{used:.1f} of the grip to hold it"
        away2 = x * x + y * y
        ahead = line.ahead(place, config.reach_m, self._tracker.most_m, self._tracker.back_m(v))
        free = self.free_m = min(self._free_m(scan, ahead, x, y), self._swept_m(ahead, v, x, y, away2))
        short = config.stop_distance_m + max(v, 0.0) * motion.period_s
        stop = math.sqrt(2.0 * self._brake_mps2 * max(free - short, 0.0))
        if stop < _SLOWED * min(v, wanted):
            return f"free for {free:.1f} m only"
        # coming back takes more curvature than the line: no faster than the tyres can hold that
        hold = math.sqrt(_HOLD * self._grip_mps2 / max(abs(asked), 1e-3))
        wanted = min(wanted, stop, hold)
        curvature = planner.within_grip(asked, v, wanted)
        near_m = _ARC_M + _ARC_S * max(v, 0.0)
        reach_m = near_m + self._outline.front_m + self._outline.half_width_m
        near = (away2 < reach_m * reach_m).nonzero()[0]
        swept = swept_free_m(x.take(near) + self._body.middle_m, y.take(near), curvature, self._outline, near_m)
        if swept < near_m:
            return f"{swept:.1f} m to a wall on the arc that is steered"
        # no more of the motor than the tyres have left beside the bend
        wanted = min(wanted, v + _SETTLE_S * self.limits.along_mps2(curvature * v * v))
        return Command(wanted, self._steered_rad(curvature, motion, wanted, now_ns), curvature, free)

    def _steered_rad(self, curvature: float, motion: Motion, wanted: float, now_ns: int) -> float:
        """Angle of the front wheels: understeer, the load on them, and what the yaw rate shows to be missing of the
        curvature that was asked for when the command was given that acts now.
        """
        v, config = motion.speed_mps, self._config
        angle = steering_rad(curvature, v, self._body, self._understeer_rad_per_mps2)
        angle += self._load_rad(curvature, v, wanted)
        since_ns = now_ns - int(config.actuation_s * NS_PER_S)
        while len(self._asked) > 1 and self._asked[1][0] <= since_ns:
            self._asked.popleft()
        if self._asked and v > _SLOW_MPS and self._asked[0][0] >= since_ns - _STALE_NS:
            missing = self._asked[0][1] - motion.yaw_rate_radps / v
            missing *= config.line_yaw_share * self._body.wheelbase_m
            angle += min(max(missing, -_MOST_RAD), _MOST_RAD)
        self._asked.append((now_ns, curvature))
        return angle

    def _load_rad(self, curvature: float, v: float, wanted: float) -> float:
        """Speeding up takes load off the front wheels, which then must be turned farther; braking puts it there.

        With slip angles proportional to force over load the understeer gradient is linear in the acceleration along
        the car, to first order (Gillespie, Fundamentals of Vehicle Dynamics, 1992, chapter 6).
        """
        room = self.limits.along_mps2(curvature * v * v)
        along = min(
            max((wanted - v) / _SETTLE_S, -min(self.limits.brake_mps2, room)), min(self.limits.accel_mps2, room)
        )
        grip = self._grip_mps2
        return self._config.load_shift_rad * along * curvature * v * v / (grip * grip)

    def _free_m(self, scan: Scan, ahead: Ahead, x: Float64s, y: Float64s) -> float:
        """How far the line is free in this scan."""
        config = self._config
        reach_m = self._body.half_width_m + config.line_clear_m
        profile = self._space.profile(x, y, scan.state != FREE, reach_m, config.reach_m, scan.step_rad)
        index = np.rint(np.arctan2(ahead.y_m, ahead.x_m) * (1.0 / STEP_RAD)).astype(np.intp)
        seen = profile.take(index + HALF, mode="clip")
        blocked = seen * seen <= ahead.x_m * ahead.x_m + ahead.y_m * ahead.y_m
        blocked |= np.abs(index) > HALF
        first = int(blocked.argmax())
        return float(ahead.way_m[first]) if blocked[first] else config.reach_m

    def _swept_m(self, ahead: Ahead, v: float, x: Float64s, y: Float64s, away2: Float64s) -> float:
        """How far the real outline goes along the line, turned as tyres that slip turn it; in bends, as far as it needs
        to stop.
        """
        far = _FAR_M + max(v, 0.0) * _FAR_S + v * v / (2.0 * self._brake_mps2)
        size = np.abs(ahead.curvature_pm)
        tight = ((size > _TIGHT_PM) & (ahead.way_m < far)).nonzero()[0]
        reach_m = far + self._body.front_m
        close = (away2 < reach_m * reach_m).nonzero()[0]
        if not len(tight) or not len(close):
            return self._config.reach_m
        # no bend ahead is driven faster than its grip allows
        slip = self._slip_rad_per_mps2 * np.minimum(v * v, self.limits.lateral_mps2 / size.take(tight))
        heading = ahead.turned_rad.take(tight) - ahead.curvature_pm.take(tight) * (self._body.middle_m - slip)
        cos, sin = np.cos(heading), np.sin(heading)
        px, py = ahead.x_m.take(tight), ahead.y_m.take(tight)
        # returns (2, n) as each place of the car (k, 2, 2) sees them
        turn, points = np.empty((len(tight), 2, 2)), np.empty((2, len(close)))
        turn[:, 0, 0] = turn[:, 1, 1] = cos
        turn[:, 0, 1] = sin
        np.negative(sin, out=turn[:, 1, 0])
        x.take(close, out=points[0])
        y.take(close, out=points[1])
        seen: Float64s = turn @ points
        seen[:, 0] -= (cos * px + sin * py)[:, None]
        seen[:, 1] -= (cos * py - sin * px)[:, None]
        np.abs(seen, out=seen)
        outline = self._outline
        touched = seen[:, 0] < (outline.front_m - outline.rear_m) / 2.0
        touched &= seen[:, 1] < outline.half_width_m
        hit = np.logical_or.reduce(touched, axis=1)
        first = int(hit.argmax())
        return float(ahead.way_m[tight[first]]) if hit[first] else self._config.reach_m
