"""From a config's plain data to the parts of one robot, gathering every problem on the way."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

from robotd.authoring.config import Config, NoConfig
from robotd.authoring.device import World
from robotd.engine.parts import BehaviourPart, BridgePart, DevicePart, Parts, PerceptorPart, WorldPart
from robotd.safety.settings import GuardConfig, GuardianConfig, Zones
from robotd.setup.problems import Path
from robotd.setup.registry import PluginError, Registry
from robotd.setup.sections import (
    ENTRIES,
    PLUGIN_SECTIONS,
    SECTIONS,
    BehaviourEntry,
    DeviceEntry,
    OperatorSection,
    RecorderSection,
    RobotSection,
    SimulationEntry,
    TopSection,
    entry_keys,
)
from robotd.setup.validate import Checker, said
from robotd.setup.words import meant_key, nearest, suggestion
from robotd.world.kinematics import Ackermann
from robotd.world.robot import Robot

SectionT = TypeVar("SectionT", bound=Config)

_NAME = re.compile(r"[a-z][a-z0-9_]*\Z")
_NO_GUARD = GuardConfig(zones=Zones(off="stands in for a guard that was refused"))
_ANY_BODY = Robot(kinematics=Ackermann(wheelbase_m=0.2, track_m=0.2, max_steering_rad=0.4))
"""Stands in for a body that was refused: no check of commands has anything to say against it."""


@dataclass(slots=True)
class Assembled:
    """What came out. `parts` is None where there were problems."""

    parts: Parts | None
    recorder: RecorderSection


@dataclass(slots=True)
class _Entry:
    """One plugin of the file: its name, what every entry may say, its class and its config (None where refused)."""

    name: str
    path: Path
    own: Any
    cls: type[Any] | None
    config: Config | None
    topics: dict[str, str]


@dataclass(slots=True)
class Assembler:
    """Builds the parts of one robot. `whole`: check `simulation:` down to its parameters also without `sim`."""

    checker: Checker
    registry: Registry
    sim: bool = False
    whole: bool = False
    _misspelt: set[str | None] = field(default_factory=set, init=False)
    """Sections that seem to be there under a wrong name: that is one mistake, and nothing else is said of them."""
    _blurred: bool = field(default=False, init=False)
    """A class or a topic name is unknown, so that nothing can be said about who reads what from whom."""

    def run(self) -> Assembled:
        """Check everything, then build."""
        checker, source = self.checker, self.checker.source
        top = self._mapping(source.data, ())
        for key in top:
            if key not in SECTIONS:
                checker.at_key((key,), "unknown section", self._where_it_belongs(key))
                self._misspelt.add(nearest(key, SECTIONS))
        self._blurred = not self._misspelt.isdisjoint(PLUGIN_SECTIONS)
        robot = self._section(RobotSection, top, "robot")
        guard = self._section(GuardConfig, top, "guard")
        guardian = self._section(GuardianConfig, top, "guardian")
        operator = self._section(OperatorSection, top, "operator")
        recorder = self._section(RecorderSection, top, "recorder")
        single = checker.model(TopSection, {k: v for k, v in top.items() if k in TopSection.model_fields}, ())
        entries = {section: self._entries(section, top.get(section)) for section in PLUGIN_SECTIONS}
        if robot is not None:
            self._are_devices(robot.mounts, ("robot", "mounts"), entries["devices"])
        world, twins, armed = self._simulation(top, entries["devices"])
        devices = twins if self.sim else entries["devices"]
        parts = Parts(
            robot=robot.build() if robot is not None else _ANY_BODY,
            devices=tuple(_device(e) for e in devices if e.cls is not None),
            perceptors=tuple(_perceptor(e) for e in entries["perception"] if e.cls is not None),
            behaviours=tuple(_behaviour(e, i) for i, e in enumerate(entries["behaviours"]) if e.cls is not None),
            bridges=tuple(
                BridgePart(e.name, e.cls, e.config or NoConfig()) for e in entries["bridges"] if e.cls is not None
            ),
            guard=guard if guard is not None else _NO_GUARD,
            guardian=guardian if guardian is not None else GuardianConfig(),
            act_hz=single.act_hz if single is not None else 50.0,
            arm_at_start=armed if self.sim else operator is not None and operator.arm_at_start,
            world=world,
        )
        self._ties(entries["behaviours"])
        if not self._blurred:
            self._flow(parts)
        good = not checker.problems and not source.problems
        return Assembled(parts if good else None, recorder if recorder is not None else RecorderSection())

    # --------------------------------------------------------------------------------------- sections

    def _mapping(self, value: Any, path: Path) -> dict[str, Any]:
        """A section's content; an empty section is an empty mapping, anything else is a problem."""
        if isinstance(value, dict):
            return value
        if value is not None:
            self.checker.at_value(path, f"is {said(value)} (expected a mapping of keys to values)")
            self._blurred = True
        return {}

    def _section(self, cls: type[SectionT], top: dict[str, Any], key: str) -> SectionT | None:
        if key not in top and key == "robot":
            if key not in self._misspelt:
                self.checker.at_key(
                    (), "section `robot` is missing", "it holds kinematics, footprint_m, mounts and limits"
                )
            return None
        raw = top.get(key)
        if raw is not None and not isinstance(raw, dict):
            self.checker.at_value((key,), f"is {said(raw)} (expected a mapping of keys to values)")
            return None
        return self.checker.model(cls, raw if raw is not None else {}, (key,))

    def _entries(self, section: str, value: Any) -> list[_Entry]:
        found: list[_Entry] = []
        for name, content in self._mapping(value, (section,)).items():
            path: Path = (section, name)
            if self.checker.source.is_spoiled(path):
                self._blurred = True
                continue
            if not _NAME.match(name):
                self.checker.at_key(path, "is not a name (expected lower case letters, digits and _, a letter first)")
            found.append(self._entry(section, name, self._mapping(content, path), path))
        return found

    def _entry(self, section: str, name: str, content: dict[str, Any], path: Path) -> _Entry:
        form = ENTRIES[section]
        reserved = entry_keys(form)
        cls = self._load(section, content, name, path)
        params = {key: value for key, value in content.items() if key not in reserved}
        fields = [*cls.config_type.model_fields] if cls is not None else []
        excused = {meant_key(key, [*fields, *reserved]) for key in params if key not in fields}
        own: Any = self.checker.model(
            form, {key: value for key, value in content.items() if key in reserved}, path, excused=excused
        )
        config: Config | None = None
        topics: dict[str, str] = {}
        if cls is not None:
            hidden = [key for key in fields if key in reserved]
            if hidden:
                self.checker.at_key(
                    path, f"{cls.__name__} has a parameter '{hidden[0]}', a key that robotd keeps for itself"
                )
            config = self.checker.model(cls.config_type, params, path, also=reserved)
            content.update(params)
            if isinstance(own, BehaviourEntry):
                own = self._goal(own, cls, path)
            elif form is DeviceEntry:
                emits = (cls.produces,) if section == "perception" else cls.emits
                topics = self._topics(own, emits, path)
        return _Entry(name, path, own, cls, config, topics)

    def _load(self, section: str, content: dict[str, Any], name: str, path: Path) -> type[Any] | None:
        use = content.get("use")
        said_so = use is not None
        if said_so and not isinstance(use, str):
            # refused with the other keys of the entry
            self._blurred = True
            return None
        try:
            cls = self.registry.load(section, use if isinstance(use, str) else name)
        except PluginError as error:
            self._blurred = True
            misspelt = [key for key in content if key not in entry_keys(ENTRIES[section]) and nearest(key, ["use"])]
            if said_so:
                self.checker.at_value((*path, "use"), error.message, error.hint)
            elif error.unknown and misspelt:
                self.checker.at_key((*path, misspelt[0]), "unknown key", "did you mean 'use'?")
            else:
                name_it = error.unknown and "did you mean" not in error.hint
                hint = f"say which one with `use:`; {error.hint}" if name_it else error.hint
                self.checker.at_key(path, error.message, hint)
            return None
        if section == "devices" and issubclass(cls, World):
            self._blurred = True
            self.checker.at_key(
                path, f"{cls.__name__} is a simulated world", "it belongs under `simulation: {use: ...}`"
            )
            return None
        return cls

    def _goal(self, own: BehaviourEntry, cls: type[Any], path: Path) -> BehaviourEntry:
        if own.goal is None and not own.start:
            return own
        goal = self.checker.model(cls.goal_type, own.goal if own.goal is not None else {}, (*path, "goal"))
        # the checked goal travels in place of the mapping that it came from
        return own.model_copy(update={"goal": goal})

    def _are_devices(self, named: Iterable[str], path: Path, devices: Sequence[_Entry]) -> None:
        known = [entry.name for entry in devices]
        for name in named:
            if name not in known and "devices" not in self._misspelt:
                self.checker.at_key((*path, name), "there is no device of this name", suggestion(name, known))

    # ------------------------------------------------------------------------------------- simulation

    def _simulation(
        self, top: dict[str, Any], devices: Sequence[_Entry]
    ) -> tuple[WorldPart | None, list[_Entry], bool]:
        path: Path = ("simulation",)
        if "simulation" not in top:
            self._blurred = self._blurred or self.sim
            if self.sim and "simulation" not in self._misspelt:
                self.checker.at_key((), "section `simulation` is missing", "for example simulation: {use: flat_world}")
            return None, [], True
        content = self._mapping(top["simulation"], path)
        reserved = entry_keys(SimulationEntry)
        params = {key: value for key, value in content.items() if key not in reserved}
        own = self.checker.model(SimulationEntry, {k: v for k, v in content.items() if k in reserved}, path)
        overrides = content.get("devices") or {}
        self._are_devices(overrides if isinstance(overrides, dict) else (), (*path, "devices"), devices)
        if own is None or not (self.sim or self.whole):
            self._blurred = self._blurred or self.sim
            return None, [], True
        world: WorldPart | None = None
        try:
            cls = self.registry.load("devices", own.use)
        except PluginError as error:
            self.checker.at_value((*path, "use"), error.message.replace("device", "world", 1), error.hint)
        else:
            if issubclass(cls, World):
                config = self.checker.model(cls.config_type, params, path, also=reserved)
                content.update(params)
                world = WorldPart(cls, config) if config is not None else None
            else:
                self.checker.at_value((*path, "use"), f"{cls.__name__} is a device, not a simulated world")
        twins = [self._twin(entry, overrides) for entry in devices]
        return world if self.sim else None, twins, own.arm_at_start

    def _twin(self, entry: _Entry, overrides: dict[str, Any]) -> _Entry:
        path: Path = ("simulation", "devices", entry.name)
        nobody = replace(entry, cls=None, config=None)
        if entry.cls is None:
            return nobody
        raw = overrides.get(entry.name)
        params = dict(raw) if isinstance(raw, dict) else {}
        named = params.pop("use", None)
        if named is None and entry.cls.sim_twin is None:
            # without --sim nothing is replaced; parameters for a twin that cannot be are a mistake all the same
            if self.sim or entry.name in overrides:
                self._blurred = self._blurred or self.sim
                self.checker.at_key(
                    entry.path if self.sim else path,
                    f"{entry.cls.__name__} has no simulated twin (`sim_twin`)",
                    f"name one: simulation: {{devices: {{{entry.name}: {{use: ...}}}}}}",
                )
            return nobody
        try:
            cls = self.registry.load("devices", str(named) if named is not None else str(entry.cls.sim_twin))
        except PluginError as error:
            if named is not None:
                self.checker.at_value((*path, "use"), error.message, error.hint)
            else:
                self.checker.at_key(entry.path, f"its simulated twin: {error.message}", error.hint)
            self._blurred = self._blurred or self.sim
            return nobody
        config = self.checker.model(cls.config_type, params, path, also=("use",))
        if isinstance(raw, dict):
            raw.update(params)
        # a twin may publish less than the device that it stands for
        kinds = {kind.__name__ for kind in cls.emits}
        return replace(entry, cls=cls, config=config, topics={k: t for k, t in entry.topics.items() if k in kinds})

    def _topics(self, own: Any, emits: tuple[type[Any], ...], path: Path) -> dict[str, str]:
        """Message type to topic name, as `as:` says."""
        if not isinstance(own, DeviceEntry):
            self._blurred = True
            return {}
        rename, path = own.rename, (*path, "as")
        kinds = [kind.__name__ for kind in emits]
        if rename is None:
            return {}
        before = len(self.checker.problems)
        if isinstance(rename, str) and len(kinds) != 1:
            what = f"publishes {' and '.join(kinds)}" if kinds else "publishes nothing"
            hint = f"write as: {{{kinds[0]}: {rename}}}" if kinds else "remove `as`"
            self.checker.at_value(path, f"this device {what}", hint)
        topics = rename if isinstance(rename, dict) else {kinds[0]: rename} if kinds else {}
        for kind, topic in topics.items():
            at = path if isinstance(rename, str) else (*path, kind)
            if not _NAME.match(topic):
                self.checker.at_value(at, f"{topic!r} is not a topic (expected lower snake case such as rear_scan)")
            elif kind not in kinds:
                self.checker.at_key(at, f"this device publishes no {kind}", suggestion(kind, kinds))
        if len(self.checker.problems) > before:
            self._blurred = True
            return {}
        return topics

    # ----------------------------------------------------------------------------------- cross checks

    def _ties(self, entries: Sequence[_Entry]) -> None:
        first: dict[int, str] = {}
        for entry in entries:
            priority = entry.own.priority if isinstance(entry.own, BehaviourEntry) else None
            if priority is None:
                continue
            if priority in first:
                self.checker.at_value(
                    (*entry.path, "priority"),
                    f"{priority} is also the priority of {first[priority]}; a tie has no winner",
                    "give each behaviour its own",
                )
            first.setdefault(priority, entry.name)

    def _flow(self, parts: Parts) -> None:
        from robotd.engine.graph import problems

        told = {problem.path for problem in self.checker.problems}
        for wrong in problems(parts):
            path = tuple(wrong.path.split(".")) if wrong.path else ()
            section_refused = path[:1] in (("robot",), ("guard",)) and any(
                p == path[0] or p.startswith((f"{path[0]}.", f"{path[0]}[")) for p in told
            )
            if wrong.path in told or section_refused:
                continue
            if isinstance(_at(self.checker.source.data, path), dict):
                self.checker.at_key(path, wrong.message, wrong.hint)
            else:
                self.checker.at_value(path, wrong.message, wrong.hint)

    def _where_it_belongs(self, key: str) -> str:
        near = nearest(key, SECTIONS)
        if near is not None:
            return f"did you mean '{near}'?"
        forms: dict[str, type[Config]] = {
            "robot": RobotSection, "guard": GuardConfig, "guardian": GuardianConfig, "operator": OperatorSection,
        }  # fmt: skip
        for section, form in forms.items():
            if key in form.model_fields:
                return f"it belongs under `{section}:`"
        for section in PLUGIN_SECTIONS:
            if key in self.registry.names(section):
                return f"it belongs under `{section}:`"
        return f"known: {', '.join(SECTIONS)}"


