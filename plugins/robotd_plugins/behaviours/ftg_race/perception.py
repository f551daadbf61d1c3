"""Perception: from the beams of any lidar to one range for each bin of bearing, with what was not seen kept apart."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from robotd.world.messages import Float32s, Float64s, LidarScan
from robotd_plugins.behaviours.ftg_race.planning_types import FREE, HIT, MISSING, Motion, Scan

_FILL_RAD = math.radians(3.0)
"""A narrower hole is filled from its neighbours."""
_HOLE_M = 1.0
_ALONE_M = 0.3
_MEDIAN_OF_BENT = 0.6745 * math.sqrt(6.0)
_NOISE_EVERY = 8
"""Scans between two looks at how much the ranges err."""


class ScanPreprocessor:
    """Bins of `step_rad`, the nearest return of each, from right to left over -fov_rad to fov_rad.

    Bins without a beam of this lidar are left out. A range below `range_min_m` becomes 0: something touches there.
    median: ranges are smoothed over so many bins, towards nearer only (1: not at all). confirm: a return that stands
    alone, much nearer than both neighbours and than its bin in the scan before, counts only when it is seen again.
    """

    def __init__(
        self,
        step_rad: float,
        fov_rad: float,
        range_min_m: float,
        range_max_m: float,
        median: int = 1,
        confirm: bool = False,
    ) -> None:
        self._step_rad = step_rad
        self._fov_rad = fov_rad
        self._range_min_m = range_min_m
        self._range_max_m = range_max_m
        self._median = median
        self._confirm = confirm
        self._angles: Float32s | None = None
        self._yaw_rad = 0.0
        self._before: Float64s | None = None
        self._scans = 0
        self._noise_m = 0.0

    def process(self, scan: LidarScan, motion: Motion) -> Scan:
        """The binned scan. Raises ValueError for a scan without a beam in the field of view."""
        if self._angles is not scan.angles_rad or self._yaw_rad != scan.yaw_rad:
            self._lay_out(scan)
        if self._scans % _NOISE_EVERY == 0:
            self._noise_m = noise_m(scan.ranges_m)
        self._scans += 1
        most_m = min(self._range_max_m, scan.range_max_m)
        beams = scan.ranges_m if self._order is None else scan.ranges_m[self._order]
        # the nearest in each bin; nan only where no beam of the bin was measured
        ranges: Float64s = np.fmin.reduceat(beams, self._begin).astype(np.float64)
        state = (ranges >= most_m).astype(np.int8)
        # nan compares false, and its sum is nan
        if math.isnan(float(np.add.reduce(np.minimum(ranges, most_m)))):
            missing = np.isnan(ranges)
            ranges, state = _fill(ranges, state, missing, max(1, int(_FILL_RAD / self._step_rad)))
        np.minimum(ranges, most_m, out=ranges)
        if ranges.min() < self._range_min_m:
            ranges[ranges < self._range_min_m] = 0.0
        if self._confirm:
            ranges = self._confirmed(ranges)
        if self._median > 1:
            windows = np.lib.stride_tricks.sliding_window_view(np.pad(ranges, self._median // 2, "edge"), self._median)
            ranges = np.fmin(ranges, np.median(windows, axis=1)).astype(np.float64)
        return Scan(
            self._bearing, ranges, state, self._unit, self._share, self._step_rad, most_m, scan.x_m, scan.y_m, motion,
            self._noise_m,
        )  # fmt: skip

    def _lay_out(self, scan: LidarScan) -> None:
        """Which beams fall into which bin; kept while the lidar hands over the same bearings."""
        bearing = scan.angles_rad.astype(np.float64) + scan.yaw_rad
        bearing = np.where(np.abs(bearing) > math.pi, np.remainder(bearing + math.pi, math.tau) - math.pi, bearing)
        bins = np.rint(bearing / self._step_rad).astype(np.intp)
        inside = np.flatnonzero(np.abs(bins * self._step_rad) <= self._fov_rad + 1e-9)
        if not len(inside):
            raise ValueError("the lidar has no beam in the field of view: check fov_rad and the lidar's mount")
        order = inside[np.argsort(bins[inside], kind="stable")]
        sorted_bins = bins[order]
        self._begin: NDArray[np.intp] = np.flatnonzero(np.concatenate(([True], np.diff(sorted_bins) > 0)))
        in_order = len(order) == len(bins) and bool((np.diff(order) == 1).all())
        self._order: NDArray[np.intp] | None = None if in_order else order
        self._bearing: Float64s = (sorted_bins[self._begin] * self._step_rad).astype(np.float64)
        self._unit: Float64s = np.stack((np.cos(self._bearing), np.sin(self._bearing)))
        shares = np.arange(len(bins)) / max(1, len(bins) - 1)
        counts = np.diff(np.append(self._begin, len(order)))
        self._share: Float64s = np.add.reduceat(shares[order], self._begin) / counts
        self._angles, self._yaw_rad = scan.angles_rad, scan.yaw_rad

    def _confirmed(self, ranges: Float64s) -> Float64s:
        before, self._before = self._before, ranges
        if before is None or len(before) != len(ranges):
            return ranges
        beside = np.minimum(np.append(ranges[1:], ranges[-1]), np.append(ranges[0], ranges[:-1]))
        alone = (ranges < beside - _ALONE_M) & (ranges < before - _ALONE_M)
        return np.where(alone, beside, ranges) if alone.any() else ranges


def noise_m(ranges_m: Float32s) -> float:
    """By how much ranges (n,) err, one sigma: from the median size of their second differences, since walls are smooth.

    Of normal errors it is 0.6745 sqrt(6) sigma. 0 where nothing was measured.
    """
    with np.errstate(invalid="ignore"):
        bent = np.abs((ranges_m[:-2] + ranges_m[2:]) - 2.0 * ranges_m[1:-1])
    bent = bent[np.isfinite(bent)]
    if not len(bent):
        return 0.0
    middle = len(bent) // 2
    return float(np.partition(bent, middle)[middle]) / _MEDIAN_OF_BENT


def _fill(
    ranges: Float64s, state: NDArray[np.int8], missing: NDArray[np.bool_], most_bins: int
) -> tuple[Float64s, NDArray[np.int8]]:
    """Narrow holes take the nearer of their two neighbours. Wide ones, and holes at the edge, are MISSING, as near as
    their neighbours or a metre; where nothing at all was measured, 0.
    """
    n = len(ranges)
    at = np.arange(n)
    left = np.maximum.accumulate(np.where(missing, -1, at))
    right = np.minimum.accumulate(np.where(missing, n, at)[::-1])[::-1]
    inner = missing & (left >= 0) & (right < n) & (right - left - 1 <= most_bins)
    near = np.minimum(
        np.where(left >= 0, ranges.take(left, mode="clip"), np.inf),
        np.where(right < n, ranges.take(right, mode="clip"), np.inf),
    )
    wide = np.full(n, 0.0) if missing.all() else np.minimum(near, _HOLE_M)
    filled: Float64s = np.where(inner, near, np.where(missing, wide, ranges))
    state = np.where(inner, np.where(np.isinf(near), FREE, HIT), np.where(missing, MISSING, state))
    return filled, state.astype(np.int8)
