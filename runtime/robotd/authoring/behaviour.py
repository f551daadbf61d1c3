"""What the author of a behaviour writes: a synchronous `step` from a typed view to a command or an outcome."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, TypeAlias

from typing_extensions import TypeVar

from robotd.authoring.config import Config, Goal, NoConfig, NoGoal
from robotd.authoring.explain import Explanation
from robotd.authoring.generics import type_arguments
from robotd.authoring.view import View
from robotd.world.messages import Command, Drive
from robotd.world.robot import Robot

ConfigT = TypeVar("ConfigT", bound=Config, default=NoConfig)
SeesT = TypeVar("SeesT", bound=View, default=View)
GoalT = TypeVar("GoalT", bound=Goal, default=NoGoal)


@dataclass(frozen=True, slots=True)
class Done:
    """The goal is reached: stop at once and become inactive."""

    reason: str = ""


@dataclass(frozen=True, slots=True)
class Failed:
    """The goal cannot be reached: stop at once and become inactive. The reason is for people."""

    reason: str


StepResult: TypeAlias = Command | Done | Failed | None


class Behaviour(Generic[ConfigT, SeesT, GoalT]):
    """Messages in, a proposed command or an outcome out.

        class Wander(Behaviour[WanderConfig, Sees]):
            def step(self, seen: Sees) -> Drive | None: ...

    A fresh instance is made for every goal, so that an instance's fields are the memory of one goal. `step` never
    blocks, sleeps or reads a clock: `seen.now_ns` is the time. `None` means "no opinion" and withdraws the proposal.
    An exception benches the behaviour; the others drive on.
    """

    config_type: ClassVar[type[Config]] = NoConfig
    sees: ClassVar[type[View]] = View
    goal_type: ClassVar[type[Goal]] = NoGoal
    emits: ClassVar[type[Any]] = Drive
    """The command class that `step` returns: `Drive` (default) or `Steer`."""

    #: "Blind for N seconds" fails the goal: the runtime counts, the author does not.
    blind_after_s: ClassVar[float | None] = None

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        args = type_arguments(cls, Behaviour, f"class {cls.__name__}(Behaviour[MyConfig, Sees])")
        if args is not None:
            cls.config_type, cls.sees = args[0], args[1]
            cls.goal_type = args[2] if len(args) > 2 else NoGoal

    def __init__(self, config: ConfigT, goal: GoalT | None = None, robot: Robot | None = None) -> None:
        self.config: ConfigT = config
        self.goal: GoalT = goal if goal is not None else self.goal_type()  # type: ignore[assignment]
        self.robot: Robot = robot if robot is not None else Robot()

    @classmethod
    def load(cls, config: ConfigT) -> None:
        """Heavy imports, models and maps; runs in a worker before arming. Raises with a sentence for people."""

    def step(self, seen: SeesT) -> StepResult:
        """One decision. Pure but for the instance's own memory."""
        raise NotImplementedError(f"{type(self).__qualname__}.step")

    def explain(self) -> Explanation:
        """What the last step thought; called right after it, only while somebody looks, at most 10 times a second."""
        return ()

    def close(self) -> None:
        """The goal ended, whichever way; for clean-up of own memory only."""


Plan: TypeAlias = Generator[Command | None, SeesT, Done | Failed | None]
"""What `Sequence.plan` returns: yields commands, receives views, returns the outcome (None means Done)."""


class Sequence(Behaviour[ConfigT, SeesT, GoalT]):
    """A behaviour that reads from top to bottom: a synchronous generator adapted to `step`.

        def plan(self, seen: Sees) -> Plan[Sees]:
            while seen.scan.ranges_m.min() > 0.3:
                seen = yield Drive(0.2)
            return Done("touching the wall")

    Its `finally` blocks run when the goal ends, also when it is cancelled.
    """

    _running: Generator[Command | None, SeesT, Done | Failed | None] | None = None

    def plan(self, seen: SeesT) -> Generator[Command | None, SeesT, Done | Failed | None]:
        """The whole sequence; `seen` is the first view."""
        raise NotImplementedError(f"{type(self).__qualname__}.plan")

    def step(self, seen: SeesT) -> StepResult:
        try:
            if self._running is None:
                self._running = self.plan(seen)
                return next(self._running)
            return self._running.send(seen)
        except StopIteration as end:
            return end.value if end.value is not None else Done()

    def close(self) -> None:
        if self._running is not None:
            self._running.close()
            self._running = None
