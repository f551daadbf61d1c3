"""A race track for tests: two straights and two half circles, its walls and its line known exactly."""

from __future__ import annotations

import math

import numpy as np

from robotd.world.messages import Float64s
from robotd_plugins.behaviours.ftg_race.line import WallField
from robotd_plugins.toolkit.race_track import RaceTrack

RESOLUTION_M = 0.05


def middle(straight_m: float = 40.0, radius_m: float = 5.0, step_m: float = 0.25) -> Float64s:
    """Poses (n, 3) once round, counter-clockwise, from the middle of the lower straight, which lies on y = 0."""
    half, arc = straight_m / 2.0, math.pi * radius_m
    length = 2.0 * (straight_m + arc)
    n = round(length / step_m)
    poses = []
    for s in np.arange(n) * (length / n):
        if s < half or s >= half + 2.0 * arc + straight_m:
            poses.append((s if s < half else s - length, 0.0, 0.0))
        elif s < half + arc:
            turn = (s - half) / radius_m
            poses.append((half + radius_m * math.sin(turn), radius_m * (1.0 - math.cos(turn)), turn))
        elif s < half + arc + straight_m:
            poses.append((half - (s - half - arc), 2.0 * radius_m, math.pi))
        else:
            turn = math.pi + (s - half - arc - straight_m) / radius_m
            poses.append((-half + radius_m * math.sin(turn), radius_m * (1.0 - math.cos(turn)), turn))
    return np.array(poses)


def walls(straight_m: float = 40.0, radius_m: float = 5.0, width_m: float = 1.8) -> WallField:
    """Signed distance to the walls, exact at the cells' middles."""
    x0, y0 = -straight_m / 2.0 - radius_m - 2.0, -2.0
    columns, rows = round(-2.0 * x0 / RESOLUTION_M), round((2.0 * radius_m + 4.0) / RESOLUTION_M)
    x = x0 + (np.arange(columns) + 0.5) * RESOLUTION_M
    y = y0 + (np.arange(rows) + 0.5) * RESOLUTION_M
    along = np.maximum(np.abs(x) - straight_m / 2.0, 0.0)
    away = np.abs(np.hypot(along[None, :], y[:, None] - radius_m) - radius_m)
    return WallField((width_m / 2.0 - away).astype(np.float32), RESOLUTION_M, (x0, y0))


def learned(version: int = 1) -> RaceTrack:
    """The track with its middle for a line, at 4 m/s; the path of base is 0.165 m behind."""
    line, field = middle(), walls()
    path = line.copy()
    path[:, 0] -= 0.165 * np.cos(line[:, 2])
    path[:, 1] -= 0.165 * np.sin(line[:, 2])
    s = np.arange(len(line)) * 0.25
    x, y, yaw = line.T.copy()
    bend = np.where(np.abs(x) > 20.0, 0.2, 0.0)
    return RaceTrack(
        1, field.distance_m, field.resolution_m, field.origin_m, path, s, x, y, yaw, bend, np.full(len(s), 4.0),
        float(len(s) * 0.25), 28.0, version,
    )  # fmt: skip
