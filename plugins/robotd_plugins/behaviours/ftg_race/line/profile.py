"""The speed along a closed line: a pass backwards for the brakes, one forwards for the motor, on the friction circle.

(Heilmeier et al., Minimum curvature trajectory planning and control for an autonomous race car, 2020, section 5.)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robotd.world.messages import Float64s


@dataclass(frozen=True, slots=True)
class LineLimits:
    """What a lap on the line is planned with, in m/s and m/s^2, as magnitudes."""

    top_mps: float
    lateral_mps2: float
    """In bends, at most."""
    accel_mps2: float
    brake_mps2: float
    grip_mps2: float
    """Radius of the friction circle in which bends, motor and brakes share."""


def speeds_mps(curvature_pm: Float64s, step_m: float, limits: LineLimits) -> Float64s:
    """Speed at each point (n,) of a closed line of equal steps."""
    kappa = np.abs(curvature_pm)
    cap2 = np.minimum(limits.lateral_mps2 / np.maximum(kappa, 1e-6), limits.top_mps**2)
    used = (kappa / limits.grip_mps2).tolist()
    v2 = cap2.tolist()
    n = len(v2)
    # from the slowest point, which neither pass changes
    first = int(np.argmin(cap2))
    order = [(first + k) % n for k in range(n + 1)]
    for way, most in ((order[::-1], 2.0 * limits.brake_mps2 * step_m), (order, 2.0 * limits.accel_mps2 * step_m)):
        at = way[0]
        for to in way[1:]:
            share = v2[at] * used[at]
            reached = v2[at] + (most * (1.0 - share * share) ** 0.5 if share < 1.0 else 0.0)
            if reached < v2[to]:
                v2[to] = reached
            at = to
    speed: Float64s = np.sqrt(np.array(v2))
    return speed


def lap_s(speed_mps: Float64s, step_m: float) -> float:
    """Time of a flying lap, each step at the mean of its ends' speeds."""
    return float((2.0 * step_m / (speed_mps + np.roll(speed_mps, -1))).sum())
