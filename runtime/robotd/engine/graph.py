"""Who reads what from whom: checked as a whole before anything starts, then laid out in topological order."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from typing import Any

from robotd.authoring.device import Actuator, Device
from robotd.authoring.view import FieldSpec, View, Wake
from robotd.engine.bus import Slot
from robotd.engine.nodes import BehaviourNode, Node, PerceptorNode
from robotd.engine.parts import DevicePart, Parts, PerceptorPart
from robotd.world.clock import ns
from robotd.world.kinematics import Ackermann
from robotd.world.messages import ActiveGoal, Applied, Drive, LidarScan, Message, ModeChange, Steer
from robotd.world.topics import Topic, default_topic

CORE_TOPICS: tuple[Topic[Message], ...] = tuple(default_topic(t) for t in (ModeChange, ActiveGoal, Applied))
"""What a plugin may know of the way down; nobody else may publish these."""


@dataclass(frozen=True, slots=True)
class GraphProblem:
    """Something that cannot work. `path` is the place in the config (`behaviours.jetbot_route`)."""

    path: str
    message: str
    hint: str = ""


@dataclass(slots=True)
class Graph:
    """Slots by topic name, and the nodes in the order in which one turn visits them."""

    slots: dict[str, Slot]
    perceptors: tuple[PerceptorNode, ...]
    behaviours: tuple[BehaviourNode, ...]

    @property
    def nodes(self) -> tuple[Node, ...]:
        return (*self.perceptors, *self.behaviours)


def device_topics(part: DevicePart) -> dict[type[Message], Topic[Message]]:
    """The topic of each message type that a device publishes, after `as:`."""
    return {
        kind: Topic(part.topics[kind.__name__], kind) if kind.__name__ in part.topics else default_topic(kind)
        for kind in part.cls.emits
    }


def perceptor_topic(part: PerceptorPart) -> Topic[Message]:
    """The topic that a perceptor publishes on, after `as:`."""
    kind = part.cls.produces
    return Topic(part.topic, kind) if part.topic else default_topic(kind)


def problems(parts: Parts) -> list[GraphProblem]:
    """Everything wrong with the flow of data and commands; empty means `compile_graph` will work."""
    found: list[GraphProblem] = []
    producers: dict[str, tuple[str, Topic[Message]]] = {t.name: ("the runtime", t) for t in CORE_TOPICS}
    for path, topic in _outputs(parts):
        if topic.name in producers:
            found.append(
                GraphProblem(
                    path,
                    f"publishes {topic.name!r}, which {producers[topic.name][0]} publishes already",
                    f"give one of them another name, for example `as: {topic.name}_2`",
                )
            )
        else:
            producers[topic.name] = (path, topic)
    for path, view in _views(parts):
        for spec in view.specs:
            found += _field_problems(path, view, spec, producers)
    if not found:
        found += _cycle_problems(parts) + _age_problems(parts)
    return found + _command_problems(parts) + _guard_problems(parts, producers)


def compile_graph(parts: Parts) -> Graph:
    """Slots and nodes of a robot; raises ValueError with the first problem where `problems` finds any."""
    wrong = problems(parts)
    if wrong:
        raise ValueError(f"{wrong[0].path}: {wrong[0].message}")
    slots = {topic.name: Slot(topic) for topic in CORE_TOPICS}
    for path, topic in _outputs(parts):
        slots[topic.name] = Slot(topic)
        slots[topic.name].source = path.rpartition(".")[2]
    for _, view in _views(parts):
        for spec in view.specs:
            slots.setdefault(spec.topic.name, Slot(spec.topic))
    by_name = {part.name: part for part in parts.perceptors}
    order = [by_name[name] for name in _order(parts)]
    perceptors = tuple(
        PerceptorNode(i, part, slots, slots[perceptor_topic(part).name], parts.robot) for i, part in enumerate(order)
    )
    behaviours = tuple(
        BehaviourNode(len(order) + i, part, slots, parts.robot) for i, part in enumerate(parts.behaviours)
    )
    nodes: tuple[Node, ...] = (*perceptors, *behaviours)
    for slot in slots.values():
        slot.wakes = tuple(n for n in nodes if _reads(n, slot, Wake.EVERY))
        slot.readers = tuple(n for n in nodes if _reads(n, slot, None))
    for slot in slots.values():
        reached: set[int] = set()
        _reach(slot, reached)
        slot.downstream = tuple(n for n in nodes if n.index in reached)
    return Graph(slots, perceptors, behaviours)


def _reads(node: Node, slot: Slot, wake: Wake | None) -> bool:
    return any(
        spec.topic.name == slot.topic.name and wake in (None, spec.wake) for spec in node.lookout.view_type.specs
    )


def _reach(slot: Slot, reached: set[int]) -> None:
    for node in slot.wakes:
        if node.index not in reached:
            reached.add(node.index)
            if isinstance(node, PerceptorNode) and not node.offload:
                _reach(node.output, reached)


def _outputs(parts: Parts) -> Iterable[tuple[str, Topic[Message]]]:
    for device in parts.devices:
        for topic in device_topics(device).values():
            yield f"devices.{device.name}", topic
    for perceptor in parts.perceptors:
        yield f"perception.{perceptor.name}", perceptor_topic(perceptor)


def _views(parts: Parts) -> Iterable[tuple[str, type[View]]]:
    for perceptor in parts.perceptors:
        yield f"perception.{perceptor.name}", perceptor.cls.sees
    for behaviour in parts.behaviours:
        yield f"behaviours.{behaviour.name}", behaviour.cls.sees


def _field_problems(
    path: str, view: type[View], spec: FieldSpec, producers: dict[str, tuple[str, Topic[Message]]]
) -> list[GraphProblem]:
    name = spec.topic.name
    if name not in producers:
        if spec.wake is Wake.LATEST:
            return []
        import difflib

        same_type = [n for n, (_, t) in producers.items() if issubclass(t.type, spec.topic.type)]
        close = same_type or difflib.get_close_matches(name, producers, n=1)
        hint = f"there is {close[0]!r}: rename it with `as: {name}`" if close else "add a device or a perceptor for it"
        return [GraphProblem(path, f"needs {name!r} ({spec.topic.type.__name__}), which nothing publishes", hint)]
    source, topic = producers[name]
    if not issubclass(topic.type, spec.topic.type):
        return [
            GraphProblem(
                path,
                f"reads {name!r} as {spec.topic.type.__name__}, but {source} publishes {topic.type.__name__} there",
            )
        ]
    if topic.type is Applied and spec.wake is Wake.EVERY:
        return [
            GraphProblem(
                path,
                f"{view.__name__}.{spec.name}: the applied command cannot wake a step, it would answer itself",
                "use latest(within_s=...) or step by time: View, hz=20",
            )
        ]
    return []


def _feeds(parts: Parts) -> dict[str, set[str]]:
    """Each perceptor and the perceptors whose output it reads."""
    made_by = {perceptor_topic(p).name: p.name for p in parts.perceptors}
    return {
        p.name: {made_by[s.topic.name] for s in p.cls.sees.specs if s.topic.name in made_by} for p in parts.perceptors
    }


def _order(parts: Parts) -> list[str]:
    declared = {part.name: i for i, part in enumerate(parts.perceptors)}
    sorter = TopologicalSorter(_feeds(parts))
    sorter.prepare()
    order: list[str] = []
    while sorter.is_active():
        ready = sorted(sorter.get_ready(), key=declared.__getitem__)
        order += ready
        sorter.done(*ready)
    return order


def _cycle_problems(parts: Parts) -> list[GraphProblem]:
    try:
        _order(parts)
    except CycleError as error:
        ring: list[str] = error.args[1]
        return [
            GraphProblem(
                f"perception.{ring[0]}",
                f"perceptors read each other in a ring: {' -> '.join(ring)}",
                "data flows one way: let one of them read a sensor instead",
            )
        ]
    return []


def _period_ns(topic: str, parts: Parts, seen: frozenset[str] = frozenset()) -> int | None:
    """Longest time between two messages of a topic, and the delay a slow perceptor adds; None where unknown."""
    for device in parts.devices:
        if any(t.name == topic for t in device_topics(device).values()):
            period_s = device.cls.publish_period_s(device.config)
            return ns(period_s) if period_s is not None else None
    for part in parts.perceptors:
        if perceptor_topic(part).name == topic and topic not in seen:
            if part.cls.sees.period_ns is not None:
                return part.cls.sees.period_ns
            waking = [s.topic.name for s in part.cls.sees.specs if s.wake is Wake.EVERY]
            periods = [_period_ns(name, parts, seen | {topic}) for name in waking]
            known = [p for p in periods if p is not None]
            return min(known) if known else None
    return None


def _latency_ns(topic: str, parts: Parts, seen: frozenset[str] = frozenset()) -> int:
    for part in parts.perceptors:
        if perceptor_topic(part).name == topic and topic not in seen:
            own = ns(part.cls.sim_latency_s) if part.cls.offload else 0
            inputs = [s.topic.name for s in part.cls.sees.specs if s.wake is Wake.EVERY]
            return own + max((_latency_ns(name, parts, seen | {topic}) for name in inputs), default=0)
    return 0


def _age_problems(parts: Parts) -> list[GraphProblem]:
    found: list[GraphProblem] = []
    for path, view in _views(parts):
        for spec in view.specs:
            period = _period_ns(spec.topic.name, parts)
            if period is None or spec.within_ns is None:
                continue
            least = 3 * period // 2 + _latency_ns(spec.topic.name, parts)
            if spec.within_ns < least:
                found.append(
                    GraphProblem(
                        path,
                        f"{view.__name__}.{spec.name}: within_s={spec.within_ns / 1e9:g} starves: {spec.topic.name} "
                        f"comes every {period / 1e9:g} s; 1.5 periods and latency are {least / 1e9:g} s",
                        "raise within_s, or the rate of the source",
                    )
                )
    for source in _guard_sources(parts):
        period = _period_ns(source, parts)
        if period is not None and ns(parts.guard.scan_within_s) < 3 * period // 2:
            found.append(
                GraphProblem(
                    "guard.scan_within_s",
                    f"{parts.guard.scan_within_s:g} s is less than 1.5 periods of {source} ({period / 1e9:g} s)",
                    f"at least {1.5 * period / 1e9:g}",
                )
            )
    return found


def base_of(parts: Parts) -> DevicePart | None:
    """The one actuator that moves the robot; None where there is none or more than one."""
    bases = [part for part in parts.devices if issubclass(part.cls, Actuator)]
    return bases[0] if len(bases) == 1 else None


def _command_problems(parts: Parts) -> list[GraphProblem]:
    bases = [part for part in parts.devices if issubclass(part.cls, Actuator)]
    if len(bases) > 1:
        names = ", ".join(part.name for part in bases)
        return [
            GraphProblem(f"devices.{bases[1].name}", f"one robot has one base, but these all take commands: {names}")
        ]
    if not bases:
        return [GraphProblem("devices", "no device takes commands", "add the motors")] if parts.behaviours else []
    takes = _accepts(bases[0].cls)
    found: list[GraphProblem] = []
    is_car = isinstance(parts.robot.kinematics, Ackermann)
    for part in parts.behaviours:
        path = f"behaviours.{part.name}"
        emits = part.cls.emits
        if emits is Drive and takes is Steer:
            found.append(
                GraphProblem(path, f"emits Drive, but {bases[0].name} takes Steer, and a car cannot turn in place")
            )
        elif emits is Steer and takes is Drive and not is_car:
            found.append(
                GraphProblem(
                    path,
                    f"emits Steer, but {bases[0].name} takes Drive and robot.kinematics has no wheelbase to convert",
                    "kinematics: {type: ackermann, ...}",
                )
            )
    if parts.robot.limits.vy_mps > 0.0 and not parts.robot.kinematics.is_holonomic:
        found.append(
            GraphProblem(
                "robot.limits.vy_mps", "this base cannot move sideways", "set vy_mps: 0 or use mecanum kinematics"
            )
        )
    priorities: dict[int, str] = {}
    for part in parts.behaviours:
        if part.priority in priorities:
            found.append(
                GraphProblem(
                    f"behaviours.{part.name}.priority",
                    f"{part.priority} is also the priority of {priorities[part.priority]}; a tie has no winner",
                    "give each behaviour its own",
                )
            )
        priorities.setdefault(part.priority, part.name)
    return found


def _accepts(cls: type[Device[Any]]) -> type[Any]:
    assert issubclass(cls, Actuator)
    return cls.accepts


def _guard_sources(parts: Parts) -> tuple[str, ...]:
    zones = parts.guard.zones
    return tuple(dict.fromkeys(s for zone in (zones.stop, zones.slow) if zone is not None for s in zone.sources))


def _guard_problems(parts: Parts, producers: dict[str, tuple[str, Topic[Message]]]) -> list[GraphProblem]:
    found: list[GraphProblem] = []
    for zone in ("stop", "slow"):
        entry = getattr(parts.guard.zones, zone)
        for source in entry.sources if entry is not None else ():
            path = f"guard.zones.{zone}.sources"
            if source not in producers:
                scans = [n for n, (_, t) in producers.items() if issubclass(t.type, LidarScan)]
                hint = f"there is {scans[0]!r}" if scans else "or say `zones: {off: the reason}`"
                found.append(GraphProblem(path, f"{source!r} is published by nothing", hint))
            elif not issubclass(producers[source][1].type, LidarScan):
                kind = producers[source][1].type.__name__
                found.append(GraphProblem(path, f"{source!r} carries {kind}, a zone needs LidarScan"))
    contact = parts.guard.contact
    known = {part.name for part in parts.behaviours}
    for name in contact.behaviours if contact is not None else ():
        if name not in known:
            found.append(GraphProblem("guard.contact.behaviours", f"there is no behaviour {name!r}"))
    return found


def needed_devices(parts: Parts, graph: Graph) -> frozenset[str]:
    """Devices without which the robot does not drive: the base, the guard's sources, what a behaviour cannot miss."""
    wanted = set(_guard_sources(parts))
    nodes: list[Node] = list(graph.behaviours)
    made_by = {node.output.topic.name: node for node in graph.perceptors}
    while nodes:
        for spec in nodes.pop().lookout.view_type.specs:
            name = spec.topic.name
            if spec.wake is not Wake.LATEST and name not in wanted:
                wanted.add(name)
                if name in made_by:
                    nodes.append(made_by[name])
    needed = {
        part.name for part in parts.devices if any(topic.name in wanted for topic in device_topics(part).values())
    }
    base = base_of(parts)
    return frozenset(needed | ({base.name} if base is not None else set()))
