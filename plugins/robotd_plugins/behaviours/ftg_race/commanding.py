"""Commanding: the speed that the way allows, and the two limiters between a plan and the motor and servo."""

from __future__ import annotations

import math
from dataclasses import dataclass

from robotd_plugins.behaviours.ftg_race.body import Body

GRAVITY_MPS2 = 9.81
_SHAPE = 1.6
"""Of the limit that bends and the motor share: 2 is a circle. Speeding up takes load off the axle that steers."""
_LEAST_ROOM = 0.25
"""A little stays along the car whatever the bend takes, so that it can always slow down."""
_IN_BEND, _SPED_UP_MPS = 0.5, 0.1
"""In a bend with more than this share of grip a car that was told to speed up by more than this does not brake in the
same moment: its front wheels are still turned for the load that brakes put back on them.
"""


@dataclass(frozen=True, slots=True)
class SpeedPolicy:
    """Speeds in m/s, accelerations in m/s^2 as magnitudes, gains in 1/s.

    The seed's rule is `by_gains`; `ramp` is for every planner. Where the speed controller of the car is slack, that is
    follows v' = (wanted - v) / response, the wanted speed leads by acceleration x response so that the acceleration
    comes out; with a response of 0 the wanted speed itself climbs.
    """

    top_mps: float
    stop_distance_m: float
    front_gain_ps: float
    """k1: of the free distance ahead, less the stopping distance."""
    steer_slowdown_mps_per_rad: float
    """k2."""
    target_gain_ps: float
    """k3: of the distance to the target."""
    accel_mps2: float
    brake_mps2: float
    grip_mps2: float
    accel_response_s: float
    brake_response_s: float
    settle_s: float
    """In so long a difference of speed is to be made up."""

    def by_gains(self, target_m: float, front_m: float, steering_rad: float) -> float:
        """The seed's section 7: min(k3 d_target, k1 (d_front - stop), v_max - k2 |steering|), never below 0."""
        front = self.front_gain_ps * (front_m - self.stop_distance_m)
        steer = self.top_mps - self.steer_slowdown_mps_per_rad * abs(steering_rad)
        return max(min(self.target_gain_ps * target_m, front, steer, self.top_mps), 0.0)

    def stoppable_mps(self, free_m: float, speed_mps: float, delay_s: float) -> float:
        """The speed from which the car stops in time: the way until the command acts is lost, then v^2 = 2 a d."""
        left = free_m - self.stop_distance_m - speed_mps * delay_s
        return math.sqrt(2.0 * self.brake_mps2 * left) if left > 0.0 else 0.0

    def ramp(
        self, wanted_mps: float, speed_mps: float, before_mps: float, lateral_mps2: float, period_s: float
    ) -> float:
        """What the motor is told. A stop is never delayed.

        speed_mps: measured; before_mps: what was told last; lateral_mps2: that the tyres hold at the same time.
        """
        if wanted_mps <= 0.0:
            return 0.0
        if self.accel_response_s <= 0.0:
            room = self._brake_room(lateral_mps2)
            most, least = self.accel_mps2 * room * period_s, self.brake_mps2 * room * period_s
            return min(max(wanted_mps, max(before_mps, speed_mps) - least), before_mps + most, self.top_mps)
        along = self.along_mps2(wanted_mps, speed_mps, lateral_mps2)
        sped_up = before_mps > speed_mps + _SPED_UP_MPS
        if along < 0.0 and sped_up and abs(lateral_mps2) > _IN_BEND * self.grip_mps2:
            along = 0.0
        response_s = self.accel_response_s if along > 0.0 else self.brake_response_s
        return min(max(speed_mps + along * max(response_s, period_s), 0.0), self.top_mps)

    def along_mps2(self, wanted_mps: float, speed_mps: float, lateral_mps2: float) -> float:
        """The acceleration along the car that comes of a wanted speed beside a bend; negative for brakes."""
        asked = (wanted_mps - speed_mps) / self.settle_s
        if asked <= 0.0:
            return max(asked, -self.brake_mps2 * self._brake_room(lateral_mps2))
        used = min(abs(lateral_mps2) / self.grip_mps2, 1.0)
        room = float((1.0 - used**_SHAPE) ** (1.0 / _SHAPE))
        most = self.accel_mps2 * max(room, _LEAST_ROOM)
        if self.accel_response_s > 0.0:
            # a slack controller is told no more than the top speed, and so speeds up less and less towards it
            most = min(most, max(self.top_mps - speed_mps, 0.0) / self.accel_response_s)
        return min(asked, most)

    def _brake_room(self, lateral_mps2: float) -> float:
        """The share of grip that a bend leaves for the brakes."""
        used = min(abs(lateral_mps2) / self.grip_mps2, 1.0)
        return max(math.sqrt(1.0 - used * used), _LEAST_ROOM)


class SteeringSmoother:
    """A first-order filter and a rate limit, both in time and not in cycles; keeps the last angle.

    time_constant_s and rate_radps of 0 switch them off.
    """

    def __init__(self, body: Body, time_constant_s: float, rate_radps: float) -> None:
        self._most_rad = body.max_steering_rad
        self._time_constant_s = time_constant_s
        self._rate_radps = rate_radps
        self.steering_rad = 0.0

    def step(self, wanted_rad: float, period_s: float) -> float:
        """The angle for the servo."""
        angle = min(max(wanted_rad, -self._most_rad), self._most_rad)
        if self._time_constant_s > 0.0:
            share = 1.0 - math.exp(-period_s / self._time_constant_s)
            angle = self.steering_rad + share * (angle - self.steering_rad)
        if self._rate_radps > 0.0:
            most = self._rate_radps * period_s
            angle = self.steering_rad + min(max(angle - self.steering_rad, -most), most)
        self.steering_rad = angle
        return angle


def iir_time_constant_s(beta: float, cycle_s: float) -> float:
    """The time constant of y += beta (x - y) at one step a cycle; 0 for beta 1."""
    return 0.0 if beta >= 1.0 else -cycle_s / math.log(1.0 - beta)


def steering_rad(curvature_pm: float, speed_mps: float, body: Body, understeer_rad_per_mps2: float) -> float:
    """Front wheel angle for a curvature: Ackermann, and what the tyres' slip takes away (Rajamani 2012, eq. 3.12)."""
    return math.atan(body.wheelbase_m * curvature_pm) + understeer_rad_per_mps2 * speed_mps * speed_mps * curvature_pm