def _device(entry: _Entry) -> DevicePart:
    assert entry.cls is not None
    if entry.config is None:
        return DevicePart(entry.name, _of_unknown_rate(entry.cls), NoConfig(), entry.topics)
    return DevicePart(entry.name, entry.cls, entry.config, entry.topics)


def _perceptor(entry: _Entry) -> PerceptorPart:
    assert entry.cls is not None
    topic = entry.topics.get(entry.cls.produces.__name__)
    return PerceptorPart(entry.name, entry.cls, entry.config or NoConfig(), topic)


def _behaviour(entry: _Entry, index: int) -> BehaviourPart:
    assert entry.cls is not None
    own = entry.own
    if not isinstance(own, BehaviourEntry):
        # stands in for an entry that was refused: a priority that nothing else has
        own = BehaviourEntry(priority=0).model_copy(update={"priority": -1_000_000 - index})
    # `Assembler._goal` has put the checked goal here
    goal: Any = own.goal
    config = entry.config or NoConfig()
    return BehaviourPart(entry.name, entry.cls, config, own.priority, own.start, goal, own.timeout_s)


def _of_unknown_rate(cls: type[Any]) -> type[Any]:
    """The same class without a word about its period, for a device whose parameters were refused: the flow of data can
    still be checked, only not its pace."""
    return type(cls.__name__, (cls,), {"publish_period_s": classmethod(lambda cls, config: None)})


def _at(data: Any, path: Path) -> Any:
    for step in path:
        data = data.get(step) if isinstance(data, dict) else None
    return data
