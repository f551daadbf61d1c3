"""The straight ways that a survey's lidar looked along: from where it was at a key frame to each return."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robotd.world.messages import Float64s
from robotd_plugins.perception.race_track.register import eyes_of, placed
from robotd_plugins.toolkit.race_track import TrackSurvey


@dataclass(frozen=True, slots=True, eq=False)
class Rays:
    """key: (n,), of which key frame; from_m, to_m: (n, 2), the lidar and the return in `track`."""

    key: NDArray[np.intp]
    from_m: Float64s
    to_m: Float64s

    def points(self, step_m: float, short_m: float) -> tuple[NDArray[np.intp], Float64s]:
        """Points every `step_m` along each ray, but for its last `short_m`: of which ray (k,), and where (k, 2)."""
        way = self.to_m - self.from_m
        length = np.maximum(np.hypot(way[:, 0], way[:, 1]), 1e-6)
        count = np.maximum(((length - short_m) / step_m).astype(np.intp), 0)
        ray = np.repeat(np.arange(len(count)), count)
        nth = np.arange(len(ray)) - np.repeat(np.cumsum(count) - count, count)
        share = (nth + 0.5) * step_m / length[ray]
        return ray, self.from_m[ray] + share[:, None] * way[ray]


def rays_of(survey: TrackSurvey, poses: Float64s) -> Rays:
    """All of a survey, with the given poses (n, 3) of its key frames."""
    key = survey.key.astype(np.intp)
    return Rays(key, eyes_of(survey, poses)[key], placed(survey.points_m.astype(np.float64), key, poses))
