"""The deterministic heart of one robot: every input of every turn enters by a method here, together with the time.

One turn, in this order, without a wait or a queue:

    1. the message goes into its slot (or a timer fires, a request comes in, a device is lost)
    2. perceptors downstream of it step, in topological order
    3. behaviours downstream of it step, and put up, keep or withdraw their proposals
    4. the arbiter picks one, the guard limits it against the newest scans
    5. the base gets one write

Nothing in here reads a clock, opens a device or starts a task: replay calls the same methods with the recorded
inputs and must get the same commands, bit for bit.
"""

from __future__ import annotations

import logging
import math
from collections import deque
from collections.abc import Callable
from functools import partial

from robotd.engine.bus import Slot
from robotd.engine.contracts import Base, Journal, Offloader, Timers
from robotd.engine.graph import Graph, device_topics, needed_devices
from robotd.engine.nodes import BehaviourNode, Node, PerceptorNode
from robotd.engine.parts import Parts
from robotd.engine.stepping import Stepping, declared
from robotd.engine.way_down import WayDown
from robotd.safety.arbiter import Proposal
from robotd.safety.operator import (
    Answer,
    Arm,
    Disarm,
    Facts,
    OperatorState,
    Request,
    Start,
    Teleop,
    decide,
    ended,
)
from robotd.world.messages import (
    ActiveGoal,
    Battery,
    BatteryLow,
    Drive,
    EStopped,
    Event,
    Message,
    Mode,
    ModeChange,
    Outcome,
    Steer,
)
from robotd.world.topics import default_topic

log = logging.getLogger("robotd")


