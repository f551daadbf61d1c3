"""What the core asks of those around it: hands, a diary, an alarm clock, somebody for the slow work."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from robotd.authoring.view import View
from robotd.engine.nodes import PerceptorNode


class Base(Protocol):
    """The one actuator, as the turn sees it."""

    def apply(self, command: Any) -> None: ...
    def halt(self) -> None: ...
    def estop(self) -> None: ...


class Journal(Protocol):
    """Who writes down every input of every turn; `ref` names the topic, node or device.

    An input is noted before anything that follows from it: what a frame perceptor made (`perceived`) and what was
    written to the base (`command`) are noted inside the turn, between its input and the next.
    """

    def note(self, kind: str, ref: str, now_ns: int, payload: object) -> None: ...


class Timers(Protocol):
    """What calls the core back later; in replay nothing does, the recording says when."""

    def now_ns(self) -> int: ...
    def call_at_ns(self, when_ns: int, callback: Callable[..., object], *args: object) -> object: ...


class Offloader(Protocol):
    """Runs a slow perceptor's step elsewhere and answers through `Core.offloaded`."""

    def submit(self, node: PerceptorNode, view: View, oldest_ns: int, now_ns: int) -> None: ...
