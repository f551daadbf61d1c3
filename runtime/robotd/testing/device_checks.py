"""The contract of sensors and actuators as one call each; a device is made with `robotd.testing.connected`."""

from __future__ import annotations

import asyncio
import inspect
import statistics
import time
from collections.abc import Callable, Sequence
from typing import Any

from robotd.authoring.device import Actuator, Device, Sensor
from robotd.engine.codec import RecordError, encode
from robotd.testing.failure import fail
from robotd.testing.links import FakeLink
from robotd.world.messages import Command, Drive, LidarScan, Message, Steer

CLOSE_WITHIN_S = 0.2
_CALL_WITHIN_S = 0.005
_SLACK_S = 0.01


async def check_sensor(device: Sensor[Any, Any], *, messages: int = 3, within_s: float = 5.0) -> list[Message]:
    """Opens, reads, closes and reopens a sensor; returns what it published.

    It publishes `messages` within `within_s` each time; only the declared types; stamps of each type never go back and
    are not from the future; it closes within 0.2 s, is silent afterwards, and may be closed twice. Raises CheckFailed.
    The source behind it (fake, pty, folder of pictures) must go on giving while this runs.
    """
    link = _link(device)
    cls = type(device)
    if not cls.emits:
        fail(cls, "declares no message type", "write class MySensor(Sensor[MyConfig, LidarScan])")
    cls.load(device.config)
    published: list[Message] = []
    for turn in ("opening", "reopening"):
        link.clear()
        await device.open()
        try:
            await link.until(lambda link: len(link.messages) >= messages or bool(link.losses), within_s)
        except TimeoutError as error:
            fail(cls, f"after {turn}, {error}", f"{messages} messages were expected")
        finally:
            await _close(device)
        if link.losses:
            fail(cls, f"after {turn} it said that it was lost: {link.losses[0]}")
        _check_messages(device, link)
        published += link.messages
        count = len(link.messages)
        await asyncio.sleep(0.05)
        if len(link.messages) != count:
            fail(cls, "published after close()", "stop reader, task or thread in close()")
        await _close(device)
    return published


async def check_actuator(
    device: Actuator[Any, Any],
    *,
    written: Callable[[], Sequence[Any]] | None = None,
    is_stop: Callable[[Any], bool] | None = None,
    command: Command | None = None,
    within_s: float = 1.0,
) -> None:
    """Opens, drives, halts, closes and reopens an actuator.

    `halt` raises neither before opening nor after closing; `apply` and `halt` are plain functions that return at once;
    it closes within 0.2 s and may be closed twice. With `written` (everything that reached the fake so far, oldest
    first) and `is_stop` (is one of those a stop?): the first write after each opening and the last before each closing
    are stops, a halt is followed by a stop, and a command arrives. Raises CheckFailed.

    command: something that is not a stop; by default slow motion of the accepted kind.
    """
    _link(device)
    cls = type(device)
    if (written is None) != (is_stop is None):
        raise ValueError("give both written= and is_stop=, or neither")
    for name in ("apply", "halt"):
        if inspect.iscoroutinefunction(getattr(device, name)):
            fail(cls, f"{name} is a coroutine", f"write `def {name}`: it must work in the turn in which it is called")
    if command is None:
        command = Steer(0.1, 0.05) if cls.accepts is Steer else Drive(0.1, 0.2)
    if not isinstance(command, cls.accepts):
        fail(cls, f"accepts {cls.accepts.__name__}, the command to try is {type(command).__name__}")
    cls.load(device.config)
    _halt(device, "before opening")
    for turn in ("opening", "reopening"):
        writes = _Writes(written, is_stop)
        await device.open()
        await writes.expect(cls, within_s, lambda new: bool(new), f"nothing was written after {turn}")
        writes.check_first(cls, turn)
        _apply(device, command)
        await writes.expect(cls, within_s, writes.ends_moving, f"after {turn} no command arrived")
        _halt(device, "while open")
        await writes.expect(cls, within_s, writes.ends_stopped, "no stop was written after halt()")
        _apply(device, command)
        await _close(device)
        await writes.expect(cls, within_s, writes.ends_stopped, "the last write before closing is no stop")
        _halt(device, "after closing")
        await _close(device)


# ----------------------------------------------------------------------------------------------- parts


def _link(device: Device[Any]) -> FakeLink:
    link = device.context.link
    if not isinstance(link, FakeLink):
        fail(type(device), "is not on a FakeLink", "make it with robotd.testing.connected(cls, config)")
    return link


