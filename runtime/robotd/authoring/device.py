"""What the author of a driver writes: sensors that publish, actuators that apply and halt, worlds that simulate.

Errors a device may raise from `open` or pass to `lost`:

    DeviceError
     +-- DeviceLost         it was there and went away (cable out, end of file): the supervisor reopens with backoff
     +-- DeviceUnavailable  it cannot be opened now (no such port, busy): likewise
     +-- DeviceMisconfigured  the config cannot be right for it: not retried, exit code 78
"""

from __future__ import annotations

import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, ClassVar, Generic, Literal, Protocol, TypeAlias

from typing_extensions import TypeVar

from robotd.authoring.config import Config, NoConfig
from robotd.authoring.generics import type_arguments
from robotd.world.clock import Clock, ManualClock
from robotd.world.messages import Command, Drive, Message
from robotd.world.robot import Mount, Robot

ConfigT = TypeVar("ConfigT", bound=Config, default=NoConfig)
MessageT = TypeVar("MessageT", bound=Message, default=Message)
CommandT = TypeVar("CommandT", bound=Command, default=Drive)


class DeviceError(Exception):
    """Root of what goes wrong with a device; the message says the cause and the mend."""


class DeviceLost(DeviceError):
    """The device was there and went away."""


class DeviceUnavailable(DeviceError):
    """The device cannot be opened now."""


class DeviceMisconfigured(DeviceError):
    """The config cannot be right for this device."""


class DeviceLink(Protocol):
    """The device's only way into the runtime. All three are plain calls on the loop thread, none blocks."""

    def publish(self, message: Message) -> None:
        """Hand over a message in the loop turn in which its bytes arrived."""
        ...

    def lost(self, error: DeviceError) -> None:
        """The device went away: its topics count as missing at once, then it is closed and reopened."""
        ...

    def fault(self, name: str, detail: str = "") -> None:
        """Count a fault that the device survived (bad checksum, dropped frame); logged when it begins and ends."""
        ...


class _NoLink:
    def publish(self, message: Message) -> None:
        raise RuntimeError("this device is not connected to a runtime; in a test use robotd.testing.check_sensor")

    def lost(self, error: DeviceError) -> None:
        raise error

    def fault(self, name: str, detail: str = "") -> None:
        pass


@dataclass(frozen=True, slots=True)
class DeviceContext:
    """What the runtime gives to a device: its name, a clock, the robot's body, a link, and the world in `--sim`."""

    name: str = "device"
    clock: Clock = field(default_factory=ManualClock)
    robot: Robot = field(default_factory=Robot)
    link: DeviceLink = field(default_factory=_NoLink)
    world: World | None = None

    @property
    def mount(self) -> Mount:
        """Where this device sits on the robot."""
        return self.robot.mount(self.name)


class Device(Generic[ConfigT]):
    """The common part of sensors, actuators and worlds: only `open` and `close` may wait."""

    config_type: ClassVar[type[Config]] = NoConfig
    emits: ClassVar[tuple[type[Message], ...]] = ()
    """The message types that this device publishes; each on its default topic unless the config says `as:`."""

    mends: ClassVar[Mapping[str, str]] = MappingProxyType({})
    """Names of faults that it counts, to what mends them: what `robotd doctor --probe` then says."""

    sim_twin: ClassVar[str | None] = None
    """Entry-point name of the simulated device that `--sim` puts in its place."""

    def __init__(self, config: ConfigT, context: DeviceContext | None = None) -> None:
        self.config: ConfigT = config
        self.context: DeviceContext = context if context is not None else DeviceContext()

    @classmethod
    def load(cls, config: ConfigT) -> None:
        """Heavy imports; runs in a worker before the device is opened."""

    async def open(self) -> None:
        """Get hold of the hardware and begin; raises DeviceError. Called again after `close` on every reconnect."""

    async def close(self) -> None:
        """Let go of the hardware; must not raise, must not take longer than 0.2 s, also when it is already gone."""

    @classmethod
    def publish_period_s(cls, config: ConfigT) -> float | None:
        """Seconds between messages where known: a reader whose `within_s` is shorter than 1.5 of it is refused."""
        return None


