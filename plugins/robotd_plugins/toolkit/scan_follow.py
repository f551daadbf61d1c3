"""Scan after scan on walls: where the car should be now, how sure that is, and where the scan says that it is."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from robotd.world.clock import NS_PER_S
from robotd.world.geometry import compose, inverse
from robotd.world.messages import Float64s, LidarScan
from robotd_plugins.toolkit.scan_match import Match, Pose, Walls, align, prior_of
from robotd_plugins.toolkit.scan_motion import Beams, CarMotion, twist_of

SIGMA_MIN_M: Final = 0.02
SIGMA_MAX_M: Final = 0.08
_SIGMA_FIRST_M: Final = 0.04
_REDO_M: Final = 0.01
Twist = tuple[float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """One scan's match. moved: base at the scan, seen in base at the one before, as it was expected.

    along_m, across_m, turn_rad: standard deviations of that. residual_m: see `Match`.
    """

    match: Match
    residual_m: float
    moved: Pose
    along_m: float
    across_m: float
    turn_rad: float


class ScanFollower:
    """Keeps the car's velocity and the returns' spread from scan to scan.

    odometry_share: standard deviation of the way that wheels tell, as a share of it. accel_mps2: where nothing is
    measured, the car's speed changes no faster. cut_m: returns farther from a wall than this have no say.
    """

    def __init__(self, beams: int, range_max_m: float, odometry_share: float, accel_mps2: float, cut_m: float) -> None:
        self._count, self._range_max_m, self._cut_m = beams, range_max_m, cut_m
        self._odometry_share, self._accel_mps2 = odometry_share, accel_mps2
        self._beams: Beams | None = None
        self._layout: object = None
        self.stamp_ns = 0
        """Of the newest scan."""
        self.twist: Twist = (0.0, 0.0, 0.0)
        """vx, vy, wz of base between the last two scans."""
        self.sigma_m = _SIGMA_FIRST_M
        """How far returns lie from their walls."""

    def begin(self, stamp_ns: int, twist: Twist = (0.0, 0.0, 0.0)) -> None:
        """From this scan on, which stands where the caller says."""
        self.stamp_ns, self.twist = stamp_ns, twist

    def points(self, scan: LidarScan, twist: Twist) -> tuple[Float64s, Float64s]:
        """Some returns of a scan, x and y in base at the end of its sweep."""
        if self._beams is None or self._layout is not scan.angles_rad:
            self._layout, self._beams = scan.angles_rad, Beams.of(scan, self._count)
        x, y, _ = self._beams.points(scan, twist, self._range_max_m)
        return x, y

    def follow(self, scan: LidarScan, motion: CarMotion, pose: Pose, walls: Walls) -> Followed:
        """Lays a scan on walls. pose: of base at the last scan, in the walls' frame."""
        passed_s = (scan.stamp_ns - self.stamp_ns) / NS_PER_S
        moved = self._expected(motion.between(self.stamp_ns, scan.stamp_ns), passed_s, motion.is_measured)
        way, turn = math.hypot(moved[0], moved[1]), abs(moved[2])
        if motion.is_measured:
            along, across, turned = 0.004 + self._odometry_share * way, 0.006 + 0.1 * way, 0.006 + 0.1 * turn
        else:
            along = 0.01 + 0.5 * self._accel_mps2 * passed_s * passed_s
            across, turned = 0.01 + 0.12 * way, 0.02 + 0.8 * passed_s + 0.2 * turn
        prior = prior_of(along, across, turned)
        expected = compose(pose, moved)
        x, y = self.points(scan, twist_of(moved, passed_s))
        match = align(x, y, expected, prior, walls, self.sigma_m, self._cut_m)
        self.twist = twist_of(compose(inverse(pose), match.pose), passed_s)
        is_sweep = 0 < scan.start_ns < scan.stamp_ns
        if is_sweep and math.hypot(match.moved[0], match.moved[1]) + 3.0 * abs(match.moved[2]) > _REDO_M:
            # it was put to one instant with the expected motion; once more with the motion that came out
            x, y = self.points(scan, self.twist)
            match = align(x, y, expected, prior, walls, self.sigma_m, self._cut_m, 4)
            self.twist = twist_of(compose(inverse(pose), match.pose), passed_s)
        self.stamp_ns = scan.stamp_ns
        residual_m = match.residual_m
        if math.isfinite(residual_m):
            sigma = self.sigma_m + 0.1 * (1.3 * residual_m - self.sigma_m)
            self.sigma_m = min(max(sigma, SIGMA_MIN_M), SIGMA_MAX_M)
        return Followed(match, residual_m, moved, along, across, turned)

    def _expected(self, told: Pose, passed_s: float, measured: bool) -> Pose:
        """Base now, seen in base at the last scan. What is told knows no side slip: that is half as it was."""
        vx, vy, wz = twist_of(told, passed_s)
        if not measured:
            # what was commanded, as far as the car can have followed it since the last match
            most = self._accel_mps2 * passed_s
            vx = self.twist[0] + min(max(vx - self.twist[0], -most), most)
        vy = 0.5 * self.twist[1]
        turn = wz * passed_s
        cos, sin = math.cos(0.5 * turn), math.sin(0.5 * turn)
        return passed_s * (vx * cos - vy * sin), passed_s * (vx * sin + vy * cos), turn
