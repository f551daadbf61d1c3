"""Two wheels on a SparkFun SCMD over I2C (the SparkFun JetBot): no encoders, but a failsafe of the board's own."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from functools import partial
from typing import ClassVar

from pydantic import Field, field_validator

from robotd.authoring.config import Config
from robotd.authoring.device import (
    Actuator,
    DeviceContext,
    DeviceError,
    DeviceMisconfigured,
    I2cStop,
    StopLine,
    Watchdog,
)
from robotd.world.kinematics import Differential
from robotd.world.messages import Drive, Message, Odometry
from robotd_devices.motor import scmd
from robotd_devices.motor.jetbot_wheels import Base, Speeds, WheelModel
from robotd_devices.motor.reckoning import CommandedOdometry
from robotd_devices.motor.scmd import ScmdChip
from robotd_devices.ports import i2c_bus
from robotd_devices.ports.i2c_bus import I2cBus
from robotd_devices.ports.i2c_writer import ChipPlan, I2cWriter

_LONGEST_FAILSAFE_S = 0.5


class ScmdMotorsConfig(Config):
    """Parameters of a SparkFun motor driver. The defaults fit a JetBot; the two speeds want calibration."""

    bus: int | str = Field(default=1, union_mode="left_to_right")
    """Number of the I2C bus (1 is /dev/i2c-1), a path, or `unix:` and the path of a fake bus's socket."""
    address: int = Field(default=0x5D, ge=0x58, le=0x61)
    """Address of the board, by its solder jumpers."""
    failsafe_s: float = Field(default=0.2, ge=0.1, le=_LONGEST_FAILSAFE_S)
    """The board stops the motors after this long without a transaction; in steps of 10 ms."""
    top_speed_mps: float = Field(default=1.0, gt=0.0, le=10.0)
    """Rim speed of a wheel on the floor at full drive."""
    dead_band: float = Field(default=0.1, ge=0.0, le=0.6)
    """Share of full drive at which a wheel just begins to turn."""
    still_mps: float = Field(default=0.005, gt=0.0, le=0.1)
    """A wheel that is asked for less than this is released."""
    left_gain: float = Field(default=1.0, ge=0.3, le=3.0)
    """Multiplied onto the left wheel's drive above the dead band: above 1 where the robot drifts to the left."""
    right_gain: float = Field(default=1.0, ge=0.3, le=3.0)
    """The same for the right wheel."""
    left_reversed: bool = False
    """The left motor's leads (output A) are swapped."""
    right_reversed: bool = False
    """The right motor's leads (output B) are swapped."""
    odometry_hz: float = Field(default=50.0, ge=0.0, le=200.0)
    """How often the odometry that the commands lead to is published; 0: never."""
    lag_s: float = Field(default=0.08, ge=0.0, le=2.0)
    """Time constant with which the wheels follow a command, for that odometry."""
    check_s: float = Field(default=1.0, ge=0.05, le=10.0)
    """How often the board is asked whether it still is as it was set up."""

    @field_validator("bus")
    @classmethod
    def _plain_path(cls, bus: int | str) -> int | str:
        return bus.removeprefix("unix:") if isinstance(bus, str) else bus


class ScmdMotors(Actuator[ScmdMotorsConfig, Drive]):
    """Drives two wheels; publishes where its commands ought to have led (`CommandedOdometry`): nothing is measured.

    Faults that it counts: `I2C retry`, `no finite command`. Lost where a transaction fails three times, and where the
    board forgot its settings. Raises DeviceMisconfigured for a base that is not differential.

    open_bus: what opens the bus, on the writer's thread; a fake's in tests.
    """

    sim_twin = "sim_base"
    emits: ClassVar[tuple[type[Message], ...]] = (Odometry,)
    watchdog = Watchdog("firmware", round(1000 * _LONGEST_FAILSAFE_S))

    def __init__(
        self,
        config: ScmdMotorsConfig,
        context: DeviceContext | None = None,
        *,
        open_bus: Callable[[], I2cBus] | None = None,
    ) -> None:
        super().__init__(config, context)
        self._open_bus = open_bus if open_bus is not None else partial(i2c_bus.open_bus, config.bus)
        self._writer: I2cWriter[Speeds] | None = None
        self._chip = ScmdChip(config.address, config.failsafe_s)
        self._base: Base | None = None
        self._odometry: CommandedOdometry | None = None
        self._beat: asyncio.TimerHandle | None = None

    @classmethod
    def load(cls, config: ScmdMotorsConfig) -> None:
        i2c_bus.load_bus(config.bus)

    @classmethod
    def publish_period_s(cls, config: ScmdMotorsConfig) -> float | None:
        return 1.0 / config.odometry_hz if config.odometry_hz > 0.0 else None

    def stop_line(self) -> StopLine | None:
        writes = tuple((write.address, bytes((write.register,)) + write.data) for write in self._stop())
        return I2cStop(i2c_bus.bus_path(self.config.bus), writes)

    async def open(self) -> None:
        config, body = self.config, self.context.robot.kinematics
        if not isinstance(body, Differential):
            raise DeviceMisconfigured(
                f"{self.context.name}: this board drives two wheels, robot.kinematics says "
                f"{type(body).__name__.lower()}; write `kinematics: {{type: differential, track_m: 0.118}}`"
            )
        self._base = Base(
            body,
            WheelModel(config.top_speed_mps, config.dead_band, config.left_gain, config.left_reversed),
            WheelModel(config.top_speed_mps, config.dead_band, config.right_gain, config.right_reversed),
            config.still_mps,
        )
        self._odometry = self._odometry or CommandedOdometry(body, config.lag_s)
        self._chip = ScmdChip(config.address, config.failsafe_s)
        plan = ChipPlan[Speeds](
            begin=self._chip.begin,
            plan=self._chip.plan,
            stop=self._stop(),
            check=self._chip.check,
            check_s=config.check_s,
            explain=partial(i2c_bus.explain, bus=config.bus, address=config.address),
        )
        self._writer = I2cWriter(
            self.context.name,
            plan,
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

    def _stop(self) -> tuple[i2c_bus.I2cWrite, ...]:
        return scmd.stop_writes(self.config.address)

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
        if speeds is None:
            self._chip.is_moving = False
        if self._odometry is not None and self._base is not None:
            self._odometry.tell(self._base.rims_mps(speeds or Speeds()), self.context.clock.now_ns())

    def _still(self) -> None:
        if self._beat is not None:
            self._beat.cancel()
            self._beat = None

    def _gone(self, reason: str) -> None:
        self._still()
        self.lost(reason)
