"""The parts of one robot after its config was read and checked: what `app` wires and `replay` rebuilds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from robotd.authoring.behaviour import Behaviour
from robotd.authoring.bridge import Bridge
from robotd.authoring.config import Config, Goal
from robotd.authoring.device import Device, World
from robotd.authoring.perceptor import Perceptor
from robotd.safety.settings import GuardConfig, GuardianConfig
from robotd.world.robot import Robot


@dataclass(frozen=True, slots=True)
class DevicePart:
    """One entry of `devices:`. `topics`: message type name to topic name, from `as:`; empty means default topics."""

    name: str
    cls: type[Device[Any]]
    config: Config
    topics: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class PerceptorPart:
    """One entry of `perception:`. `topic`: the name from `as:`, or None for the default topic."""

    name: str
    cls: type[Perceptor[Any, Any, Any]]
    config: Config
    topic: str | None = None


@dataclass(frozen=True, slots=True)
class BehaviourPart:
    """One entry of `behaviours:`.

    `start`: begin with `goal` as soon as the robot is armed. `timeout_s`: the goal fails after that long.
    """

    name: str
    cls: type[Behaviour[Any, Any, Any]]
    config: Config
    priority: int
    start: bool = False
    goal: Goal | None = None
    timeout_s: float | None = None


@dataclass(frozen=True, slots=True)
class BridgePart:
    """One entry of `bridges:`."""

    name: str
    cls: type[Bridge[Any]]
    config: Config


@dataclass(frozen=True, slots=True)
class WorldPart:
    """The simulated world that `--sim` opens before the devices."""

    cls: type[World[Any]]
    config: Config


@dataclass(frozen=True, slots=True)
class Parts:
    """One robot, checked and ready to be wired. In `--sim` the devices here are already the twins."""

    robot: Robot
    devices: tuple[DevicePart, ...]
    perceptors: tuple[PerceptorPart, ...] = ()
    behaviours: tuple[BehaviourPart, ...] = ()
    bridges: tuple[BridgePart, ...] = ()
    guard: GuardConfig = field(default_factory=GuardConfig)
    guardian: GuardianConfig = field(default_factory=GuardianConfig)
    act_hz: float = 50.0
    arm_at_start: bool = False
    world: WorldPart | None = None
