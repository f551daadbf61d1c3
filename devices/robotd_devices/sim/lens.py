"""Where a point of the world falls in a picture, and which ray a pixel looks along: pinhole and wide-angle lenses.

Camera frame (optical): x right, y down, z along the axis. A pixel's centre has whole coordinates; (0, 0) is the top
left one, so that the axis meets a picture at ((width - 1) / 2, (height - 1) / 2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from robotd.world.messages import Float64s
from robotd.world.robot import Mount

_NEWTON_ROUNDS = 12


@dataclass(frozen=True, slots=True)
class Lens:
    """A centred lens. `distortion` None: a pinhole, r = f tan(theta).

    Otherwise the wide-angle model of Kannala and Brandt (IEEE TPAMI 28(8), 2006), as OpenCV's fisheye module names its
    terms: r = f (theta + k1 theta^3 + k2 theta^5 + k3 theta^7 + k4 theta^9); four zeros are the equidistant lens.
    fov_rad is the horizontal field of view from edge to edge; `vertical_fov_rad` None means square pixels, a value is
    for pictures that were squeezed to another shape. Raises ValueError for a field of view that the model cannot show.
    """

    width_px: int
    height_px: int
    fov_rad: float
    vertical_fov_rad: float | None = None
    distortion: tuple[float, float, float, float] | None = (0.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        for half in (self.fov_rad / 2.0, (self.vertical_fov_rad or self.fov_rad) / 2.0):
            if self.distortion is None and half >= math.pi / 2.0 - 0.01:
                raise ValueError("a pinhole shows less than 180 degrees: lower fov_rad or give distortion")
            steepness = np.diff(self._radius(np.linspace(0.0, half, 65)))
            if not (steepness > 0.0).all():
                raise ValueError(f"distortion {self.distortion} folds the picture within the field of view")

    @property
    def focal_px(self) -> tuple[float, float]:
        """Horizontal and vertical focal length."""
        fx = self.width_px / 2.0 / float(self._radius(np.array(self.fov_rad / 2.0)))
        if self.vertical_fov_rad is None:
            return fx, fx
        return fx, self.height_px / 2.0 / float(self._radius(np.array(self.vertical_fov_rad / 2.0)))

    @property
    def centre_px(self) -> tuple[float, float]:
        """Where the axis meets the picture."""
        return (self.width_px - 1) / 2.0, (self.height_px - 1) / 2.0

    def without_distortion(self) -> Lens:
        """The pinhole of the same focal length: the picture that undoing the distortion gives."""
        fx, fy = self.focal_px
        across, down = 2.0 * math.atan(self.width_px / 2.0 / fx), 2.0 * math.atan(self.height_px / 2.0 / fy)
        return Lens(self.width_px, self.height_px, across, down, None)

    def pixels(self, points: Float64s) -> Float64s:
        """Pixels (n, 2) of points or rays (n, 3) in the camera frame; nan where the lens cannot see them."""
        x, y, z = points.T
        side = np.hypot(x, y)
        theta = np.arctan2(side, z)
        seen = theta < (math.pi / 2.0 - 1e-6 if self.distortion is None else math.pi - 1e-6)
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = np.where(side > 0.0, self._radius(np.where(seen, theta, 0.0)) / side, 1.0)
        pixels = np.stack((x, y), axis=1) * scale[:, None] * self.focal_px + self.centre_px
        return np.where(seen[:, None], pixels, math.nan)

    def rays(self, pixels: Float64s) -> Float64s:
        """Unit rays (n, 3) in the camera frame that pixels (n, 2) look along; nan beyond 180 degrees off the axis."""
        plane = (pixels - self.centre_px) / self.focal_px
        radius = np.hypot(plane[:, 0], plane[:, 1])
        theta = self._angle(radius)
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = np.where(radius > 0.0, np.sin(theta) / radius, 1.0)
        rays = np.column_stack((plane * scale[:, None], np.cos(theta)))
        return np.where((theta < math.pi)[:, None], rays, math.nan)

    def undistorted(self, pixels: Float64s) -> Float64s:
        """Where pixels (n, 2) of this lens's picture are in that of `without_distortion()`."""
        return self.without_distortion().pixels(self.rays(pixels))

    def _radius(self, theta: Float64s) -> Float64s:
        if self.distortion is None:
            tangent: Float64s = np.tan(theta)
            return tangent
        square = theta * theta
        k1, k2, k3, k4 = self.distortion
        return theta * (1.0 + square * (k1 + square * (k2 + square * (k3 + square * k4))))

    def _angle(self, radius: Float64s) -> Float64s:
        if self.distortion is None:
            angle: Float64s = np.arctan(radius)
            return angle
        k1, k2, k3, k4 = self.distortion
        theta = np.array(radius, dtype=np.float64)
        for _ in range(_NEWTON_ROUNDS if any(self.distortion) else 0):
            square = theta * theta
            slope = 1.0 + square * (3.0 * k1 + square * (5.0 * k2 + square * (7.0 * k3 + square * 9.0 * k4)))
            theta = theta - (self._radius(theta) - radius) / np.maximum(slope, 1e-3)
        return np.maximum(theta, 0.0)


@dataclass(frozen=True, slots=True)
class FloorCamera:
    """A lens on a robot, over a flat floor at z = 0 of the base frame."""

    lens: Lens
    mount: Mount

    @property
    def camera_base(self) -> Float64s:
        """Rotation (3, 3) that turns a vector of the camera frame into one of base."""
        roll, pitch, yaw = self.mount.roll_rad, self.mount.pitch_rad, self.mount.yaw_rad
        about_z = np.array([[math.cos(yaw), -math.sin(yaw), 0.0], [math.sin(yaw), math.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
        about_y = np.array(
            [[math.cos(pitch), 0.0, math.sin(pitch)], [0.0, 1.0, 0.0], [-math.sin(pitch), 0.0, math.cos(pitch)]]
        )
        about_x = np.array(
            [[1.0, 0.0, 0.0], [0.0, math.cos(roll), -math.sin(roll)], [0.0, math.sin(roll), math.cos(roll)]]
        )
        optical = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
        turned: Float64s = about_z @ about_y @ about_x @ optical
        return turned

    def pixels(self, floor_m: Float64s) -> Float64s:
        """Pixels (n, 2) of floor points (n, 2) in base; nan for what is out of the lens's sight."""
        offset = np.column_stack((floor_m, np.zeros(len(floor_m)))) - (self.mount.x_m, self.mount.y_m, self.mount.z_m)
        return self.lens.pixels(offset @ self.camera_base)

    def rays_base(self, pixels: Float64s) -> Float64s:
        """Unit rays (n, 3) in base that pixels (n, 2) look along."""
        return self.lens.rays(pixels) @ self.camera_base.T

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
