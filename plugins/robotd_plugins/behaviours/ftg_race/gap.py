"""The seed's way through a scan, step by step: inflation, bubble, disparity extender, gap, aim point. Pure functions.

All take and give ranges (n,) in bins of equal angle from right to left; blocked is range 0. Differences from the
seed are named where they are.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from robotd.world.messages import Float64s

Gap = tuple[int, int]
"""First bin, and the bin after the last."""


def front_min_m(bearing_rad: Float64s, ranges_m: Float64s, sector_rad: float) -> float:
    """Step 2: the nearest ahead, within `sector_rad` to each side; inf where the lidar has no bin there."""
    return float(np.min(ranges_m[np.abs(bearing_rad) <= sector_rad], initial=math.inf))


def inflated(ranges_m: Float64s, half_width_m: float, step_rad: float) -> Float64s:
    """Section 5: each return holds its range over atan2(half_width, range) to both sides."""
    return _painted(ranges_m, ranges_m, np.arctan2(half_width_m, np.maximum(ranges_m, 1e-3)), step_rad)


def bubbled(ranges_m: Float64s, radius_m: float, step_rad: float) -> Float64s:
    """Step 3: nothing is free within `radius_m` of the nearest return that is not blocked already."""
    seen = np.where(ranges_m > 0.0, ranges_m, np.inf)
    nearest = int(seen.argmin())
    if radius_m <= 0.0 or not math.isfinite(seen[nearest]):
        return ranges_m
    k = int(math.atan2(radius_m, float(seen[nearest])) / step_rad)
    out = ranges_m.copy()
    out[max(0, nearest - k) : nearest + k + 1] = 0.0
    return out


def extended(ranges_m: Float64s, threshold_m: float, half_width_m: float, step_rad: float) -> Float64s:
    """Step 4: at a step of range the near side is painted over the far side, as wide as half the car is there."""
    near_left = ranges_m[1:] + threshold_m < ranges_m[:-1]
    near_right = ranges_m[:-1] + threshold_m < ranges_m[1:]
    edge = np.append(near_right, False) | np.append(False, near_left)
    width = np.where(edge, np.arctan2(half_width_m, np.maximum(ranges_m, 1e-3)), 0.0)
    return _painted(ranges_m, ranges_m, width, step_rad)


def gaps(ranges_m: Float64s, threshold_m: float) -> list[Gap]:
    """Step 5: runs of bins with at least `threshold_m`, from right to left."""
    free = np.concatenate(([False], ranges_m >= threshold_m, [False]))
    ends = np.flatnonzero(free[1:] != free[:-1])
    return [(int(a), int(b)) for a, b in zip(ends[::2], ends[1::2], strict=True)]


def best_gap(found: list[Gap], middle: int, kept: int | None) -> Gap | None:
    """The widest; the one that holds the last target if it is nearly as wide; of equals the one nearer to ahead."""
    if not found:
        return None
    if kept is not None:
        widest = max(b - a for a, b in found)
        for a, b in found:
            if a <= kept < b and b - a >= 0.7 * widest:
                return a, b
    return max(found, key=lambda gap: (gap[1] - gap[0], -abs(gap[0] + gap[1] - 1 - 2 * middle)))


def aim(ranges_m: Float64s, gap: Gap, pull: float, kept: int | None, keep_bins: int) -> int:
    """Step 6: the farthest bin of the gap, pulled towards the gap's middle; near the last target it is favoured."""
    a, b = gap
    inside = ranges_m[a:b]
    if kept is not None:
        inside = inside + 0.05 * inside.max() * (np.abs(np.arange(a, b) - kept) <= keep_bins)
    best = np.flatnonzero(inside >= inside.max() - 1e-9)
    # of equally far bins the middle one
    farthest = a + int(best[len(best) // 2])
    return round(farthest + pull * ((a + b - 1) / 2.0 - farthest))


def _painted(ranges_m: Float64s, value_m: Float64s, width_rad: Float64s, step_rad: float) -> Float64s:
    """The least of all values whose width holds a bin."""
    k: NDArray[np.intp] = (width_rad / step_rad).astype(np.intp)
    count = 2 * k + 1
    source = np.repeat(np.arange(len(ranges_m)), count)
    first = np.cumsum(count) - count
    target = source - k.take(source) + np.arange(len(source)) - first.take(source)
    inside = (target >= 0) & (target < len(ranges_m))
    out = ranges_m.copy()
    np.minimum.at(out, target[inside], value_m.take(source[inside]))
    return out
