"""From pixels to rays and bearings and back, for calibrated pinhole and fisheye lenses. Pure numpy, whole arrays.

Camera frame (optical): x right, y down, z along the axis. A pixel's centre has whole coordinates, (0, 0) is the top
left one; so numbers that OpenCV's calibration gives are used as they are. Sources of the two models:

- `pinhole`: D. C. Brown, Close-range camera calibration, Photogrammetric Engineering 37(8), 1971, with the terms
  k1, k2, p1, p2, k3 in OpenCV's order.
- `fisheye`: J. Kannala and S. S. Brandt, IEEE TPAMI 28(8), 2006, theta_d = theta (1 + k1 theta^2 + ... + k4 theta^8),
  OpenCV's module `fisheye`. Unlike there, rays behind the camera's plane (theta above 90 degrees) are known too.

A distortion polynomial that was fitted inside the picture may turn back outside of it and then maps two directions to
one pixel. Whatever lies beyond that fold is nan here, in both directions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from robotd.world.messages import Float64s
from robotd.world.robot import Mount
from robotd.world.rotation import sensor_base

_ROUNDS = 60
_NEWTON_2D_ROUNDS = 30
_STEP_SMALL = 1e-14
_NEAR = 1e-9
_NO_TERM = 1e-12
_OPTICAL_BASE = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
_TERMS = {"pinhole": 5, "fisheye": 4}


@dataclass(frozen=True, slots=True)
class Lens:
    """One calibrated lens for pictures of `width_px` x `height_px`.

    distortion: k1, k2, p1, p2, k3 of a pinhole, k1 to k4 of a fisheye; missing ones at the end are 0.
    Raises ValueError for sizes or focal lengths that are not positive, and for too many terms.
    """

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    model: Literal["pinhole", "fisheye"] = "pinhole"
    distortion: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if min(self.width_px, self.height_px, self.fx_px, self.fy_px) <= 0:
            raise ValueError("a lens needs a positive width, height and focal length in pixels")
        most = _TERMS[self.model]
        if len(self.distortion) > most or not all(math.isfinite(term) for term in self.distortion):
            raise ValueError(f"a {self.model} lens takes up to {most} finite terms, not {self.distortion}")

    @classmethod
    def of_fov(
        cls,
        width_px: int,
        height_px: int,
        fov_rad: float,
        model: Literal["pinhole", "fisheye"] = "pinhole",
        *,
        vertical_fov_rad: float | None = None,
        distortion: tuple[float, ...] = (),
    ) -> Lens:
        """A centred lens by its horizontal field of view from edge to edge.

        Without distortion a fisheye is equidistant. vertical_fov_rad: for pictures that were squeezed to another shape;
        None means square pixels. Raises ValueError for a pinhole of 180 degrees or more, and for distortion that folds
        the picture within the field of view.
        """
        lens = cls(width_px, height_px, 1.0, 1.0, (width_px - 1) / 2.0, (height_px - 1) / 2.0, model, distortion)
        fx_px = width_px / 2.0 / lens._radius_at(fov_rad / 2.0)
        fy_px = fx_px if vertical_fov_rad is None else height_px / 2.0 / lens._radius_at(vertical_fov_rad / 2.0)
        return replace(lens, fx_px=fx_px, fy_px=fy_px)

    def scaled(self, width_px: int, height_px: int) -> Lens:
        """The same lens for pictures that were resized (not cropped) to another size."""
        across, down = width_px / self.width_px, height_px / self.height_px
        return replace(
            self,
            width_px=width_px,
            height_px=height_px,
            fx_px=self.fx_px * across,
            fy_px=self.fy_px * down,
            cx_px=(self.cx_px + 0.5) * across - 0.5,
            cy_px=(self.cy_px + 0.5) * down - 0.5,
        )

    def pixels(self, points: Float64s) -> Float64s:
        """Pixels (n, 2) of points or rays (n, 3) in the camera frame; nan where the lens cannot see them.

        Pixels may lie outside of the picture.
        """
        x, y, z = np.asarray(points, dtype=np.float64).T
        side = np.hypot(x, y)
        angle = np.arctan2(side, z)
        limit, terms = self._fold, self._radial
        if self.model == "fisheye":
            seen = angle <= limit
            argument = np.where(seen, angle, 0.0)
        else:
            seen = angle < math.pi / 2.0 - _NEAR
            argument = np.tan(np.where(seen, angle, 0.0))
            seen &= argument <= limit
        with np.errstate(invalid="ignore", divide="ignore"):
            direction = np.where(side > 0.0, np.stack((x, y)) / side, 0.0)
        plane = direction * argument * _odd_factor(argument, terms)
        if self.model == "pinhole":
            plane = plane + self._tangential(direction * argument)
        found = plane.T * (self.fx_px, self.fy_px) + (self.cx_px, self.cy_px)
        return np.where(seen[:, None], found, math.nan)

    def rays(self, pixels: Float64s) -> Float64s:
        """Unit rays (n, 3) in the camera frame that pixels (n, 2) look along, to rounding; nan beyond the fold."""
        plane = ((np.asarray(pixels, dtype=np.float64) - (self.cx_px, self.cy_px)) / (self.fx_px, self.fy_px)).T
        if self.model == "fisheye":
            radius = np.hypot(*plane)
            angle = _odd_inverse(radius, self._radial, self._fold)
            with np.errstate(invalid="ignore", divide="ignore"):
                direction = np.where(radius > 0.0, plane / radius, 0.0)
            rays = np.vstack((direction * np.sin(angle), np.cos(angle)))
        else:
            ideal = self._without_distortion(plane)
            rays = np.vstack((ideal, np.ones(ideal.shape[1]))) / np.sqrt(1.0 + (ideal**2).sum(axis=0))
        return np.where(np.isnan(rays).any(axis=0), math.nan, rays).T

    # ------------------------------------------------------------------------------------------- parts

    @property
    def _radial(self) -> tuple[float, ...]:
        """Factors of the even powers, the second one first."""
        terms = self.distortion + (0.0,) * (_TERMS[self.model] - len(self.distortion))
        return terms if self.model == "fisheye" else (terms[0], terms[1], terms[4])

    @property
    def _fold(self) -> float:
        """The largest argument up to which the radial polynomial rises: tan(theta), or theta for a fisheye."""
        slope = [1.0] + [(2 * i + 3) * k if abs(k) > _NO_TERM else 0.0 for i, k in enumerate(self._radial)]
        roots = np.roots(slope[::-1])
        folds = [float(root.real) for root in roots if abs(root.imag) < _NEAR * max(1.0, abs(root)) and root.real > 0.0]
        fold = math.sqrt(min(folds)) if folds else math.inf
        return min(fold, math.pi - _NEAR) if self.model == "fisheye" else fold

    def _radius_at(self, angle_rad: float) -> float:
        """How far off the centre, in focal lengths, a ray falls; raises ValueError where this lens shows none."""
        if not 0.0 < angle_rad < (math.pi / 2.0 if self.model == "pinhole" else math.pi):
            raise ValueError(f"a {self.model} lens cannot show {math.degrees(2.0 * angle_rad):g} degrees")
        argument = math.tan(angle_rad) if self.model == "pinhole" else angle_rad
        if argument > self._fold:
            raise ValueError(f"distortion {self.distortion} folds the picture within the field of view")
        return argument * float(_odd_factor(np.array(argument), self._radial))

    @property
    def _p(self) -> tuple[float, float]:
        terms = self.distortion + (0.0,) * (_TERMS["pinhole"] - len(self.distortion))
        return terms[2], terms[3]

    def _tangential(self, ideal: Float64s) -> Float64s:
        p1, p2 = self._p
        x, y = ideal
        square = x * x + y * y
        return np.stack(
            (2.0 * p1 * x * y + p2 * (square + 2.0 * x * x), p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y)
        )

    def _without_distortion(self, plane: Float64s) -> Float64s:
        """Ideal image points (2, n) of distorted ones: the radial part by itself, then Newton's method in the plane."""
        radius = np.hypot(*plane)
        terms, limit = self._radial, self._fold
        p1, p2 = self._p
        if not (p1 or p2):
            with np.errstate(invalid="ignore", divide="ignore"):
                return plane * np.where(radius > 0.0, _odd_inverse(radius, terms, limit) / radius, 1.0)
        # the tangential part may push a point that is near the fold over it: begin inside
        reach = _odd_inverse(np.minimum(radius, 0.999 * _reach(terms, limit)), terms, limit)
        with np.errstate(invalid="ignore", divide="ignore"):
            ideal = plane * np.where(radius > 0.0, reach / radius, 1.0)
        for _ in range(_NEWTON_2D_ROUNDS):
            x, y = ideal
            square = x * x + y * y
            factor, slope = _odd_factor(np.sqrt(square), terms), _factor_slope(square, terms)
            off_x, off_y = ideal * factor + self._tangential(ideal) - plane
            # the Jacobian is symmetric: both parts are gradients of a potential
            xx = factor + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
            yy = factor + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
            xy = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
            with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
                determinant = xx * yy - xy * xy
                step = np.stack((yy * off_x - xy * off_y, xx * off_y - xy * off_x)) / determinant
                ideal = ideal - step
            if not (np.abs(step) > _STEP_SMALL * (1.0 + np.abs(ideal))).any():
                break
        with np.errstate(invalid="ignore", over="ignore"):
            error = np.abs(ideal * _odd_factor(np.hypot(*ideal), terms) + self._tangential(ideal) - plane).max(axis=0)
            good = (error < _NEAR) & (determinant > 0.0) & (np.hypot(*ideal) <= limit)
        return np.where(good, ideal, math.nan)


