"""Opens devices for a moment, without a runtime, and notes what they do; `judge` then says what that means.

An actuator is opened and halted, never driven.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from robotd.authoring.device import Actuator, Device, DeviceContext, DeviceError
from robotd.engine.devices import CLOSE_LIMIT_S, OPEN_LIMIT_S
from robotd.engine.loops import running_loop
from robotd.engine.parts import DevicePart
from robotd.world.clock import NS_PER_S, Clock
from robotd.world.messages import Message
from robotd.world.robot import Robot

KEPT = 5
"""Messages of one type that are kept: the first ones say little, the last ones what is so now."""


@dataclass(slots=True)
class Stream:
    """The messages of one type: how many, when they came (ns), how old they were then (ns), and the last `KEPT`."""

    kind: type[Message]
    arrived_ns: list[int] = field(default_factory=list)
    age_ns: list[int] = field(default_factory=list)
    last: deque[Message] = field(default_factory=lambda: deque(maxlen=KEPT))

    @property
    def hz(self) -> float:
        """Messages a second; 0 for fewer than two."""
        span_ns = self.arrived_ns[-1] - self.arrived_ns[0] if self.arrived_ns else 0
        return (len(self.arrived_ns) - 1) * NS_PER_S / span_ns if span_ns > 0 else 0.0


@dataclass(slots=True)
class Sighting:
    """What one device did. `error`: why it did not open; `hung`: because it took too long; `loss`: it went away."""

    name: str
    error: Exception | None = None
    hung: bool = False
    loss: DeviceError | None = None
    streams: dict[type[Message], Stream] = field(default_factory=dict)
    faults: dict[str, int] = field(default_factory=dict)
    details: dict[str, str] = field(default_factory=dict)
    """The last detail of each fault."""
    watched_s: float = 0.0
    close_s: float = 0.0
    has_stop_line: bool = False

    @property
    def is_open(self) -> bool:
        """Whether it opened."""
        return self.error is None and not self.hung


class Watcher:
    """A `DeviceLink` that notes everything in a `Sighting`; `gone` is set at a loss, `heard` at the first message."""

    def __init__(self, name: str, clock: Clock) -> None:
        self.sighting = Sighting(name)
        self.gone = asyncio.Event()
        self.heard = asyncio.Event()
        self._clock = clock

    def publish(self, message: Message) -> None:
        stream = self.sighting.streams.setdefault(type(message), Stream(type(message)))
        now_ns = self._clock.now_ns()
        stream.arrived_ns.append(now_ns)
        stream.age_ns.append(now_ns - message.stamp_ns)
        stream.last.append(message)
        self.heard.set()

    def lost(self, error: DeviceError) -> None:
        if self.sighting.loss is None:
            self.sighting.loss = error
        self.gone.set()

    def fault(self, name: str, detail: str = "") -> None:
        self.sighting.faults[name] = self.sighting.faults.get(name, 0) + 1
        self.sighting.details[name] = detail


def made(part: DevicePart, robot: Robot, clock: Clock) -> tuple[Device[Any], Watcher]:
    """The device of a part on a new `Watcher`, not yet opened."""
    watcher = Watcher(part.name, clock)
    return part.cls(part.config, DeviceContext(part.name, clock, robot, watcher)), watcher


async def sight(part: DevicePart, robot: Robot, seconds: float, *, until_heard: bool = False) -> Sighting:
    """Open one device for `seconds`, or only until its first message; it is closed on every way out.

    Raises RuntimeError where the running loop is none of robotd's own.
    """
    loop = running_loop()
    try:
        device, watcher = made(part, robot, loop)
    except Exception as error:
        return Sighting(part.name, error=error)
    sighting = watcher.sighting
    opening = asyncio.timeout(OPEN_LIMIT_S)
    try:
        async with opening:
            await device.open()
        if isinstance(device, Actuator):
            device.halt()
            sighting.has_stop_line = device.stop_line() is not None
    except Exception as error:
        sighting.hung = opening.expired()
        sighting.error = None if sighting.hung else error
    else:
        began_s = loop.time()
        await _first_of(seconds, watcher.gone, *([watcher.heard] if until_heard else []))
        sighting.watched_s = loop.time() - began_s
    finally:
        began_s = loop.time()
        await shut(device)
        sighting.close_s = loop.time() - began_s
    return sighting


async def shut(device: Device[Any]) -> None:
    """Halt and close, whatever happens."""
    if isinstance(device, Actuator):
        _quietly(device.halt)
    try:
        async with asyncio.timeout(CLOSE_LIMIT_S):
            await device.close()
    except Exception:
        return  # what can still be done about a device that does not close was done: it was halted


def _quietly(call: Callable[[], None]) -> None:
    try:
        call()
    except Exception:
        return


async def _first_of(seconds: float, *events: asyncio.Event) -> None:
    tasks = [asyncio.ensure_future(event.wait()) for event in events]
    try:
        await asyncio.wait(tasks, timeout=seconds, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()


async def sight_all(parts: Sequence[DevicePart], robot: Robot, seconds: float) -> list[Sighting]:
    """All devices at once, as they will work: a weak supply shows only so."""
    return list(await asyncio.gather(*(sight(part, robot, seconds) for part in parts)))
