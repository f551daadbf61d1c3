"""From a pixel to the place on the floor that it shows, for a wide-angle camera on a robot. Scalars, a few a frame.

Source: the wide-angle model of Kannala and Brandt (IEEE TPAMI 28(8), 2006), r = f (theta + k1 theta^3 + ... +
k4 theta^9), whose four terms OpenCV's fisheye module names k1 to k4; all zero is the equidistant lens.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from robotd import Config
from robotd.world.robot import Mount

_NEWTON_ROUNDS = 8


@dataclass(frozen=True, slots=True)
class FloorView:
    """A centred lens over a flat floor at z = 0 of the base frame.

    fov_rad: from the picture's left edge to its right one; vertical_fov_rad None: square pixels. distortion None: a
    pinhole. Raises ValueError for a pinhole that would see 180 degrees or more.
    """

    mount: Mount
    fov_rad: float
    vertical_fov_rad: float | None = None
    distortion: tuple[float, float, float, float] | None = (0.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if self.distortion is None and max(self.fov_rad, self.vertical_fov_rad or 0.0) >= math.pi - 0.02:
            raise ValueError("a pinhole shows less than 180 degrees: lower fov_rad, or give distortion")

    @property
    def knows_floor(self) -> bool:
        """Whether the camera's height is known, without which nothing can be told in metres."""
        return self.mount.z_m > 0.0

    def floor_m(self, x: float, row: float, aspect: float) -> tuple[float, float]:
        """The place on the floor, (ahead, left) in base, that the picture shows.

        x: -1 (left) to 1 (right). row: 0 (top) to 1 (bottom). aspect: the picture's width over its height.
        (nan, nan) at or above the horizon.
        """
        if not self.knows_floor or math.isnan(x) or math.isnan(row):
            return math.nan, math.nan
        u = x * self._radius(self.fov_rad / 2.0)
        v = 2.0 * row - 1.0
        if self.vertical_fov_rad is None:
            v *= self._radius(self.fov_rad / 2.0) / aspect
        else:
            v *= self._radius(self.vertical_fov_rad / 2.0)
        radius = math.hypot(u, v)
        theta = self._angle(radius)
        side = math.sin(theta) / radius if radius > 1e-12 else 1.0
        # the optical frame (right, down, along) turned into base axes before the mount's own rotation
        ray = self._mounted(math.cos(theta), -u * side, -v * side)
        if ray[2] > -1e-3:
            return math.nan, math.nan
        reach = self.mount.z_m / -ray[2]
        return self.mount.x_m + reach * ray[0], self.mount.y_m + reach * ray[1]

    def _mounted(self, x: float, y: float, z: float) -> tuple[float, float, float]:
        """A vector of the camera's mount (x along the axis, y left, z up) in base: roll, then pitch, then yaw."""
        cos, sin = math.cos(self.mount.roll_rad), math.sin(self.mount.roll_rad)
        y, z = cos * y - sin * z, sin * y + cos * z
        cos, sin = math.cos(self.mount.pitch_rad), math.sin(self.mount.pitch_rad)
        x, z = cos * x + sin * z, -sin * x + cos * z
        cos, sin = math.cos(self.mount.yaw_rad), math.sin(self.mount.yaw_rad)
        return cos * x - sin * y, sin * x + cos * y, z

    def _radius(self, theta: float) -> float:
        if self.distortion is None:
            return math.tan(theta)
        k1, k2, k3, k4 = self.distortion
        square = theta * theta
        return theta * (1.0 + square * (k1 + square * (k2 + square * (k3 + square * k4))))

    def _angle(self, radius: float) -> float:
        if self.distortion is None:
            return math.atan(radius)
        k1, k2, k3, k4 = self.distortion
        theta = radius
        for _ in range(_NEWTON_ROUNDS if any(self.distortion) else 0):
            square = theta * theta
            slope = 1.0 + square * (3.0 * k1 + square * (5.0 * k2 + square * (7.0 * k3 + square * 9.0 * k4)))
            theta -= (self._radius(theta) - radius) / max(slope, 1e-3)
        return min(max(theta, 0.0), math.pi)


class LensConfig(Config):
    """The camera's lens; the defaults are a JetBot's wide-angle camera."""

    fov_rad: float = 2.1
    """Horizontal field of view, from edge to edge."""
    vertical_fov_rad: float | None = None
    """Only for pictures that were squeezed to another shape (a JetBot's 224 x 224: 1.75)."""
    distortion: tuple[float, float, float, float] | None = (0.0, 0.0, 0.0, 0.0)
    """Terms k1 to k4 of the wide-angle model (zeros: equidistant); null: a pinhole without distortion."""
