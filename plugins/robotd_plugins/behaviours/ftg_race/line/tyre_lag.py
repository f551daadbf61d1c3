"""Slip angles take time to build up: until they have, a car goes less sideways than its yaw rate will make it go."""

from __future__ import annotations

import math

from robotd.world.clock import NS_PER_S

_STILL_MPS = 1.0


class TyreLag:
    """Sideways velocity follows the tyres' force as a first-order lag of speed over (stiffness / mass), so that it is
    slower the faster the car and the less its tyres hold (Rajamani, Vehicle Dynamics and Control, 2012, eq. 2.31 for a
    yaw rate that is given). Call once a plan.

    slip_rad: of the rear axle with all the grip, `grip_mps2`, sideways.
    """

    def __init__(self, slip_rad: float, grip_mps2: float) -> None:
        self._rad_per_mps2 = slip_rad / grip_mps2
        self._slip_rad = 0.0
        self._at_ns = 0

    def missing_rad(self, speed_mps: float, yaw_rate_radps: float, now_ns: int, after_s: float) -> float:
        """By how much farther left the course will be `after_s` from now than with the slip of a steady bend."""
        steady = self._rad_per_mps2 * speed_mps * yaw_rate_radps
        passed_s, self._at_ns = max(now_ns - self._at_ns, 0) / NS_PER_S, now_ns
        if speed_mps < _STILL_MPS:
            self._slip_rad = steady
            return 0.0
        lag_s = self._rad_per_mps2 * speed_mps
        self._slip_rad = steady + (self._slip_rad - steady) * math.exp(-passed_s / lag_s)
        return (steady - self._slip_rad) * math.exp(-after_s / lag_s)
