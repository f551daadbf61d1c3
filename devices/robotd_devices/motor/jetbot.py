"""The motors of a JetBot: two wheels on a PCA9685 over I2C, without encoders and without a watchdog."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable
from functools import partial
from typing import ClassVar, Literal

from pydantic import Field, field_validator

from robotd.authoring.config import Config
from robotd.authoring.device import (
    Actuator,
    DeviceContext,
    DeviceError,
    DeviceMisconfigured,
    DeviceUnavailable,
    I2cStop,
    StopLine,
    Watchdog,
)
from robotd.world.kinematics import Differential
from robotd.world.messages import Drive, Message, Odometry
from robotd_devices.motor import pca9685
from robotd_devices.motor.jetbot_wheels import Base, Speeds, WheelModel, plan
from robotd_devices.motor.reckoning import CommandedOdometry
from robotd_devices.ports import i2c_bus
from robotd_devices.ports.i2c_bus import I2cBus
from robotd_devices.ports.i2c_writer import ChipPlan, I2cWriter

_OSCILLATOR_S = 0.001


class JetBotMotorsConfig(Config):
    """Parameters of a JetBot's motor board. The defaults fit a JetBot; the two speeds want calibration."""

    bus: int | str = Field(default=1, union_mode="left_to_right")
    """Number of the I2C bus (1 is /dev/i2c-1), a path, or `unix:` and the path of a fake bus's socket."""
    address: int = Field(default=0x60, ge=0x08, le=0x77)
    """Address of the PCA9685."""
    wiring: Literal["jetbot", "adafruit", "waveshare"] = "jetbot"
    """Which outputs drive the motors; `jetbot` writes those of both boards, as NVIDIA's library does."""
    pwm_hz: float = Field(default=1600.0, ge=24.0, le=1600.0)
    """Frequency of the PWM; the chip's fastest is 1526 Hz."""
    top_speed_mps: float = Field(default=1.0, gt=0.0, le=10.0)
    """Rim speed of a wheel on the floor at full duty."""
    dead_band: float = Field(default=0.1, ge=0.0, le=0.6)
    """Share of full duty at which a wheel just begins to turn."""
    still_mps: float = Field(default=0.005, gt=0.0, le=0.1)
    """A wheel that is asked for less than this is released."""
    left_gain: float = Field(default=1.0, ge=0.3, le=3.0)
    """Multiplied onto the left wheel's duty above the dead band: above 1 where the robot drifts to the left."""
    right_gain: float = Field(default=1.0, ge=0.3, le=3.0)
    """The same for the right wheel."""
    left_reversed: bool = False
    """The left motor's leads are swapped."""
    right_reversed: bool = False
    """The right motor's leads are swapped."""
    odometry_hz: float = Field(default=50.0, ge=0.0, le=200.0)
    """How often the odometry that the commands lead to is published; 0: never."""
    lag_s: float = Field(default=0.08, ge=0.0, le=2.0)
    """Time constant with which the wheels follow a command, for that odometry."""
    check_s: float = Field(default=0.5, ge=0.05, le=10.0)
    """How often the chip is asked whether it still is as it was set up."""

    @field_validator("bus")
    @classmethod
    def _plain_path(cls, bus: int | str) -> int | str:
        return bus.removeprefix("unix:") if isinstance(bus, str) else bus