class Sensor(Device[ConfigT], Generic[ConfigT, MessageT]):
    """Publishes messages: `class Ld19(Sensor[Ld19Config, LidarScan])`; two types: `Sensor[C, Odometry | Battery]`."""

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        args = type_arguments(cls, Sensor, f"class {cls.__name__}(Sensor[MyConfig, LidarScan])")
        if args is not None:
            cls.config_type = args[0]
            cls.emits = typing.get_args(args[1]) if isinstance(args[1], types.UnionType) else (args[1],)

    def publish(self, message: MessageT) -> None:
        """Hand over a message; call it on the loop thread, in the turn in which the bytes arrived."""
        self.context.link.publish(message)

    def lost(self, reason: str) -> None:
        """Say that the device went away; close and reopen follow."""
        self.context.link.lost(DeviceLost(f"{self.context.name}: {reason}"))


WatchdogKind = Literal["hardware", "firmware", "none"]


@dataclass(frozen=True, slots=True)
class Watchdog:
    """What stops the motors when the program falls silent: a circuit, a firmware time limit, or nothing."""

    kind: WatchdogKind = "none"
    timeout_ms: int | None = None


@dataclass(frozen=True, slots=True)
class SerialStop:
    """The stop on a serial line as data, for the guardian.

    path: the line as this driver has it open; the guardian gets a duplicate of that very descriptor. data: the stop
    after as many delimiters as it takes to end a frame that was cut in two.
    """

    path: str
    data: bytes


@dataclass(frozen=True, slots=True)
class I2cStop:
    """The stop on an I2C bus as data, for the guardian.

    bus: `/dev/i2c-1`, or the path of a fake bus's socket. writes: (address, register and what is written from it on).
    """

    bus: str
    writes: tuple[tuple[int, bytes], ...]


StopLine: TypeAlias = SerialStop | I2cStop


class Actuator(Device[ConfigT], Generic[ConfigT, CommandT]):
    """Takes commands: `class JetBotMotors(Actuator[MotorConfig, Drive])`.

    `apply` and `halt` are plain non-blocking calls; at most one unsent command is kept, the newest wins. A stop is
    the first thing written after opening and the last before closing. An actuator may also publish (`emits = (...)`).
    """

    accepts: ClassVar[type[Any]] = Drive
    watchdog: ClassVar[Watchdog] = Watchdog()

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        args = type_arguments(cls, Actuator, f"class {cls.__name__}(Actuator[MyConfig, Drive])")
        if args is not None:
            cls.config_type = args[0]
            cls.accepts = args[1] if len(args) > 1 else Drive

    def apply(self, command: CommandT) -> None:
        """Write the command, or keep it as the only unsent one. Never blocks."""
        raise NotImplementedError(f"{type(self).__qualname__}.apply")

    def halt(self) -> None:
        """Stop now: drop what is unsent, write the stop. Never blocks, never raises."""
        raise NotImplementedError(f"{type(self).__qualname__}.halt")

    def estop(self) -> None:
        """The e-stop was pulled. By itself a stop; a controller with a latch of its own may be told to take it."""
        self.halt()

    def stop_line(self) -> StopLine | None:
        """The stop as data, asked for after each `open`: the guardian writes it when this program no longer breathes.

        A driver that defines this gets a guardian; None: this one has no line that another process could write to.
        """
        return None

    def publish(self, message: Message) -> None:
        """Hand over a message of one of the types in `emits`."""
        self.context.link.publish(message)

    def lost(self, reason: str) -> None:
        """Say that the device went away; close and reopen follow."""
        self.context.link.lost(DeviceLost(f"{self.context.name}: {reason}"))


class World(Device[ConfigT], Generic[ConfigT]):
    """What simulated devices share: opened before them, closed after them, stepped on a fixed grid of virtual time."""

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        args = type_arguments(cls, World, f"class {cls.__name__}(World[MyConfig])")
        if args is not None:
            cls.config_type = args[0]
