"""Wheels and twists of differential, mecanum and Ackermann bases, and exact dead reckoning on the plane.

Formulas and test vectors: research report on devices, section 5 (REP-103; a positive wheel speed drives forward).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, TypeAlias

from robotd.world.geometry import wrap_rad
from robotd.world.messages import Drive, Steer


@dataclass(frozen=True, slots=True)
class Differential:
    """Two driven wheels `track_m` apart."""

    track_m: float
    wheel_radius_m: float = 0.0325
    is_holonomic: ClassVar[bool] = False
    takes: ClassVar[type[Drive]] = Drive

    def rim_speeds(self, drive: Drive) -> tuple[float, float]:
        """Left and right rim speed in m/s for a body velocity."""
        half = drive.wz_radps * self.track_m / 2.0
        return drive.vx_mps - half, drive.vx_mps + half

    def body(self, left_mps: float, right_mps: float) -> Drive:
        """Body velocity from rim speeds."""
        return Drive((left_mps + right_mps) / 2.0, (right_mps - left_mps) / self.track_m)


@dataclass(frozen=True, slots=True)
class Mecanum:
    """Four wheels whose rollers form an X seen from above."""

    wheelbase_m: float
    track_m: float
    wheel_radius_m: float
    is_holonomic: ClassVar[bool] = True
    takes: ClassVar[type[Drive]] = Drive

    @property
    def arm_m(self) -> float:
        """Half wheelbase plus half track."""
        return (self.wheelbase_m + self.track_m) / 2.0

    def wheel_speeds(self, drive: Drive) -> tuple[float, float, float, float]:
        """Front left, front right, rear left, rear right in rad/s."""
        vx, vy, spin, r = drive.vx_mps, drive.vy_mps, self.arm_m * drive.wz_radps, self.wheel_radius_m
        return (vx - vy - spin) / r, (vx + vy + spin) / r, (vx + vy - spin) / r, (vx - vy + spin) / r

    def body(self, fl: float, fr: float, rl: float, rr: float) -> Drive:
        """Body velocity from wheel speeds in rad/s (least squares)."""
        r = self.wheel_radius_m / 4.0
        return Drive(
            vx_mps=r * (fl + fr + rl + rr),
            vy_mps=r * (-fl + fr + rl - rr),
            wz_radps=r / self.arm_m * (-fl + fr - rl + rr),
        )


@dataclass(frozen=True, slots=True)
class Ackermann:
    """A car; the reference point is the middle of the rear axle."""

    wheelbase_m: float
    track_m: float
    max_steering_rad: float
    is_holonomic: ClassVar[bool] = False
    takes: ClassVar[type[Steer]] = Steer

    def body(self, steer: Steer) -> Drive:
        """Body velocity of a car without slip."""
        return Drive(steer.speed_mps, steer.speed_mps * math.tan(steer.steering_rad) / self.wheelbase_m)


Kinematics: TypeAlias = Differential | Mecanum | Ackermann


def steer_to_drive(steer: Steer, wheelbase_m: float) -> Drive:
    """A car's command as a body velocity. The other way is never converted: a car cannot turn in place."""
    return Drive(steer.speed_mps, steer.speed_mps * math.tan(steer.steering_rad) / wheelbase_m)


def saturate(drive: Drive, vx_mps: float, vy_mps: float, wz_radps: float) -> Drive:
    """The largest velocity of the same direction and curvature within the limits (all three divided by one factor)."""
    if abs(drive.vx_mps) <= vx_mps and abs(drive.vy_mps) <= vy_mps and abs(drive.wz_radps) <= wz_radps:
        return drive
    factor = max(
        1.0,
        abs(drive.vx_mps) / vx_mps if vx_mps > 0.0 else (math.inf if drive.vx_mps else 1.0),
        abs(drive.vy_mps) / vy_mps if vy_mps > 0.0 else (math.inf if drive.vy_mps else 1.0),
        abs(drive.wz_radps) / wz_radps if wz_radps > 0.0 else (math.inf if drive.wz_radps else 1.0),
    )
    if factor == 1.0:
        return drive
    return Drive(drive.vx_mps / factor, drive.wz_radps / factor, drive.vy_mps / factor)


def advance(x_m: float, y_m: float, yaw_rad: float, drive: Drive, dt_s: float) -> tuple[float, float, float]:
    """Pose after moving at a constant body velocity for `dt_s`: exact on SE(2)."""
    phi = drive.wz_radps * dt_s
    if abs(phi) < 1e-6:
        s, c = 1.0 - phi * phi / 6.0, phi / 2.0
    else:
        s, c = math.sin(phi) / phi, (1.0 - math.cos(phi)) / phi
    dx = (s * drive.vx_mps - c * drive.vy_mps) * dt_s
    dy = (c * drive.vx_mps + s * drive.vy_mps) * dt_s
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    return x_m + dx * cos - dy * sin, y_m + dx * sin + dy * cos, wrap_rad(yaw_rad + phi)
