"""Lay the returns of a scan on walls: Gauss-Newton on the plane, robust, with a prior where the walls say nothing.

The walls are whatever tells a distance and its slope for any point: a key frame, or the distance field of a map.
Method: point-to-line distances (Censi, An ICP variant using a point-to-line metric, ICRA 2008), Cauchy weights, and a
prior about the pose that was expected, so that the way along a corridor without features comes from the odometry.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np

from robotd.world.geometry import wrap_rad
from robotd.world.messages import Float64s

FAR_M: Final = 99.0
"""The distance to a wall that is not known."""
_SMALL_M: Final = 0.004
_SMALL_RAD: Final = 0.001
Pose = tuple[float, float, float]


class Walls(Protocol):
    """Where walls are."""

    def look(self, x_m: Float64s, y_m: Float64s) -> tuple[Float64s, Float64s, Float64s]:
        """For points (n,): signed distance to the wall beside each, and the x and y of its slope (a unit normal).

        A point beside which no wall is known has a distance greater than any that counts, such as `FAR_M`.
        """
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """Where a scan fits. pose: of base. moved: the same seen in the base that was expected.

    distance_m: signed, of each return to its wall at `pose`, (n,), FAR_M or so where no wall is known. information:
    (3, 3), of x, y, yaw in base, from the walls alone. sigma_m: what the distances were weighed with.
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
        """1.4826 times the median size of the distances; nan without returns."""
        n = len(self.distance_m)
        return 1.4826 * float(np.partition(np.abs(self.distance_m), n // 2)[n // 2]) if n else math.nan

    def cost_m(self, most_m: float) -> float:
        """Mean size of the distances, each counted as `most_m` at most; that much without returns."""
        return float(np.minimum(np.abs(self.distance_m), most_m).mean()) if len(self.distance_m) else most_m


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
    cos, sin = math.cos(expected[2]), math.sin(expected[2])
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    hold = turn @ prior @ turn.T
    rows, moved = np.empty((3, len(x_m))), np.zeros(3)
    sigma2, cut2 = sigma_m * sigma_m, cut_m * cut_m
    information = np.zeros((3, 3))
    distance: Float64s = np.full(len(x_m), math.inf)
    at_x, at_y, yaw = expected
    for _ in range(iterations):
        cos, sin = math.cos(yaw), math.sin(yaw)
        x, y = cos * x_m - sin * y_m, sin * x_m + cos * y_m
        distance, rows[0], rows[1] = walls.look(x + at_x, y + at_y)
        np.subtract(rows[1] * x, rows[0] * y, out=rows[2])
        squared = distance * distance
        # Cauchy: 1 / sigma^2 for what lies on its wall
        weighted = rows * ((squared < cut2) / (squared + sigma2))
        information = weighted @ rows.T
        step = _solved(information + hold, weighted @ distance + hold @ moved)
        moved -= step
        at_x, at_y, yaw = (a + b for a, b in zip(expected, moved.tolist(), strict=True))
        # as far as the slope tells; the next look tells better
        distance = distance - step @ rows
        if abs(step[0]) + abs(step[1]) < _SMALL_M and abs(step[2]) < _SMALL_RAD:
            break
    dx, dy, dyaw = (turn.T @ moved).tolist()
    return Match((at_x, at_y, wrap_rad(yaw)), (dx, dy, dyaw), distance, turn.T @ information @ turn, sigma_m)


def _solved(h: Float64s, g: Float64s) -> Float64s:
    """The solution of h x = g for a symmetric 3 by 3 matrix, by cofactors: many times quicker than a general solver."""
    (a, b, c), (_, d, e), (_, _, f) = h.tolist()
    aa, bb, cc = d * f - e * e, c * e - b * f, b * e - c * d
    dd, ee, ff = a * f - c * c, b * c - a * e, a * d - b * b
    whole = a * aa + b * bb + c * cc
    u, v, w = g.tolist()
    return np.array(
        [(aa * u + bb * v + cc * w) / whole, (bb * u + dd * v + ee * w) / whole, (cc * u + ee * v + ff * w) / whole]
    )


def prior_of(along_m: float, across_m: float, yaw_rad: float) -> Float64s:
    """Information (3, 3) of an expected pose from its standard deviations in base."""
    prior = np.zeros((3, 3))
    prior[0, 0], prior[1, 1], prior[2, 2] = 1.0 / along_m**2, 1.0 / across_m**2, 1.0 / yaw_rad**2
    return prior
