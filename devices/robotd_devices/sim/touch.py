"""Does the outline of a robot touch a wall or a post, and how far is it from that?"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from robotd.world.geometry import convex_hull, half_planes
from robotd.world.messages import Float64s
from robotd_devices.sim.maps import WorldMap, distance_to_segments_m


class Outline:
    """The convex hull of a footprint, moved about in a map.

    footprint_m: corners in base, at least three that span an area (ValueError otherwise).
    """

    def __init__(self, footprint_m: Sequence[tuple[float, float]], world: WorldMap) -> None:
        self._hull_m = convex_hull(footprint_m)
        self._normals, self._offsets = half_planes(self._hull_m)
        self._edges_m = np.hstack((self._hull_m, np.roll(self._hull_m, -1, axis=0)))
        self._segments_m = world.segments_m
        self._circles_m = world.circles_m
        self.radius_m = float(np.hypot(self._hull_m[:, 0], self._hull_m[:, 1]).max())

    def clearance_m(self, x_m: float, y_m: float) -> float:
        """At most the distance that the base may travel from (x, y) in any way before it touches; inf in the open."""
        nearest_m = math.inf
        here_m = np.array([[x_m, y_m]])
        if len(self._segments_m):
            # the distance from the point to each wall, all at once
            nearest_m = float(distance_to_segments_m(here_m, self._segments_m)[0])
        if len(self._circles_m):
            gap = np.hypot(self._circles_m[:, 0] - x_m, self._circles_m[:, 1] - y_m) - self._circles_m[:, 2]
            nearest_m = min(nearest_m, float(np.abs(gap).min()))
        return nearest_m - self.radius_m

    def touches(self, x_m: float, y_m: float, yaw_rad: float) -> bool:
        """Whether the outline at this pose has a point in common with a wall or a post."""
        cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
        to_base = np.array([[cos, -sin], [sin, cos]])
        if len(self._segments_m):
            ends_m = (self._segments_m.reshape(-1, 2) - (x_m, y_m)) @ to_base
            if self._crossed(ends_m[0::2], ends_m[1::2]):
                return True
        if len(self._circles_m):
            centres_m = (self._circles_m[:, :2] - (x_m, y_m)) @ to_base
            inside = (centres_m @ self._normals - self._offsets).max(axis=1) <= 0.0
            gap_m = np.where(inside, 0.0, distance_to_segments_m(centres_m, self._edges_m))
            return bool((gap_m <= self._circles_m[:, 2]).any())
        return False

    def _crossed(self, start_m: Float64s, end_m: Float64s) -> bool:
        """Clips each segment by each side of the hull (Cyrus and Beck, 1978); something left means contact."""
        outside = start_m @ self._normals - self._offsets
        change = end_m @ self._normals - self._offsets - outside
        with np.errstate(divide="ignore", invalid="ignore"):
            at = -outside / change
        enter = np.where(change < 0.0, at, -math.inf).max(axis=1)
        leave = np.where(change > 0.0, at, math.inf).min(axis=1)
        beside = ((change == 0.0) & (outside > 0.0)).any(axis=1)
        return bool((~beside & (np.maximum(enter, 0.0) <= np.minimum(leave, 1.0))).any())
