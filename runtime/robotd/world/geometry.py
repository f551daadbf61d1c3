"""Plane geometry in pure numpy: angles, poses, beams to points, convex outlines."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from robotd.world.messages import Float64s, LidarScan


def wrap_rad(angle_rad: float) -> float:
    """The same angle in (-pi, pi]."""
    wrapped = math.remainder(angle_rad, math.tau)
    return math.pi if wrapped == -math.pi else wrapped


def compose(a_b: tuple[float, float, float], b_c: tuple[float, float, float]) -> tuple[float, float, float]:
    """Pose of c in a from b seen in a and c seen in b, each (x_m, y_m, yaw_rad)."""
    cos, sin = math.cos(a_b[2]), math.sin(a_b[2])
    return (
        a_b[0] + cos * b_c[0] - sin * b_c[1],
        a_b[1] + sin * b_c[0] + cos * b_c[1],
        wrap_rad(a_b[2] + b_c[2]),
    )


def inverse(a_b: tuple[float, float, float]) -> tuple[float, float, float]:
    """a seen in b, from b seen in a."""
    cos, sin = math.cos(a_b[2]), math.sin(a_b[2])
    return (-cos * a_b[0] - sin * a_b[1], sin * a_b[0] - cos * a_b[1], wrap_rad(-a_b[2]))


def scan_points_base(scan: LidarScan) -> Float64s:
    """Hit points of a scan in the base frame, float64 (m, 2); beams without a finite range are left out."""
    hit = np.isfinite(scan.ranges_m)
    ranges = scan.ranges_m[hit].astype(np.float64)
    bearing = scan.angles_rad[hit].astype(np.float64) + scan.yaw_rad
    return np.stack((scan.x_m + ranges * np.cos(bearing), scan.y_m + ranges * np.sin(bearing)), axis=1)


def convex_hull(points_m: Sequence[tuple[float, float]]) -> Float64s:
    """Convex hull of at least three points, float64 (k, 2), counter-clockwise (Andrew's monotone chain, 1979).

    Raises ValueError where the points span no area.
    """
    points = sorted({(float(x), float(y)) for x, y in points_m})

    def half(ordered: list[tuple[float, float]]) -> list[tuple[float, float]]:
        chain: list[tuple[float, float]] = []
        for point in ordered:
            while len(chain) >= 2:
                (ax, ay), (bx, by) = chain[-2], chain[-1]
                if (bx - ax) * (point[1] - ay) - (by - ay) * (point[0] - ax) > 0.0:
                    break
                chain.pop()
            chain.append(point)
        return chain[:-1]

    hull = half(points) + half(points[::-1])
    if len(hull) < 3:
        raise ValueError(f"a footprint needs three corners that span an area, got {list(points_m)}")
    return np.array(hull, dtype=np.float64)


def half_planes(hull_m: Float64s) -> tuple[Float64s, Float64s]:
    """Outward unit normals (2, k) and offsets (k,) of a counter-clockwise convex outline.

    The signed distance of point p to the outline is at least `max(p @ normals - offsets)`; equal inside and beside
    an edge, smaller than the true distance beside a corner, so that a clearance is never overestimated.
    """
    edges = np.roll(hull_m, -1, axis=0) - hull_m
    normals = np.stack((edges[:, 1], -edges[:, 0]), axis=0)
    normals /= np.hypot(normals[0], normals[1])
    offsets = np.einsum("ij,ji->i", hull_m, normals)
    return normals, offsets
