"""Walls as a signed distance field on a grid: what the scans are laid on, and what the line keeps away from."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from robotd.world.messages import Float32s, Float64s
from robotd_plugins.perception.race_track.register import Surface

_BAND_M: Final = 0.5
"""So near a wall distances are exact, beyond they are those of the grid."""
_ROUND_M: Final = 3.0
"""Round everything that was seen."""
_AWAY_M: Final = 4.0
"""No distance is greater."""
_NEAREST: Final = 4
_SEEN_LEAST: Final = 3
"""So many points on beams in a cell and the eight about it: it was looked through,"""
_SEEN_M: Final = 0.1
"""and is free, however walls look at it, if it is so far from any."""
_BESIDE_M: Final = 0.15
"""A wall goes on beside its last point for so much."""


def distance_field(
    walls: Surface, path_m: Float64s, resolution_m: float, reach_m: float, seen_m: Float64s | None = None
) -> tuple[Float32s, tuple[float, float]]:
    """Signed distances float32 (rows, columns) as in `RaceTrack`, and the origin.

    path_m: (n, 2), the driven way; the grid ends `reach_m` beside it. seen_m: (k, 2), points that beams have passed on
    their way to a return: at a sharp corner no normal tells which side of it is the track. Raises ValueError where
    there are no walls there.
    """
    from scipy.ndimage import distance_transform_edt
    from scipy.spatial import cKDTree

    low, high = path_m.min(axis=0) - reach_m, path_m.max(axis=0) + reach_m
    inside = ((walls.points_m > low) & (walls.points_m < high)).all(axis=1)
    points, normals = walls.points_m[inside], walls.normals[inside]
    if len(points) < _NEAREST:
        raise ValueError("the survey shows no walls beside the driven way")
    columns, rows = (math.ceil(v) for v in (high - low) / resolution_m)
    at = ((points - low) / resolution_m).astype(np.intp)
    free = np.ones((rows, columns), dtype=np.bool_)
    free[at[:, 1], at[:, 0]] = False
    side = np.zeros((rows, columns, 2), dtype=np.float32)
    np.add.at(side, (at[:, 1], at[:, 0]), normals.astype(np.float32))
    cells, (near_row, near_column) = distance_transform_edt(free, return_indices=True)
    away = (cells * resolution_m).astype(np.float32)
    # a cell is on the track where its nearest wall looks at it
    own_row, own_column = np.indices((rows, columns), sparse=True)
    towards = side[near_row, near_column]
    dot = towards[..., 0] * (own_column - near_column) + towards[..., 1] * (own_row - near_row)
    field = np.where(dot >= 0.0, np.minimum(away, _AWAY_M), -np.minimum(away, _AWAY_M))
    band = np.flatnonzero(away.ravel() < _BAND_M)
    middle = np.stack((band % columns, band // columns), axis=1) + 0.5
    field.ravel()[band] = _exact(cKDTree(points), points, normals, low + resolution_m * middle)
    if seen_m is not None:
        field = _free_where_looked_through(field, seen_m, low, resolution_m)
    field = _only_what_was_seen(field, path_m, low, resolution_m)
    return field.astype(np.float32), (float(low[0]), float(low[1]))


def _exact(tree: object, points: Float64s, normals: Float64s, cells: Float64s) -> Float64s:
    """Signed distances of cells (n, 2) near walls: along the normals of the nearest wall points, or to its end."""
    _, nearest = tree.query(cells, k=_NEAREST)  # type: ignore[attr-defined]
    away = cells[:, None, :] - points[nearest]
    across = np.einsum("ijk,ijk->ij", normals[nearest], away)
    size = np.sqrt(np.einsum("ijk,ijk->ij", away, away))
    beside = np.sqrt(np.maximum(size * size - across * across, 0.0))
    weight = 1.0 / (0.02 + size) ** 2
    plane = (weight * across).sum(axis=1) / weight.sum(axis=1)
    # beyond the end of a wall, the distance to the end
    ends = beside[:, 0] > np.maximum(_BESIDE_M, np.abs(across[:, 0]))
    found: Float64s = np.where(ends, np.copysign(size[:, 0], across[:, 0]), plane)
    return found


def _free_where_looked_through(field: Float64s, seen_m: Float64s, low: Float64s, resolution_m: float) -> Float64s:
    """Cells that beams have passed, positive."""
    from scipy.ndimage import uniform_filter

    rows, columns = field.shape
    column, row = ((seen_m - low) / resolution_m).astype(np.intp).T
    inside = (seen_m > low).all(axis=1) & (column < columns) & (row < rows)
    count = np.bincount(row[inside] * columns + column[inside], minlength=field.size).reshape(field.shape)
    about = uniform_filter(count.astype(np.float32), 3, mode="constant") * 9.0
    return np.where((about > _SEEN_LEAST - 0.5) & (field < -_SEEN_M), -field, field)


def _only_what_was_seen(field: Float64s, path_m: Float64s, low: Float64s, resolution_m: float) -> Float64s:
    """Positive only where it joins the driven way without crossing a wall."""
    from scipy.ndimage import label

    parts, count = label(field > 0.0)
    if count <= 1:
        return field
    at = ((path_m - low) / resolution_m).astype(np.intp)
    driven = np.unique(parts[at[:, 1].clip(0, len(field) - 1), at[:, 0].clip(0, field.shape[1] - 1)])
    joined = np.isin(parts, driven[driven > 0])
    return np.where(joined | (field <= 0.0), field, -np.abs(field))
