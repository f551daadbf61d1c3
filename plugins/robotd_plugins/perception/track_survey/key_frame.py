"""A key frame: one scan as walls over bearing, against which the scans after it are laid.

A point of a later scan belongs to the return that the key frame's lidar had in the same bearing (projective data
association: Diosi and Kleeman, Laser scan matching in polar coordinates, IROS 2005), so that no search is needed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from robotd.world.messages import Float64s
from robotd_plugins.toolkit.scan_match import FAR_M

BINS: Final = 720
_STEP_RAD: Final = math.tau / BINS
_PAD: Final = 24
_WINDOW_M: Final = 0.15
"""A wall's direction is taken from returns so far to each side, where bearings are that dense."""
_FEWEST: Final = 3
_HOLE_RAD: Final = 0.013
_CURVED_M: Final = 0.09
"""Returns that lie about a line with a greater spread are no wall: a corner, an edge, grass."""
_TANGENT_M: Final = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class KeyFrame:
    """Walls (5, BINS) over bearing about the lidar: x, y in base, x, y of the normal towards the lidar, spread in m.

    Without a return the spread is inf.
    """

    walls: Float64s
    x_m: float
    y_m: float

    def look(self, x_m: Float64s, y_m: Float64s) -> tuple[Float64s, Float64s, Float64s]:
        """See `Walls`; points in base of the key frame."""
        bearing = np.arctan2(y_m - self.y_m, x_m - self.x_m)
        bearing *= 1.0 / _STEP_RAD
        bearing += BINS / 2.0
        px, py, nx, ny, spread = self.walls.take(bearing.astype(np.intp), axis=1, mode="clip")
        dx, dy = x_m - px, y_m - py
        distance = nx * dx + ny * dy
        # a point far along the wall from the return of its bearing belongs to something else
        tangent = ny * dx - nx * dy
        return np.where(np.abs(tangent) + spread < _TANGENT_M, distance, FAR_M), nx, ny


def key_frame(x_m: Float64s, y_m: Float64s, lidar_x_m: float, lidar_y_m: float) -> KeyFrame:
    """The walls that returns (n,) in base show; a bin of bearing without a return near its middle is a hole."""
    walls = np.zeros((5, BINS))
    walls[4] = math.inf
    if len(x_m) < 2 * _FEWEST:
        return KeyFrame(walls, lidar_x_m, lidar_y_m)
    dx, dy = x_m - lidar_x_m, y_m - lidar_y_m
    bearing = np.arctan2(dy, dx)
    order = np.argsort(bearing)
    bearing = bearing[order]
    middle = (np.arange(BINS) + 0.5) * _STEP_RAD - math.pi
    after = np.searchsorted(bearing, middle).clip(1, len(bearing) - 1)
    nearest = np.where(middle - bearing[after - 1] < bearing[after] - middle, after - 1, after)
    there = np.abs(bearing[nearest] - middle) < _HOLE_RAD
    x, y = np.where(there, dx[order][nearest], 0.0), np.where(there, dy[order][nearest], 0.0)
    half = np.rint(_WINDOW_M / _STEP_RAD / np.maximum(np.hypot(x, y), 0.05)).clip(_FEWEST, _PAD).astype(np.intp)
    mean_x, mean_y, along, least = _windows(x, y, there, half)
    nx, ny = -np.sin(along), np.cos(along)
    # towards the lidar
    flip = np.where(nx * x + ny * y > 0.0, -1.0, 1.0)
    nx, ny = flip * nx, flip * ny
    off = nx * (x - mean_x) + ny * (y - mean_y)
    walls[0], walls[1] = x - off * nx + lidar_x_m, y - off * ny + lidar_y_m
    walls[2], walls[3] = nx, ny
    is_wall = there & (least < _CURVED_M) & (np.abs(off) < 2.0 * _CURVED_M)
    walls[4] = np.where(is_wall, least, math.inf)
    return KeyFrame(walls, lidar_x_m, lidar_y_m)


def _windows(
    x: Float64s, y: Float64s, there: NDArray[np.bool_], half: NDArray[np.intp]
) -> tuple[Float64s, Float64s, Float64s, Float64s]:
    """Of the returns within `half` bins to each side: mean x and y, direction of most spread, the least spread."""
    sums = np.stack((there, x, y, x * x, x * y, y * y)).astype(np.float64)
    sums = np.concatenate((sums[:, -_PAD:], sums, sums[:, :_PAD]), axis=1)
    sums = np.concatenate((np.zeros((6, 1)), np.cumsum(sums, axis=1)), axis=1)
    at = np.arange(BINS) + _PAD
    count, sx, sy, sxx, sxy, syy = sums[:, at + half + 1] - sums[:, at - half]
    n = np.maximum(count, 1.0)
    mean_x, mean_y = sx / n, sy / n
    xx, xy, yy = sxx / n - mean_x * mean_x, sxy / n - mean_x * mean_y, syy / n - mean_y * mean_y
    along = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    least2 = 0.5 * (xx + yy) - np.hypot(0.5 * (xx - yy), xy)
    return mean_x, mean_y, along, np.where(count > half, np.sqrt(np.maximum(least2, 0.0)), math.inf)
