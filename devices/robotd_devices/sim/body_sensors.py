"""The simulated sensors that feel the robot itself: an inertial unit, a bumper and the battery."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from pydantic import Field, model_validator

from robotd.authoring.config import Config
from robotd.authoring.device import DeviceContext, Sensor
from robotd.world.clock import NS_PER_S
from robotd.world.messages import Battery, Contact, Float64s, Imu
from robotd_devices.ports.ticker import Ticker
from robotd_devices.sim.world import FlatWorld, flat_world

GRAVITY_MPS2 = 9.80665

_CHARGE = (0.0, 0.1, 0.9, 1.0)
_VOLTAGE_SHARE = (0.0, 0.4, 0.8, 1.0)
"""Open-circuit voltage of a lithium pack between empty and full, by its charge: steep at both ends, flat between."""


class SimImuConfig(Config):
    """A simulated inertial unit; the defaults are those of a cheap MEMS part that was not calibrated."""

    rate_hz: float = Field(default=100.0, gt=0.0, le=1000.0)
    """Samples a second, each the mean since the one before."""
    gyro_noise_radps: float = Field(default=0.004, ge=0.0, le=1.0)
    """Noise of each rate, standard deviation."""
    gyro_bias_radps: float = Field(default=0.01, ge=0.0, le=1.0)
    """Standard deviation of the rates' fixed offsets."""
    gyro_walk_radps: float = Field(default=0.0005, ge=0.0, le=0.1)
    """The offsets walk by so much in a second, standard deviation; with the square root of time."""
    gyro_error: float = Field(default=0.01, ge=0.0, le=0.2)
    """Rates are too large or too small by a fixed share up to this."""
    accel_noise_mps2: float = Field(default=0.08, ge=0.0, le=10.0)
    """Noise of each acceleration, standard deviation."""
    accel_bias_mps2: float = Field(default=0.05, ge=0.0, le=5.0)
    """Standard deviation of the accelerations' fixed offsets."""


class SimImu(Sensor[SimImuConfig, Imu]):
    """Rates and specific force in base, as at the base's origin: gravity up, centripetal force included."""

    sim_twin: ClassVar[str | None] = "sim_imu"

    def __init__(self, config: SimImuConfig, context: DeviceContext | None = None) -> None:
        super().__init__(config, context)
        self._world: FlatWorld | None = None
        self._rng = np.random.default_rng(0)
        self._ticker = Ticker(1.0 / config.rate_hz, self._feel)
        self._gyro_bias: Float64s = np.zeros(3)
        self._accel_bias: Float64s = np.zeros(3)
        self._scale = 1.0
        self._before = (0, 0.0, 0.0, 0.0)

    @classmethod
    def publish_period_s(cls, config: SimImuConfig) -> float | None:
        return 1.0 / config.rate_hz

    async def open(self) -> None:
        self._world = flat_world(self.context)
        self._rng = self._world.generator(self.context.name)
        self._gyro_bias = self.config.gyro_bias_radps * self._rng.standard_normal(3)
        self._accel_bias = self.config.accel_bias_mps2 * self._rng.standard_normal(3)
        self._scale = 1.0 + float(self._rng.uniform(-self.config.gyro_error, self.config.gyro_error))
        self._before = self._motion(self._world)
        self._ticker.start()

    async def close(self) -> None:
        self._ticker.stop()
        self._world = None

    def _motion(self, world: FlatWorld) -> tuple[int, float, float, float]:
        """Now, yaw without wrap, and the velocity in map."""
        now_ns = self.context.clock.now_ns()
        yaw_rad = float(world.poses(np.array([now_ns]))[0, 2])
        cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
        vx, vy = world.velocity.vx_mps, world.velocity.vy_mps
        return now_ns, yaw_rad, cos * vx - sin * vy, sin * vx + cos * vy

    def _feel(self) -> None:
        if self._world is None:
            return
        before_ns, before_rad, before_x, before_y = self._before
        self._before = now_ns, yaw_rad, vx, vy = self._motion(self._world)
        over_s = (now_ns - before_ns) / NS_PER_S
        config = self.config
        # towards where the robot looked in the middle of the sample
        cos, sin = math.cos((before_rad + yaw_rad) / 2.0), math.sin((before_rad + yaw_rad) / 2.0)
        ax, ay = (vx - before_x) / over_s, (vy - before_y) / over_s
        noise = self._rng.standard_normal((3, 3))
        self._gyro_bias = self._gyro_bias + config.gyro_walk_radps * math.sqrt(over_s) * noise[2]
        rates = np.array((0.0, 0.0, (yaw_rad - before_rad) / over_s * self._scale))
        rates += self._gyro_bias + config.gyro_noise_radps * noise[0]
        forces = np.array((cos * ax + sin * ay, cos * ay - sin * ax, GRAVITY_MPS2))
        forces += self._accel_bias + config.accel_noise_mps2 * noise[1]
        self.publish(Imu(now_ns, *rates.tolist(), *forces.tolist()))


