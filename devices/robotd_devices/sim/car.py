"""The simulated car: takes `Steer`, moves the world's robot as a single track, publishes what its axle tells."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import numpy as np
from pydantic import Field

from robotd.authoring.config import Config
from robotd.authoring.device import Actuator, DeviceContext, DeviceMisconfigured
from robotd.world.clock import NS_PER_S
from robotd.world.kinematics import Ackermann, advance
from robotd.world.messages import STOP, Drive, Message, Odometry, Steer
from robotd_devices.ports.ticker import Ticker
from robotd_devices.sim.world import FlatWorld, flat_world

_STILL_MPS = 1e-6


class SimCarConfig(Config):
    """A simulated car with front steering. 0 in every error is a perfect one."""

    odometry_hz: float = Field(default=50.0, ge=1.0, le=200.0)
    """How often the odometry is published."""
    speed_lag_s: float = Field(default=0.12, ge=0.0, le=2.0)
    """Time constant of the first-order lag from a command to the axle's speed."""
    accel_mps2: float = Field(default=8.0, gt=0.0, le=50.0)
    """The axle gains or loses speed no faster than this."""
    dead_band_mps: float = Field(default=0.05, ge=0.0, le=1.0)
    """A car that is told less speed than this stands."""
    speed_error: float = Field(default=0.03, ge=0.0, le=0.3)
    """The motor turns faster or slower than told by a fixed share up to this; the axle's encoder sees it."""
    wheel_error: float = Field(default=0.02, ge=0.0, le=0.3)
    """The wheels are larger or smaller than they should be by a fixed share up to this; nothing on board sees it."""
    slip_std: float = Field(default=0.02, ge=0.0, le=0.5)
    """Standard deviation of the driven wheels' slip as a share of their speed; it drifts over `slip_time_s`."""
    slip_time_s: float = Field(default=0.3, gt=0.0, le=10.0)
    """Correlation time of the slip (a first-order Gauss-Markov process)."""
    steering_lag_s: float = Field(default=0.05, ge=0.0, le=2.0)
    """Time constant of the first-order lag from a command to the front wheels' angle."""
    steering_rate_radps: float = Field(default=5.0, gt=0.0, le=50.0)
    """The servo turns the front wheels no faster than this."""
    steering_offset_rad: float = Field(default=0.02, ge=0.0, le=0.3)
    """The front wheels stand askew by a fixed angle up to this; nothing on board sees it."""
    steering_error: float = Field(default=0.05, ge=0.0, le=0.3)
    """The front wheels turn farther or less far than told by a fixed share up to this; nothing on board sees it."""
    encoder_step_m: float = Field(default=0.005, ge=0.0, le=0.1)
    """Way of one count of the axle's encoder; 0: it knows every way."""


