"""Scan-matched odometry: each scan is laid on the newest key frame, from where wheels or commands say the car is."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from robotd.world.clock import NS_PER_S
from robotd.world.geometry import compose, inverse
from robotd.world.messages import Float64s, LidarScan
from robotd_plugins.perception.track_survey.config import TrackSurveyConfig
from robotd_plugins.perception.track_survey.key_frame import KeyFrame, key_frame
from robotd_plugins.toolkit.scan_match import Match, Pose, align, prior_of
from robotd_plugins.toolkit.scan_motion import Beams, CarMotion, twist_of

SIGMA_MIN_M: Final = 0.02
SIGMA_MAX_M: Final = 0.08
_CUT_M: Final = 0.35
_KEEP_EXPLAINED: Final = 0.75
"""Below this share a new key frame is made at once: the old one does not show enough of what is seen now."""
_LONG_S: Final = 0.5
_REDO_M: Final = 0.01
_ALL: Final = 1440
Twist = tuple[float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Key:
    """A scan that others are laid on. pose: of base, by odometry. way_m, turned_rad: since the beginning."""

    stamp_ns: int
    pose: Pose
    frame: KeyFrame
    way_m: float
    turned_rad: float


class ScanOdometry:
    """Call `follow` with each new scan."""

    def __init__(self, config: TrackSurveyConfig) -> None:
        self._config = config
        self._beams: Beams | None = None
        self._all: Beams | None = None
        self._layout: object = None
        self.key: Key | None = None
        self.pose_key: Pose = (0.0, 0.0, 0.0)
        """Base now, seen in base at the newest key frame."""
        self.twist: Twist = (0.0, 0.0, 0.0)
        self.sigma_m = 0.04
        self.match: Match | None = None
        self.is_new_key = False
        self.passed_ns = 0
        self._stamp_ns = 0

    @property
    def pose(self) -> Pose:
        """Base now, seen in base at the first key frame."""
        return compose(self.key.pose, self.pose_key) if self.key is not None else self.pose_key

    def follow(self, scan: LidarScan, motion: CarMotion) -> bool:
        """Takes a scan in; False where it has lost itself, and the next scan begins anew."""
        self.is_new_key = False
        self.passed_ns = scan.stamp_ns - self._stamp_ns
        passed_s = self.passed_ns / NS_PER_S
        since_ns, self._stamp_ns = self._stamp_ns, scan.stamp_ns
        if self._layout is not scan.angles_rad:
            self._layout = scan.angles_rad
            self._beams, self._all = Beams.of(scan, self._config.beams), Beams.of(scan, _ALL)
        if self.key is None or not 0.0 < passed_s < _LONG_S:
            lost = self.key is not None
            self._begin(scan)
            return not lost
        moved = self._expected(motion.between(since_ns, scan.stamp_ns), passed_s, motion.is_measured)
        match = self._lay(scan, moved, passed_s, motion.is_measured)
        self.match = match
        explained = match.explained_share
        if explained < 0.5:
            self.key = None
            return False
        self._learn_sigma(match)
        key, pose = self.key, match.pose
        self.pose_key = pose
        away = math.hypot(pose[0], pose[1])
        far = away > self._config.key_m or abs(pose[2]) > self._config.key_turn_rad
        if far or (explained < _KEEP_EXPLAINED and away > 0.1):
            self._new_key(scan, key)
        return True

    def points(self, scan: LidarScan, most_m: float) -> tuple[Float64s, Float64s]:
        """All returns of the newest scan nearer than `most_m`, x and y in base at its end."""
        assert self._all is not None
        x, y, _ = self._all.points(scan, self.twist, most_m)
        return x, y

    def _begin(self, scan: LidarScan) -> None:
        self.twist, self.pose_key = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        self.key = Key(scan.stamp_ns, (0.0, 0.0, 0.0), self._frame(scan), 0.0, 0.0)
        self.is_new_key = True

    def _new_key(self, scan: LidarScan, key: Key) -> None:
        way = key.way_m + math.copysign(math.hypot(self.pose_key[0], self.pose_key[1]), self.pose_key[0])
        self.key = Key(scan.stamp_ns, self.pose, self._frame(scan), way, key.turned_rad + self.pose_key[2])
        self.pose_key = (0.0, 0.0, 0.0)
        self.is_new_key = True

    def _frame(self, scan: LidarScan) -> KeyFrame:
        assert self._all is not None
        x, y, _ = self._all.points(scan, self.twist, self._config.range_max_m + 2.0)
        return key_frame(x, y, scan.x_m, scan.y_m)

    def _expected(self, told: Pose, passed_s: float, measured: bool) -> Pose:
        """Base now, seen in base at the last scan. What is told knows no side slip: that is as it was."""
        vx, vy, wz = twist_of(told, passed_s)
        if not measured:
            # what was commanded, as far as the car can have followed it since the last match
            most = self._config.accel_mps2 * passed_s
            vx = self.twist[0] + min(max(vx - self.twist[0], -most), most)
        vy = 0.5 * self.twist[1]
        turn = wz * passed_s
        cos, sin = math.cos(0.5 * turn), math.sin(0.5 * turn)
        return passed_s * (vx * cos - vy * sin), passed_s * (vx * sin + vy * cos), turn

    def _lay(self, scan: LidarScan, moved: Pose, passed_s: float, measured: bool) -> Match:
        config = self._config
        assert self._beams is not None and self.key is not None
        way, turn = math.hypot(moved[0], moved[1]), abs(moved[2])
        if measured:
            prior = prior_of(0.004 + config.odometry_share * way, 0.006 + 0.1 * way, 0.006 + 0.1 * turn)
        else:
            along = 0.01 + 0.5 * config.accel_mps2 * passed_s * passed_s
            prior = prior_of(along, 0.01 + 0.12 * way, 0.02 + 0.8 * passed_s + 0.2 * turn)
        expected, before = compose(self.pose_key, moved), self.pose_key
        twist = twist_of(moved, passed_s)
        x, y, _ = self._beams.points(scan, twist, config.range_max_m)
        match = align(x, y, expected, prior, self.key.frame, self.sigma_m, _CUT_M)
        self.twist = twist_of(compose(inverse(before), match.pose), passed_s)
        if scan.start_ns and scan.start_ns < scan.stamp_ns:
            # a sweep was put to one instant with the expected motion; once more with the motion that came out
            off = math.hypot(match.moved[0], match.moved[1]) + 3.0 * abs(match.moved[2])
            if off > _REDO_M:
                x, y, _ = self._beams.points(scan, self.twist, config.range_max_m)
                match = align(x, y, expected, prior, self.key.frame, self.sigma_m, _CUT_M, 4)
                self.twist = twist_of(compose(inverse(before), match.pose), passed_s)
        return match

    def _learn_sigma(self, match: Match) -> None:
        spread = match.residual_m
        if math.isfinite(spread):
            sigma = self.sigma_m + 0.1 * (1.3 * spread - self.sigma_m)
            self.sigma_m = min(max(sigma, SIGMA_MIN_M), SIGMA_MAX_M)
