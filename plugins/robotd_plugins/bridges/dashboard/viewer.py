"""One open page as the bridge sees it: what it still has to get, and whether it keeps up. No I/O, no clock.

State goes out in beats. A beat holds the newest of each channel that changed; the page answers it once it is drawn, and
only then gets the next. So a slow page sees fewer and never older pictures, and there is never more than one beat on
its way, however long the page stops reading.
"""

from __future__ import annotations

import asyncio
import dataclasses
from collections import deque
from dataclasses import dataclass, field
from typing import TypeAlias, cast

from robotd_plugins.bridges.dashboard.messages import dumps

Payload: TypeAlias = str | bytes

ANSWERS_MAX = 32
"""Answers to requests that wait for a page that does not read them; the oldest goes first."""
ASKS_PER_S = 100.0
ASKS_BURST = 200.0
"""More messages than a page of ours could send end the connection."""
EVENTS = "events"
"""The one channel whose message depends on what the page was told before: `events_told` is its last entry."""
EVENTS_KEPT = 100


@dataclass(frozen=True, slots=True)
class Entry:
    """One line of the event log. `number` counts from 1 and never repeats."""

    number: int
    stamp_ns: int
    kind: str
    text: str


class EventLog:
    """The last events and requests, for pages that come later."""

    def __init__(self) -> None:
        self.last = 0
        self._entries: deque[Entry] = deque(maxlen=EVENTS_KEPT)

    def add(self, stamp_ns: int, kind: str, text: str) -> None:
        self.last += 1
        self._entries.append(Entry(self.last, stamp_ns, kind, text))

    def message(self, after: int) -> str:
        """What a page that has seen entry `after` lacks; entries that are kept no longer show as a gap in `number`."""
        entries = [dataclasses.asdict(entry) for entry in self._entries if entry.number > after]
        return dumps({"kind": "events", "entries": entries})


@dataclass(slots=True, eq=False)
class Viewer:
    """`number` counts the pages since robotd started, `address` is for the log. `camera`: the topic it looks at."""

    number: int
    address: str
    heard_s: float
    camera: str | None = None
    wake: asyncio.Event = field(default_factory=asyncio.Event)
    events_told: int = 0
    _answers: deque[str] = field(default_factory=lambda: deque(maxlen=ANSWERS_MAX))
    _newest: dict[str, Payload] = field(default_factory=dict)
    _sent: dict[str, tuple[object, int]] = field(default_factory=dict)
    _beat: int = 0
    _drawn: int = 0
    _allowance: float = ASKS_BURST

    @property
    def name(self) -> str:
        """Who asks, in the operator's books."""
        return f"page {self.number}"

    @property
    def keeps_up(self) -> bool:
        """Whether the page has drawn the last beat, so that it may have the next."""
        return self._drawn == self._beat

    def hears(self, now_s: float) -> bool:
        """Counts one message of the page; False where it sends more than any page of ours does."""
        self._allowance = min(ASKS_BURST, self._allowance + (now_s - self.heard_s) * ASKS_PER_S) - 1.0
        self.heard_s = now_s
        return self._allowance >= 0.0

    def drew(self, beat: int) -> None:
        """The page has drawn this beat."""
        if beat == self._beat:
            self._drawn = beat

    def is_due(self, channel: str, now_ns: int, period_ns: int) -> bool:
        """Whether the last message of a channel is at least `period_ns` ago."""
        sent = self._sent.get(channel)
        return sent is None or now_ns - sent[1] >= period_ns

    def lacks(self, channel: str, version: object) -> bool:
        """Whether this version of a channel is news to the page."""
        sent = self._sent.get(channel)
        return sent is None or sent[0] != version

    def forget(self, channel: str) -> None:
        """Have the channel told again with the next beat."""
        self._sent.pop(channel, None)

    def give(self, channel: str, version: object, now_ns: int, payload: Payload) -> None:
        """The newest of a channel, for the next beat; what that channel held unsent is dropped."""
        self._sent[channel] = (version, now_ns)
        self._newest[channel] = payload
        self.wake.set()

    def answer(self, text: str) -> None:
        """Goes out at once, beside the beats."""
        self._answers.append(text)
        self.wake.set()

    def take(self) -> list[Payload]:
        """All that may be sent now, in order."""
        out: list[Payload] = list(self._answers)
        self._answers.clear()
        if self._newest and self.keeps_up:
            self._beat += 1
            out += self._newest.values()
            if EVENTS in self._newest:
                self.events_told = cast(int, self._sent[EVENTS][0])
            out.append(dumps({"kind": "beat", "n": self._beat}))
            self._newest.clear()
        return out
