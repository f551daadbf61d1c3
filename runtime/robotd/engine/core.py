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
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from robotd.authoring.behaviour import Behaviour, Done, Failed, StepResult
from robotd.authoring.perceptor import Perceptor
from robotd.engine.bus import Slot
from robotd.engine.contracts import Base, Journal, Offloader, Timers
from robotd.engine.graph import Graph, device_topics, needed_devices
from robotd.engine.nodes import BehaviourNode, Node, PerceptorNode
from robotd.engine.parts import Parts
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
from robotd.world.clock import ns
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

EXPLAIN_PERIOD_NS = 100_000_000


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
        self.turns = 0
        self.explain_until_ns = 0
        self.on_event: list[Callable[[Event], None]] = []
        self.on_armed: list[Callable[[], None]] = []
        self._timers = timers
        self._offloader = offloader
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
        self._expiries_armed: set[tuple[int, int]] = set()
        self._acting = False
        self.complaints: dict[str, str] = {}
        """Name of a device that is open to what is wrong with it all the same."""
        self._late: deque[Callable[[], object]] = deque()
        self._latest = {
            node.index: tuple(
                (i, graph.slots[spec.topic.name], within_ns)
                for i, spec in enumerate(node.lookout.view_type.specs)
                if spec.wake.value == "latest" and (within_ns := spec.within_ns) is not None
            )
            for node in graph.nodes
        }
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
                if node.instance is not None:
                    self._check_time(node, now_ns)
        self._act(now_ns, tick=True)

    def timer(self, node: Node, now_ns: int) -> None:
        """A view that steps on time alone is due."""
        if self._journal is not None:
            self._journal.note("timer", node.name, now_ns, node.index)
        self._wake(node, now_ns)

    def expire(self, node: Node, now_ns: int) -> None:
        """An optional input of a view became too old: the step sees None now."""
        if self._journal is not None:
            self._journal.note("expiry", node.name, now_ns, node.index)
        self._wake(node, now_ns)

    def offloaded(self, node: PerceptorNode, result: Message | str | None, oldest_ns: int, now_ns: int) -> None:
        """A slow perceptor finished: its message, None, or the text of its exception."""
        if not isinstance(result, str):
            result = _declared(node, result)
        if self._journal is not None:
            self._journal.note("offloaded", node.name, now_ns, (result, oldest_ns))
        node.busy = False
        if isinstance(result, str):
            self._bench_perceptor(node, result)
        elif result is not None:
            self._publish_made(node, result, oldest_ns, now_ns)
            self._visit(node.output.downstream, now_ns)
        if now_ns < self.explain_until_ns:
            self._explain(node, node.perceptor, now_ns)
        if node.again and not node.benched:
            node.again = False
            self._perceive(node, now_ns)
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
        self._journal = None
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

    @property
    def stepping(self) -> bool:
        """Whether behaviours are stepped at all: in AUTO only."""
        return self.operator.mode is Mode.AUTO

    # --------------------------------------------------------------------------------- the inner turn

    def _wake(self, node: Node, now_ns: int) -> None:
        node.woken = True
        nodes: Sequence[Node] = (node,)
        if isinstance(node, PerceptorNode):
            nodes = (node, *node.output.downstream)
        self._visit(nodes, now_ns)
        self._act(now_ns)

    def _visit(self, nodes: Sequence[Node], now_ns: int) -> None:
        for node in nodes:
            if node.woken:
                node.woken = False
                if node.__class__ is BehaviourNode:
                    self._behave(node, now_ns)
                else:
                    self._perceive(node, now_ns)  # type: ignore[arg-type]

    def _perceive(self, node: PerceptorNode, now_ns: int) -> None:
        if node.benched:
            return
        lookout = node.lookout
        view = lookout.look(now_ns)
        if view is None:
            return
        if self._latest[node.index]:
            self._arm_expiries(node, now_ns)
        oldest_ns = lookout.oldest_ns
        if node.offload:
            if node.busy:
                node.again = True
            else:
                node.busy = True
                self._offloader.submit(node, view, oldest_ns, now_ns)
            return
        raised: Exception | None = None
        result: Message | str | None
        if node.played is not None:
            result = node.played.popleft()
        else:
            try:
                result = _declared(node, node.perceptor.step(view))
            except Exception as error:
                raised, result = error, f"{type(error).__name__}: {error}"
        if self._journal is not None and node.sees_frames:
            self._journal.note("perceived", node.name, now_ns, result)
        if isinstance(result, str):
            self._bench_perceptor(node, result, raised)
            return
        if now_ns < self.explain_until_ns and now_ns - node.explained_ns >= EXPLAIN_PERIOD_NS:
            self._explain(node, node.perceptor, now_ns)
        if result is not None:
            self._publish_made(node, result, oldest_ns, now_ns)

    def _explain(self, node: Node, plugin: Perceptor[Any, Any, Any] | Behaviour[Any, Any, Any], now_ns: int) -> None:
        """For whoever listens; nothing that goes wrong here touches the commands, which replay without it."""
        node.explained_ns = now_ns
        try:
            node.explanation = plugin.explain()
        except Exception as error:
            node.explanation = ()
            log.warning("%s: explain() raised %s: %s", node.name, type(error).__name__, error)

    def _publish_made(self, node: PerceptorNode, result: Message, oldest_ns: int, now_ns: int) -> None:
        if result.stamp_ns > now_ns:
            self._bench_perceptor(node, f"stamped its output {(result.stamp_ns - now_ns) / 1e9:g} s in the future")
        else:
            node.output.put(result, min(oldest_ns, result.stamp_ns))

    def _bench_perceptor(self, node: PerceptorNode, text: str, error: Exception | None = None) -> None:
        node.benched = text
        node.output.clear()
        log.error("perceptor %s is benched: %s", node.name, text, exc_info=error)

    def _behave(self, node: BehaviourNode, now_ns: int) -> None:
        instance = node.instance
        if instance is None or not self.stepping:
            return
        lookout = node.lookout
        view = lookout.look(now_ns)
        if view is None:
            node.proposal = None
            return
        if self._latest[node.index]:
            self._arm_expiries(node, now_ns)
        node.blind_since_ns = None
        try:
            result: StepResult = instance.step(view)
        except Exception as error:
            self._bench(node, f"{type(error).__name__}: {error}", now_ns, error)
            return
        if now_ns < self.explain_until_ns and now_ns - node.explained_ns >= EXPLAIN_PERIOD_NS:
            self._explain(node, instance, now_ns)
        if result is None:
            node.proposal = None
        elif result.__class__ is node.part.cls.emits:
            node.proposal = Proposal(node.name, node.priority, result, lookout.oldest_ns, lookout.fresh_until_ns)  # type: ignore[arg-type]
        elif isinstance(result, Done):
            self._finish(node, "SUCCEEDED", result.reason, now_ns)
        elif isinstance(result, Failed):
            self._finish(node, "FAILED", result.reason, now_ns)
        else:
            declared = node.part.cls.emits.__name__
            self._bench(node, f"step returned {type(result).__name__}; it declares {declared}", now_ns)

    def _bench(self, node: BehaviourNode, text: str, now_ns: int, error: Exception | None = None) -> None:
        node.benched = text
        log.error("behaviour %s is benched: %s", node.name, text, exc_info=error)
        self._finish(node, "FAILED", text, now_ns)

    def _finish(self, node: BehaviourNode, result: str, reason: str, now_ns: int) -> None:
        try:
            node.end(f"{result}: {reason}" if reason else result)
        except Exception as error:
            node.benched = node.benched or f"close: {type(error).__name__}: {error}"
            log.error("behaviour %s is benched: its close() raised %r", node.name, error, exc_info=error)
        self.operator = ended(self.operator, node.name)
        log.info("%s %s%s", node.name, result, f": {reason}" if reason else "")
        self._publish_state(ActiveGoal(now_ns))
        self._emit(Outcome(now_ns, node.name, result, reason))

    def _check_time(self, node: BehaviourNode, now_ns: int) -> None:
        timeout_s, blind_s = node.part.timeout_s, node.part.cls.blind_after_s
        if timeout_s is not None and now_ns - node.started_ns > ns(timeout_s):
            self._finish(node, "FAILED", f"not done within {timeout_s:g} s", now_ns)
        elif blind_s is not None and self.stepping:
            fresh = node.proposal is not None and now_ns <= node.proposal.fresh_until_ns
            if fresh or node.lookout.look(now_ns) is not None:
                node.blind_since_ns = None
            elif node.blind_since_ns is None:
                node.blind_since_ns = now_ns
            elif now_ns - node.blind_since_ns > ns(blind_s):
                topic, what = node.lookout.missing or ("its inputs", "missing")
                self._finish(node, "FAILED", f"blind for {blind_s:g} s: {topic} {what}", now_ns)

    def _arm_expiries(self, node: Node, now_ns: int) -> None:
        for index, slot, within_ns in self._latest[node.index]:
            key = (node.index, index)
            fresh = slot.message is not None and now_ns - slot.oldest_ns <= within_ns
            if fresh and key not in self._expiries_armed:
                self._expiries_armed.add(key)
                self._timers.call_at_ns(slot.oldest_ns + within_ns + 1, self._expiry_due, node, index, slot, within_ns)

    def _expiry_due(self, node: Node, index: int, slot: Slot, within_ns: int) -> None:
        due_ns = slot.oldest_ns + within_ns + 1
        now_ns = self.clock_ns()
        if slot.message is not None and due_ns > now_ns:
            self._timers.call_at_ns(due_ns, self._expiry_due, node, index, slot, within_ns)
            return
        self._expiries_armed.discard((node.index, index))
        self.expire(node, now_ns)

    clock_ns: Callable[[], int] = staticmethod(lambda: 0)
    """The loop's clock, for timers only; set by the app. Replay never fires a timer."""

    # ------------------------------------------------------------------- arbitration, guard, one write

    def _act(self, now_ns: int, *, tick: bool = False) -> None:
        """Ends every turn; what the base said or suffered meanwhile follows as turns of their own."""
        self._acting = True
        try:
            self._decide(now_ns, tick=tick)
        finally:
            self._acting = False
        while self._late:
            self._late.popleft()()

    def _decide(self, now_ns: int, *, tick: bool) -> None:
        self.turns += 1
        proposals = [node.proposal for node in self.graph.behaviours if node.proposal is not None]
        if self.way_down.decide(proposals, self._manual, self.operator, now_ns, tick=tick):
            self._say_standing()

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

    def _take(self, answer: Answer, now_ns: int) -> None:
        before = self.operator
        self.operator = answer.state
        lease = answer.state.lease
        self._manual = Proposal(lease.by, 0, lease.drive, now_ns, lease.until_ns) if lease is not None else None
        for name in answer.stop:
            node = self._behaviours[name]
            if node.instance is not None:
                kept = self.operator
                self._finish(node, "CANCELLED", answer.why, now_ns)
                self.operator = kept
        for start in answer.start:
            node = self._behaviours[start.behaviour]
            try:
                node.begin(start.goal, now_ns)
            except Exception as error:
                self._bench(node, f"{type(error).__name__}: {error}", now_ns, error)
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


def _declared(node: PerceptorNode, result: Any) -> Message | str | None:
    """What a perceptor's step returned; anything but the declared message becomes the text of a fault."""
    declared = node.part.cls.produces
    if result is None or isinstance(result, declared):
        return result
    return f"step returned {type(result).__name__}, not {declared.__name__}"
