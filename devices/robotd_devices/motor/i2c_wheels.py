"""What drivers of two wheels on an I2C chip share: the body, the writer's thread, the reckoned odometry, the stop."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import ClassVar, Generic, Protocol

from pydantic import Field
from typing_extensions import TypeVar

from robotd.authoring.device import Actuator, DeviceContext, DeviceError, DeviceMisconfigured, I2cStop, StopLine
from robotd.world.kinematics import Differential
from robotd.world.messages import Drive, Message, Odometry
from robotd_devices.motor.jetbot_wheels import Base, Speeds, WheelModel
from robotd_devices.motor.reckoning import CommandedOdometry
from robotd_devices.ports import i2c_bus
from robotd_devices.ports.i2c_bus import I2cBus, I2cWrite
from robotd_devices.ports.i2c_config import I2cConfig
from robotd_devices.ports.i2c_writer import ChipPlan, I2cWriter
from robotd_devices.ports.ticker import Ticker


class I2cWheelsConfig(I2cConfig):
    """Parameters that every such board has. The defaults fit a JetBot; the two speeds want calibration."""

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


class WheelsChip(Protocol):
    """What a driver knows of its chip; all but `stopped` is called on the writer's thread. See `ChipPlan`."""

    def begin(self, bus: I2cBus) -> None:
        """Get the chip ready, the stop first. Raises OSError and DeviceUnavailable."""
        ...

    def plan(self, before: Speeds | None, wanted: Speeds) -> Sequence[I2cWrite]:
        """The writes that lead from what was written last (None: the stop) to what is wanted."""
        ...

    def check(self, bus: I2cBus) -> None:
        """Is the chip still as `begin` left it? Raises OSError and DeviceUnavailable."""
        ...

    def stopped(self) -> None:
        """On the loop: the stop was written."""
        ...


WheelsConfigT = TypeVar("WheelsConfigT", bound=I2cWheelsConfig, default=I2cWheelsConfig)


class I2cWheels(Actuator[WheelsConfigT, Drive], Generic[WheelsConfigT]):
    """The shell around a chip that drives two wheels without encoders. A driver says what is written to the chip.

    Publishes where its commands ought to have led (`CommandedOdometry`): nothing is measured. Faults counted here:
    `I2C retry`, `no finite command`. Lost where a transaction fails three times, and where the chip's `check` says so.
    Raises DeviceMisconfigured for a base that is not differential.

    open_bus: what opens the bus, on the writer's thread; a fake's in tests.
    """

    sim_twin = "sim_base"
    emits: ClassVar[tuple[type[Message], ...]] = (Odometry,)

    def __init__(
        self,
        config: WheelsConfigT,
        context: DeviceContext | None = None,
        *,
        open_bus: Callable[[], I2cBus] | None = None,
    ) -> None:
        super().__init__(config, context)
        self._open_bus = open_bus if open_bus is not None else partial(i2c_bus.open_bus, config.bus)
        self._writer: I2cWriter[Speeds] | None = None
        self._chip: WheelsChip | None = None
        self._base: Base | None = None
        self._odometry: CommandedOdometry | None = None
        period_s = self.publish_period_s(config)
        self._ticker = Ticker(period_s, self._tell) if period_s is not None else None

    @classmethod
    def load(cls, config: WheelsConfigT) -> None:
        i2c_bus.load_bus(config.bus)

    @classmethod
    def publish_period_s(cls, config: WheelsConfigT) -> float | None:
        return 1.0 / config.odometry_hz if config.odometry_hz > 0.0 else None

    # ------------------------------------------------------------------------------------ a driver's part

    def stop_writes(self) -> tuple[I2cWrite, ...]:
        """The writes that stop both wheels, whatever the state of the chip."""
        raise NotImplementedError(f"{type(self).__qualname__}.stop_writes")

    def make_chip(self) -> WheelsChip:
        """What the writer's thread does with the chip; a new one for each opening."""
        raise NotImplementedError(f"{type(self).__qualname__}.make_chip")

    # -------------------------------------------------------------------------------- the actuator's part

    def stop_line(self) -> StopLine:
        writes = tuple((write.address, bytes((write.register,)) + write.data) for write in self.stop_writes())
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
        self._chip = self.make_chip()
        plan = ChipPlan[Speeds](
            begin=self._chip.begin,
            plan=self._chip.plan,
            stop=self.stop_writes(),
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
        if self._ticker is not None:
            self._ticker.start()

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
        if not command.is_finite:
            self.context.link.fault("no finite command", repr(command))
            self._writer.stop()
            return
        self._writer.put(self._base.speeds(command))

    def halt(self) -> None:
        if self._writer is not None:
            self._writer.stop()

    def _tell(self) -> None:
        if self._odometry is not None:
            self.publish(self._odometry.at(self.context.clock.now_ns()))

    def _written(self, speeds: Speeds | None) -> None:
        if speeds is None and self._chip is not None:
            self._chip.stopped()
        if self._odometry is not None and self._base is not None:
            self._odometry.tell(self._base.rims_mps(speeds or Speeds()), self.context.clock.now_ns())

    def _still(self) -> None:
        if self._ticker is not None:
            self._ticker.stop()

    def _gone(self, reason: str) -> None:
        self._still()
        self.lost(reason)
