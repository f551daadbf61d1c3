"""The room beside a driven path: how far to each side the car's middle may go before the walls are too near."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robotd.world.messages import Float32s, Float64s

_LOOK_M, _LOOK_STEP_M = 2.4, 0.03
"""Looked at to each side, and how finely."""
_LOST_M = 0.6
"""A path that has come too near a wall is put back by no more than this."""
_LEAST_ROOM_M = 0.01
_INSIDE = 0.85
"""Of the radius of a bend: no offset goes farther towards its centre."""


@dataclass(frozen=True, slots=True, eq=False)
class WallField:
    """Distance to the nearest wall, as in `RaceTrack`: float32 (rows, columns), row 0 lowest, the value at each cell's
    middle; origin_m: the lower left corner of cell 0, 0.
    """

    distance_m: NDArray[np.float32]
    resolution_m: float
    origin_m: tuple[float, float]

    def at(self, x_m: Float64s, y_m: Float64s) -> Float64s:
        """Bilinear, same shape as the points; 0 outside the field."""
        rows, columns = self.distance_m.shape
        u = (x_m - self.origin_m[0]) / self.resolution_m - 0.5
        v = (y_m - self.origin_m[1]) / self.resolution_m - 0.5
        inside = (u >= 0.0) & (v >= 0.0) & (u < columns - 1) & (v < rows - 1)
        u, v = np.where(inside, u, 0.0), np.where(inside, v, 0.0)
        c, r = u.astype(np.intp), v.astype(np.intp)
        fu, fv = u - c, v - r
        flat: Float32s = self.distance_m.reshape(-1)
        at = r * columns + c
        low = (1.0 - fu) * flat.take(at) + fu * flat.take(at + 1)
        high = (1.0 - fu) * flat.take(at + columns) + fu * flat.take(at + columns + 1)
        found: Float64s = np.where(inside, (1.0 - fv) * low + fv * high, 0.0)
        return found


@dataclass(frozen=True, slots=True, eq=False)
class Ring:
    """A closed line of equal steps, each array (n,): places, unit normals to the left, curvature; the last joins the
    first.
    """

    x_m: Float64s
    y_m: Float64s
    normal_x: Float64s
    normal_y: Float64s
    curvature_pm: Float64s
    step_m: float

    @property
    def yaw_rad(self) -> Float64s:
        """Direction of travel, (n,)."""
        return np.arctan2(-self.normal_x, self.normal_y)


def ring_of(x_m: Float64s, y_m: Float64s, step_m: float, smooth: int = 0) -> Ring:
    """A closed line through points (m,) in driving order, at even steps; smooth: passes of (1 2 1) / 4."""
    x, y = np.append(x_m, x_m[0]), np.append(y_m, y_m[0])
    way = np.concatenate(([0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))))
    keep = np.concatenate(([True], np.diff(way) > 1e-9))
    x, y, way = x[keep], y[keep], way[keep]
    n = max(round(way[-1] / step_m), 8)
    at = np.arange(n) * (way[-1] / n)
    ex, ey = np.interp(at, way, x), np.interp(at, way, y)
    for _ in range(smooth):
        ex, ey = (0.25 * (np.roll(e, 1) + np.roll(e, -1)) + 0.5 * e for e in (ex, ey))
    tx, ty = (0.5 * (np.roll(e, -1) - np.roll(e, 1)) for e in (ex, ey))
    size = np.hypot(tx, ty)
    tx, ty = tx / size, ty / size
    ax, ay = ex - np.roll(ex, 1), ey - np.roll(ey, 1)
    bx, by = np.roll(ax, -1), np.roll(ay, -1)
    turn = np.arctan2(ax * by - ay * bx, ax * bx + ay * by)
    step = float(np.mean(np.hypot(ax, ay)))
    return Ring(ex, ey, -ty, tx, turn / (0.5 * (np.hypot(ax, ay) + np.hypot(bx, by))), step)


def room_m(ring: Ring, field: WallField, clear_m: float) -> tuple[Float64s, Float64s]:
    """Least and greatest offset along the normals, (n,) each, left positive, at which walls stay `clear_m` away.

    Where the line itself is too near a wall the offsets lead back. Raises ValueError where no offset is free.
    """
    offsets = np.arange(-_LOOK_M, _LOOK_M + 1e-9, _LOOK_STEP_M)
    x = ring.x_m[:, None] + offsets * ring.normal_x[:, None]
    y = ring.y_m[:, None] + offsets * ring.normal_y[:, None]
    free = field.at(x, y) >= clear_m
    near = np.where(free, np.abs(offsets), np.inf)
    seed = near.argmin(axis=1)
    lost = near[np.arange(len(seed)), seed] > _LOST_M
    if lost.any():
        at = int(lost.argmax())
        raise ValueError(f"no room beside the path at {ring.x_m[at]:.2f}, {ring.y_m[at]:.2f}")
    columns = np.arange(len(offsets))
    low = np.where(~free & (columns < seed[:, None]), columns, -1).max(axis=1) + 1
    high = np.where(~free & (columns > seed[:, None]), columns, len(offsets)).min(axis=1) - 1
    least, most = offsets[low], offsets[high]
    radius = _INSIDE / np.maximum(np.abs(ring.curvature_pm), 1e-3)
    least = np.where(ring.curvature_pm < 0.0, np.maximum(least, -radius), least)
    most = np.where(ring.curvature_pm > 0.0, np.minimum(most, radius), most)
    thin = most - least < 2.0 * _LEAST_ROOM_M
    middle = 0.5 * (least + most)
    return np.where(thin, middle - _LEAST_ROOM_M, least), np.where(thin, middle + _LEAST_ROOM_M, most)
