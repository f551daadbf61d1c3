"""The survey of a lap: key frames as they are driven, and the search for the beginning when the lap comes round.

A track that does not cross itself turns the car once round, so the beginning is looked for only after a whole turn and
near where odometry has it. Of two key frames that may show one place, the later is laid on the earlier one from several
places along the track, one of them a scan, so that no turn of the loop pays for the whole search.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from robotd.world.geometry import compose, inverse
from robotd.world.messages import Float32s, LidarScan
from robotd_plugins.perception.track_survey.config import TrackSurveyConfig
from robotd_plugins.perception.track_survey.odometry import Key, ScanOdometry
from robotd_plugins.toolkit.race_track import TrackSurvey
from robotd_plugins.toolkit.scan_match import Pose, align, prior_of
from robotd_plugins.toolkit.scan_motion import CarMotion

_FIRST_KEYS: Final = 12
"""The lap may be closed over any of so many keys."""
_WHOLE_TURN_RAD: Final = (math.tau - 1.0, math.tau + 1.0)
"""A lap has turned the car by 2 pi, give or take drift and heading."""
_SAME_HEADING_RAD: Final = 0.5
_STEP_M: Final = 0.5
_CUT_M: Final = 0.5
_BACK_M: Final = 0.5
"""A car that has gone back farther than this leaves a path that cannot be driven: the survey begins anew."""
_CLOSE_POINTS: Final = 120
_ASIDE_M: Final = 0.6
_AGREE_M: Final = 0.25
_ALONE: Final = 0.05
"""What a place that only one late key tells is worth less than one that many tell."""
_TRIES: Final = 5
_TRY_NS: Final = 8_000_000
"""One try for so much time between scans, at most `_TRIES`."""


@dataclass(frozen=True, slots=True)
class Closing:
    """Key `late` seen in base of key `early`; odometry has missed it by so much."""

    early: int
    late: int
    pose: Pose
    score: float
    along_m: float
    """How far odometry has missed it along the track."""
    residual_m: float
    residual_rad: float


@dataclass(slots=True)
class Survey:
    """Call `step` with each new scan; after a survey was given out, `begin` starts another."""

    config: TrackSurveyConfig
    odometry: ScanOdometry = field(init=False)
    keys: list[Key] = field(default_factory=list)
    points: list[Float32s] = field(default_factory=list)
    closing: Closing | None = None
    why: str = "waits for the first scan"
    _queue: deque[tuple[int, int, Pose]] = field(default_factory=deque)
    _found: list[Closing] = field(default_factory=list)
    _look_from_m: float | None = None
    attempt: int = 0
    """How many surveys were given out since the caller set it to 0."""
    _number: int = 0
    _farthest_m: float = 0.0

    def __post_init__(self) -> None:
        self.begin()

    def begin(self, why: str = "a new survey") -> None:
        """Forgets all but how many surveys there were."""
        self.odometry = ScanOdometry(self.config)
        self.keys, self.points = [], []
        self.closing = None
        self._queue.clear()
        self._found.clear()
        self._farthest_m, self._look_from_m = 0.0, None
        self.why = why

    def step(self, scan: LidarScan, motion: CarMotion) -> TrackSurvey | None:
        """One scan, with how the car has moved since the last one."""
        if not self.odometry.follow(scan, motion):
            self.begin("lost itself between two scans")
            self.odometry.follow(scan, motion)
        key = self.odometry.key
        if self.odometry.is_new_key and key is not None:
            self._add(scan, key)
            if key.way_m < self._farthest_m - _BACK_M:
                self.begin("the car went back")
                return None
            if key.way_m > self.config.lap_max_m:
                self.begin(f"no lap after {key.way_m:.0f} m")
                return None
            self._farthest_m = max(self._farthest_m, key.way_m)
            if self.closing is None and not self._queue:
                self._decide(key)
                self._look_for_the_beginning(key)
            if self.closing is not None:
                return self._finished(scan)
        else:
            for _ in range(min(_TRIES, len(self._queue), max(1, self.odometry.passed_ns // _TRY_NS))):
                self._try()
        return None

    def _add(self, scan: LidarScan, key: Key) -> None:
        x, y = self.odometry.points(scan, self.config.key_points_m)
        every = max(1, math.ceil(len(x) / self.config.key_points))
        self.keys.append(key)
        self.points.append(np.stack((x[::every], y[::every]), axis=1).astype(np.float32))
        self.why = f"{len(self.keys)} key frames, {key.way_m:.0f} m"

    # ------------------------------------------------------------------------------------ closing

    def _look_for_the_beginning(self, key: Key) -> None:
        """Puts into the queue where this key may lie beside an early one, for each drift that odometry may have."""
        config = self.config
        if key.way_m < config.lap_min_m or len(self.keys) <= _FIRST_KEYS:
            return
        if not _WHOLE_TURN_RAD[0] < abs(key.turned_rad) < _WHOLE_TURN_RAD[1]:
            return
        reach_m = config.search_m + config.drift_share * key.way_m
        for step in sorted(range(-round(reach_m / _STEP_M), round(reach_m / _STEP_M) + 1), key=abs):
            shifted = compose(key.pose, (step * _STEP_M, 0.0, 0.0))
            seen = [compose(inverse(first.pose), shifted) for first in self.keys[:_FIRST_KEYS]]
            early = min(range(len(seen)), key=lambda i: math.hypot(seen[i][0], seen[i][1]))
            x, y, yaw = seen[early]
            if abs(x) < config.key_m and abs(y) < reach_m and abs(yaw) < _SAME_HEADING_RAD:
                # across the track the car cannot be farther out than the track is wide
                self._queue.append((early, len(self.keys) - 1, (x, min(max(y, -_ASIDE_M), _ASIDE_M), yaw)))
        if self._queue and self._look_from_m is None:
            self._look_from_m = key.way_m

    def _try(self) -> None:
        """One place of the queue."""
        early, late, place = self._queue.popleft()
        points, first = self.points[late], self.keys[early]
        some = points[:: max(1, len(points) // _CLOSE_POINTS)].astype(np.float64)
        sigma_m = max(self.odometry.sigma_m, 0.03)
        match = align(some[:, 0], some[:, 1], place, prior_of(0.5, 0.5, 0.2), first.frame, sigma_m, _CUT_M, 6)
        by_odometry = compose(inverse(first.pose), self.keys[late].pose)
        miss = compose(inverse(by_odometry), match.pose)
        residual_m = math.hypot(miss[0], miss[1])
        # many places of a corridor look alike: the nearer to where odometry has it, the likelier
        drift_m = self.config.search_m + self.config.drift_share * self.keys[late].way_m
        share = match.explained_share
        score = share - 2.0 * match.residual_m - 0.1 * (residual_m / drift_m) ** 2
        if share >= self.config.explained_share_min:
            self._found.append(Closing(early, late, match.pose, score, miss[0], residual_m, abs(miss[2])))

    def _decide(self, key: Key) -> None:
        """Takes the best place, when the whole stretch in which the beginning may lie has been driven."""
        if self._look_from_m is None or self._queue:
            return
        reach_m = self.config.search_m + self.config.drift_share * key.way_m
        if key.way_m < self._look_from_m + 2.0 * reach_m + self.config.overlap_m:
            return
        self._look_from_m = None
        self.closing = agreed(self._found)
        self._found.clear()
        if self.closing is not None:
            self.why = f"the lap is closed, odometry missed it by {self.closing.residual_m:.2f} m"

    def _finished(self, scan: LidarScan) -> TrackSurvey:
        closing, keys = self.closing, self.keys
        assert closing is not None
        self._number += 1
        self.attempt += 1
        counts = [len(points) for points in self.points]
        return TrackSurvey(
            scan.stamp_ns,
            np.array([key.pose for key in keys]),
            np.concatenate(self.points),
            np.repeat(np.arange(len(keys), dtype=np.int32), counts),
            closing.late,
            closing.early,
            closing.pose,
            closing.residual_m,
            closing.residual_rad,
            scan.x_m,
            scan.y_m,
            self._number,
            self.attempt,
        )


def agreed(found: list[Closing]) -> Closing | None:
    """The best of those closings that agree about how far odometry has missed the lap's end along the track.

    In a corridor one scan fits many places about as well; where several late keys say the same, each with its best
    closing, and say it best in the mean, is the place.
    """

    def worth(about: Closing) -> float:
        best: dict[int, float] = {}
        for other in found:
            if abs(other.along_m - about.along_m) < _AGREE_M:
                best[other.late] = max(best.get(other.late, 0.0), other.score)
        return (sum(best.values()) - _ALONE) / len(best)

    if not found:
        return None
    centre = max(found, key=worth)
    return max((c for c in found if abs(c.along_m - centre.along_m) < _AGREE_M), key=lambda c: c.score)
