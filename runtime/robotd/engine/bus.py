"""The newest message of each topic, and who looks at it: the whole bus.

buffered?       one message a topic, the newest wins, overwrites are counted
several readers yes, by reference, nobody can take a message away
blocks?         never
provenance      `oldest_ns` beside each message: the minimum over the inputs it was made from
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from robotd.authoring.view import View, Wake
from robotd.world.messages import Message
from robotd.world.topics import Topic

if TYPE_CHECKING:
    from robotd.engine.nodes import Node

NEVER_NS = 1 << 62
"""A fresh-until far beyond any run, for nodes whose view holds nothing that ages."""


class Slot:
    """The newest message of one topic. `message` is None before the first and after its source was lost."""

    __slots__ = (
        "downstream", "is_state", "looked", "message", "oldest_ns", "overwritten", "readers", "sequence", "source",
        "topic", "wakes",
    )  # fmt: skip

    def __init__(self, topic: Topic[Message]) -> None:
        self.topic = topic
        self.is_state = topic.type.is_state
        self.message: Message | None = None
        self.oldest_ns = 0
        self.sequence = 0
        self.looked = 0
        """Sequence of the message that a plugin saw last."""
        self.overwritten = 0
        """Messages that were replaced before any of their readers saw them."""
        self.source = ""
        self.wakes: tuple[Node, ...] = ()
        self.readers: tuple[Node, ...] = ()
        self.downstream: tuple[Node, ...] = ()

    def put(self, message: Message, oldest_ns: int) -> None:
        if self.looked != self.sequence and self.readers:
            self.overwritten += 1
        self.message = message
        self.oldest_ns = oldest_ns
        self.sequence += 1
        for node in self.wakes:
            node.woken = True

    def clear(self) -> None:
        """The source went away: what it said last counts as missing at once."""
        self.message = None


class Lookout:
    """Gathers one plugin's view from the slots, and keeps what the author must not have to: age and provenance."""

    __slots__ = ("_fields", "expiring", "fresh_until_ns", "missing", "oldest_ns", "view_type")

    def __init__(self, view_type: type[View], slots: dict[str, Slot]) -> None:
        self.view_type = view_type
        self._fields = tuple(
            (spec.name, slots[spec.topic.name], spec.wake is Wake.LATEST, spec.within_ns) for spec in view_type.specs
        )
        self.expiring = tuple(
            (i, slot, within_ns)
            for i, (_, slot, is_optional, within_ns) in enumerate(self._fields)
            if is_optional and within_ns is not None
        )
        """Index, slot and age limit in ns of each input that becomes None when it is too old."""
        self.oldest_ns = 0
        self.fresh_until_ns = 0
        self.missing: tuple[str, str] | None = None

    def look(self, now_ns: int) -> View | None:
        """The view at `now_ns`, or None with `missing` set to (topic, what is wrong).

        `oldest_ns` becomes the oldest stamp among the messages seen, `fresh_until_ns` the instant at which the first
        input that the step cannot do without becomes too old. State topics have no age and count in neither.
        """
        values: dict[str, Any] = {}
        oldest = now_ns
        fresh_until = NEVER_NS
        for name, slot, optional, within_ns in self._fields:
            message = slot.message
            if message is None:
                if not optional:
                    self.missing = (slot.topic.name, "missing")
                    return None
            elif within_ns is not None:
                stamp = slot.oldest_ns
                if now_ns - stamp > within_ns:
                    if not optional:
                        self.missing = (slot.topic.name, "too old")
                        return None
                    message = None
                else:
                    if stamp < oldest:
                        oldest = stamp
                    if not optional and stamp + within_ns < fresh_until:
                        fresh_until = stamp + within_ns
            slot.looked = slot.sequence
            values[name] = message
        self.missing = None
        self.oldest_ns = oldest
        self.fresh_until_ns = fresh_until
        return self.view_type.assemble(now_ns, values)
