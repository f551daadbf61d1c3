"""Where the lap meets its beginning, once more: all key frames of its end are laid on all of its beginning at once.

The survey has closed the lap by two scans. In a corridor, or round a bend of one radius, two scans fit a little farther
along the track as well, but many do not. From several places along the track the end is moved as one body by
point-to-line distances (Censi, ICRA 2008) that count less and less where they are long, and the best fit is taken,
among fits as good the nearest to where odometry has it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from robotd.world.geometry import compose, inverse
from robotd.world.messages import Float64s
from robotd_plugins.perception.race_track.register import eyes_of, normals_of, placed
from robotd_plugins.toolkit.race_track import TrackSurvey
from robotd_plugins.toolkit.scan_match import Pose

_EARLY_KEYS: Final = 14
_BEFORE_KEYS: Final = 4
"""So many key frames before the closing one belong to the lap's end."""
_SLIDE_M: Final = 2.5
_STEP_M: Final = 0.5
_EARLY_M: Final = 0.04
_LATE_M: Final = 0.12
"""One return for each square of this size."""
_ROUNDS: Final = 15
_FIRST_CUT_M, _LAST_CUT_M, _CUT_SHARE = 0.5, 0.12, 0.8
_SIGMA_MIN_M: Final = 0.04
_SAME_WALL: Final = 0.6
_HOLD: Final = 0.5
_STILL: Final = 0.002
_MOST_M: Final = 0.3
"""No return costs more."""
_AHEAD_M: Final = 2.0
"""Beyond the last early key frame by more, and behind the first, the beginning was hardly seen."""
_FEWEST: Final = 100
_DRIFT_M, _DRIFT_SHARE = 0.1, 0.005
"""Standard deviation of what odometry loses in a lap."""
_DRIFT_COST_M: Final = 0.003
"""What one standard deviation costs, in mean distance."""


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Returns of some key frames as odometry has them, (m, 2), and the normals of their walls (m, 2)."""

    points_m: Float64s
    normals: Float64s

    def moved(self, by: Pose) -> Block:
        """The same block elsewhere."""
        cos, sin = math.cos(by[2]), math.sin(by[2])
        turn = np.array([[cos, sin], [-sin, cos]])
        return Block(self.points_m @ turn + by[:2], self.normals @ turn)


class Beginning:
    """The walls of the first key frames, and where they were well seen."""

    def __init__(self, survey: TrackSurvey, keys: int) -> None:
        from scipy.spatial import cKDTree

        self.path = survey.path[:keys]
        self._block = _block(survey, 0, keys, _EARLY_M)
        self._tree = cKDTree(self._block.points_m)

    def distances(self, block: Block, most_m: float) -> tuple[Float64s, Float64s]:
        """Of each return to the nearest such wall along its normal (m,), inf beyond `most_m`; the normals (m, 2)."""
        away, near = self._tree.query(block.points_m, k=4, distance_upper_bound=most_m)
        near = np.where(np.isfinite(away), near, 0)
        normals = self._block.normals
        same = np.isfinite(away) & (np.einsum("ik,ijk->ij", block.normals, normals[near]) > _SAME_WALL)
        first = same.argmax(axis=1)
        row = np.arange(len(near))
        near, there = near[row, first], same[row, first]
        off = np.einsum("ij,ij->i", normals[near], block.points_m - self._block.points_m[near])
        return np.where(there, off, math.inf), normals[near]

    def saw(self, block: Block) -> NDArray[np.bool_]:
        """Which returns lie where the beginning was seen, (m,)."""
        x, y, yaw = self.path.T
        dx, dy = block.points_m[:, :1] - x, block.points_m[:, 1:] - y
        near = (dx * dx + dy * dy).argmin(axis=1)
        row = np.arange(len(near))
        ahead = np.cos(yaw[near]) * dx[row, near] + np.sin(yaw[near]) * dy[row, near]
        seen: NDArray[np.bool_] = ((near > 0) | (ahead >= 0.0)) & ((near < len(x) - 1) | (ahead <= _AHEAD_M))
        return seen


def closed_again(survey: TrackSurvey) -> TrackSurvey:
    """The survey with a better `closing`; as it is where too few returns are seen at both ends."""
    n = len(survey.path)
    keys = min(_EARLY_KEYS, n // 3)
    late = tuple(survey.path[survey.closing_key].tolist())
    if survey.closed_key >= keys:
        return survey
    beginning = Beginning(survey, keys)
    end = _block(survey, max(survey.closing_key - _BEFORE_KEYS, n // 2), n, _LATE_M)
    way = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(survey.path[:, :2], axis=0).T))))
    drift_m = _DRIFT_M + _DRIFT_SHARE * way[-1]
    best, least = None, _MOST_M
    for slide_m in np.arange(-_SLIDE_M, _SLIDE_M + 1e-9, _STEP_M):
        on = _along(survey.path, way, way[survey.closed_key] + slide_m)
        by = _laid(beginning, end, compose(compose(on, survey.closing), inverse(late)))
        x, y, _ = compose(by, late)
        missed = math.hypot(x - late[0], y - late[1]) / drift_m
        cost = _cost_m(beginning, end.moved(by)) + _DRIFT_COST_M * missed * missed
        if cost < least:
            best, least = by, cost
    if best is None:
        return survey
    early = tuple(survey.path[survey.closed_key].tolist())
    return replace(survey, closing=compose(inverse(early), compose(best, late)))


def _laid(beginning: Beginning, end: Block, by: Pose) -> Pose:
    """Gauss-Newton from one place; what counts as near shrinks."""
    cut_m = _FIRST_CUT_M
    for _ in range(_ROUNDS):
        block = end.moved(by)
        e, normals = beginning.distances(block, cut_m)
        there = np.isfinite(e)
        e = np.where(there, e, 0.0)
        sigma = max(_SIGMA_MIN_M, 0.5 * cut_m)
        weight = there / (1.0 + (e / sigma) ** 2)
        arm = block.points_m - np.array(by[:2])
        rows = np.stack((normals[:, 0], normals[:, 1], normals[:, 1] * arm[:, 0] - normals[:, 0] * arm[:, 1]))
        weighted = rows * weight
        step = np.linalg.solve(weighted @ rows.T + _HOLD * np.eye(3), -(weighted @ e)).tolist()
        by = (by[0] + step[0], by[1] + step[1], by[2] + step[2])
        cut_m = max(_CUT_SHARE * cut_m, _LAST_CUT_M)
        if cut_m == _LAST_CUT_M and max(map(abs, step)) < _STILL:
            break
    return by


def _cost_m(beginning: Beginning, block: Block) -> float:
    """Mean distance of the returns that the beginning should explain."""
    seen = beginning.saw(block)
    if np.count_nonzero(seen) < _FEWEST:
        return _MOST_M
    e, _ = beginning.distances(Block(block.points_m[seen], block.normals[seen]), _MOST_M)
    return float(np.minimum(np.abs(e), _MOST_M).mean())


def _block(survey: TrackSurvey, first: int, last: int, size_m: float) -> Block:
    """Of the key frames from `first` to before `last`, one return for each square of that size."""
    chosen = (survey.key >= first) & (survey.key < last)
    key = survey.key[chosen].astype(np.intp)
    points = placed(survey.points_m[chosen].astype(np.float64), key, survey.path)
    normals, _, _, there = normals_of(points, eyes_of(survey, survey.path)[key], 16, 0.25)
    known = there.sum(axis=1) >= 4
    points, normals = points[known], normals[known]
    cell: Any = np.floor(points / size_m).astype(np.int64)
    cell -= cell.min(axis=0, initial=0)
    _, one = np.unique(cell[:, 0] << 32 | cell[:, 1], return_index=True)
    return Block(points[one], normals[one])


def _along(path: Float64s, way: Float64s, at_m: float) -> Pose:
    """The pose at a way along the path; before its beginning straight back."""
    x, y = (float(np.interp(at_m, way, path[:, k])) for k in (0, 1))
    yaw = float(np.interp(at_m, way, np.unwrap(path[:, 2])))
    return compose((x, y, yaw), (min(at_m, 0.0), 0.0, 0.0))
