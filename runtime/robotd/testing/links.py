"""A device's link to nothing: it keeps what the device says, and lets a test wait for it."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable
from typing import Any

from typing_extensions import TypeVar

from robotd.authoring.config import Config
from robotd.authoring.device import Device, DeviceContext, DeviceError, World
from robotd.engine.loops import RealLoop, VirtualLoop
from robotd.testing.failure import CheckFailed
from robotd.world.clock import Clock
from robotd.world.messages import Message
from robotd.world.robot import Robot

MessageT = TypeVar("MessageT", bound=Message)
DeviceT = TypeVar("DeviceT", bound=Device[Any])


class AmbientClock:
    """The clock of the running loop: virtual time on a virtual loop, the monotonic clock anywhere else."""

    def now_ns(self) -> int:
        try:
            loop = asyncio.get_running_loop()
        except RuntimeError:
            return time.monotonic_ns()
        return loop.now_ns() if isinstance(loop, RealLoop | VirtualLoop) else time.monotonic_ns()


class FakeLink:
    """A `DeviceLink` that collects. Calls from another thread than the one that made it raise CheckFailed."""

    def __init__(self, clock: Clock | None = None) -> None:
        self.clock: Clock = clock if clock is not None else AmbientClock()
        self.messages: list[Message] = []
        self.arrived_ns: list[int] = []
        """When each of `messages` was published."""
        self.losses: list[DeviceError] = []
        self.faults: list[tuple[str, str]] = []
        """Name and detail of each fault."""
        self._thread = threading.get_ident()
        self._news = asyncio.Event()

    def publish(self, message: Message) -> None:
        self._note("publish")
        self.messages.append(message)
        self.arrived_ns.append(self.clock.now_ns())

    def lost(self, error: DeviceError) -> None:
        self._note("lost")
        self.losses.append(error)

    def fault(self, name: str, detail: str = "") -> None:
        self._note("fault")
        self.faults.append((name, detail))

    def _note(self, call: str) -> None:
        if threading.get_ident() != self._thread:
            raise CheckFailed(
                f"{call}() was called on thread {threading.current_thread().name!r}, not on the loop's; "
                "hand over with loop.call_soon_threadsafe"
            )
        self._news.set()

    def of(self, message_type: type[MessageT]) -> list[MessageT]:
        """The messages of one type, in order."""
        return [message for message in self.messages if isinstance(message, message_type)]

    def clear(self) -> None:
        """Forget everything so far."""
        for kept in (self.messages, self.arrived_ns, self.losses, self.faults):
            kept.clear()

    async def until(self, condition: Callable[[FakeLink], bool], within_s: float = 5.0) -> None:
        """Wait until `condition(link)` holds, looked at after each call of the device. Raises TimeoutError."""
        try:
            async with asyncio.timeout(within_s):
                while not condition(self):
                    self._news.clear()
                    await self._news.wait()
        except TimeoutError:
            seen = f"{len(self.messages)} messages, {len(self.losses)} losses, {len(self.faults)} faults"
            raise TimeoutError(f"waited {within_s:g} s in vain; so far {seen}: {self.faults[-3:]}") from None

    async def received(self, count: int = 1, within_s: float = 5.0) -> list[Message]:
        """Wait for `count` messages in all; returns all so far. Raises TimeoutError."""
        await self.until(lambda link: len(link.messages) >= count, within_s)
        return self.messages


def connected(
    device_cls: Callable[..., DeviceT],
    config: Config,
    *,
    robot: Robot | None = None,
    world: World[Any] | None = None,
    name: str = "device",
    clock: Clock | None = None,
) -> tuple[DeviceT, FakeLink]:
    """A device on a new `FakeLink`, not yet opened: `lidar, link = connected(Ld19, Ld19Config(port=...))`.

    clock: by default the world's where there is a world, else the running loop's.
    """
    if clock is None:
        clock = world.context.clock if world is not None else AmbientClock()
    link = FakeLink(clock)
    body = robot if robot is not None else Robot()
    return device_cls(config, DeviceContext(name, clock, body, link, world)), link
