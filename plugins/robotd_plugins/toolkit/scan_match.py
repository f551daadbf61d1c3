"""Lay the returns of a scan on walls: Gauss-Newton on the plane, robust, with a prior where the walls say nothing.

The walls are whatever tells a distance and its slope for any point: a key frame, or the distance field of a map.
Method: point-to-line distances (Censi, An ICP variant using a point-to-line metric, ICRA 2008), Cauchy weights, and a
prior about the pose that was expected, so that the way along a corridor without features comes from the odometry.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from robotd.world.geometry import wrap_rad
from robotd.world.messages import Float64s

_SMALL_M = 0.002
_SMALL_RAD = 0.0005
Pose = tuple[float, float, float]


class Walls(Protocol):
    """Where walls are."""

    def look(self, x_m: Float64s, y_m: Float64s) -> tuple[Float64s, Float64s, Float64s]:
        """For points (n,): signed distance to the wall beside each, and the x and y of its slope (a unit normal).

        A point beside which no wall is known has the distance inf.
        """
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """Where a scan fits. pose: of base. moved: the same seen in the base that was expected.

    distance_m: signed, of each return to its wall at `pose`, (n,), inf where no wall is known. information: (3, 3), of
    x, y, yaw in base, from the walls alone. sigma_m: what the distances were weighed with.
    """

    pose: Pose
    moved: Pose
    distance_m: Float64s
    information: Float64s
    sigma_m: float

    @property
    def explained_share(self) -> float:
        """Of the returns, those within 3 sigma of a wall."""
        return float(np.count_nonzero(np.abs(self.distance_m) < 3.0 * self.sigma_m)) / max(len(self.distance_m), 1)

    @property
    def residual_m(self) -> float:
        """1.4826 times the median size of the distances to known walls; nan without any."""
        size = np.abs(self.distance_m)
        known = size[size < math.inf]
        if not len(known):
            return math.nan
        middle = len(known) // 2
        return 1.4826 * float(np.partition(known, middle)[middle])


def align(
    x_m: Float64s,
    y_m: Float64s,
    expected: Pose,
    prior: Float64s,
    walls: Walls,
    sigma_m: float,
    cut_m: float,
    iterations: int = 3,
) -> Match:
    """The pose at which returns (n,) in base lie on the walls, near `expected`.

    prior: (3, 3), information of `expected` about x, y (in base) and yaw. sigma_m: how far a return lies from its wall
    by noise. cut_m: those farther away have no say.
    """
    xi = np.zeros(3)
    pose = expected
    rows = np.empty((3, len(x_m)))
    per_sigma2 = 1.0 / (sigma_m * sigma_m)
    information = np.zeros((3, 3))
    distance: Float64s = np.full(len(x_m), math.inf)
    for _ in range(iterations):
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        distance, nx, ny = walls.look(cos * x_m - sin * y_m + pose[0], sin * x_m + cos * y_m + pose[1])
        near = np.abs(distance) < cut_m
        e = np.where(near, distance, 0.0)
        # the slope as base sees it
        np.multiply(nx, cos, out=rows[0])
        rows[0] += sin * ny
        np.multiply(ny, cos, out=rows[1])
        rows[1] -= sin * nx
        np.multiply(rows[1], x_m, out=rows[2])
        rows[2] -= rows[0] * y_m
        weight = near / (1.0 + e * e * per_sigma2)
        weight *= per_sigma2
        weighted = rows * weight
        information = weighted @ rows.T
        step = np.linalg.solve(information + prior, -(weighted @ e + prior @ xi))
        xi += step
        pose = _moved(expected, xi)
        if abs(step[0]) < _SMALL_M and abs(step[1]) < _SMALL_M and abs(step[2]) < _SMALL_RAD:
            # so small a step changes the distances by what their slope says
            distance = distance + step @ rows
            break
    else:
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        distance, _, _ = walls.look(cos * x_m - sin * y_m + pose[0], sin * x_m + cos * y_m + pose[1])
    return Match(pose, (float(xi[0]), float(xi[1]), float(xi[2])), distance, information, sigma_m)


def _moved(pose: Pose, xi: Float64s) -> Pose:
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    dx, dy, turn = float(xi[0]), float(xi[1]), float(xi[2])
    return pose[0] + cos * dx - sin * dy, pose[1] + sin * dx + cos * dy, wrap_rad(pose[2] + turn)


def prior_of(along_m: float, across_m: float, yaw_rad: float) -> Float64s:
    """Information (3, 3) of an expected pose from its standard deviations in base."""
    return np.diag([1.0 / along_m**2, 1.0 / across_m**2, 1.0 / yaw_rad**2])
