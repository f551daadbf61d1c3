"""The car on its learned track, scan after scan, and whether that is to be believed.

Sure is what passes every check with every scan: enough returns lie on walls and near them, the car is where it was
expected to be, nothing new stands on the track, and the way along has been seen to be right lately.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from robotd.world.clock import NS_PER_S
from robotd.world.geometry import compose
from robotd.world.messages import Float64s, LidarScan
from robotd_plugins.perception.track_position.config import TrackPositionConfig
from robotd_plugins.perception.track_position.seek import Seeker
from robotd_plugins.perception.track_position.walls import FieldWalls
from robotd_plugins.toolkit.race_track import Located, RaceTrack
from robotd_plugins.toolkit.scan_follow import Followed, ScanFollower
from robotd_plugins.toolkit.scan_match import Pose, align, prior_of
from robotd_plugins.toolkit.scan_motion import Beams, CarMotion

_CUT_M: Final = 0.4
_LOST_SHARE: Final = 0.5
_LOST_SCANS: Final = 4
_LOST: Final = 5
"""Scans that fit hardly count as so many that fit badly."""
_LONG_S: Final = 0.5
_CHUNK: Final = 80
"""Places that are tried with one scan when the whole lap is searched."""
_NEAR_M, _NEAR_SHARE = 2.0, 0.15
_FIRST_TRIES: Final = 20
_DRIFT_M: Final = 0.2
"""Where odometry has the car is not known better."""
_RIVALS_M: Final = (0.5, -0.5, 1.0, -1.0, 1.5, -1.5)
"""Places along the track that are tried, one a scan, while the place that was found is not yet proven,"""
_BETTER: Final = 0.95
"""and taken where the scan fits better by this factor,"""
_ELSEWHERE_M: Final = 0.2
"""unless that is the same place."""
_RIVAL_PRIOR: Final = prior_of(0.5, 0.3, 0.2)
_DENSE: Final = 361
_SIDE_BY_SIDE: Final = 3
_STANDS_SHARE: Final = 0.02
"""A heading that is a degree out moves a return by this share of its range."""
_STANDS_RANGE_M: Final = 8.0
_CALM_SCANS: Final = 3
_LATELY: Final = 0.2
"""Share of a new scan in the running means."""
_LIE_M: Final = 0.003


@dataclass(slots=True)
class Locator:
    """Call `take` with each new track and `step` with each new scan."""

    config: TrackPositionConfig
    track: RaceTrack | None = None
    pose: Pose | None = None
    _walls: FieldWalls | None = None
    _seeker: Seeker | None = None
    _follower: ScanFollower = field(init=False)
    _dense: Beams | None = None
    _layout: object = None
    _tries: int = 0
    _chunk: int = 0
    _searched: list[Float64s] = field(default_factory=list)
    _held: tuple[Float64s, Float64s, int] | None = None
    _proven_m: float = 0.0
    _rivals: int = 0
    _along_var: float = 0.0
    _way_m: float = 0.0
    _off_m: float = 0.0
    _bad: int = 0
    _calm: int = 0

    def __post_init__(self) -> None:
        config = self.config
        self._follower = ScanFollower(
            config.beams, config.range_max_m, config.odometry_share, config.accel_mps2, _CUT_M
        )

    def take(self, track: RaceTrack) -> None:
        """A new track: the car is looked for near where the survey ended and odometry has led it since."""
        self.track = track
        self._walls = FieldWalls(track)
        self._seeker = Seeker(track, self._walls)
        self._lose()

    def step(self, scan: LidarScan, motion: CarMotion) -> Located | None:
        """Where base is at the end of the sweep; None without a track."""
        if self.track is None or self._walls is None:
            return None
        passed_s = (scan.stamp_ns - self._follower.stamp_ns) / NS_PER_S
        if self.pose is not None and not 0.0 < passed_s < _LONG_S:
            self._lose()
        if self.pose is None:
            return self._seek(scan, motion)
        followed = self._follower.follow(scan, motion, self.pose, self._walls)
        self.pose = followed.match.pose
        reason = self._why_not(scan, followed, motion.is_measured)
        if self._rivals < len(_RIVALS_M):
            self._try_a_rival(scan, followed)
        share = followed.match.explained_share
        self._bad = 0 if share >= self.config.explained_share_min else self._bad + (_LOST if share < _LOST_SHARE else 1)
        if self._bad >= _LOST * _LOST_SCANS:
            self._lose()
            self._tries = _FIRST_TRIES
        return self._said(scan, followed.match.pose, followed.residual_m, share, reason)

    # ------------------------------------------------------------------------------------ is it true?

    def _why_not(self, scan: LidarScan, followed: Followed, measured: bool) -> str:
        """Empty where the place may be driven by."""
        config, match = self.config, followed.match
        self._along_var += followed.along_m**2
        self._along_var = 1.0 / (1.0 / self._along_var + float(match.information[0, 0]))
        self._proven_m += math.hypot(followed.moved[0], followed.moved[1])
        self._way_m += _LATELY * (followed.moved[0] - self._way_m)
        self._off_m += _LATELY * (match.moved[0] - self._off_m) if measured else 0.0
        why = self._why_not_this(scan, followed)
        # what was surprised once is not believed again at once
        self._calm = 0 if why else self._calm + 1
        if why:
            return why
        if self._calm < _CALM_SCANS:
            return "settles after a surprise"
        if self._proven_m < config.prove_m or self._rivals < len(_RIVALS_M):
            return "found, not yet proven"
        return ""

    def _why_not_this(self, scan: LidarScan, followed: Followed) -> str:
        config, match = self.config, followed.match
        share = match.explained_share
        if share < config.explained_share_min:
            return f"only {100.0 * share:.0f} % of the returns lie on walls"
        if not followed.residual_m <= config.residual_max_m:
            return f"returns lie {followed.residual_m:.2f} m off the walls"
        along, across, turn = match.moved
        limit_m, limit_rad = config.surprise_m, config.surprise_rad
        if abs(along) > limit_m + 4.0 * followed.along_m or abs(across) > limit_m + 4.0 * followed.across_m:
            return f"not where it was expected: {along:+.2f} m along, {across:+.2f} m across"
        if abs(turn) > limit_rad + 4.0 * followed.turn_rad:
            return f"turned {turn:+.2f} rad farther than expected"
        if abs(self._off_m) > config.lie_share * abs(self._way_m) + _LIE_M:
            return f"odometry tells {self._way_m:.3f} m for {self._way_m + self._off_m:.3f} m of way, scan by scan"
        if self._along_var > config.along_max_m**2:
            return f"the way along is known to {math.sqrt(self._along_var):.2f} m only"
        return self._something_stands(scan, match.pose)

    def _something_stands(self, scan: LidarScan, pose: Pose) -> str:
        """Returns side by side where the track is free."""
        if self._dense is None or self._layout is not scan.angles_rad:
            self._layout, self._dense = scan.angles_rad, Beams.of(scan, _DENSE)
        assert self._walls is not None
        x, y, seen = self._dense.points(scan, self._follower.twist, _STANDS_RANGE_M)
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        inside = self._walls.at(cos * x - sin * y + pose[0], sin * x + cos * y + pose[1])
        inside -= _STANDS_SHARE * np.abs(x)
        stands = inside > self.config.stands_m
        if np.count_nonzero(stands) < _SIDE_BY_SIDE:
            return ""
        beams = np.flatnonzero(seen)[stands]
        side_by_side = beams[_SIDE_BY_SIDE - 1 :] - beams[: 1 - _SIDE_BY_SIDE] <= _SIDE_BY_SIDE
        if not side_by_side.any():
            return ""
        first = int(np.flatnonzero(stands)[int(side_by_side.argmax())])
        return f"something stands {math.hypot(x[first], y[first]):.1f} m away that is not on the map"

    def _try_a_rival(self, scan: LidarScan, followed: Followed) -> None:
        """In a corridor a scan fits a little farther along as well; where it fits better the car is moved there."""
        assert self.pose is not None and self._walls is not None
        start = compose(self.pose, (_RIVALS_M[self._rivals], 0.0, 0.0))
        self._rivals += 1
        x, y = self._follower.points(scan, self._follower.twist)
        match = align(x, y, start, _RIVAL_PRIOR, self._walls, self._follower.sigma_m, _CUT_M, 6)
        is_better = match.cost_m(_CUT_M) < _BETTER * followed.match.cost_m(_CUT_M)
        if is_better and math.dist(match.pose[:2], self.pose[:2]) > _ELSEWHERE_M:
            self.pose, self._proven_m, self._rivals = match.pose, 0.0, 0

    # --------------------------------------------------------------------------------------- looking for it

    def _lose(self) -> None:
        self.pose, self._held = None, None
        self._tries = self._chunk = self._bad = self._calm = 0
        self._searched = []

    def _seek(self, scan: LidarScan, motion: CarMotion) -> Located:
        """Near where odometry has it; after some tries, all round the lap."""
        assert self.track is not None and self._seeker is not None
        track, seeker, sigma_m = self.track, self._seeker, max(self._follower.sigma_m, 0.04)
        moved = motion.between(self._follower.stamp_ns, scan.stamp_ns) if self._follower.stamp_ns else (0.0, 0.0, 0.0)
        passed_s = max((scan.stamp_ns - self._follower.stamp_ns) / NS_PER_S, 1e-3)
        still = passed_s > _LONG_S
        twist = (0.0, 0.0, 0.0) if still else (moved[0] / passed_s, 0.0, moved[2] / passed_s)
        self._follower.begin(scan.stamp_ns, twist)
        x, y = self._follower.points(scan, twist)
        if self._tries < _FIRST_TRIES:
            self._tries += 1
            way = motion.way_m(track.at_ns, scan.stamp_ns)
            which = seeker.beyond(track.at, way, _NEAR_M + _NEAR_SHARE * abs(way))
            drift_m = _DRIFT_M + self.config.odometry_share * abs(way)
            return self._take_best(scan, x, y, which, seeker.misfit_m(x, y, which), sigma_m, 0, motion, drift_m)
        if self._held is None:
            self._held, self._chunk, self._searched = (x, y, scan.stamp_ns), 0, []
        hx, hy, held_ns = self._held
        begin = self._chunk * _CHUNK
        which = np.arange(begin, min(begin + _CHUNK, len(seeker.places)), dtype=np.intp)
        self._searched.append(seeker.misfit_m(hx, hy, which))
        self._chunk += 1
        if begin + _CHUNK < len(seeker.places):
            return self._said(scan, (0.0, 0.0, 0.0), math.nan, 0.0, "looks for itself all round the lap")
        misfit = np.concatenate(self._searched)
        self._held = None
        return self._take_best(scan, hx, hy, np.arange(len(misfit)), misfit, sigma_m, held_ns, motion)

    def _take_best(
        self,
        scan: LidarScan,
        x: Float64s,
        y: Float64s,
        which: NDArray[np.intp],
        misfit: Float64s,
        sigma_m: float,
        seen_ns: int,
        motion: CarMotion,
        drift_m: float = math.inf,
    ) -> Located:
        """seen_ns: when the returns were seen; 0: now."""
        assert self._seeker is not None
        match = self._seeker.best(x, y, which, misfit, sigma_m, drift_m)
        if match is None or match.explained_share < self.config.explained_share_min:
            return self._said(scan, (0.0, 0.0, 0.0), math.nan, 0.0, "does not know where it is")
        since = motion.between(seen_ns, scan.stamp_ns) if seen_ns else (0.0, 0.0, 0.0)
        self.pose = compose(match.pose, since)
        self._proven_m, self._along_var, self._way_m, self._off_m, self._rivals = 0.0, 0.3**2, 0.0, 0.0, 0
        return self._said(scan, self.pose, match.residual_m, match.explained_share, "found, not yet proven")

    def _said(self, scan: LidarScan, pose: Pose, residual_m: float, share: float, reason: str) -> Located:
        assert self.track is not None
        return Located(
            scan.stamp_ns, *pose, residual_m, share, not reason, reason, self.track.version, *self._follower.twist
        )
