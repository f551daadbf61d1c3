"""When the car stands before a wall: back off with a look behind, on the arc that turns its nose to the freer side."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from robotd.world.messages import Float64s
from robotd_plugins.behaviours.ftg_race.body import Body, swept_free_m
from robotd_plugins.behaviours.ftg_race.config import FtgRaceConfig
from robotd_plugins.behaviours.ftg_race.planning_types import FREE, Command, Scan

_SEEN_RAD = 2.7
"""Behind this bearing a lidar must see to look straight back."""
_REAR_MARGINS_M = (0.04, 0.015, 0.0)
_FREE_AGAIN_M = 0.7
_NEW_PLACE_M = 1.5
_STILL_MPS = 0.08


class State(Enum):
    """What the car is doing."""

    RACE = "race"
    STUCK = "stuck"
    """Stands with nothing free ahead, until it is sure."""
    REVERSE = "reverse"
    FAILED = "failed"


@dataclass(slots=True)
class Recovery:
    """RACE -> STUCK -> REVERSE -> RACE. After `retries` in one place: FAILED.

    Without a lidar that sees behind, it goes back no farther than `reverse_blind_m` at a time.
    """

    config: FtgRaceConfig
    body: Body
    state: State = State.RACE
    _stood_s: float = 0.0
    _backed_m: float = 0.0
    _since_m: float = 0.0
    _tries: int = 0
    _curvature_pm: float = 0.0

    def step(self, scan: Scan, command: Command) -> Command:
        """The command that is carried out in place of the planner's."""
        motion = scan.motion
        way = abs(motion.speed_mps) * motion.period_s
        if self.state is State.REVERSE:
            self._backed_m += way
            return self._reverse(scan, command)
        self._since_m += way
        if self._since_m > _NEW_PLACE_M:
            self._tries = 0
        stands = command.is_blocked and abs(motion.speed_mps) < _STILL_MPS
        if not stands:
            self.state, self._stood_s = State.RACE, 0.0
            return command
        self._stood_s += motion.period_s
        self.state = State.STUCK
        if not self.config.recover or not self.config.can_reverse or self._stood_s < self.config.stuck_s:
            return command
        if self._tries >= self.config.retries:
            self.state = State.FAILED
            return command
        self._tries += 1
        self._stood_s = self._backed_m = self._since_m = 0.0
        self.state = State.REVERSE
        self._curvature_pm = self._way_out(scan)
        return self._reverse(scan, command)

    def _reverse(self, scan: Scan, command: Command) -> Command:
        free = self._behind_m(scan, self._curvature_pm)
        most = self.config.reverse_m
        if float(np.abs(scan.bearing_rad).max()) < _SEEN_RAD:
            most = min(most, self.config.reverse_blind_m)
        left = min(free, most - self._backed_m)
        done = not command.is_blocked and command.free_m > _FREE_AGAIN_M and self._backed_m > 0.1
        if done or left < 0.03:
            self.state, self._since_m, self._stood_s = State.RACE, 0.0, 0.0
            # stands for one step, so that the motor controller changes direction from rest
            return Command(0.0, 0.0, 0.0, command.free_m, is_blocked=True)
        # what brakes at 2 m/s^2 stops in time; a stop passes the limiters anyway
        speed = min(self.config.reverse_mps, max(0.15, (2.0 * 2.0 * max(left - 0.03, 0.0)) ** 0.5))
        angle = float(np.arctan(self.body.wheelbase_m * self._curvature_pm))
        return Command(-speed, angle, self._curvature_pm, left)

    def _way_out(self, scan: Scan) -> float:
        """Curvature to back off with: the nose turns to the freer side, unless the tail has no room for that."""
        ahead = np.abs(scan.bearing_rad) < 1.9
        left = float(scan.ranges_m[ahead & (scan.bearing_rad > 0.2)].mean())
        right = float(scan.ranges_m[ahead & (scan.bearing_rad < -0.2)].mean())
        tight = 0.95 * np.tan(self.body.max_steering_rad) / self.body.wheelbase_m
        # backwards with the wheels to the right the nose goes to the left
        wanted = -tight if left >= right else tight
        rooms = [(self._behind_m(scan, k), k) for k in (wanted, 0.0, -wanted)]
        if rooms[0][0] > 0.15:
            return float(wanted)
        return float(max(rooms)[1])

    def _behind_m(self, scan: Scan, curvature: float) -> float:
        x, y = points_base(scan)
        # beside a wall that is nearer than the margin the car may still move along it and away
        for margin in _REAR_MARGINS_M:
            free = swept_free_m(x, y, curvature, self.body.wider(margin), 1.0, back=True)
            if free > 0.0:
                break
        return free


def points_base(scan: Scan) -> tuple[Float64s, Float64s]:
    """Returns in base, as they were at the sweep's end."""
    hit = scan.state != FREE
    return scan.ranges_m[hit] * scan.unit[0, hit] + scan.x_m, scan.ranges_m[hit] * scan.unit[1, hit] + scan.y_m
