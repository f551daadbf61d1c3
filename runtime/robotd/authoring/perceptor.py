"""What the author of a perceptor writes: messages in, one message out."""

from __future__ import annotations

from typing import ClassVar, Generic

from typing_extensions import TypeVar

from robotd.authoring.config import Config, NoConfig
from robotd.authoring.explain import Explanation
from robotd.authoring.generics import type_arguments
from robotd.authoring.view import View
from robotd.world.messages import Message
from robotd.world.robot import Robot

ConfigT = TypeVar("ConfigT", bound=Config, default=NoConfig)
SeesT = TypeVar("SeesT", bound=View, default=View)
MessageT = TypeVar("MessageT", bound=Message, default=Message)


class Perceptor(Generic[ConfigT, SeesT, MessageT]):
    """Messages in, one message out, in the loop turn of the message that woke it.

        class Tracker(Perceptor[TrackerConfig, Sees, Target]):
            def step(self, seen: Sees) -> Target | None: ...

    Stamp the output with the stamp of the input that it describes. `None` publishes nothing. A perceptor that needs
    more than a few milliseconds sets `offload = True`: a worker thread steps it with the newest view only; in virtual
    time its result appears `sim_latency_s` later.
    """

    config_type: ClassVar[type[Config]] = NoConfig
    sees: ClassVar[type[View]] = View
    produces: ClassVar[type[Message]] = Message
    offload: ClassVar[bool] = False
    sim_latency_s: ClassVar[float] = 0.05

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        args = type_arguments(cls, Perceptor, f"class {cls.__name__}(Perceptor[MyConfig, Sees, Target])")
        if args is not None:
            cls.config_type, cls.sees, cls.produces = args

    def __init__(self, config: ConfigT, robot: Robot | None = None) -> None:
        self.config: ConfigT = config
        self.robot: Robot = robot if robot is not None else Robot()

    @classmethod
    def load(cls, config: ConfigT) -> None:
        """Heavy imports and models; runs in a worker before arming. Raises with a sentence for people."""

    def step(self, seen: SeesT) -> MessageT | None:
        """One look. Pure but for the instance's own memory."""
        raise NotImplementedError(f"{type(self).__qualname__}.step")

    def explain(self) -> Explanation:
        """What the last step saw; see `Behaviour.explain`."""
        return ()
