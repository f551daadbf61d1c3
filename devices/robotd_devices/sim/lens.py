"""A lens over a flat floor: where points of the floor fall in a picture, and which of them a pixel shows."""

from __future__ import annotations

import math

import numpy as np

from robotd.world.lens import MountedLens
from robotd.world.messages import Float64s


class FloorCamera(MountedLens):
    """A lens on a robot, over a flat floor at z = 0 of the base frame."""

    __slots__ = ()

    def floor_px(self, floor_m: Float64s) -> Float64s:
        """Pixels (n, 2) of floor points (n, 2) in base; nan for what is out of the lens's sight."""
        return self.pixels(np.column_stack((floor_m, np.zeros(len(floor_m)))))

    def floor_m(self, pixels: Float64s) -> Float64s:
        """Floor points (n, 2) in base that pixels (n, 2) show; nan at and above the horizon."""
        rays = self.rays_base(pixels)
        with np.errstate(divide="ignore", invalid="ignore"):
            reach = np.where(rays[:, 2] < -1e-6, -self.mount.z_m / rays[:, 2], math.nan)
        return rays[:, :2] * reach[:, None] + (self.mount.x_m, self.mount.y_m)


def floor_to_base(floor_map_m: Float64s, pose: tuple[float, float, float]) -> Float64s:
    """Floor points (n, 2) of the map in the base frame of a robot at `pose` (x, y, yaw)."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    moved: Float64s = (floor_map_m - pose[:2]) @ np.array([[cos, -sin], [sin, cos]])
    return moved
