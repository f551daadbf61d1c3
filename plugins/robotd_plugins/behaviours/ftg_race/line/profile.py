"""The speed along a closed line: a pass backwards for the brakes, one forwards for the motor, on the friction circle.

(Heilmeier et al., Minimum curvature trajectory planning and control for an autonomous race car, 2020, section 5.)
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from robotd.world.messages import Float64s

_SHAPE = 1.3
"""Of the limit that bends and pedals share: 2 is a circle, 1 a diamond. Speeding up unloads the axle that steers, and
braking the other one, so that a short car with a high centre of mass stays well inside the circle: fitted to
sqrt(g^2 - a^2) (1 - 0.045 a), which is the f1tenth car's.
"""
_BRAKE_SHAPE, _BRAKE_SHAPE_PER_MPS, _LEAST_SHAPE = 1.4, 0.045, 0.9
"""The same while braking into a bend, less the faster the car is: the tyres' slip then takes longer to build up, and a
car that still brakes hard runs wide. Found on AUT, both ways round.
"""


@dataclass(frozen=True, slots=True)
class LineLimits:
    """What a lap on the line is planned with, in m/s and m/s^2, as magnitudes."""

    top_mps: float
    lateral_mps2: float
    """In bends, at most."""
    accel_mps2: float
    brake_mps2: float
    grip_mps2: float
    """That bends, motor and brakes share."""

    def along_mps2(self, lateral_mps2: float) -> float:
        """What the tyres have left for motor or brakes in a bend."""
        return self._left_mps2(lateral_mps2, _SHAPE)

    def braking_mps2(self, lateral_mps2: float, speed_mps: float) -> float:
        """What they have left for braking into a bend."""
        return self._left_mps2(lateral_mps2, max(_BRAKE_SHAPE - _BRAKE_SHAPE_PER_MPS * speed_mps, _LEAST_SHAPE))

    def _left_mps2(self, lateral_mps2: float, shape: float) -> float:
        share = abs(lateral_mps2) / self.grip_mps2
        return float(self.grip_mps2 * (1.0 - share**shape) ** (1.0 / shape)) if share < 1.0 else 0.0


def speeds_mps(curvature_pm: Float64s, step_m: float, limits: LineLimits) -> Float64s:
    """Speed at each point (n,) of a closed line of equal steps."""
    kappa = np.abs(curvature_pm)
    cap2 = np.minimum(limits.lateral_mps2 / np.maximum(kappa, 1e-6), limits.top_mps**2)
    bend = kappa.tolist()
    v2 = cap2.tolist()
    n = len(v2)
    # from the slowest point, which neither pass changes
    first = int(np.argmin(cap2))
    order = [(first + k) % n for k in range(n + 1)]
    for way, is_back in ((order[::-1], True), (order, False)):
        at = way[0]
        for to in way[1:]:
            if v2[at] < v2[to]:
                lateral = v2[at] * max(bend[at], bend[to])
                if is_back:
                    along = min(limits.brake_mps2, limits.braking_mps2(lateral, math.sqrt(v2[at])))
                else:
                    along = min(limits.accel_mps2, limits.along_mps2(lateral))
                v2[to] = min(v2[to], v2[at] + 2.0 * step_m * along)
            at = to
    speed: Float64s = np.sqrt(np.array(v2))
    return speed


def lap_s(speed_mps: Float64s, step_m: float) -> float:
    """Time of a flying lap, each step at the mean of its ends' speeds."""
    return float((2.0 * step_m / (speed_mps + np.roll(speed_mps, -1))).sum())
