"""A car whose tyres slide: the dynamic single track with a friction circle, a servo with delay and a drive train.

Model and parameters of the f1tenth car: Althoff, Koschi, Manzinger, CommonRoad: Composable benchmarks for motion
planning on roads (IV 2017), vehicle models 7, and the f1tenth_gym's values for it. Where we differ: that model's
tyres are linear without end; here the force of each axle is held inside its friction circle, so that a car that is
too fast slides instead of gripping at any acceleration.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Final

from robotd.world.messages import Drive, Steer

GRAVITY_MPS2: Final = 9.81
_ROLLS_BELOW_MPS = 1.0
"""Slip angles are not defined at rest: below this the car rolls where its wheels point."""
_BEND = 4.0
"""How sharply the tyre's force bends from its linear part into the limit."""


@dataclass(frozen=True, slots=True)
class RaceCar:
    """One car. Cornering stiffnesses are per radian and newton of load, before friction: the force is mu C Fz alpha."""

    mass_kg: float
    inertia_kgm2: float
    front_m: float
    """From the centre of mass to the front axle."""
    rear_m: float
    """From the centre of mass to the rear axle, where `base` is."""
    height_m: float
    """Of the centre of mass, for the load that moves between the axles."""
    front_stiffness: float
    rear_stiffness: float
    mu: float
    max_steering_rad: float
    steering_rate_radps: float
    steering_delay_s: float
    """From a command to the first motion of the servo."""
    steering_lag_s: float
    accel_mps2: float
    """Of the motor at low speed."""
    full_power_to_mps: float
    """Above this speed the motor's acceleration falls with 1/speed."""
    brake_mps2: float
    speed_gain_up_ps: float
    """The speed controller asks for this acceleration for each m/s that is missing."""
    speed_gain_down_ps: float
    drive_lag_s: float
    top_mps: float
    reverse_mps: float
    length_m: float
    width_m: float

    @property
    def wheelbase_m(self) -> float:
        """From axle to axle."""
        return self.front_m + self.rear_m

    def footprint_m(self) -> tuple[tuple[float, float], ...]:
        """Corners of the body in base (rear axle), which is centred over the two axles."""
        front = self.wheelbase_m / 2.0 + self.length_m / 2.0
        rear, side = front - self.length_m, self.width_m / 2.0
        return ((front, side), (front, -side), (rear, -side), (rear, side))


F1TENTH: Final = RaceCar(
    mass_kg=3.74, inertia_kgm2=0.04712, front_m=0.15875, rear_m=0.17145, height_m=0.074, front_stiffness=4.718,
    rear_stiffness=5.4562, mu=1.0489, max_steering_rad=0.4189, steering_rate_radps=3.2, steering_delay_s=0.02,
    steering_lag_s=0.01, accel_mps2=9.51, full_power_to_mps=7.319, brake_mps2=9.51, speed_gain_up_ps=4.755,
    speed_gain_down_ps=19.02, drive_lag_s=0.01, top_mps=20.0, reverse_mps=5.0, length_m=0.58, width_m=0.31,
)  # fmt: skip
"""The 1/10 car of the f1tenth_gym; servo lag and drive lag are ours."""

TT02D: Final = RaceCar(
    mass_kg=1.75, inertia_kgm2=0.021, front_m=0.1285, rear_m=0.1285, height_m=0.05, front_stiffness=4.7,
    rear_stiffness=5.4, mu=0.85, max_steering_rad=math.radians(25.0), steering_rate_radps=4.0, steering_delay_s=0.02,
    steering_lag_s=0.04, accel_mps2=4.0, full_power_to_mps=4.0, brake_mps2=5.0, speed_gain_up_ps=6.0,
    speed_gain_down_ps=10.0, drive_lag_s=0.05, top_mps=5.0, reverse_mps=1.0, length_m=0.40, width_m=0.19,
)  # fmt: skip
"""Seed 004's car (Tamiya TT-02D, wheelbase 0.257 m, 25 degrees); masses, servo and motor are estimates."""


