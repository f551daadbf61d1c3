"""Does the outline of a robot touch a wall or a post, and how far is it from that?"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from robotd.world.geometry import convex_hull, half_planes
from robotd.world.messages import Float64s
from robotd_devices.sim.polyline import distance_to_segments_m


class Obstacles(Protocol):
    """What can be run into: a map, or what stands in a scene at one time."""

    @property
    def segments_m(self) -> Float64s:
        """(m, 4)."""
        ...

    @property
    def circles_m(self) -> Float64s:
        """(k, 3)."""
        ...


class Outline:
    """The convex hull of a footprint, moved about among obstacles.

    footprint_m: corners in base, at least three that span an area (ValueError otherwise).
    """

    def __init__(self, footprint_m: Sequence[tuple[float, float]], things: Obstacles) -> None:
        self._hull_m = convex_hull(footprint_m)
        self._normals, self._offsets = half_planes(self._hull_m)
        self._edges_m = np.hstack((self._hull_m, np.roll(self._hull_m, -1, axis=0)))
        self._segments_m = things.segments_m
        self._circles_m = things.circles_m
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
        return bool(self.contacts_rad(x_m, y_m, yaw_rad))

    def contacts_rad(self, x_m: float, y_m: float, yaw_rad: float) -> tuple[float, ...]:
        """Bearings in base of every wall and post that the outline at this pose touches."""
        found: list[float] = []
        if len(self._segments_m):
            cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
            ends_m = (self._segments_m.reshape(-1, 2) - (x_m, y_m)) @ np.array([[cos, -sin], [sin, cos]])
            found += self._crossed(ends_m[0::2], ends_m[1::2])
        if len(self._circles_m):
            found += self.meets(x_m, y_m, yaw_rad, self._circles_m).values()
        return tuple(found)

    def meets(self, x_m: float, y_m: float, yaw_rad: float, circles_m: Float64s) -> dict[int, float]:
        """Which circles (k, 3) the outline at this pose touches: index to bearing in base."""
        cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
        centres_m = (circles_m[:, :2] - (x_m, y_m)) @ np.array([[cos, -sin], [sin, cos]])
        inside = (centres_m @ self._normals - self._offsets).max(axis=1) <= 0.0
        gap_m = np.where(inside, 0.0, distance_to_segments_m(centres_m, self._edges_m))
        touched = np.flatnonzero(gap_m <= circles_m[:, 2]).tolist()
        return {at: math.atan2(float(centres_m[at, 1]), float(centres_m[at, 0])) for at in touched}

    def _crossed(self, start_m: Float64s, end_m: Float64s) -> list[float]:
        """Clips each segment by each side of the hull (Cyrus and Beck, 1978); something left means contact.

        Gives the bearing of the middle of what is left of each.
        """
        outside = start_m @ self._normals - self._offsets
        change = end_m @ self._normals - self._offsets - outside
        with np.errstate(divide="ignore", invalid="ignore"):
            at = -outside / change
        enter = np.maximum(np.where(change < 0.0, at, -math.inf).max(axis=1), 0.0)
        leave = np.minimum(np.where(change > 0.0, at, math.inf).min(axis=1), 1.0)
        beside = ((change == 0.0) & (outside > 0.0)).any(axis=1)
        crossed = np.flatnonzero(~beside & (enter <= leave))
        share = ((enter + leave) / 2.0)[crossed, None]
        middle_m = start_m[crossed] + share * (end_m - start_m)[crossed]
        return [math.atan2(y, x) for x, y in middle_m.tolist()]
