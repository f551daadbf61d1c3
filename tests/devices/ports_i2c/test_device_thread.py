"""A driver's thread: what it says comes out on the loop, the newest only, and nothing once it was closed."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable

import pytest

from robotd.authoring.device import DeviceLost, DeviceUnavailable
from robotd_devices.ports.device_thread import DeviceThread, Newest


class Heard:
    """Makes a thread, and keeps what it says, each with the thread on which it arrived."""

    def __init__(self, work: Callable[[DeviceThread], None]) -> None:
        self.said: list[tuple[str, ...]] = []
        self.threads: set[int] = set()
        self.lost = asyncio.Event()
        self.thread = DeviceThread("test", lambda: work(self.thread), on_fault=self._fault, on_lost=self._lose)

    def _fault(self, name: str, detail: str) -> None:
        self.threads.add(threading.get_ident())
        self.said.append((name, detail))

    def _lose(self, reason: str) -> None:
        self.said.append((reason,))
        self.lost.set()


async def test_says_on_the_loop_what_happened_on_the_thread_in_order() -> None:
    def work(thread: DeviceThread) -> None:
        thread.ready()
        thread.fault("first", "a")
        thread.fault("second", "b")
        thread.fail(DeviceLost("gone"))

    heard = Heard(work)
    await heard.thread.open()
    async with asyncio.timeout(5.0):
        await heard.lost.wait()
    assert heard.said == [("first", "a"), ("second", "b"), ("gone",)]
    assert heard.threads == {threading.get_ident()}
    assert await heard.thread.close()


async def test_failure_before_it_is_ready_is_raised_by_open() -> None:
    heard = Heard(lambda thread: thread.fail(DeviceUnavailable("no such port")))
    with pytest.raises(DeviceUnavailable, match="no such port"):
        await heard.thread.open()
    assert await heard.thread.close()
    assert heard.said == []


async def test_nothing_is_said_after_close_and_one_that_hangs_is_left() -> None:
    gate, ended = threading.Event(), threading.Event()

    def work(thread: DeviceThread) -> None:
        thread.ready()
        gate.wait(5.0)
        thread.fault("late", "")
        thread.fail(DeviceLost("late"))
        ended.set()

    heard = Heard(work)
    await heard.thread.open()
    assert not await heard.thread.close()
    assert heard.thread.is_alive
    gate.set()
    assert await asyncio.to_thread(ended.wait, 5.0)
    heard.thread.join()
    await asyncio.sleep(0)
    assert heard.said == []
    assert not heard.thread.is_alive


async def test_of_what_the_loop_was_too_slow_for_it_gets_the_newest() -> None:
    taken: list[int] = []
    put, went_on = threading.Event(), threading.Event()

    def work(thread: DeviceThread) -> None:
        thread.ready()
        for value in range(1, 6):
            newest.put(value)
        put.set()
        went_on.wait(5.0)
        newest.put(6)

    heard = Heard(work)
    newest = Newest[int](heard.thread, taken.append)
    opening = asyncio.create_task(heard.thread.open())
    await asyncio.sleep(0)
    assert put.wait(5.0)  # blocks the loop, as a slow program does
    await opening
    await asyncio.sleep(0)
    assert taken == [5]
    assert newest.overwritten == 4
    went_on.set()
    async with asyncio.timeout(5.0):
        while len(taken) < 2:  # noqa: ASYNC110
            await asyncio.sleep(0.001)
    assert taken == [5, 6]
    assert newest.overwritten == 4
    assert await heard.thread.close()
