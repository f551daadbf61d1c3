"""Lidar scans of simple places, computed exactly: open ground, a corridor, a box, each with round posts if wanted.

The robot stands at the origin of base; the lidar sits at (x_m, y_m, yaw_rad) on it. Beams go once round, counter-
clockwise from behind: `beams` of them, the first at -pi in the lidar's own frame.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from robotd.world.messages import Float64s, LidarScan

Post = tuple[float, float, float]
"""A round post in base: x_m, y_m, radius_m."""


def open_scan(
    *,
    posts: Iterable[Post] = (),
    stamp_ns: int = 0,
    beams: int = 360,
    range_max_m: float = 8.0,
    x_m: float = 0.0,
    y_m: float = 0.0,
    yaw_rad: float = 0.0,
) -> LidarScan:
    """Nothing within range, but for the posts."""
    return _scan((), posts, stamp_ns, beams, range_max_m, x_m, y_m, yaw_rad)


def box_scan(
    ahead_m: float = 2.0,
    left_m: float = 2.0,
    behind_m: float = 2.0,
    right_m: float = 2.0,
    *,
    posts: Iterable[Post] = (),
    stamp_ns: int = 0,
    beams: int = 360,
    range_max_m: float = 8.0,
    x_m: float = 0.0,
    y_m: float = 0.0,
    yaw_rad: float = 0.0,
) -> LidarScan:
    """Four walls square to the robot at these distances from the origin of base; `inf` leaves a side open.

    Raises ValueError where the lidar would stand behind a wall.
    """
    walls = ((0.0, ahead_m), (math.pi / 2, left_m), (math.pi, behind_m), (-math.pi / 2, right_m))
    return _scan(walls, posts, stamp_ns, beams, range_max_m, x_m, y_m, yaw_rad)


def corridor_scan(
    width_m: float = 1.0,
    *,
    offset_m: float = 0.0,
    heading_rad: float = 0.0,
    ahead_m: float = math.inf,
    behind_m: float = math.inf,
    posts: Iterable[Post] = (),
    stamp_ns: int = 0,
    beams: int = 360,
    range_max_m: float = 8.0,
    x_m: float = 0.0,
    y_m: float = 0.0,
    yaw_rad: float = 0.0,
) -> LidarScan:
    """Two walls `width_m` apart; the robot stands `offset_m` left of the middle and looks `heading_rad` left of along.

    ahead_m, behind_m: end walls square to the corridor, measured along it. Raises ValueError where the lidar would
    stand behind a wall.
    """
    left_m, right_m = width_m / 2.0 - offset_m, width_m / 2.0 + offset_m
    walls = (
        (math.pi / 2 - heading_rad, left_m),
        (-math.pi / 2 - heading_rad, right_m),
        (-heading_rad, ahead_m),
        (math.pi - heading_rad, behind_m),
    )
    return _scan(walls, posts, stamp_ns, beams, range_max_m, x_m, y_m, yaw_rad)


def _scan(
    walls: Iterable[tuple[float, float]],
    posts: Iterable[Post],
    stamp_ns: int,
    beams: int,
    range_max_m: float,
    x_m: float,
    y_m: float,
    yaw_rad: float,
) -> LidarScan:
    angles = np.linspace(-math.pi, math.pi, beams, endpoint=False).astype(np.float32)
    bearing = angles.astype(np.float64) + yaw_rad
    ranges = np.full(beams, math.inf)
    for wall_rad, distance_m in walls:
        ranges = np.minimum(ranges, _to_wall(bearing, wall_rad, distance_m, x_m, y_m))
    for post_x_m, post_y_m, radius_m in posts:
        ranges = np.minimum(ranges, _to_post(bearing, post_x_m - x_m, post_y_m - y_m, radius_m))
    ranges[ranges > range_max_m] = math.inf
    return LidarScan(
        stamp_ns,
        ranges.astype(np.float32),
        angles,
        start_ns=stamp_ns,
        range_max_m=range_max_m,
        x_m=x_m,
        y_m=y_m,
        yaw_rad=yaw_rad,
    )


def _to_wall(bearing: Float64s, wall_rad: float, distance_m: float, x_m: float, y_m: float) -> Float64s:
    """Distance along each beam to a wall; inf where the beam goes along it or away."""
    if math.isinf(distance_m):
        return np.full(bearing.shape, math.inf)
    away_m = distance_m - (x_m * math.cos(wall_rad) + y_m * math.sin(wall_rad))
    if away_m <= 0.0:
        raise ValueError(
            f"the lidar at ({x_m:g}, {y_m:g}) m stands {-away_m:g} m behind the wall at {wall_rad:.3g} rad"
        )
    towards = np.cos(bearing - wall_rad)
    reach = np.full(bearing.shape, math.inf)
    np.divide(away_m, towards, out=reach, where=towards > 1e-9)
    return reach


def _to_post(bearing: Float64s, x_m: float, y_m: float, radius_m: float) -> Float64s:
    """Distance along each beam to a round post seen at (x, y) from the lidar; 0 where the lidar stands in it."""
    distance_m = math.hypot(x_m, y_m)
    if distance_m <= radius_m:
        return np.zeros(bearing.shape)
    off = bearing - math.atan2(y_m, x_m)
    beside = np.abs(distance_m * np.sin(off))
    hit = (beside <= radius_m) & (np.cos(off) > 0.0)
    half_chord = np.sqrt(np.maximum(radius_m**2 - beside**2, 0.0))
    reach: Float64s = np.where(hit, distance_m * np.cos(off) - half_chord, math.inf)
    return reach
