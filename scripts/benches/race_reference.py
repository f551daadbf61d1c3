"""Planners to measure against: plain follow-the-gap, written from its published description.

Evans, Trumpp, Caccamo, Jahncke, Betz, Jordaan, Engelbrecht, Unifying F1TENTH Autonomous Racing: Survey, Methods and
Benchmarks (arXiv 2402.18558), section on the follow-the-gap method: smooth the scan, clear a bubble of beams about the
nearest return, take a gap, steer half the bearing of its deepest (averaged) beam, and choose one of three speeds by
the steering. Bubble 160 beams, windows of 3 and 80 beams, 10 m, 5, 5 and 3 m/s
as in its published parameters.
"""

from __future__ import annotations

import math

import numpy as np

from robotd.world.messages import LidarScan, Odometry, Steer


class PlainFollowTheGap:
    """speeds_mps: straight ahead, in bends, in corners; angles_rad: steering at which each begins."""

    def __init__(
        self,
        speeds_mps: tuple[float, float, float] = (5.0, 5.0, 3.0),
        angles_rad: tuple[float, float] = (0.0785, 0.174),
    ) -> None:
        self._speeds_mps = speeds_mps
        self._angles_rad = angles_rad

    def __call__(self, scan: LidarScan, odometry: Odometry, now_ns: int) -> Steer:
        keep = slice(135, len(scan.ranges_m) - 135)
        ranges = np.nan_to_num(scan.ranges_m[keep].astype(np.float64), nan=0.0, posinf=30.0)
        ranges = np.clip(np.convolve(ranges, np.full(3, 1.0 / 3.0), "same"), 0.0, 10.0)
        nearest = int(ranges.argmin())
        ranges[max(0, nearest - 160) : min(len(ranges) - 1, nearest + 160)] = 0.0
        free = np.flatnonzero(np.diff(np.concatenate(([False], ranges > 0.0, [False])).astype(np.int8)))
        gaps = [(a, b) for a, b in free.reshape(-1, 2).tolist() if b - a > 5]
        if not gaps:
            return Steer(0.0, 0.0)
        begin, end = gaps[-1]
        deep = np.convolve(ranges[begin:end], np.full(80, 1.0 / 80.0), "same")
        best = begin + int(deep.argmax())
        bearing = (best - len(ranges) / 2.0) * (math.tau / len(scan.ranges_m))
        steering = min(max(bearing / 2.0, -0.4), 0.4)
        fast, middle, slow = self._speeds_mps
        at = abs(steering)
        return Steer(slow if at > self._angles_rad[1] else middle if at > self._angles_rad[0] else fast, steering)
