"""The real loop: punctual, never early, and an ordinary asyncio loop otherwise."""

from __future__ import annotations

import asyncio
import os
import selectors
import socket
import statistics
import sys
import threading
import time

import pytest

from robotd.engine.loop_real import PreciseSelector
from robotd.engine.loops import RealLoop, RobotLoop, real_loop, running_loop

MS = 1_000_000


async def _lateness_ns(count: int, period_ns: int) -> list[int]:
    loop = running_loop()
    late: list[int] = []
    for _ in range(count):
        when_ns = loop.now_ns() + period_ns
        came: asyncio.Future[int] = asyncio.get_running_loop().create_future()
        loop.call_at_ns(when_ns, lambda f=came: f.set_result(loop.now_ns()))
        late.append(await came - when_ns)
    return late


def test_timers_are_never_early_and_rarely_late() -> None:
    with asyncio.Runner(loop_factory=real_loop) as runner:
        late = runner.run(_lateness_ns(40, 2_300_000))
    # the loop may serve a timer within the resolution of its clock
    assert min(late) >= -int(time.get_clock_info("monotonic").resolution * 1e9) - 1
    assert statistics.median(late) < 20 * MS


def test_now_ns_and_time_are_one_clock() -> None:
    loop = real_loop()
    try:
        as_interface: RobotLoop = loop
        before, inside, after = as_interface.now_ns(), loop.time(), as_interface.now_ns()
        assert before / 1e9 - 1e-6 <= inside <= after / 1e9 + 1e-6
    finally:
        loop.close()


@pytest.mark.skipif(sys.platform != "linux", reason="a timerfd is a thing of Linux")
def test_linux_has_a_timerfd_and_closes_it() -> None:
    before = len(os.listdir("/proc/self/fd"))
    selector = PreciseSelector()
    assert selector.is_precise
    assert selector.own_descriptors == 1
    selector.close()
    assert len(os.listdir("/proc/self/fd")) == before


def test_without_a_timerfd_it_is_the_default_selector(monkeypatch: pytest.MonkeyPatch) -> None:
    def none() -> None:
        raise OSError("this system has no timerfd")

    monkeypatch.setattr("robotd.engine.loop_real._open_timerfd", none)
    with asyncio.Runner(loop_factory=RealLoop) as runner:
        late = runner.run(_lateness_ns(5, 2_300_000))
    assert len(late) == 5
    selector = PreciseSelector()
    assert not selector.is_precise
    assert selector.own_descriptors == 0
    selector.close()


def test_a_past_expiry_does_not_end_a_wait_without_an_end() -> None:
    """The timerfd stays readable after it expired: a following endless wait must not spin on it."""
    selector = PreciseSelector()
    left, right = socket.socketpair()
    with left, right:
        selector.register(right, selectors.EVENT_READ)
        assert selector.select(0.002) == []
        assert selector.select(0) == []
        sender = threading.Timer(0.05, left.send, (b"x",))
        began = time.monotonic()
        sender.start()
        events = selector.select(None)
        assert [key.fileobj for key, _ in events] == [right]
        assert time.monotonic() - began >= 0.045
        sender.join()
        selector.unregister(right)
    selector.close()


def test_a_timer_armed_for_an_earlier_wait_does_not_cut_a_later_one_short() -> None:
    selector = PreciseSelector()
    left, right = socket.socketpair()
    with left, right:
        selector.register(right, selectors.EVENT_READ)
        left.send(b"x")
        assert len(selector.select(0.01)) == 1
        right.recv(1)
        began = time.monotonic()
        assert selector.select(0.06) == []
        assert time.monotonic() - began >= 0.06
        selector.unregister(right)
    selector.close()


def test_tasks_timeouts_and_executors_work() -> None:
    async def main() -> str:
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.005):
                await asyncio.sleep(5.0)
        async with asyncio.TaskGroup() as group:
            one = group.create_task(asyncio.to_thread(lambda: "threads"))
            group.create_task(asyncio.sleep(0.001))
        return one.result()

    with asyncio.Runner(loop_factory=real_loop) as runner:
        assert runner.run(main()) == "threads"