class Core:
    """The turn, the standing proposals, the operator's state and the last command of one robot."""

    def __init__(
        self,
        parts: Parts,
        graph: Graph,
        base: Base,
        *,
        timers: Timers,
        offloader: Offloader,
        journal: Journal | None = None,
        now_ns: int = 0,
    ) -> None:
        self.parts = parts
        self.graph = graph
        self.operator = OperatorState()
        self.way_down = WayDown(parts, graph, base, journal, self.operator.reason, now_ns)
        self.stepping = Stepping(
            timers=timers, offloader=offloader, journal=journal, finished=self._finished, expired=self.expire
        )
        self.turns = 0
        self.on_event: list[Callable[[Event], None]] = []
        self.on_armed: list[Callable[[], None]] = []
        self._visit = self.stepping.visit
        self._journal = journal
        self._slots = graph.slots
        self._behaviours = {node.name: node for node in graph.behaviours}
        self._manual: Proposal | None = None
        self._standing = ""
        self._open: dict[str, bool] = {part.name: False for part in parts.devices}
        self._device_slots = {
            part.name: tuple(graph.slots[topic.name] for topic in device_topics(part).values())
            for part in parts.devices
        }
        self.needed_devices = needed_devices(parts, graph)
        self._acting = False
        self.complaints: dict[str, str] = {}
        """Name of a device that is open to what is wrong with it all the same."""
        self._late: deque[Callable[[], object]] = deque()
        if journal is not None:
            journal.note("started", "", now_ns, None)
        self._publish_state(ModeChange(now_ns, self.operator.mode, self.operator.reason))
        self._publish_state(ActiveGoal(now_ns))

    # --------------------------------------------------------------------- inputs: each is one turn

    def receive(self, slot: Slot, message: Message, now_ns: int) -> None:
        """A device's message, in the loop turn in which its bytes arrived."""
        if self._acting:  # the base speaks while it is written to: a turn of its own, after this one
            self._late.append(partial(self.receive, slot, message, now_ns))
            return
        if self._journal is not None:
            self._journal.note("message", slot.topic.name, now_ns, message)
        slot.put(message, message.stamp_ns)
        if message.__class__ is Battery:
            self._watch_battery(slot.source, message, now_ns)
        if slot.downstream:
            self._visit(slot.downstream, now_ns)
        self._act(now_ns)

    def tick(self, now_ns: int) -> None:
        """What no message wakes: expiry, ramps, heartbeat, time limits of goals."""
        if self._journal is not None:
            self._journal.note("tick", "", now_ns, None)
        if self.operator.active:
            for node in self.graph.behaviours:
                self.stepping.check_time(node, now_ns)
        self._act(now_ns, tick=True)

    def timer(self, node: Node, now_ns: int) -> None:
        """A view that steps on time alone is due."""
        if self._journal is not None:
            self._journal.note("timer", node.name, now_ns, node.index)
        self.stepping.wake(node, now_ns)
        self._act(now_ns)

    def expire(self, node: Node, now_ns: int) -> None:
        """An optional input of a view became too old: the step sees None now."""
        if self._journal is not None:
            self._journal.note("expiry", node.name, now_ns, node.index)
        self.stepping.wake(node, now_ns)
        self._act(now_ns)

    def offloaded(self, node: PerceptorNode, result: Message | str | None, oldest_ns: int, now_ns: int) -> None:
        """A slow perceptor finished: its message, None, or the text of its exception."""
        if not isinstance(result, str):
            result = declared(node, result)
        if self._journal is not None:
            self._journal.note("offloaded", node.name, now_ns, (result, oldest_ns))
        self.stepping.offloaded(node, result, oldest_ns, now_ns)
        self._act(now_ns)

    def request(self, request: Request, now_ns: int) -> str:
        """An operator's request; returns the reason of a refusal, or an empty string."""
        if self._acting:  # the way to the base is closed while it is written to: a turn of its own, after this one
            self._late.append(partial(self.request, request, now_ns))
            return ""
        if self._journal is not None:
            self._journal.note("request", type(request).__name__, now_ns, request)
        if isinstance(request, Teleop) and self.way_down.takes is Steer and isinstance(request.drive, Drive):
            return "this base is a car: drive it by hand with Steer, a Drive cannot be converted"
        answer = decide(self.operator, request, self._facts(), now_ns)
        if answer.refused:
            log.info("refused %s: %s", type(request).__name__, answer.refused)
            return answer.refused
        was_estopped = self.operator.estop is not None
        if answer.state.estop is not None and not was_estopped:
            self._acting = True  # what the base says to it comes after this turn
            try:
                self.way_down.estop()
            finally:
                self._acting = False
        self._take(answer, now_ns)
        if answer.state.estop is not None and not was_estopped:
            self._emit(EStopped(now_ns, answer.state.estop.by, answer.state.estop.reason))
        if isinstance(request, Arm):
            for armed in self.on_armed:
                armed()
        self._act(now_ns)
        return ""

    def device_opened(self, name: str, now_ns: int) -> None:
        """A device is ready for use."""
        if self._journal is not None:
            self._journal.note("opened", name, now_ns, None)
        self._open[name] = True

    def device_lost(self, name: str, reason: str, now_ns: int) -> None:
        """A device went away: what it said counts as missing, and a robot that needs it is disarmed.

        A name that is none of the config's devices (the guardian) is needed from its first word on.
        """
        if self._acting:  # the base broke while it was written to
            self._late.append(partial(self.device_lost, name, reason, now_ns))
            return
        if self._journal is not None:
            self._journal.note("lost", name, now_ns, reason)
        self._open[name] = False
        self.complaints.pop(name, None)
        if name not in self._device_slots:
            self.needed_devices |= {name}
        for slot in self._device_slots.get(name, ()):
            slot.clear()
        if name in self.needed_devices and self.operator.armed:
            answer = decide(self.operator, Disarm("runtime", reason), self._facts(), now_ns)
            self._take(answer, now_ns)
        for node in self.graph.behaviours:
            if node.proposal is not None and node.lookout.look(now_ns) is None:
                node.proposal = None
        self._act(now_ns)

    def halt(self) -> None:
        """The way out: stop the base, whatever state the rest is in. From here on nothing drives or is written down."""
        self._journal = self.stepping.journal = None
        self.way_down.halt()

    # ------------------------------------------------------------------------------------- questions

    @property
    def not_ready(self) -> str:
        """Why the robot cannot be armed, or empty."""
        closed = sorted(name for name in self.needed_devices if not self._open[name])
        return f"waiting for {', '.join(closed)}" if closed else ""

    def is_open(self, device: str) -> bool:
        return self._open[device]

    @property
    def standing_reason(self) -> str:
        """Why the robot stands still, in words; empty while it moves."""
        way_down, verdict = self.way_down, self.way_down.verdict
        if way_down.moves:
            return ""
        if way_down.guard_reason:
            return way_down.guard_reason
        if verdict.winner is not None:
            return f"{verdict.winner.by} asks to stand still"
        if self.operator.mode is not Mode.AUTO or verdict.losers:
            return verdict.reason
        waiting = [
            f"{n.name} waits for {n.lookout.missing[0]} ({n.lookout.missing[1]})"
            for n in self.graph.behaviours
            if n.instance is not None and n.lookout.missing is not None
        ]
        over = [f"{n.name} {n.outcome}" for n in self.graph.behaviours if n.outcome and n.instance is None]
        benched = [f"{n.name} is benched: {n.benched}" for n in self.graph.behaviours if n.benched]
        return "; ".join(waiting or benched or over) or verdict.reason

    # ------------------------------------------------------------------- arbitration, guard, one write

    def _act(self, now_ns: int, *, tick: bool = False) -> None:
        """Ends every turn; what the base said or suffered meanwhile follows as turns of their own."""
        self.turns += 1
        proposals = [node.proposal for node in self.graph.behaviours if node.proposal is not None]
        self._acting = True
        try:
            if self.way_down.decide(proposals, self._manual, self.operator, now_ns, tick=tick):
                self._say_standing()
        finally:
            self._acting = False
        while self._late:
            self._late.popleft()()

    def _say_standing(self) -> None:
        reason = self.standing_reason
        if reason and reason != self._standing:
            log.info("standing still because %s", reason)
        self._standing = reason

    # -------------------------------------------------------------------------------------- operator

    def _facts(self) -> Facts:
        return Facts(
            behaviours=frozenset(self._behaviours),
            benched=frozenset(node.name for node in self.graph.behaviours if node.benched),
            autostart=tuple(Start("config", part.name, part.goal) for part in self.parts.behaviours if part.start),
            not_ready=self.not_ready,
        )

    def _become(self, state: OperatorState) -> None:
        self.operator = state
        self.stepping.behaves = state.mode is Mode.AUTO

    def _finished(self, node: BehaviourNode, result: str, reason: str, now_ns: int) -> None:
        self._become(ended(self.operator, node.name))
        self._publish_state(ActiveGoal(now_ns))
        self._emit(Outcome(now_ns, node.name, result, reason))

    def _take(self, answer: Answer, now_ns: int) -> None:
        before = self.operator
        self._become(answer.state)
        lease = answer.state.lease
        self._manual = Proposal(lease.by, 0, lease.drive, now_ns, lease.until_ns) if lease is not None else None
        for name in answer.stop:
            node = self._behaviours[name]
            if node.instance is not None:
                kept = self.operator
                self.stepping.finish(node, "CANCELLED", answer.why, now_ns)
                self._become(kept)
        for start in answer.start:
            node = self._behaviours[start.behaviour]
            try:
                node.begin(start.goal, now_ns)
            except Exception as error:
                self.stepping.bench(node, f"{type(error).__name__}: {error}", now_ns, error)
                continue
            self._publish_state(ActiveGoal(now_ns, node.name, start.goal))
        if before.mode is not self.operator.mode:
            if self.operator.mode is not Mode.AUTO:
                for node in self.graph.behaviours:
                    node.proposal = None
            log.info("mode %s%s", self.operator.mode.value, f": {self.operator.reason}" if self.operator.reason else "")
            self._publish_state(ModeChange(now_ns, self.operator.mode, self.operator.reason))

    def _publish_state(self, message: Message) -> None:
        slot = self._slots[default_topic(type(message)).name]
        slot.put(message, message.stamp_ns)
        if slot.downstream:
            self._visit(slot.downstream, message.stamp_ns)

    def _watch_battery(self, device: str, battery: Message, now_ns: int) -> None:
        """Say it once when a pack becomes low, and as long as it is, in the status."""
        assert isinstance(battery, Battery)
        if not battery.low:
            if self.complaints.pop(device, None):
                log.info("%s: the battery is not low any more", device)
            return
        began = device not in self.complaints
        left = "" if math.isnan(battery.charge) else f", {battery.charge:.0%}"
        self.complaints[device] = words = f"battery low: {battery.voltage_v:.1f} V{left}"
        if began:
            log.warning("%s: %s: charge it", device, words)
            self._emit(BatteryLow(now_ns, device, battery.voltage_v, battery.charge))

    def _emit(self, event: Event) -> None:
        for listener in self.on_event:
            listener(event)