@dataclass(frozen=True, slots=True)
class MountedLens:
    """A lens on a robot: pixels to directions in base. Directions begin at the camera, not at the base's origin."""

    lens: Lens
    mount: Mount

    @property
    def camera_base(self) -> Float64s:
        """Rotation (3, 3) that turns a vector of the camera frame into one of base."""
        turned: Float64s = sensor_base(self.mount) @ _OPTICAL_BASE
        return turned

    def rays_base(self, pixels: Float64s) -> Float64s:
        """Unit rays (n, 3) in base that pixels (n, 2) look along; nan where the lens gives none."""
        turned: Float64s = self.lens.rays(pixels) @ self.camera_base.T
        return turned

    def bearings_rad(self, pixels: Float64s) -> Float64s:
        """(n, 2): bearing (0 ahead, left positive) and elevation (up positive) of what pixels (n, 2) show."""
        x, y, z = self.rays_base(pixels).T
        return np.stack((np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))), axis=1)

    def pixels(self, points_base_m: Float64s) -> Float64s:
        """Pixels (n, 2) of points (n, 3) in base; nan where the lens cannot see them."""
        mount = self.mount
        offset = np.asarray(points_base_m, dtype=np.float64) - (mount.x_m, mount.y_m, mount.z_m)
        return self.lens.pixels(offset @ self.camera_base)


