"""Steps perceptors and behaviours: who is woken, in what order, and what becomes of what they say."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from typing import Any

from robotd.authoring.behaviour import Behaviour, Done, Failed, StepResult
from robotd.authoring.perceptor import Perceptor
from robotd.engine.bus import Slot
from robotd.engine.contracts import Journal, Offloader, Timers
from robotd.engine.nodes import BehaviourNode, Node, PerceptorNode
from robotd.safety.arbiter import Proposal
from robotd.world.clock import ns
from robotd.world.messages import Message

log = logging.getLogger("robotd")

EXPLAIN_PERIOD_NS = 100_000_000


class Stepping:
    """The middle of every turn. A plugin that raises or says what it may not is benched; the others step on.

    finished: told when a behaviour's goal ended, with SUCCEEDED, FAILED or CANCELLED and the reason. expired: told that
    an optional input of a node became too old.
    """

    def __init__(
        self,
        *,
        timers: Timers,
        offloader: Offloader,
        journal: Journal | None,
        finished: Callable[[BehaviourNode, str, str, int], None],
        expired: Callable[[Node, int], None],
    ) -> None:
        self.journal = journal
        self.behaves = False
        """Whether behaviours are stepped at all: in AUTO only."""
        self.explain_until_ns = 0
        self._timers = timers
        self._offloader = offloader
        self._finished = finished
        self._expired = expired
        self._expiries_armed: set[tuple[int, int]] = set()

    def visit(self, nodes: Sequence[Node], now_ns: int) -> None:
        """Step those of `nodes` that are woken, by then."""
        for node in nodes:
            if node.woken:
                node.woken = False
                if node.__class__ is BehaviourNode:
                    self._behave(node, now_ns)
                else:
                    self._perceive(node, now_ns)  # type: ignore[arg-type]

    def wake(self, node: Node, now_ns: int) -> None:
        """Step one node, and what is woken by what it made."""
        node.woken = True
        self.visit((node, *node.output.downstream) if isinstance(node, PerceptorNode) else (node,), now_ns)

    # ------------------------------------------------------------------------------------- perceptors

    def _perceive(self, node: PerceptorNode, now_ns: int) -> None:
        if node.benched:
            return
        lookout = node.lookout
        view = lookout.look(now_ns)
        if view is None:
            return
        if lookout.expiring:
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
                result = declared(node, node.perceptor.step(view))
            except Exception as error:
                raised, result = error, f"{type(error).__name__}: {error}"
        if self.journal is not None and node.sees_frames:
            self.journal.note("perceived", node.name, now_ns, result)
        if isinstance(result, str):
            _bench_perceptor(node, result, raised)
            return
        if now_ns < self.explain_until_ns and now_ns - node.explained_ns >= EXPLAIN_PERIOD_NS:
            _explain(node, node.perceptor, now_ns)
        if result is not None:
            _publish_made(node, result, oldest_ns, now_ns)

    def offloaded(self, node: PerceptorNode, result: Message | str | None, oldest_ns: int, now_ns: int) -> None:
        """A slow perceptor finished: its message, None, or the text of a fault."""
        node.busy = False
        if isinstance(result, str):
            _bench_perceptor(node, result)
        elif result is not None:
            _publish_made(node, result, oldest_ns, now_ns)
            self.visit(node.output.downstream, now_ns)
        if now_ns < self.explain_until_ns:
            _explain(node, node.perceptor, now_ns)
        if node.again and not node.benched:
            node.again = False
            self._perceive(node, now_ns)

    # ------------------------------------------------------------------------------------- behaviours

    def _behave(self, node: BehaviourNode, now_ns: int) -> None:
        instance = node.instance
        if instance is None or not self.behaves:
            return
        lookout = node.lookout
        view = lookout.look(now_ns)
        if view is None:
            node.proposal = None
            return
        if lookout.expiring:
            self._arm_expiries(node, now_ns)
        node.blind_since_ns = None
        try:
            result: StepResult = instance.step(view)
        except Exception as error:
            self.bench(node, f"{type(error).__name__}: {error}", now_ns, error)
            return
        if now_ns < self.explain_until_ns and now_ns - node.explained_ns >= EXPLAIN_PERIOD_NS:
            _explain(node, instance, now_ns)
        if result.__class__ is node.emits:
            node.proposal = Proposal(node.name, node.priority, result, lookout.oldest_ns, lookout.fresh_until_ns)  # type: ignore[arg-type]
        elif result is None:
            node.proposal = None
        elif isinstance(result, Done):
            self.finish(node, "SUCCEEDED", result.reason, now_ns)
        elif isinstance(result, Failed):
            self.finish(node, "FAILED", result.reason, now_ns)
        else:
            self.bench(node, f"step returned {type(result).__name__}; it declares {node.emits.__name__}", now_ns)

    def check_time(self, node: BehaviourNode, now_ns: int) -> None:
        """End a goal that takes too long, or whose behaviour has been blind for too long."""
        if node.instance is None:
            return
        timeout_s, blind_s = node.part.timeout_s, node.part.cls.blind_after_s
        if timeout_s is not None and now_ns - node.started_ns > ns(timeout_s):
            self.finish(node, "FAILED", f"not done within {timeout_s:g} s", now_ns)
        elif blind_s is not None and self.behaves:
            fresh = node.proposal is not None and now_ns <= node.proposal.fresh_until_ns
            if fresh or node.lookout.look(now_ns) is not None:
                node.blind_since_ns = None
            elif node.blind_since_ns is None:
                node.blind_since_ns = now_ns
            elif now_ns - node.blind_since_ns > ns(blind_s):
                topic, what = node.lookout.missing or ("its inputs", "missing")
                self.finish(node, "FAILED", f"blind for {blind_s:g} s: {topic} {what}", now_ns)

    def bench(self, node: BehaviourNode, text: str, now_ns: int, error: Exception | None = None) -> None:
        """The behaviour is at fault: it is not started again, and its goal failed."""
        node.benched = text
        log.error("behaviour %s is benched: %s", node.name, text, exc_info=error)
        self.finish(node, "FAILED", text, now_ns)

    def finish(self, node: BehaviourNode, result: str, reason: str, now_ns: int) -> None:
        """The goal is over: withdraw, clean up, tell."""
        try:
            node.end(f"{result}: {reason}" if reason else result)
        except Exception as error:
            node.benched = node.benched or f"close: {type(error).__name__}: {error}"
            log.error("behaviour %s is benched: its close() raised %r", node.name, error, exc_info=error)
        log.info("%s %s%s", node.name, result, f": {reason}" if reason else "")
        self._finished(node, result, reason, now_ns)

    # --------------------------------------------------------------------------------------- expiries

    def _arm_expiries(self, node: Node, now_ns: int) -> None:
        for index, slot, within_ns in node.lookout.expiring:
            key = (node.index, index)
            fresh = slot.message is not None and now_ns - slot.oldest_ns <= within_ns
            if fresh and key not in self._expiries_armed:
                self._expiries_armed.add(key)
                self._timers.call_at_ns(slot.oldest_ns + within_ns + 1, self._expiry_due, node, index, slot, within_ns)

    def _expiry_due(self, node: Node, index: int, slot: Slot, within_ns: int) -> None:
        due_ns = slot.oldest_ns + within_ns + 1
        now_ns = self._timers.now_ns()
        if slot.message is not None and due_ns > now_ns:
            self._timers.call_at_ns(due_ns, self._expiry_due, node, index, slot, within_ns)
            return
        self._expiries_armed.discard((node.index, index))
        self._expired(node, now_ns)


def declared(node: PerceptorNode, result: Any) -> Message | str | None:
    """What a perceptor's step returned; anything but the declared message becomes the text of a fault."""
    produces = node.part.cls.produces
    if result is None or isinstance(result, produces):
        return result
    return f"step returned {type(result).__name__}, not {produces.__name__}"


def _publish_made(node: PerceptorNode, result: Message, oldest_ns: int, now_ns: int) -> None:
    if result.stamp_ns > now_ns:
        _bench_perceptor(node, f"stamped its output {(result.stamp_ns - now_ns) / 1e9:g} s in the future")
    else:
        node.output.put(result, min(oldest_ns, result.stamp_ns))


def _bench_perceptor(node: PerceptorNode, text: str, error: Exception | None = None) -> None:
    node.benched = text
    node.output.clear()
    log.error("perceptor %s is benched: %s", node.name, text, exc_info=error)


def _explain(node: Node, plugin: Perceptor[Any, Any, Any] | Behaviour[Any, Any, Any], now_ns: int) -> None:
    """For whoever listens; nothing that goes wrong here touches the commands, which replay without it."""
    node.explained_ns = now_ns
    try:
        node.explanation = plugin.explain()
    except Exception as error:
        node.explanation = ()
        log.warning("%s: explain() raised %s: %s", node.name, type(error).__name__, error)