class RaceTrack:
    """One car on a grid of physics: `command` at any time, `step` once a grid step.

    mu: in place of the car's own. saturates: false gives the linear tyres of the published simulators, whose force has
    no limit; only for comparison with numbers that were found on them.
    """

    def __init__(self, car: RaceCar, step_s: float, mu: float | None = None, saturates: bool = True) -> None:
        self.car = car
        self._tyre = _tyre if saturates else _linear
        self.mu = car.mu if mu is None else mu
        self._step_s = step_s
        self._delay: deque[float] = deque([0.0] * round(car.steering_delay_s / step_s))
        self._servo_keep = math.exp(-step_s / car.steering_lag_s) if car.steering_lag_s > 0.0 else 0.0
        self._drive_keep = math.exp(-step_s / car.drive_lag_s) if car.drive_lag_s > 0.0 else 0.0
        self.wanted = Steer()
        self.vx_mps = 0.0
        """Of the centre of mass, along the car."""
        self.vy_mps = 0.0
        self.wz_radps = 0.0
        self.steering_rad = 0.0
        """Where the front wheels are."""
        self._ax_mps2 = 0.0
        self._drag_mps2 = 0.0
        """Of the turned front wheels; the speed controller makes up for it, as one with an integral part does."""

    def command(self, steer: Steer) -> None:
        """What motor and servo are told from now on, cut at what the car can do."""
        car, most = self.car, self.car.max_steering_rad
        speed = min(max(steer.speed_mps, -car.reverse_mps), car.top_mps)
        self.wanted = Steer(speed, min(max(steer.steering_rad, -most), most))

    def step(self) -> Drive:
        """One grid step; the velocity of base (rear axle's middle) during it, in its own frame."""
        self._servo()
        asked_mps2 = self._motor()
        if self.vx_mps < _ROLLS_BELOW_MPS:
            self._roll(asked_mps2)
        else:
            self._slide(asked_mps2)
        return Drive(self.vx_mps, self.wz_radps, self.vy_mps - self.wz_radps * self.car.rear_m)

    def _servo(self) -> None:
        self._delay.append(self.wanted.steering_rad)
        target = self._delay.popleft()
        most = self.car.steering_rate_radps * self._step_s
        move = (1.0 - self._servo_keep) * (target - self.steering_rad)
        self.steering_rad += min(max(move, -most), most)

    def _motor(self) -> float:
        """Acceleration that the wheels ask of the floor, m/s^2, after the drive train's lag and the motor's limits."""
        car, v = self.car, self.vx_mps
        missing = self.wanted.speed_mps - v
        faster = missing > 0.0 if v >= 0.0 else missing < 0.0
        asked = (car.speed_gain_up_ps if faster else car.speed_gain_down_ps) * missing
        power = car.accel_mps2 * min(1.0, car.full_power_to_mps / max(abs(v), 1e-6))
        most = power if faster else car.brake_mps2
        asked = min(max(asked, -most), most)
        self._ax_mps2 = asked + self._drive_keep * (self._ax_mps2 - asked)
        limit = 0.98 * self.mu * GRAVITY_MPS2
        return min(max(self._ax_mps2 + self._drag_mps2, -limit), limit)

    def _roll(self, ax_mps2: float) -> None:
        """The kinematic single track about the centre of mass."""
        car = self.car
        self.vx_mps += ax_mps2 * self._step_s
        if self.wanted.speed_mps == 0.0 and abs(self.vx_mps) < 0.01:
            self.vx_mps = self._ax_mps2 = 0.0
        self._drag_mps2 = 0.0
        self.wz_radps = self.vx_mps * math.tan(self.steering_rad) / car.wheelbase_m
        self.vy_mps = self.wz_radps * car.rear_m

    def _slide(self, ax_mps2: float) -> None:
        """Tyre forces of both axles inside their friction circles, then one semi-implicit step."""
        car, step_s, v = self.car, self._step_s, self.vx_mps
        load = GRAVITY_MPS2 * car.rear_m - ax_mps2 * car.height_m, GRAVITY_MPS2 * car.front_m + ax_mps2 * car.height_m
        used = ax_mps2 / GRAVITY_MPS2
        grip = math.sqrt(max(self.mu * self.mu - used * used, 0.0))
        slip_front = self.steering_rad - math.atan2(self.vy_mps + car.front_m * self.wz_radps, v)
        slip_rear = -math.atan2(self.vy_mps - car.rear_m * self.wz_radps, v)
        per_kg = 1.0 / car.wheelbase_m
        front = per_kg * load[0] * self._tyre(self.mu * car.front_stiffness * slip_front, grip)
        rear = per_kg * load[1] * self._tyre(self.mu * car.rear_stiffness * slip_rear, grip)
        turned = front * math.cos(self.steering_rad)
        lever = car.mass_kg / car.inertia_kgm2
        self.wz_radps += lever * (car.front_m * turned - car.rear_m * rear) * step_s
        self.vy_mps += (turned + rear - v * self.wz_radps) * step_s
        self._drag_mps2 = front * math.sin(self.steering_rad) - self.vy_mps * self.wz_radps
        self.vx_mps += (ax_mps2 - self._drag_mps2) * step_s


def _tyre(linear: float, limit: float) -> float:
    """Force over load: `linear` while small, never above `limit`."""
    if limit <= 1e-6:
        return 0.0
    share = abs(linear) / limit
    return linear / math.pow(1.0 + math.pow(share, _BEND), 1.0 / _BEND)


def _linear(linear: float, limit: float) -> float:
    return linear