# ---------------------------------------------------------- odd polynomials a (1 + k1 a^2 + k2 a^4 + ...)


def _odd_factor(argument: Float64s, terms: tuple[float, ...]) -> Float64s:
    square = argument * argument
    factor = np.zeros_like(square)
    for k in reversed(terms):
        factor = (factor + k) * square
    return 1.0 + factor


def _factor_slope(square: Float64s, terms: tuple[float, ...]) -> Float64s:
    """Derivative of the factor by the square of its argument."""
    slope = np.zeros_like(square)
    for power in range(len(terms), 0, -1):
        slope = slope * square + power * terms[power - 1]
    return slope


def _reach(terms: tuple[float, ...], limit: float) -> float:
    """The largest value up to the fold."""
    if math.isinf(limit):
        return math.inf
    return limit * float(_odd_factor(np.array(limit), terms))


def _odd_inverse(value: Float64s, terms: tuple[float, ...], limit: float) -> Float64s:
    """The argument below the fold that gives each value (>= 0); nan beyond. Newton, kept inside of a bracket."""
    if not any(terms):
        return np.where(value <= limit, value, math.nan)
    wanted = np.where(value <= _reach(terms, limit), value, 0.0)
    low, high = np.zeros_like(wanted), np.full_like(wanted, limit if math.isfinite(limit) else 1.0)
    while math.isinf(limit):
        short = high * _odd_factor(high, terms) < wanted
        if not short.any():
            break
        high = np.where(short, 2.0 * high, high)
    argument = np.minimum(wanted, high)
    for _ in range(_ROUNDS):
        square = argument * argument
        factor = _odd_factor(argument, terms)
        off = argument * factor - wanted
        low, high = np.where(off <= 0.0, argument, low), np.where(off >= 0.0, argument, high)
        with np.errstate(invalid="ignore", divide="ignore"):
            better = argument - off / (factor + 2.0 * square * _factor_slope(square, terms))
        inside = (better >= low) & (better <= high)
        better = np.where(inside, better, (low + high) / 2.0)
        moved = np.abs(better - argument)
        argument = better
        if not (moved > _STEP_SMALL * (1.0 + argument)).any():
            break
    return np.where(value <= _reach(terms, limit), argument, math.nan)