class SingleTrack:
    """A car on the grid of physics: rear axle with lag and slip, front wheels with a servo, no side slip.

    wz = v tan(steering) / wheelbase (Rajamani, Vehicle Dynamics and Control, 2012, section 2.2).
    The odometry integrates the axle's counts and the servo's nominal angle.
    """

    def __init__(self, car: Ackermann, config: SimCarConfig, rng: np.random.Generator, step_ns: int) -> None:
        self._car = car
        self._config = config
        self._rng = rng
        self._step_s = step_ns / NS_PER_S
        self._speed_keep = math.exp(-self._step_s / config.speed_lag_s) if config.speed_lag_s > 0.0 else 0.0
        self._angle_keep = math.exp(-self._step_s / config.steering_lag_s) if config.steering_lag_s > 0.0 else 0.0
        self._slip_keep = math.exp(-self._step_s / config.slip_time_s)
        self._slip_gain = config.slip_std * math.sqrt(1.0 - self._slip_keep**2)
        errors = (config.speed_error, config.wheel_error, config.steering_error, config.steering_offset_rad)
        drawn = [float(rng.uniform(-error, error)) for error in errors]
        self._motor, self._wheel, self._turn, self._askew_rad = 1.0 + drawn[0], 1.0 + drawn[1], 1.0 + drawn[2], drawn[3]
        self._slip = config.slip_std * float(rng.standard_normal())
        self._wanted = Steer()
        self.speed_mps = 0.0
        """Of the axle's rim."""
        self.steering_rad = 0.0
        """What the servo believes."""
        self._way_m = 0.0
        self._counted_m = 0.0
        self._reported_m = 0.0
        self._unreported = 0
        self.odometry: tuple[float, float, float] = (0.0, 0.0, 0.0)
        """Rear axle's middle in the odometry frame as axle and servo tell: x, y, yaw."""

    def command(self, steer: Steer) -> None:
        """What motor and servo are told from the next step on; the angle is cut at the car's greatest."""
        most = self._car.max_steering_rad
        speed = steer.speed_mps if abs(steer.speed_mps) >= self._config.dead_band_mps else 0.0
        self._wanted = Steer(speed * self._motor, min(max(steer.steering_rad, -most), most))

    @property
    def wanted(self) -> Steer:
        """The last command."""
        return self._wanted

    def step(self) -> Drive:
        """One grid step; the true velocity of the rear axle's middle during it."""
        config, step_s = self._config, self._step_s
        self._unreported += 1
        most = config.steering_rate_radps * step_s
        angle = self._wanted.steering_rad + self._angle_keep * (self.steering_rad - self._wanted.steering_rad)
        self.steering_rad += min(max(angle - self.steering_rad, -most), most)
        most = config.accel_mps2 * step_s
        speed = self._wanted.speed_mps + self._speed_keep * (self.speed_mps - self._wanted.speed_mps)
        self.speed_mps += min(max(speed - self.speed_mps, -most), most)
        if abs(self.speed_mps) < _STILL_MPS and self._wanted.speed_mps == 0.0:
            self.speed_mps = 0.0
            return STOP
        self._count()
        if self._slip_gain > 0.0:
            self._slip = self._slip_keep * self._slip + self._slip_gain * float(self._rng.standard_normal())
        most = self._car.max_steering_rad
        true_rad = min(max(self.steering_rad * self._turn + self._askew_rad, -most), most)
        return self._car.body(Steer(self.speed_mps * self._wheel * (1.0 - self._slip), true_rad))

    def report(self) -> Drive:
        """Velocity that axle and servo tell since the last report."""
        speed = self.speed_mps
        if self._config.encoder_step_m > 0.0 and self._unreported:
            speed = (self._counted_m - self._reported_m) / (self._unreported * self._step_s)
            self._reported_m, self._unreported = self._counted_m, 0
        return self._car.body(Steer(speed, self.steering_rad))

    def _count(self) -> None:
        tick_m = self._config.encoder_step_m
        self._way_m += self.speed_mps * self._step_s
        counted_m = math.floor(self._way_m / tick_m) * tick_m if tick_m > 0.0 else self._way_m
        moved_mps = (counted_m - self._counted_m) / self._step_s
        self._counted_m = counted_m
        self.odometry = advance(*self.odometry, self._car.body(Steer(moved_mps, self.steering_rad)), self._step_s)


class SimCar(Actuator[SimCarConfig, Steer]):
    """A car. Odometry drifts from the truth and starts at 0, 0, 0; `halt` stops and holds the front wheels.

    Raises DeviceMisconfigured for kinematics other than ackermann.
    """

    sim_twin: ClassVar[str | None] = "sim_car"
    emits: ClassVar[tuple[type[Message], ...]] = (Odometry,)

    def __init__(self, config: SimCarConfig, context: DeviceContext | None = None) -> None:
        super().__init__(config, context)
        self._world: FlatWorld | None = None
        self._track: SingleTrack | None = None
        self._ticker = Ticker(1.0 / config.odometry_hz, self._tell)

    @classmethod
    def publish_period_s(cls, config: SimCarConfig) -> float | None:
        return 1.0 / config.odometry_hz

    async def open(self) -> None:
        world = flat_world(self.context)
        car = self.context.robot.kinematics
        if not isinstance(car, Ackermann):
            raise DeviceMisconfigured(
                f"{self.context.name}: sim_car needs `robot: {{kinematics: {{type: ackermann, ...}}}}`; "
                "differential and mecanum bases are simulated by sim_base"
            )
        track = SingleTrack(car, self.config, world.generator(self.context.name), world.step_ns)
        world.attach(track)
        self._world, self._track = world, track
        self._ticker.start()

    async def close(self) -> None:
        self._ticker.stop()
        if self._world is not None and self._track is not None:
            self._world.detach(self._track)
        self._world = self._track = None

    def apply(self, command: Steer) -> None:
        # a wrongly wired base's command must not pass as a Steer whose fields happen to be absent
        taken: Any = command
        if not isinstance(taken, Steer):
            raise TypeError(f"{self.context.name} takes Steer, not {type(taken).__name__}")
        if self._world is not None and self._track is not None:
            self._world.advance()
            self._track.command(command)

    def halt(self) -> None:
        if self._track is not None:
            self.apply(Steer(0.0, self._track.wanted.steering_rad))

    def _tell(self) -> None:
        if self._world is None or self._track is None:
            return
        self._world.advance()
        x_m, y_m, yaw_rad = self._track.odometry
        told = self._track.report()
        now_ns = self.context.clock.now_ns()
        self.publish(Odometry(now_ns, x_m, y_m, yaw_rad, told.vx_mps, told.vy_mps, told.wz_radps))
