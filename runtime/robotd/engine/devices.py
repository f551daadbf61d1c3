"""Keeps one device open: its link into the turn, loss and return with backoff, and a stop on every way out."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from typing import Any

from robotd.authoring.device import (
    Actuator,
    Device,
    DeviceContext,
    DeviceError,
    DeviceMisconfigured,
    World,
)
from robotd.engine.bus import Slot
from robotd.engine.core import Core
from robotd.engine.graph import Graph, device_topics
from robotd.engine.parts import DevicePart
from robotd.engine.status import DeviceState
from robotd.world.clock import Clock
from robotd.world.messages import Message
from robotd.world.robot import Robot

log = logging.getLogger("robotd")

FIRST_BACKOFF_S = 0.1
LONGEST_BACKOFF_S = 0.5
OPEN_LIMIT_S = 10.0
CLOSE_LIMIT_S = 1.0


class Unavailable(Exception):
    """A device that the robot needs could not be opened at start; exit code 69."""


class KeptDevice:
    """One device and its link. It is the `DeviceLink` that the driver sees."""

    def __init__(self, part: DevicePart, graph: Graph, clock: Clock, robot: Robot, world: World[Any] | None) -> None:
        self.part = part
        self.name = part.name
        self.state: DeviceState = "closed"
        self.detail = ""
        self.faults: dict[str, int] = {}
        self.losses = 0
        self._clock = clock
        self._slots: dict[type[Message], Slot] = {
            kind: graph.slots[topic.name] for kind, topic in device_topics(part).items()
        }
        self._core: Core | None = None
        self._fail: Callable[[BaseException], None] = lambda error: None
        self._gone: asyncio.Future[DeviceError] | None = None
        context = DeviceContext(part.name, clock, robot, self, world)
        self.device: Device[Any] = part.cls(part.config, context)
        self._base: Any = self.device if isinstance(self.device, Actuator) else None

    def connect(self, core: Core, fail: Callable[[BaseException], None]) -> None:
        """From now on messages go into `core`; what breaks the turn itself goes to `fail`."""
        self._core = core
        self._fail = fail

    # ------------------------------------------------------------------------ what the driver calls

    def publish(self, message: Message) -> None:
        core = self._core
        if core is None or self._gone is None or self._gone.done():
            return  # between a loss and the next open a late callback may still fire: its data is history
        slot = self._slots.get(message.__class__)
        if slot is None:
            declared = ", ".join(kind.__name__ for kind in self._slots) or "nothing"
            self.lost(DeviceError(f"{self.name} published {type(message).__name__}; it declares {declared}"))
            return
        now_ns = self._clock.now_ns()
        before = slot.message
        if message.stamp_ns > now_ns:
            self.fault("stamp in the future", f"by {(message.stamp_ns - now_ns) / 1e9:g} s")
            return
        if before is not None and message.stamp_ns <= before.stamp_ns:
            self.fault("stamp not newer than the last", f"{slot.topic.name}")
            return
        try:
            core.receive(slot, message, now_ns)
        except Exception as error:
            self._fail(error)

    def lost(self, error: DeviceError) -> None:
        if self._gone is None or self._gone.done():
            return
        self._gone.set_result(error)
        self.losses += 1
        self.state, self.detail = "lost", str(error)
        log.warning("%s", error if str(error).startswith(self.name) else f"{self.name}: {error}")
        self.on_gone()
        if self._core is not None:
            try:
                self._core.device_lost(self.name, str(error), self._clock.now_ns())
            except Exception as failure:
                self._fail(failure)

    def fault(self, name: str, detail: str = "") -> None:
        count = self.faults.get(name, 0) + 1
        self.faults[name] = count
        if count == 1:
            log.warning("%s: %s%s (counted from now on)", self.name, name, f", {detail}" if detail else "")

    # ---------------------------------------------------------------------------- what the supervisor calls

    def apply(self, command: Any) -> None:
        """The turn's write. A base that is not open takes nothing."""
        if self.state == "open":
            if not self.may_write():
                self._base.halt()
                return
            try:
                self._base.apply(command)
            except (DeviceError, OSError) as error:
                self.lost(error if isinstance(error, DeviceError) else DeviceError(f"{self.name}: {error}"))

    def halt(self) -> None:
        """The turn's stop."""
        if self.state in ("open", "opening"):
            self._base.halt()

    def estop(self) -> None:
        """The turn's answer to an e-stop."""
        if self.state in ("open", "opening"):
            self._base.estop()

    async def keep(self, needed: bool, give_up_s: float, sleep: Callable[[float], Any] = asyncio.sleep) -> None:
        """Open, wait for the loss, close, and again; raises Unavailable or DeviceMisconfigured, both only at start."""
        loop = asyncio.get_running_loop()
        started = loop.time()
        backoff_s = FIRST_BACKOFF_S
        was_open = False
        while True:
            self._gone = loop.create_future()
            self.state = "opening"
            try:
                async with asyncio.timeout(OPEN_LIMIT_S):
                    await self.device.open()
            except DeviceMisconfigured:
                raise
            except (DeviceError, OSError, TimeoutError) as error:
                words = str(error) or f"{self.name}: no answer within {OPEN_LIMIT_S:g} s"
                if self.detail != words:
                    log.warning("%s: cannot open: %s", self.name, words)
                self.state, self.detail = "lost", words
                await self._close()
                if needed and not was_open and loop.time() - started >= give_up_s:
                    raise Unavailable(f"{self.name}: {words}") from error
                await sleep(backoff_s)
                backoff_s = min(2.0 * backoff_s, LONGEST_BACKOFF_S)
                continue
            if not self._gone.done():
                if self.losses:
                    log.info("%s is back", self.name)
                self.state, self.detail = "open", ""
                was_open, backoff_s = True, FIRST_BACKOFF_S
                assert self._core is not None
                self._core.device_opened(self.name, self._clock.now_ns())
                self.on_open()
            await self._gone
            await self._close()
            await sleep(backoff_s)

    on_open: Callable[[], None] = staticmethod(lambda: None)
    on_gone: Callable[[], None] = staticmethod(lambda: None)
    may_write: Callable[[], bool] = staticmethod(lambda: True)
    """Asked before each command; where it says no, the base is stopped instead. Set where there is a guardian."""

    async def close(self) -> None:
        """The way out. Until here the state stays what it was, so that every halt on the way still gets through."""
        await self._close()
        self.state = "closed"

    async def _close(self) -> None:
        try:
            async with asyncio.timeout(CLOSE_LIMIT_S):
                await self.device.close()
        except Exception as error:
            log.warning("%s: close: %s: %s", self.name, type(error).__name__, error)