class SimBumperConfig(Config):
    """A simulated bumper."""

    rate_hz: float = Field(default=50.0, gt=0.0, le=1000.0)
    """How often the switch is read and told."""
    where: str = Field(default="bumper", min_length=1)
    """The name that its messages carry."""
    bearing_rad: float = Field(default=0.0, ge=-math.pi, le=math.pi)
    """The middle of the part of the outline that it covers, in base."""
    arc_rad: float = Field(default=math.pi, gt=0.0, le=math.tau)
    """How much of the outline it covers, about that middle."""


class SimBumper(Sensor[SimBumperConfig, Contact]):
    """Closed while the outline touches a wall, post, box, card or person within its arc."""

    sim_twin: ClassVar[str | None] = "sim_bumper"

    def __init__(self, config: SimBumperConfig, context: DeviceContext | None = None) -> None:
        super().__init__(config, context)
        self._world: FlatWorld | None = None
        self._ticker = Ticker(1.0 / config.rate_hz, self._read)

    @classmethod
    def publish_period_s(cls, config: SimBumperConfig) -> float | None:
        return 1.0 / config.rate_hz

    async def open(self) -> None:
        self._world = flat_world(self.context)
        self._ticker.start()

    async def close(self) -> None:
        self._ticker.stop()
        self._world = None

    def _read(self) -> None:
        if self._world is None:
            return
        self._world.advance()
        half = self.config.arc_rad / 2.0 + 1e-9
        closed = any(
            abs(math.remainder(touched - self.config.bearing_rad, math.tau)) <= half
            for touched in self._world.contacts_rad
        )
        self.publish(Contact(self.context.clock.now_ns(), closed, self.config.where))


class SimBatteryConfig(Config):
    """A simulated battery; the defaults are those of three small lithium cells in a row."""

    rate_hz: float = Field(default=1.0, gt=0.0, le=100.0)
    """How often it is measured and told."""
    capacity_ah: float = Field(default=2.5, gt=0.0, le=1000.0)
    charge: float = Field(default=1.0, ge=0.0, le=1.0)
    """Charge when the world opens."""
    full_v: float = Field(default=12.6, gt=0.0, le=1000.0)
    empty_v: float = Field(default=9.6, gt=0.0, le=1000.0)
    resistance_ohm: float = Field(default=0.12, ge=0.0, le=10.0)
    """Voltage sags by the current times this."""
    idle_a: float = Field(default=0.8, ge=0.0, le=1000.0)
    """What the electronics draw."""
    drive_a_per_mps: float = Field(default=4.0, ge=0.0, le=1000.0)
    """What the motors draw for each metre a second of the base, its outline's turning included."""
    voltage_noise_v: float = Field(default=0.02, ge=0.0, le=5.0)
    """Noise of the measured voltage, standard deviation."""

    @model_validator(mode="after")
    def _full_is_more_than_empty(self) -> SimBatteryConfig:
        if self.full_v <= self.empty_v:
            raise ValueError(f"full_v {self.full_v} must be more than empty_v {self.empty_v}")
        return self


class SimBattery(Sensor[SimBatteryConfig, Battery]):
    """Empties with use and sags under load. Bases whose `battery_share` is not 0 slow down with it."""

    sim_twin: ClassVar[str | None] = "sim_battery"

    def __init__(self, config: SimBatteryConfig, context: DeviceContext | None = None) -> None:
        super().__init__(config, context)
        self._world: FlatWorld | None = None
        self._rng = np.random.default_rng(0)
        self._ticker = Ticker(1.0 / config.rate_hz, self._measure)
        self._charge = config.charge
        self._effort_m = 0.0

    @classmethod
    def publish_period_s(cls, config: SimBatteryConfig) -> float | None:
        return 1.0 / config.rate_hz

    async def open(self) -> None:
        self._world = flat_world(self.context)
        self._rng = self._world.generator(self.context.name)
        self._charge, self._effort_m = self.config.charge, self._world.effort_m
        self._world.supply = self._voltage_v(self.config.idle_a) / self.config.full_v
        self._ticker.start()

    async def close(self) -> None:
        self._ticker.stop()
        self._world = None

    def _voltage_v(self, current_a: float) -> float:
        config = self.config
        share = float(np.interp(self._charge, _CHARGE, _VOLTAGE_SHARE))
        return config.empty_v + share * (config.full_v - config.empty_v) - current_a * config.resistance_ohm

    def _measure(self) -> None:
        if self._world is None:
            return
        self._world.advance()
        config = self.config
        over_s = self._ticker.period_ns / NS_PER_S
        speed_mps = (self._world.effort_m - self._effort_m) / over_s
        self._effort_m = self._world.effort_m
        current_a = config.idle_a + config.drive_a_per_mps * speed_mps
        self._charge = max(0.0, self._charge - current_a * over_s / 3600.0 / config.capacity_ah)
        voltage_v = self._voltage_v(current_a)
        self._world.supply = max(0.0, voltage_v / config.full_v)
        measured_v = voltage_v + config.voltage_noise_v * float(self._rng.standard_normal())
        self.publish(Battery(self.context.clock.now_ns(), measured_v, current_a, self._charge))
