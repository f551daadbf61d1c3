"""Exact ranges of many rays against segments and circles at once.

A ray meets only obstacles whose bearing interval holds it, so the candidates of each obstacle are a run of
neighbouring rays in order of bearing. Those runs are laid out flat, intersected in closed form and reduced by minimum:
work grows with what is really in the way, not with rays times obstacles.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robotd.world.messages import Float64s

_ON_RAY_M = 1e-9
_SLACK_RAD = 1e-9
_GROUP_FROM = 40


def cast(
    origins_m: Float64s,
    bearings_rad: Float64s,
    segments_m: Float64s,
    circles_m: Float64s,
    moves_m: Float64s | None = None,
    shares: Float64s | None = None,
) -> Float64s:
    """Distance along each ray to the nearest obstacle, float64 (n,), inf where there is none.

    origins_m: (n, 2), or (2,) for one origin for all. bearings_rad: (n,), any order, any turn. segments_m: (m, 4);
    circles_m: (k, 3), seen from inside as well. The origins may differ (a sensor that moves during its sweep):
    obstacles are then widened by what the origins spread, and the intersection itself stays exact. A ray that runs
    exactly along a segment passes it by, as a wall without thickness shows nothing edge-on.

    moves_m: (k, 2), how far each circle goes during the sweep; it is at `circles_m` when its middle has passed. shares:
    (n,), the part of the sweep at which each ray is sent, 0 to 1; without it everything stands.
    """
    n = len(bearings_rad)
    ranges_m = np.full(n, math.inf)
    if n == 0 or (len(segments_m) == 0 and len(circles_m) == 0):
        return ranges_m
    centre_m, spread_m = _centre(origins_m)
    # about the centre of the origins, so that far from the map's zero nothing is lost to rounding
    offset_m = np.broadcast_to(origins_m - centre_m, (n, 2))
    rays = _Rays(np.cos(bearings_rad), np.sin(bearings_rad), offset_m[:, 0], offset_m[:, 1], spread_m)
    order = np.argsort(bearings_rad, kind="stable")
    sorted_rad = bearings_rad[order]
    if len(segments_m):
        local_m = segments_m - np.tile(centre_m, 2)
        low, high, nearest_m = _segment_bearings(local_m, spread_m)
        for group in _near_first(nearest_m):
            thing, ray = _candidates(sorted_rad, order, low[group], high[group])
            hidden = nearest_m[group].take(thing) - spread_m > ranges_m.take(ray)
            thing, ray = thing[~hidden], ray[~hidden]
            np.minimum.at(ranges_m, ray, _meet_segments(thing, ray, rays, local_m[group]))
    if len(circles_m):
        local_m = circles_m - np.append(centre_m, 0.0)
        reach_m: Float64s | float = spread_m
        if moves_m is not None and shares is not None:
            reach_m = spread_m + np.hypot(moves_m[:, 0], moves_m[:, 1]) * float(np.abs(shares - 0.5).max())
        thing, ray = _candidates(sorted_rad, order, *_circle_bearings(local_m, reach_m))
        centres_m = local_m.take(thing, axis=0)
        if moves_m is not None and shares is not None:
            centres_m[:, :2] += moves_m.take(thing, axis=0) * (shares.take(ray) - 0.5)[:, None]
        np.minimum.at(ranges_m, ray, _meet_circles(ray, rays, centres_m))
    return ranges_m


@dataclass(frozen=True, slots=True, eq=False)
class _Rays:
    """Directions and origins (n,) about the centre of all origins, which lie within `spread_m` of it."""

    cos: Float64s
    sin: Float64s
    x_m: Float64s
    y_m: Float64s
    spread_m: float


def _centre(origins_m: Float64s) -> tuple[Float64s, float]:
    if origins_m.ndim == 1:
        return origins_m, 0.0
    centre_m = (origins_m.min(axis=0) + origins_m.max(axis=0)) / 2.0
    offset = origins_m - centre_m
    return centre_m, math.sqrt(float(np.einsum("ij,ij->i", offset, offset).max()))


def _near_first(nearest_m: Float64s) -> list[NDArray[np.intp]]:
    """The obstacles in groups from near to far, so that what near ones hide is not computed."""
    if len(nearest_m) < _GROUP_FROM:
        return [np.arange(len(nearest_m))]
    by_distance = np.argsort(nearest_m, kind="stable")
    return [by_distance[: len(nearest_m) // 5], by_distance[len(nearest_m) // 5 :]]


def _segment_bearings(local_m: Float64s, spread_m: float) -> tuple[Float64s, Float64s, Float64s]:
    """First and last bearing (m,) under which each segment can be seen from anywhere within `spread_m` of the origin,
    and its distance (m,) from the origin.
    """
    x0, y0, x1, y1 = local_m.T
    first = np.arctan2(y0, x0)
    turn = np.arctan2(x0 * y1 - y0 * x1, x0 * x1 + y0 * y1)
    dx, dy = x1 - x0, y1 - y0
    share = np.clip(-(x0 * dx + y0 * dy) / np.maximum(dx * dx + dy * dy, 1e-300), 0.0, 1.0)
    nearest_m = np.hypot(x0 + share * dx, y0 + share * dy)
    widen = _widen(nearest_m, spread_m)
    return first + np.minimum(turn, 0.0) - widen, first + np.maximum(turn, 0.0) + widen, nearest_m


def _circle_bearings(local_m: Float64s, spread_m: float | Float64s) -> tuple[Float64s, Float64s]:
    x, y, radius_m = local_m.T
    middle = np.arctan2(y, x)
    widen = _widen(np.hypot(x, y), radius_m + spread_m)
    return middle - widen, middle + widen


def _widen(distance_m: Float64s, by_m: float | Float64s) -> Float64s:
    """Half the angle under which a disc of radius `by_m` is seen; everything from inside it."""
    inside = distance_m <= np.maximum(by_m, _ON_RAY_M)
    sine = np.clip(np.divide(by_m, distance_m, out=np.ones_like(distance_m), where=~inside), 0.0, 1.0)
    return np.where(inside, math.pi, np.arcsin(sine)) + _SLACK_RAD


def _candidates(
    sorted_rad: Float64s, order: NDArray[np.intp], low: Float64s, high: Float64s
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Pairs (thing, ray) whose bearings may meet, each (p,)."""
    first_turn = math.ceil((float(sorted_rad[0]) - float(high.max())) / math.tau)
    last_turn = math.floor((float(sorted_rad[-1]) - float(low.min())) / math.tau)
    turns = np.arange(first_turn, last_turn + 1) * math.tau
    begin = np.searchsorted(sorted_rad, (low[None, :] + turns[:, None]).ravel(), side="left")
    end = np.searchsorted(sorted_rad, (high[None, :] + turns[:, None]).ravel(), side="right")
    count = end - begin
    thing = np.repeat(np.tile(np.arange(len(low)), len(turns)), count)
    skipped = np.repeat(begin - (np.cumsum(count) - count), count)
    return thing, order[np.arange(len(thing)) + skipped]


