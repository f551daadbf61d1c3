"""A bridge's hold on the runtime: requests answered at once, status, newest messages, events, explanations."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator, Mapping
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError
from typing_extensions import TypeVar

from robotd.authoring.bridge import Refused
from robotd.authoring.explain import Explanation
from robotd.engine.status import BehaviourStatus, DeviceStatus, Status, StreamStatus
from robotd.safety.operator import (
    Arm,
    Cancel,
    Disarm,
    EStop,
    Pause,
    Request,
    ResetEStop,
    Resume,
    Start,
    Teleop,
)
from robotd.world.clock import Clock, ns
from robotd.world.messages import Command, Event, Message
from robotd.world.robot import Robot
from robotd.world.topics import Topic

if TYPE_CHECKING:
    from robotd.engine.runtime import Runtime

MessageT = TypeVar("MessageT", bound=Message, default=Message)

log = logging.getLogger("robotd")

EVENTS_KEPT = 256
WATCH_PERIOD_S = 0.02
LISTENING_NS = 500_000_000
"""How long after the last question somebody still counts as listening to `explain()`."""


class RuntimeHandle:
    """Implements `RuntimeLink`. All methods belong on the loop thread."""

    def __init__(self, runtime: Runtime) -> None:
        self._runtime = runtime
        self._core = runtime.core
        self.robot: Robot = runtime.parts.robot
        loop: Any = asyncio.get_running_loop()
        self.clock: Clock = loop
        self._rates = _Rates()

    # ----------------------------------------------------------------------------------- requests

    def arm(self, by: str) -> None:
        self._ask(Arm(by))

    def disarm(self, by: str) -> None:
        self._ask(Disarm(by))

    def estop(self, by: str, reason: str) -> None:
        self._ask(EStop(by, reason))

    def reset_estop(self, by: str) -> None:
        self._ask(ResetEStop(by))

    def start(self, by: str, behaviour: str, goal: Mapping[str, Any] | None = None) -> None:
        typed = None
        if goal is not None:
            part = next((part for part in self._runtime.parts.behaviours if part.name == behaviour), None)
            if part is not None:
                try:
                    typed = part.cls.goal_type.model_validate(dict(goal), strict=False)
                except ValidationError as error:
                    first = error.errors()[0]
                    place = ".".join(str(p) for p in first["loc"]) or "goal"
                    raise Refused(f"goal of {behaviour}: {place}: {first['msg']}") from error
        self._ask(Start(by, behaviour, typed))

    def cancel(self, by: str, behaviour: str) -> None:
        self._ask(Cancel(by, behaviour))

    def pause(self, by: str) -> None:
        self._ask(Pause(by))

    def resume(self, by: str) -> None:
        self._ask(Resume(by))

    def teleop(self, by: str, drive: Command, lease_s: float) -> None:
        self._ask(Teleop(by, drive, ns(lease_s)))

    def stop_program(self) -> None:
        """End the program: stop the motors, close the devices, exit 0."""
        self._runtime.stop()

    def _ask(self, request: Request) -> None:
        refused = self._core.request(request, self.clock.now_ns())
        if refused:
            raise Refused(refused)

    # ----------------------------------------------------------------------------------- questions

    def snapshot(self) -> Status:
        """Everything a person asks about, at this instant."""
        core, now_ns = self._core, self.clock.now_ns()
        losers = {loser.by: f"{loser.loss.value} {loser.detail}".strip() for loser in core.way_down.verdict.losers}
        winner = core.way_down.verdict.winner
        behaviours = tuple(
            BehaviourStatus(
                name=node.name,
                active=node.instance is not None,
                state=_state_text(node.explanation) if node.instance is not None else node.benched or node.outcome,
                priority=node.priority,
                verdict_reason="drives" if winner is not None and winner.by == node.name else losers.get(node.name, ""),
            )
            for node in core.graph.behaviours
        )
        faults = {kept.name: sum(kept.faults.values()) for kept in self._runtime.devices}
        streams = tuple(
            StreamStatus(
                topic=slot.topic.name,
                source=slot.source,
                rate_hz=self._rates.of(slot.topic.name, slot.sequence, now_ns),
                age_s=(now_ns - slot.oldest_ns) / 1e9 if slot.message is not None else float("inf"),
                overwritten=slot.overwritten,
                faults=faults.get(slot.source, 0),
            )
            for slot in core.graph.slots.values()
            if slot.source
        )
        return Status(
            now_ns=now_ns,
            mode=core.operator.mode,
            reason=core.standing_reason,
            behaviours=behaviours,
            streams=streams,
            devices=tuple(
                DeviceStatus(kept.name, kept.state, kept.detail or core.complaints.get(kept.name, ""))
                for kept in self._runtime.devices
            )
            + self._guardian(),
            command=core.way_down.command,
            by=winner.by if winner is not None else "",
            limited_by=core.way_down.limited_by,
            tick_late_ms=self._runtime.tick_late_ns / 1e6,
            turns=core.turns,
            virtual=self._runtime.virtual,
            zones_off=self._runtime.parts.guard.zones.off or "",
        )

    def _guardian(self) -> tuple[DeviceStatus, ...]:
        guarding = self._runtime.guarding
        return (DeviceStatus("guardian", guarding.device_state, guarding.detail),) if guarding is not None else ()

    def status(self) -> Mapping[str, Any]:
        """The snapshot as plain data for JSON: mode by name, no infinities."""
        return self.snapshot().as_dict()

    def topics(self) -> tuple[Topic[Message], ...]:
        return tuple(slot.topic for slot in self._core.graph.slots.values() if slot.source)

    def newest(self, topic: Topic[MessageT]) -> MessageT | None:
        slot = self._core.graph.slots.get(topic.name)
        message = slot.message if slot is not None else None
        return message if isinstance(message, topic.type) else None

    async def watch(self, *topics: Topic[Message]) -> AsyncIterator[Message]:
        """Newest messages of `topics` as they change, looked at every 20 ms: a slow reader delays nobody."""
        slots = [self._core.graph.slots[topic.name] for topic in topics if topic.name in self._core.graph.slots]
        seen = [-1] * len(slots)
        while True:
            for i, slot in enumerate(slots):
                if slot.sequence != seen[i] and slot.message is not None:
                    seen[i] = slot.sequence
                    yield slot.message
            await asyncio.sleep(WATCH_PERIOD_S)

    async def events(self) -> AsyncIterator[Event]:
        queue: asyncio.Queue[Event] = asyncio.Queue()

        def keep(event: Event) -> None:
            if queue.qsize() >= EVENTS_KEPT:
                lost = queue.get_nowait()
                log.error("ALARM: a bridge left %d events unread; lost %s", EVENTS_KEPT, lost)
            queue.put_nowait(event)

        self._core.on_event.append(keep)
        try:
            while True:
                yield await queue.get()
        finally:
            self._core.on_event.remove(keep)

    def explanations(self) -> Mapping[str, Explanation]:
        self._core.stepping.explain_until_ns = self.clock.now_ns() + LISTENING_NS
        return {node.name: node.explanation for node in self._core.graph.nodes if node.explanation}


def _state_text(explanation: Explanation) -> str:
    """The `state` that a behaviour names in its explanation, or just that it is active."""
    for drawing in explanation:
        text = getattr(drawing, "text", None)
        if text is not None and drawing.name == "state":
            return str(text)
    return "active"


class _Rates:
    """Messages a second of each topic, between two looks at least 0.5 s apart."""

    def __init__(self) -> None:
        self._seen: dict[str, tuple[int, int, float]] = {}

    def of(self, topic: str, sequence: int, now_ns: int) -> float:
        then, at_ns, rate = self._seen.get(topic, (sequence, now_ns, 0.0))
        if now_ns - at_ns >= 500_000_000:
            rate = (sequence - then) * 1e9 / (now_ns - at_ns)
            self._seen[topic] = (sequence, now_ns, rate)
        elif topic not in self._seen:
            self._seen[topic] = (then, at_ns, rate)
        return rate
