"""Perceptors and behaviours as the turn sees them: a lookout, the instance, and what it said last."""

from __future__ import annotations

from collections import deque
from typing import Any, TypeAlias

from robotd.authoring.behaviour import Behaviour
from robotd.authoring.config import Goal
from robotd.authoring.explain import Explanation
from robotd.authoring.perceptor import Perceptor
from robotd.engine.bus import Lookout, Slot
from robotd.engine.parts import BehaviourPart, PerceptorPart
from robotd.safety.arbiter import Proposal
from robotd.world.messages import CameraFrame, Message
from robotd.world.robot import Robot


class PerceptorNode:
    """One perceptor. `benched` holds the exception that put it there."""

    __slots__ = (
        "again", "benched", "busy", "explained_ns", "explanation", "index", "lookout", "name", "offload", "output",
        "part", "perceptor", "played", "sees_frames", "sim_latency_s", "woken",
    )  # fmt: skip

    def __init__(self, index: int, part: PerceptorPart, slots: dict[str, Slot], output: Slot, robot: Robot) -> None:
        self.index = index
        self.name = part.name
        self.part = part
        self.perceptor: Perceptor[Any, Any, Any] = part.cls(part.config, robot)
        self.lookout = Lookout(part.cls.sees, slots)
        self.output = output
        self.offload = part.cls.offload
        self.sim_latency_s = part.cls.sim_latency_s
        self.sees_frames = any(issubclass(spec.topic.type, CameraFrame) for spec in part.cls.sees.specs)
        self.played: deque[Message | str | None] | None = None  # in replay: what was recorded, where no frames were
        self.woken = False
        self.busy = False
        self.again = False
        self.benched: str = ""
        self.explanation: Explanation = ()
        self.explained_ns = 0


class BehaviourNode:
    """One behaviour. `instance` lives as long as one goal; `proposal` stands until replaced or withdrawn."""

    __slots__ = (
        "benched", "blind_since_ns", "emits", "explained_ns", "explanation", "index", "instance", "lookout", "name",
        "outcome", "part", "priority", "proposal", "robot", "started_ns", "woken",
    )  # fmt: skip

    def __init__(self, index: int, part: BehaviourPart, slots: dict[str, Slot], robot: Robot) -> None:
        self.index = index
        self.name = part.name
        self.part = part
        self.priority = part.priority
        self.emits: type[Any] = part.cls.emits
        self.lookout = Lookout(part.cls.sees, slots)
        self.robot = robot
        self.instance: Behaviour[Any, Any, Any] | None = None
        self.proposal: Proposal | None = None
        self.woken = False
        self.benched: str = ""
        self.outcome: str = ""
        self.started_ns = 0
        self.blind_since_ns: int | None = None
        self.explanation: Explanation = ()
        self.explained_ns = 0

    def begin(self, goal: Goal | None, now_ns: int) -> None:
        """A fresh instance for a new goal."""
        self.instance = self.part.cls(self.part.config, goal if goal is not None else self.part.goal, self.robot)
        self.proposal = None
        self.outcome = ""
        self.started_ns = now_ns
        self.blind_since_ns = None
        self.explanation, self.explained_ns = (), 0  # what the goal before thought is history

    def end(self, outcome: str) -> None:
        """The goal is over, whichever way: withdraw, clean up, forget the instance."""
        instance, self.instance, self.proposal = self.instance, None, None
        self.outcome = outcome
        if instance is not None:
            instance.close()


Node: TypeAlias = PerceptorNode | BehaviourNode