def _meet_segments(thing: NDArray[np.intp], ray: NDArray[np.intp], rays: _Rays, segments_m: Float64s) -> Float64s:
    """Range of each pair, inf where the ray passes by."""
    x0, y0 = segments_m[:, 0], segments_m[:, 1]
    dx, dy = segments_m[:, 2] - x0, segments_m[:, 3] - y0
    # everything that belongs to a segment alone or a ray alone is multiplied out before the pairs are formed
    cos, sin, dx_pair, dy_pair = rays.cos.take(ray), rays.sin.take(ray), dx.take(thing), dy.take(thing)
    cross = cos * dy_pair - sin * dx_pair
    range_m = (x0 * dy - y0 * dx).take(thing)
    share = x0.take(thing) * sin - y0.take(thing) * cos
    if rays.spread_m > 0.0:
        range_m -= rays.x_m.take(ray) * dy_pair - rays.y_m.take(ray) * dx_pair
        share -= (rays.x_m * rays.sin - rays.y_m * rays.cos).take(ray)
    with np.errstate(divide="ignore", invalid="ignore"):
        range_m /= cross
        share /= cross
    # the slack closes the hairline between two walls that share a corner
    share -= 0.5
    np.abs(share, out=share)
    range_m[~((share <= 0.5 + 1e-12) & (range_m >= -_ON_RAY_M))] = math.inf
    return np.maximum(range_m, 0.0, out=range_m)


def _meet_circles(ray: NDArray[np.intp], rays: _Rays, circles_m: Float64s) -> Float64s:
    """Range of each pair; circles_m: (p, 3), the circle of each pair where it is just then."""
    cos, sin, radius_m = rays.cos.take(ray), rays.sin.take(ray), circles_m[:, 2]
    px = circles_m[:, 0] - rays.x_m.take(ray)
    py = circles_m[:, 1] - rays.y_m.take(ray)
    along = px * cos + py * sin
    across = px * sin - py * cos
    half = np.sqrt(np.maximum(radius_m**2 - across**2, 0.0))
    near, far = along - half, along + half
    hit = (np.abs(across) <= radius_m) & (far >= 0.0)
    return np.where(hit, np.where(near >= 0.0, near, far), math.inf)