class JetBotMotors(Actuator[JetBotMotorsConfig, Drive]):
    """Drives two wheels; publishes where its commands ought to have led (`CommandedOdometry`): nothing is measured.

    Nothing stops the motors when the program falls silent: the chip holds its outputs for ever (`watchdog` is none).
    Faults that it counts: `I2C retry`, `no finite command`. Lost where a transaction fails three times, and where the
    chip forgot its settings (its supply broke down). Raises DeviceMisconfigured for a base that is not differential.

    open_bus: what opens the bus, on the writer's thread; a fake's in tests.
    """

    sim_twin = "sim_base"
    emits: ClassVar[tuple[type[Message], ...]] = (Odometry,)
    watchdog = Watchdog("none")

    def __init__(
        self,
        config: JetBotMotorsConfig,
        context: DeviceContext | None = None,
        *,
        open_bus: Callable[[], I2cBus] | None = None,
    ) -> None:
        super().__init__(config, context)
        self._open_bus = open_bus if open_bus is not None else partial(i2c_bus.open_bus, config.bus)
        self._writer: I2cWriter[Speeds] | None = None
        self._base: Base | None = None
        self._odometry: CommandedOdometry | None = None
        self._beat: asyncio.TimerHandle | None = None

    @classmethod
    def load(cls, config: JetBotMotorsConfig) -> None:
        i2c_bus.load_bus(config.bus)

    @classmethod
    def publish_period_s(cls, config: JetBotMotorsConfig) -> float | None:
        return 1.0 / config.odometry_hz if config.odometry_hz > 0.0 else None

    def stop_line(self) -> StopLine:
        address, register, data = pca9685.all_off(self.config.address)
        return I2cStop(i2c_bus.bus_path(self.config.bus), ((address, bytes((register,)) + data),))

    async def open(self) -> None:
        config, body = self.config, self.context.robot.kinematics
        if not isinstance(body, Differential):
            raise DeviceMisconfigured(
                f"{self.context.name}: a JetBot is driven by two wheels, robot.kinematics says "
                f"{type(body).__name__.lower()}; write `kinematics: {{type: differential, track_m: 0.118}}`"
            )
        self._base = Base(
            body,
            WheelModel(config.top_speed_mps, config.dead_band, config.left_gain, config.left_reversed),
            WheelModel(config.top_speed_mps, config.dead_band, config.right_gain, config.right_reversed),
            config.still_mps,
        )
        if self._odometry is None:
            self._odometry = CommandedOdometry(body, config.lag_s)
        chip = ChipPlan[Speeds](
            begin=partial(_begin, config),
            plan=partial(plan, config.address, config.wiring),
            stop=(pca9685.all_off(config.address),),
            check=partial(_check, config),
            check_s=config.check_s,
            explain=partial(i2c_bus.explain, bus=config.bus, address=config.address),
        )
        self._writer = I2cWriter(
            self.context.name,
            chip,
            self._open_bus,
            on_written=self._written,
            on_fault=self.context.link.fault,
            on_lost=self._gone,
        )
        try:
            await self._writer.open()
        except DeviceError as error:
            raise type(error)(f"{self.context.name}: {error}") from error
        self._odometry.start(self.context.clock.now_ns())
        if config.odometry_hz > 0.0:
            self._next_s = asyncio.get_running_loop().time()
            self._schedule()

    async def close(self) -> None:
        self._still()
        writer, self._writer = self._writer, None
        if writer is not None:
            await writer.close()

    def apply(self, command: Drive) -> None:
        if not isinstance(command, Drive):
            raise TypeError(f"{self.context.name} takes Drive, not {type(command).__name__}")
        if self._writer is None or self._base is None:
            return
        if not (math.isfinite(command.vx_mps) and math.isfinite(command.wz_radps)):
            self.context.link.fault("no finite command", repr(command))
            self._writer.stop()
            return
        self._writer.put(self._base.speeds(command))

    def halt(self) -> None:
        if self._writer is not None:
            self._writer.stop()

    # ---------------------------------------------------------------------------------------- odometry

    def _schedule(self) -> None:
        loop, period_s = asyncio.get_running_loop(), 1.0 / self.config.odometry_hz
        self._next_s = max(self._next_s + period_s, loop.time())
        self._beat = loop.call_at(self._next_s, self._tell)

    def _tell(self) -> None:
        self._schedule()
        if self._odometry is not None:
            self.publish(self._odometry.at(self.context.clock.now_ns()))

    def _written(self, speeds: Speeds | None) -> None:
        if self._odometry is not None and self._base is not None:
            self._odometry.tell(self._base.rims_mps(speeds or Speeds()), self.context.clock.now_ns())

    def _still(self) -> None:
        if self._beat is not None:
            self._beat.cancel()
            self._beat = None

    def _gone(self, reason: str) -> None:
        self._still()
        self.lost(reason)


# ------------------------------------------------------------------------------- on the writer's thread


def _begin(config: JetBotMotorsConfig, bus: I2cBus) -> None:
    *writes, restart = pca9685.begin_writes(config.address, config.pwm_hz)
    for write in writes:
        bus.write(*write)
    time.sleep(_OSCILLATOR_S)
    bus.write(*restart)
    _check(config, bus)


def _check(config: JetBotMotorsConfig, bus: I2cBus) -> None:
    (mode1,) = bus.read(config.address, pca9685.MODE1, 1)
    (prescale,) = bus.read(config.address, pca9685.PRESCALE, 1)
    want = pca9685.AUTO_INCREMENT | pca9685.ALLCALL, pca9685.prescale(config.pwm_hz)
    if (mode1, prescale) != want:
        raise DeviceUnavailable(
            f"the chip at 0x{config.address:02X} on I2C bus {i2c_bus.bus_path(config.bus)} lost its settings "
            f"(MODE1 {mode1:02X}, PRESCALE {prescale:02X}, set were {want[0]:02X}, {want[1]:02X}): its supply broke "
            "down, another program uses it, or it is no PCA9685"
        )
