"""Asks the configured lidar strategy about each scan, and keeps where it saw a crossing."""

from __future__ import annotations

import math

from robotd import LidarScan
from robotd_plugins.behaviours.jetbot_route.config import JetBotRouteConfig
from robotd_plugins.behaviours.jetbot_route.intersection_cues import (
    IntersectionDetector,
    OpenSpaceDetector,
    SimpleOppositeDetector,
)


class LidarEar:
    """The newest crossing that the lidar saw, by the odometer; without a strategy it never says anything."""

    def __init__(self, config: JetBotRouteConfig) -> None:
        self._detector: IntersectionDetector | None = None
        if config.lidar == SimpleOppositeDetector.name:
            self._detector = SimpleOppositeDetector(config.opposite_markers)
        elif config.lidar == OpenSpaceDetector.name:
            self._detector = OpenSpaceDetector(config.open_space)
        self.said = "not asked"
        """The newest answer, for people."""
        self.at_m = math.nan
        """Odometer reading over the crossing that was last seen; nan: none since `clear`."""
        self._heard_ns = -1

    def listen(self, scan: LidarScan, travelled_m: float) -> float:
        """One scan, once: the odometer reading over the crossing that it shows; nan: none, or heard before."""
        if self._detector is None or scan.stamp_ns == self._heard_ns:
            return math.nan
        self._heard_ns = scan.stamp_ns
        cue = self._detector.look(scan)
        self.said = cue.reason
        if not cue.seen:
            return math.nan
        # two markers lie on both sides of the crossing's middle
        marks = [sight for sight in cue.evidence if sight.what == "marker"]
        ahead_m = sum(mark.range_m * math.cos(mark.bearing_rad) for mark in marks) / max(len(marks), 1)
        self.at_m = travelled_m + ahead_m
        return self.at_m

    def clear(self) -> None:
        """Forget the crossing."""
        self.at_m = math.nan
