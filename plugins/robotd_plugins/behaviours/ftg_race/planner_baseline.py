"""The rule before follow-the-gap (the seed's `Process`), to compare with: away from the nearest return."""

from __future__ import annotations

import math

from robotd.authoring.explain import Explanation, Line, Scalar
from robotd_plugins.behaviours.ftg_race.body import Body
from robotd_plugins.behaviours.ftg_race.commanding import SpeedPolicy
from robotd_plugins.behaviours.ftg_race.config import FtgRaceConfig
from robotd_plugins.behaviours.ftg_race.gap import front_min_m
from robotd_plugins.behaviours.ftg_race.planning_types import Command, Scan

_NEAR_M = 1.0


class PlannerBaseline:
    """Steers away from the nearest return within the field of view, the harder the nearer it is."""

    def __init__(self, config: FtgRaceConfig, body: Body, policy: SpeedPolicy) -> None:
        self._config, self._body, self._policy = config, body, policy
        self._nearest = (0.0, math.inf)

    def plan(self, scan: Scan) -> Command:
        at = int(scan.ranges_m.argmin())
        bearing, nearest = float(scan.bearing_rad[at]), float(scan.ranges_m[at])
        farthest = float(scan.ranges_m.max())
        self._nearest = (bearing, nearest)
        share = min(max(1.0 - nearest / _NEAR_M, 0.0), 1.0)
        steering = -math.copysign(share * self._body.max_steering_rad, bearing) if bearing else 0.0
        front = front_min_m(scan.bearing_rad, scan.ranges_m, self._config.front_sector_rad)
        speed = self._policy.by_gains(farthest, front, steering)
        return Command(speed, steering, math.tan(steering) / self._body.wheelbase_m, front, speed <= 0.0)

    def explain(self) -> Explanation:
        bearing, nearest = self._nearest
        if not math.isfinite(nearest):
            return ()
        end = (nearest * math.cos(bearing), nearest * math.sin(bearing))
        return Line("nearest", (0.0, 0.0), end), Scalar("nearest", nearest, "m")
