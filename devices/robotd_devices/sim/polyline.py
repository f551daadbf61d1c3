"""Polylines on the plane: rounded corners, and distances to straight pieces."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np

from robotd.world.messages import Float64s

Point: TypeAlias = tuple[float, float]

_ARC_STEP_RAD = math.radians(4.0)


def distance_to_segments_m(points_m: Float64s, segments_m: Float64s) -> Float64s:
    """Distance of each point (n, 2) to the nearest of the segments (m, 4), float64 (n,)."""
    start, along = segments_m[:, :2], segments_m[:, 2:] - segments_m[:, :2]
    offset = points_m[:, None, :] - start[None, :, :]
    share = np.einsum("nmk,mk->nm", offset, along) / np.einsum("mk,mk->m", along, along)
    gap = offset - np.clip(share, 0.0, 1.0)[:, :, None] * along[None, :, :]
    nearest: Float64s = np.sqrt(np.einsum("nmk,nmk->nm", gap, gap).min(axis=1))
    return nearest


def rounded(points_m: Sequence[Point], radius_m: float, closed: bool) -> Float64s:
    """A polyline whose corners are arcs, float64 (n, 2); a closed one repeats its first point.

    An arc takes at most half of its shorter side, so that neighbouring arcs never overlap; straight corners stay.
    """
    corners = [np.array(point, dtype=np.float64) for point in points_m]
    if closed and not np.array_equal(corners[0], corners[-1]):
        corners.append(corners[0])
    if radius_m <= 0.0:
        return np.array(corners)
    ring = corners[:-1] if closed else corners
    out: list[Float64s] = []
    for index, corner in enumerate(ring):
        if not closed and index in (0, len(ring) - 1):
            out.append(corner)
        else:
            out.extend(_arc(ring[index - 1], corner, ring[(index + 1) % len(ring)], radius_m))
    if closed:
        out.append(out[0])
    return np.array(out)


def box_segments_m(x_m: float, y_m: float, yaw_rad: float, length_m: float, width_m: float) -> Float64s:
    """The four sides (4, 4) of a rectangle about (x, y), `length_m` along its own x axis."""
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    corners = np.array([(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)]) * (length_m / 2.0, width_m / 2.0)
    turned = corners @ np.array([[cos, sin], [-sin, cos]]) + (x_m, y_m)
    return np.hstack((turned, np.roll(turned, -1, axis=0)))


def _arc(before: Float64s, corner: Float64s, after: Float64s, radius_m: float) -> list[Float64s]:
    into, out_of = corner - before, after - corner
    reach_m = min(float(np.hypot(*into)), float(np.hypot(*out_of))) / 2.0
    into, out_of = into / np.hypot(*into), out_of / np.hypot(*out_of)
    turn_rad = math.atan2(float(into[0] * out_of[1] - into[1] * out_of[0]), float(into @ out_of))
    if abs(turn_rad) < 1e-6 or abs(turn_rad) > math.pi - 1e-3:
        return [corner]
    cut_m = min(radius_m * math.tan(abs(turn_rad) / 2.0), reach_m)
    side = math.copysign(1.0, turn_rad)
    radius = cut_m / math.tan(abs(turn_rad) / 2.0)
    begin = corner - cut_m * into
    centre = begin + side * radius * np.array([-into[1], into[0]])
    steps = max(2, math.ceil(abs(turn_rad) / _ARC_STEP_RAD))
    first = math.atan2(float(begin[1] - centre[1]), float(begin[0] - centre[0]))
    angles = first + np.linspace(0.0, turn_rad, steps + 1)
    return list(centre + radius * np.stack((np.cos(angles), np.sin(angles)), axis=1))
