"""The distance field of a `RaceTrack` as walls to lay scans on."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from robotd.world.messages import Float64s
from robotd_plugins.toolkit.race_track import RaceTrack

_KNOWN_M: Final = 3.5
"""Beyond this the field only says that it knows nothing."""


class FieldWalls:
    """See `Walls`. Between cells linear, from the slope at the nearest one; metres away where nothing is known."""

    def __init__(self, track: RaceTrack) -> None:
        self._flat = track.distance_m.reshape(-1)
        self._rows, self._columns = track.distance_m.shape
        self._per_m = 1.0 / track.resolution_m
        self._low_u, self._low_v = (v * self._per_m for v in track.origin_m)
        c = self._columns
        self._around = np.array([[0], [1], [-1], [c], [-c]], dtype=np.int32)

    def look(self, x_m: Float64s, y_m: Float64s) -> tuple[Float64s, Float64s, Float64s]:
        u, v = x_m * self._per_m - self._low_u, y_m * self._per_m - self._low_v
        at, column, row = self._cells(u, v)
        here, right, left, up, down = self._flat.take(at + self._around, mode="clip")
        slope_u, slope_v = 0.5 * (right - left), 0.5 * (up - down)
        distance = here + slope_u * (u - column - 0.5) + slope_v * (v - row - 0.5)
        return distance, slope_u * self._per_m, slope_v * self._per_m

    def at(self, x_m: Float64s, y_m: Float64s) -> Float64s:
        """The signed distance of the nearest cell, of points of any shape; -inf where nothing is known."""
        at, _, _ = self._cells(x_m * self._per_m - self._low_u, y_m * self._per_m - self._low_v)
        here = self._flat.take(at, mode="clip")
        return np.where(here > -_KNOWN_M, here, -math.inf)

    def _cells(self, u: Float64s, v: Float64s) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]:
        column, row = u.astype(np.int32), v.astype(np.int32)
        # outside the grid everything is its rim, where nothing is known
        np.minimum(np.maximum(column, 0, out=column), self._columns - 1, out=column)
        return row * self._columns + column, column, row
