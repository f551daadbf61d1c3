"""Scan-matched odometry: each scan is laid on the newest key frame, from where wheels or commands say the car is."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from robotd.world.clock import NS_PER_S
from robotd.world.geometry import compose
from robotd.world.messages import Float64s, LidarScan
from robotd_plugins.perception.track_survey.config import TrackSurveyConfig
from robotd_plugins.perception.track_survey.key_frame import KeyFrame, key_frame
from robotd_plugins.toolkit.scan_follow import ScanFollower
from robotd_plugins.toolkit.scan_match import Match, Pose
from robotd_plugins.toolkit.scan_motion import Beams, CarMotion

_CUT_M: Final = 0.35
_KEEP_EXPLAINED: Final = 0.75
"""Below this share a new key frame is made at once: the old one does not show enough of what is seen now."""
_LOST_EXPLAINED: Final = 0.5
_KEY_AT_LEAST_M: Final = 0.1
_LONG_S: Final = 0.5
_ALL: Final = 1440


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
        self._follower = ScanFollower(
            config.beams, config.range_max_m, config.odometry_share, config.accel_mps2, _CUT_M
        )
        self._all: Beams | None = None
        self._layout: object = None
        self.key: Key | None = None
        self.pose_key: Pose = (0.0, 0.0, 0.0)
        """Base now, seen in base at the newest key frame."""
        self.match: Match | None = None
        self.is_new_key = False
        """Whether the newest scan became a key frame."""
        self.passed_ns = 0
        """Between the last two scans."""

    @property
    def pose(self) -> Pose:
        """Base now, seen in base at the first key frame."""
        return compose(self.key.pose, self.pose_key) if self.key is not None else self.pose_key

    @property
    def sigma_m(self) -> float:
        """How far returns lie from their walls."""
        return self._follower.sigma_m

    def follow(self, scan: LidarScan, motion: CarMotion) -> bool:
        """Takes a scan in; False where it has lost itself, and the next scan begins anew."""
        self.is_new_key = False
        self.passed_ns = scan.stamp_ns - self._follower.stamp_ns
        if self.key is None or not 0 < self.passed_ns < _LONG_S * NS_PER_S:
            lost = self.key is not None
            self._begin(scan)
            return not lost
        key = self.key
        match = self.match = self._follower.follow(scan, motion, self.pose_key, key.frame).match
        explained = match.explained_share
        if explained < _LOST_EXPLAINED:
            self.key = None
            return False
        self.pose_key = match.pose
        away = math.hypot(match.pose[0], match.pose[1])
        far = away > self._config.key_m or abs(match.pose[2]) > self._config.key_turn_rad
        if far or (explained < _KEEP_EXPLAINED and away > _KEY_AT_LEAST_M):
            self._new_key(scan, key)
        return True

    def points(self, scan: LidarScan, most_m: float) -> tuple[Float64s, Float64s]:
        """All returns of the newest scan nearer than `most_m`, x and y in base at its end."""
        if self._all is None or self._layout is not scan.angles_rad:
            self._layout, self._all = scan.angles_rad, Beams.of(scan, _ALL)
        x, y, _ = self._all.points(scan, self._follower.twist, most_m)
        return x, y

    def _begin(self, scan: LidarScan) -> None:
        self._follower.begin(scan.stamp_ns)
        self.pose_key = (0.0, 0.0, 0.0)
        self.key = Key(scan.stamp_ns, (0.0, 0.0, 0.0), self._frame(scan), 0.0, 0.0)
        self.is_new_key = True

    def _new_key(self, scan: LidarScan, key: Key) -> None:
        way = key.way_m + math.copysign(math.hypot(self.pose_key[0], self.pose_key[1]), self.pose_key[0])
        self.key = Key(scan.stamp_ns, self.pose, self._frame(scan), way, key.turned_rad + self.pose_key[2])
        self.pose_key = (0.0, 0.0, 0.0)
        self.is_new_key = True

    def _frame(self, scan: LidarScan) -> KeyFrame:
        # walls a little beyond what is looked at, for when the car has come nearer
        return key_frame(*self.points(scan, self._config.range_max_m + 2.0), scan.x_m, scan.y_m)
