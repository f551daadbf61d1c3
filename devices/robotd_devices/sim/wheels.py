"""Motors and wheels as they are: they lag, differ, slip, and tell the odometry something slightly wrong."""

from __future__ import annotations

import math

import numpy as np
from pydantic import Field

from robotd.authoring.config import Config
from robotd.world.clock import NS_PER_S
from robotd.world.kinematics import Ackermann, Differential, Kinematics, Mecanum, advance
from robotd.world.messages import STOP, Drive, Float64s

_STILL = 1e-6
_DRAWS = 512


class WheelSettings(Config):
    """Imperfections of a simulated base. 0 everywhere is a perfect one."""

    lag_s: float = Field(default=0.08, ge=0.0, le=2.0)
    """Time constant of the first-order lag from a command to the wheels' speed."""
    motor_error: float = Field(default=0.03, ge=0.0, le=0.3)
    """Each motor turns faster or slower than told by a fixed share up to this; encoders see it, commands do not."""
    wheel_error: float = Field(default=0.02, ge=0.0, le=0.3)
    """Each wheel is larger or smaller than the kinematics say by a fixed share up to this; nothing on board sees it."""
    track_error: float = Field(default=0.02, ge=0.0, le=0.3)
    """The true arm about which the base turns differs from the kinematics by a fixed share up to this."""
    slip_std: float = Field(default=0.02, ge=0.0, le=0.5)
    """Standard deviation of each wheel's slip as a share of its speed; it drifts over `slip_time_s`."""
    slip_time_s: float = Field(default=0.3, gt=0.0, le=10.0)
    """Correlation time of the slip (a first-order Gauss-Markov process)."""
    dead_band_mps: float = Field(default=0.01, ge=0.0, le=0.5)
    """A wheel that is told less rim speed than this stands."""
    encoder_ticks: int = Field(default=1320, ge=0, le=1_000_000)
    """Counts of an encoder for one turn of its wheel (11 lines, 4 edges, gear 1:30); 0: it knows every angle."""
    battery_share: float = Field(default=0.0, ge=0.0, le=1.0)
    """Share of the motors' speed that follows the battery's voltage: 0 is a speed control, 1 a bare motor."""


class Wheels:
    """The wheels of one base on the grid of physics.

    Three velocities follow from one command: what the motors do (`lag_s`, `motor_error`), what the encoders report
    of it (in whole counts, through the nominal kinematics), and what the floor makes of it (`wheel_error`,
    `track_error`, slip). Raises ValueError for a car, which has no such wheels.
    """

    def __init__(self, kinematics: Kinematics, settings: WheelSettings, rng: np.random.Generator, step_ns: int) -> None:
        if isinstance(kinematics, Ackermann):
            raise ValueError("sim_base has differential or mecanum wheels: a car is simulated by sim_car")
        self._kinematics: Differential | Mecanum = kinematics
        count = 2 if isinstance(kinematics, Differential) else 4
        self._step_s = step_ns / NS_PER_S
        # a differential base counts metres of rim, a mecanum one radians of wheel
        self._per_m = 1.0 if isinstance(kinematics, Differential) else 1.0 / kinematics.wheel_radius_m
        turn = math.tau * kinematics.wheel_radius_m * self._per_m
        self._tick = turn / settings.encoder_ticks if settings.encoder_ticks else 0.0
        self._dead_band = settings.dead_band_mps * self._per_m
        self._battery_share = settings.battery_share
        self._motor_scale = tuple(
            1.0 + float(e) for e in rng.uniform(-settings.motor_error, settings.motor_error, count)
        )
        self._floor_scale = tuple(
            1.0 + float(e) for e in rng.uniform(-settings.wheel_error, settings.wheel_error, count)
        )
        self._track_scale = 1.0 + float(rng.uniform(-settings.track_error, settings.track_error))
        self._keep = math.exp(-self._step_s / settings.lag_s) if settings.lag_s > 0.0 else 0.0
        self._slip_keep = math.exp(-self._step_s / settings.slip_time_s)
        self._slip_gain = settings.slip_std * math.sqrt(1.0 - self._slip_keep**2)
        self._rng = rng
        self._draws: Float64s = np.empty((0, count))
        self._drawn = 0
        self._slips = [settings.slip_std * float(d) for d in rng.standard_normal(count)]
        self._wanted: tuple[float, ...] = (0.0,) * count
        self._speeds: tuple[float, ...] = (0.0,) * count
        self.odometry: tuple[float, float, float] = (0.0, 0.0, 0.0)
        """Base in the odometry frame as the encoders told at the last report: x, y, yaw."""
        self.measured: Drive = STOP
        """Body velocity of the turning motors through the nominal kinematics, before it is counted."""
        self._turned = [0.0] * count
        self._counted = [0.0] * count
        self._unreported = 0

    def command(self, drive: Drive, supply: float = 1.0) -> None:
        """What the motors are told from the next step on. A differential base has no use for `vy_mps`.

        supply: the battery's voltage as a share of the full one.
        """
        wheels = self._kinematics
        raw = wheels.rim_speeds(drive) if isinstance(wheels, Differential) else wheels.wheel_speeds(drive)
        power = 1.0 + self._battery_share * (supply - 1.0)
        self._wanted = tuple(
            speed * scale * power if abs(speed) >= self._dead_band else 0.0
            for speed, scale in zip(raw, self._motor_scale, strict=True)
        )

    def step(self) -> Drive:
        """One grid step; the body's true velocity during it."""
        keep = self._keep
        self._unreported += 1
        speeds = tuple(want + keep * (speed - want) for want, speed in zip(self._wanted, self._speeds, strict=True))
        if all(-_STILL < speed < _STILL for speed in speeds) and not any(self._wanted):
            self._speeds = (0.0,) * len(speeds)
            self.measured = STOP
            return STOP
        self._speeds = speeds
        self.measured = self._body(speeds)
        if self._tick == 0.0:
            self.odometry = advance(*self.odometry, self.measured, self._step_s)
        else:
            self._turned = [turned + speed * self._step_s for turned, speed in zip(self._turned, speeds, strict=True)]
        self._drift_slips()
        real = self._body(
            tuple(
                s * scale * (1.0 - slip) for s, scale, slip in zip(speeds, self._floor_scale, self._slips, strict=True)
            )
        )
        return Drive(real.vx_mps, real.wz_radps / self._track_scale, real.vy_mps)

    def report(self) -> Drive:
        """Reads the encoders: takes their counts into the odometry, and tells the mean velocity since the last time."""
        if self._tick == 0.0 or self._unreported == 0:
            return self.measured
        over_s = self._unreported * self._step_s
        counted = [math.floor(turned / self._tick) * self._tick for turned in self._turned]
        told = self._body(tuple((new - old) / over_s for new, old in zip(counted, self._counted, strict=True)))
        self.odometry = advance(*self.odometry, told, over_s)
        self._counted, self._unreported = counted, 0
        return told

    def _body(self, speeds: tuple[float, ...]) -> Drive:
        return self._kinematics.body(*speeds)

    def _drift_slips(self) -> None:
        if self._slip_gain == 0.0:
            return
        if self._drawn == len(self._draws):
            self._draws = self._rng.standard_normal((_DRAWS, len(self._slips)))
            self._drawn = 0
        draw = self._draws[self._drawn].tolist()
        self._drawn += 1
        keep, gain = self._slip_keep, self._slip_gain
        self._slips = [keep * slip + gain * number for slip, number in zip(self._slips, draw, strict=True)]
