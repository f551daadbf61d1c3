"""Whether a map is true: every beam that measured a return has passed through free space on its way there.

A lap that was closed in the wrong place, or key frames that were laid on each other wrongly, put walls where the car
has looked through; distances between returns do not tell that, for each lies on some wall.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from robotd.world.messages import Float32s, Float64s
from robotd_plugins.perception.race_track.rays import Rays
from robotd_plugins.perception.race_track.register import Surface

_BEHIND_M: Final = 0.08
"""So far behind a wall it is no noise of the returns that the wall is made of."""
_CELL_M: Final = 0.05
_FEWEST: Final = 2
"""So many returns in one cell are a wall, if a beam meets it steeper than by this sine."""
_STEEP: Final = 0.5


def contradicted_share(
    rays: Rays,
    ray: NDArray[np.intp],
    at: Float64s,
    walls: Surface,
    distance_m: Float32s,
    resolution_m: float,
    origin_m: tuple[float, float],
) -> float:
    """Of the key frame whose beams fit worst, the share that would have crossed a wall or been behind one.

    ray (k,), at (k, 2): points on the rays, as `Rays.points` gives them.
    """
    rows, columns = distance_m.shape
    cell = ((at - origin_m) / resolution_m).astype(np.intp)
    behind = distance_m[cell[:, 1].clip(0, rows - 1), cell[:, 0].clip(0, columns - 1)] < -_BEHIND_M
    through = np.zeros(len(rays.key), dtype=np.bool_)
    through[ray[behind | _crosses(rays, walls, ray, at)]] = True
    count = np.maximum(np.bincount(rays.key), 1)
    return float((np.bincount(rays.key, through) / count).max())


def _crosses(rays: Rays, walls: Surface, ray: NDArray[np.intp], at: Float64s) -> NDArray[np.bool_]:
    """Which points (k, 2) on rays lie in a wall that the ray does not run along."""
    low = walls.points_m.min(axis=0) - _CELL_M
    shape = ((walls.points_m.max(axis=0) - low) / _CELL_M).astype(np.intp) + 2
    size = int(shape.prod())
    column, row = ((walls.points_m - low) / _CELL_M).astype(np.intp).T
    index = row * shape[0] + column
    count = np.bincount(index, minlength=size)
    normal_x, normal_y = (np.bincount(index, walls.normals[:, k], size) / np.maximum(count, 1) for k in (0, 1))
    column, row = ((at - low) / _CELL_M).astype(np.intp).T
    inside = (column >= 0) & (column < shape[0]) & (row >= 0) & (row < shape[1])
    here = np.where(inside, row * shape[0] + column, 0)
    way = rays.to_m - rays.from_m
    way /= np.maximum(np.hypot(way[:, 0], way[:, 1]), 1e-6)[:, None]
    steep = np.abs(way[ray, 0] * normal_x[here] + way[ray, 1] * normal_y[here]) > _STEEP
    crosses: NDArray[np.bool_] = inside & (count[here] >= _FEWEST) & steep
    return crosses
