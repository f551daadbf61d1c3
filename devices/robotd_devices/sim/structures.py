"""Walls, posts and boxes in a picture: one cast of rays a frame, then a comparison for each pixel."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from robotd.world.messages import Bytes2D, Float32s, Float64s
from robotd_devices.sim.lens import FloorCamera
from robotd_devices.sim.rays import cast
from robotd_devices.sim.scene import Things

_BIN_RAD = math.radians(0.25)
_PANEL_M = 0.35
"""Walls are made of panels that differ a little."""


@dataclass(frozen=True, slots=True, eq=False)
class Hidden:
    """What structures hide: shown, uint8 (h, w), 255 where one is seen; reach_m, float32 (h, w), how far off it is,
    along the floor.
    """

    shown: Bytes2D
    reach_m: Float32s


class Structures:
    """Upright surfaces of one height over one camera's picture.

    rays_base: unit rays (h, w, 3). A pixel shows a structure where its ray gets there above the floor and below the
    structure's top; the structure's distance is taken by the ray's bearing, in steps of a quarter of a degree.
    """

    def __init__(self, camera: FloorCamera, rays_base: Float64s, height_m: float) -> None:
        mount = camera.mount
        self._at_m = (mount.x_m, mount.y_m)
        level = np.hypot(rays_base[..., 0], rays_base[..., 1])
        with np.errstate(divide="ignore", invalid="ignore"):
            rise = rays_base[..., 2] / level
            floor_m = np.where(rise < -1e-9, -mount.z_m / rise, math.inf)
            # here a ray that looks up passes over the structure, and one from above first comes to it
            top_m = np.where(np.abs(rise) > 1e-9, (height_m - mount.z_m) / rise, math.inf)
        self._looks_over = looks_over = mount.z_m > height_m
        seen = np.isfinite(rise)
        from_m = np.where(seen & looks_over, np.where(top_m > 0.0, top_m, math.inf), 0.0)
        to_m = np.where(seen, floor_m, 0.0)
        if not looks_over:
            to_m = np.minimum(to_m, np.where(rise > 1e-9, top_m, math.inf))
        bearing = np.where(seen, np.arctan2(rays_base[..., 1], rays_base[..., 0]), 0.0)
        low_rad = float(bearing.min())
        self._bins = np.round((bearing - low_rad) / _BIN_RAD).astype(np.intp)
        self._bearings_rad = low_rad + np.arange(int(self._bins.max()) + 1, dtype=np.float64) * _BIN_RAD
        self._from_m, self._to_m = from_m.astype(np.float32), to_m.astype(np.float32)

    def draw(self, picture: Bytes2D, pose: tuple[float, float, float], things: Things) -> Hidden | None:
        """Draws them into a picture (h, w, 3) in place, grey; None where nothing is seen of any."""
        import cv2

        if not len(things.segments_m) and not len(things.circles_m):
            return None
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        x_m, y_m = self._at_m
        origin_m = np.array((pose[0] + cos * x_m - sin * y_m, pose[1] + sin * x_m + cos * y_m))
        bearings_rad = self._bearings_rad + pose[2]
        reach_m = cast(origin_m, bearings_rad, things.segments_m, things.circles_m)
        there = reach_m.astype(np.float32).take(self._bins)
        shown = np.asarray(cv2.compare(there, self._to_m, cv2.CMP_LT), dtype=np.uint8)
        if self._looks_over:
            shown &= np.asarray(cv2.compare(there, self._from_m, cv2.CMP_GE), dtype=np.uint8)
        known = np.where(np.isfinite(reach_m), reach_m, 0.0)
        panels = _panels(origin_m[0] + known * np.cos(bearings_rad), origin_m[1] + known * np.sin(bearings_rad))
        cv2.copyTo(cv2.cvtColor(panels.take(self._bins), cv2.COLOR_GRAY2BGR), shown, picture)
        return Hidden(shown, there)


def _panels(x_m: Float64s, y_m: Float64s) -> Bytes2D:
    """Grey levels of walls by place, uint8 (n,): the same place always looks the same."""
    panel = np.floor(x_m / _PANEL_M + 0.25) * 12.9898 + np.floor(y_m / _PANEL_M + 0.25) * 78.233
    return np.asarray(110.0 + 70.0 * np.mod(np.sin(panel) * 43758.5453, 1.0), dtype=np.uint8)
