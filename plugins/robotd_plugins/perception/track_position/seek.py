"""Where on a track the car may be when that is not known: places along the driven lap, tried by how a scan fits there.

Few beams are laid on each place without moving it; the best few are then aligned, and the best of those is the answer.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from robotd.world.messages import Float64s
from robotd_plugins.perception.track_position.walls import FieldWalls
from robotd_plugins.toolkit.race_track import RaceTrack
from robotd_plugins.toolkit.scan_match import Match, Pose, align, prior_of

_STEP_M: Final = 0.3
_BEAMS: Final = 40
_CUT_M: Final = 0.5
_APART_M: Final = 0.8
_BEST: Final = 3
_LEAST: Final = 40
_DRIFT_COST_M: Final = 0.005
"""What one standard deviation of odometry's drift costs, in mean distance."""


class Seeker:
    """Places every 0.3 m along the lap of a track."""

    def __init__(self, track: RaceTrack, walls: FieldWalls) -> None:
        self._walls = walls
        ring = np.vstack((track.path, track.path[:1]))
        ring[:, 2] = np.unwrap(ring[:, 2])
        way = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(ring[:, :2], axis=0).T))))
        at = np.arange(0.0, way[-1], _STEP_M)
        self.places: Float64s = np.stack([np.interp(at, way, ring[:, k]) for k in range(3)], axis=1)

    def beyond(self, pose: Pose, way_m: float, reach_m: float) -> NDArray[np.intp]:
        """Indices of the places that are `way_m` along the lap from a pose, give or take `reach_m`."""
        x, y, yaw = self.places.T
        turned = np.remainder(yaw - pose[2] + math.pi, math.tau) - math.pi
        nearest = int((np.hypot(x - pose[0], y - pose[1]) + np.abs(turned)).argmin())
        steps = min(round(reach_m / _STEP_M), (len(x) - 1) // 2)
        return (nearest + round(way_m / _STEP_M) + np.arange(-steps, steps + 1)) % len(x)

    def misfit_m(self, x_m: Float64s, y_m: Float64s, which: NDArray[np.intp]) -> Float64s:
        """Mean distance of some of the returns (n,) to walls, at most half a metre each, for places (k,)."""
        if not len(x_m):
            return np.full(len(which), _CUT_M)
        every = max(1, len(x_m) // _BEAMS)
        x, y = x_m[::every], y_m[::every]
        px, py, yaw = self.places[which].T[:, :, None]
        cos, sin = np.cos(yaw), np.sin(yaw)
        away = np.abs(self._walls.at(cos * x - sin * y + px, sin * x + cos * y + py))
        misfit: Float64s = np.minimum(away, _CUT_M).mean(axis=1)
        return misfit

    def best(
        self,
        x_m: Float64s,
        y_m: Float64s,
        which: NDArray[np.intp],
        misfit_m: Float64s,
        sigma_m: float,
        drift_m: float = math.inf,
    ) -> Match | None:
        """The best fit from the most promising of some places; None where there are no places or too few returns.

        drift_m: standard deviation of where the middle one of the places has the car; of fits as good, the nearest.
        """
        if len(x_m) < _LEAST:
            return None
        found: Match | None = None
        least = math.inf
        tried: list[Float64s] = []
        far = (np.arange(len(which)) - len(which) // 2) * (_STEP_M / drift_m)
        misfit_m = misfit_m + _DRIFT_COST_M * far * far
        for i in np.argsort(misfit_m):
            place = self.places[which[i]]
            if any(math.hypot(*(place[:2] - other[:2])) < _APART_M for other in tried):
                continue
            tried.append(place)
            start = (float(place[0]), float(place[1]), float(place[2]))
            match = align(x_m, y_m, start, prior_of(0.5, 0.5, 0.3), self._walls, sigma_m, _CUT_M, 8)
            cost = match.cost_m(_CUT_M) + _DRIFT_COST_M * float(far[i]) ** 2
            if cost < least:
                found, least = match, cost
            if len(tried) == _BEST:
                break
        return found
