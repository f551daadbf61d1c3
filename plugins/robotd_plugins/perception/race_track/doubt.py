"""Whether a map is true: every beam that measured a return has passed through free space on its way there.

A lap that was closed in the wrong place, or key frames that were laid on each other wrongly, put walls where the car
has looked through; distances between returns do not tell that, for each lies on some wall.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from robotd.world.messages import Float32s, Float64s
from robotd_plugins.perception.race_track.register import placed
from robotd_plugins.toolkit.race_track import TrackSurvey

_SHARES: Final = (0.3, 0.5, 0.7, 0.85)
"""Of the way from the lidar to the return."""
_BEHIND_M: Final = 0.04
"""So far behind a wall it is no noise of the returns that the wall is made of."""


def contradicted_share(
    survey: TrackSurvey, poses: Float64s, distance_m: Float32s, resolution_m: float, origin_m: tuple[float, float]
) -> float:
    """Of the key frame whose beams fit worst, the share that would have passed through a wall."""
    key = survey.key.astype(np.intp)
    ends = placed(survey.points_m.astype(np.float64), key, poses)
    all_keys = np.arange(len(poses))
    lidar = np.broadcast_to(np.array([survey.lidar_x_m, survey.lidar_y_m]), (len(poses), 2))
    eyes = placed(lidar, all_keys, poses)[key]
    rows, columns = distance_m.shape
    through = np.zeros(len(key), dtype=np.bool_)
    for share in _SHARES:
        at = ((eyes + share * (ends - eyes) - origin_m) / resolution_m).astype(np.intp)
        through |= distance_m[at[:, 1].clip(0, rows - 1), at[:, 0].clip(0, columns - 1)] < -_BEHIND_M
    count = np.maximum(np.bincount(key, minlength=len(poses)), 1)
    return float((np.bincount(key, through, minlength=len(poses)) / count).max())
