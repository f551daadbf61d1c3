"""What the author of a bridge writes: a task that carries goals, commands and state to the world outside."""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping
from typing import Any, ClassVar, Generic, Protocol

from typing_extensions import TypeVar

from robotd.authoring.config import Config, NoConfig
from robotd.authoring.explain import Explanation
from robotd.authoring.generics import type_arguments
from robotd.world.clock import Clock
from robotd.world.messages import Command, Event, Message
from robotd.world.robot import Robot
from robotd.world.topics import Topic

ConfigT = TypeVar("ConfigT", bound=Config, default=NoConfig)
MessageT = TypeVar("MessageT", bound=Message, default=Message)


class Refused(Exception):
    """A request that the operator refused; the message is the reason, for people."""


class RuntimeLink(Protocol):
    """A bridge's hold on the runtime. Every request is answered at once: it returns, or raises `Refused`."""

    clock: Clock
    robot: Robot

    def arm(self, by: str) -> None: ...
    def disarm(self, by: str) -> None: ...
    def estop(self, by: str, reason: str) -> None: ...
    def reset_estop(self, by: str) -> None: ...
    def start(self, by: str, behaviour: str, goal: Mapping[str, Any] | None = None) -> None: ...
    def cancel(self, by: str, behaviour: str) -> None: ...
    def pause(self, by: str) -> None: ...
    def resume(self, by: str) -> None: ...
    def teleop(self, by: str, drive: Command, lease_s: float) -> None:
        """Drive by hand for `lease_s`; enters MANUAL. The lease's end stops the robot; only `resume` ends MANUAL."""
        ...

    def status(self) -> Mapping[str, Any]:
        """Mode, reason for standing still, behaviours and their state, streams with rate and age, last command."""
        ...

    def topics(self) -> tuple[Topic[Message], ...]:
        """Every stream that a device or a perceptor fills, with its message type; the same all run long."""
        ...

    def newest(self, topic: Topic[MessageT]) -> MessageT | None:
        """The newest message of a topic, or None."""
        ...

    def watch(self, *topics: Topic[Message]) -> AsyncIterator[Message]:
        """Messages as they come, newest of each topic only: a slow reader misses some, never delays anybody."""
        ...

    def events(self) -> AsyncIterator[Event]:
        """Every event from now on, none lost short of an alarm."""
        ...

    def explanations(self) -> Mapping[str, Explanation]:
        """The newest `explain()` of each plugin; asking is what makes them be called."""
        ...


class Bridge(Generic[ConfigT]):
    """Runs as one supervised task; an exception restarts it with backoff and never stops the robot's own loop."""

    config_type: ClassVar[type[Config]] = NoConfig

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        args = type_arguments(cls, Bridge, f"class {cls.__name__}(Bridge[MyConfig])")
        if args is not None:
            cls.config_type = args[0]

    def __init__(self, config: ConfigT) -> None:
        self.config: ConfigT = config

    @classmethod
    def load(cls, config: ConfigT) -> None:
        """Heavy imports; runs in a worker before the task starts."""

    async def run(self, runtime: RuntimeLink) -> None:
        """Serve until cancelled."""
        raise NotImplementedError(f"{type(self).__qualname__}.run")