def _check_messages(device: Device[Any], link: FakeLink) -> None:
    cls = type(device)
    newest: dict[type[Message], int] = {}
    for message, arrived_ns in zip(link.messages, link.arrived_ns, strict=True):
        kind = type(message)
        if kind not in cls.emits:
            fail(cls, f"published a {kind.__name__}, it declares {', '.join(t.__name__ for t in cls.emits)}")
        if message.stamp_ns > arrived_ns:
            late = message.stamp_ns - arrived_ns
            fail(cls, f"stamped a {kind.__name__} {late} ns in the future", "use self.context.clock.now_ns()")
        if message.stamp_ns < newest.get(kind, message.stamp_ns):
            fail(cls, f"the stamps of {kind.__name__} went back by {newest[kind] - message.stamp_ns} ns")
        newest[kind] = message.stamp_ns
        if isinstance(message, LidarScan) and message.start_ns > message.stamp_ns:
            fail(cls, "a scan starts after its end", "stamp_ns is the end of the sweep, start_ns its beginning")
        try:
            encode(message)
        except RecordError as error:
            fail(cls, f"published a {kind.__name__} that cannot be recorded: {error}")


async def _close(device: Device[Any]) -> None:
    loop = asyncio.get_running_loop()
    began_s = loop.time()
    try:
        async with asyncio.timeout(5.0 * CLOSE_WITHIN_S):
            await device.close()
    except TimeoutError:
        fail(type(device), f"close() took longer than {5.0 * CLOSE_WITHIN_S:g} s", f"{CLOSE_WITHIN_S:g} s is the limit")
    except Exception as error:
        fail(type(device), f"close() raised {type(error).__name__}: {error}", "closing what is gone must not raise")
    took_s = loop.time() - began_s
    if took_s > CLOSE_WITHIN_S + _SLACK_S:
        fail(type(device), f"close() took {took_s:.3f} s", f"{CLOSE_WITHIN_S:g} s is the limit")


def _halt(device: Actuator[Any, Any], when: str) -> None:
    try:
        _quick(device, "halt", device.halt)
    except Exception as error:
        if isinstance(error, AssertionError):
            raise
        fail(type(device), f"halt() {when} raised {type(error).__name__}: {error}", "halt never raises")


def _apply(device: Actuator[Any, Any], command: Command) -> None:
    try:
        _quick(device, "apply", lambda: device.apply(command))
    except Exception as error:
        if isinstance(error, AssertionError):
            raise
        fail(type(device), f"apply() raised {type(error).__name__}: {error}", "report with self.lost(...) instead")


def _quick(device: Device[Any], name: str, call: Callable[[], object]) -> None:
    """Calls some times; the median is what counts, since the machine may be busy."""
    took: list[float] = []
    for _ in range(9):
        began_s = time.perf_counter()
        call()
        took.append(time.perf_counter() - began_s)
    if statistics.median(took) > _CALL_WITHIN_S:
        mend = "keep one unsent command and write it from a writer callback or a one-slot thread"
        fail(type(device), f"{name}() blocks for {statistics.median(took) * 1e3:.1f} ms", mend)


class _Writes:
    """What reached the fake since this was made."""

    def __init__(self, written: Callable[[], Sequence[Any]] | None, is_stop: Callable[[Any], bool] | None) -> None:
        self._written = written
        self._is_stop = is_stop
        self._from = len(written()) if written is not None else 0

    def stops(self, write: Any) -> bool:
        return self._is_stop is not None and self._is_stop(write)

    def ends_stopped(self, new: Sequence[Any]) -> bool:
        return self.stops(new[-1])

    def ends_moving(self, new: Sequence[Any]) -> bool:
        return not self.stops(new[-1])

    async def expect(self, cls: type, within_s: float, holds: Callable[[Sequence[Any]], bool], what: str) -> None:
        """Looks again and again, for what is on its way through a pty or a thread."""
        if self._written is None:
            return
        loop = asyncio.get_running_loop()
        until_s = loop.time() + within_s
        while True:
            new = self._written()[self._from :]
            if new and holds(new):
                return
            if loop.time() >= until_s:
                fail(cls, what, f"the last writes were {list(new[-3:])!r}")
            await asyncio.sleep(0.005)

    def check_first(self, cls: type, turn: str) -> None:
        if self._written is not None:
            first = self._written()[self._from]
            if not self.stops(first):
                fail(cls, f"the first write after {turn} is no stop but {first!r}")
