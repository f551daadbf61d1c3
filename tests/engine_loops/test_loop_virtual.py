"""The virtual loop: order, instants, the world outside, and that it never waits for nothing."""

from __future__ import annotations

import asyncio
import hashlib
import math
import os
import random
import re
import signal
import socket
import struct
import threading
import time
from collections.abc import Awaitable, Callable
from typing import TypeVar

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robotd.engine.loops import RobotLoop, VirtualDeadlock, VirtualLoop, running_loop, virtual_loop

MS = 1_000_000
T = TypeVar("T")


def run(
    main: Callable[[VirtualLoop], Awaitable[T]], *, pace: float | None = None, start_ns: int = 0, debug: bool = False
) -> T:
    async def inside() -> T:
        loop = running_loop()
        assert isinstance(loop, VirtualLoop)
        return await main(loop)

    with asyncio.Runner(loop_factory=lambda: virtual_loop(pace, start_ns), debug=debug) as runner:
        return runner.run(inside())


def test_a_runner_takes_the_class_and_the_factory() -> None:
    async def main() -> int:
        await asyncio.sleep(3600.0)
        return running_loop().now_ns()

    for factory in (VirtualLoop, virtual_loop):
        with asyncio.Runner(loop_factory=factory) as runner:
            assert runner.run(main()) == 3600 * 1_000_000_000


def test_it_is_a_robot_loop_and_a_clock() -> None:
    async def main(loop: VirtualLoop) -> tuple[int, float]:
        as_interface: RobotLoop = loop
        return as_interface.now_ns(), loop.time()

    assert run(main, start_ns=5 * MS) == (5 * MS, 0.005)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.integers(0, 5), max_size=30))
def test_equal_instants_run_in_scheduling_order(instants: list[int]) -> None:
    async def main(loop: VirtualLoop) -> list[tuple[int, int]]:
        ran: list[tuple[int, int]] = []
        for number, instant in enumerate(instants):
            loop.call_at_ns(instant, lambda n=number: ran.append((loop.now_ns(), n)))
        await asyncio.sleep(1.0)
        return ran

    assert run(main) == sorted((instant, number) for number, instant in enumerate(instants))


def test_one_nanosecond_apart_is_apart() -> None:
    async def main(loop: VirtualLoop) -> list[int]:
        ran: list[int] = []
        start = loop.now_ns()
        for after in (3, 1, 2):
            loop.call_at_ns(start + after, lambda: ran.append(loop.now_ns() - start))
        await asyncio.sleep(0.001)
        return ran

    assert run(main, start_ns=1_700_000_000 * 1_000_000_000) == [1, 2, 3]


def test_repeated_sleeps_do_not_drift() -> None:
    async def main(loop: VirtualLoop) -> int:
        for _ in range(1000):
            await asyncio.sleep(0.1)
        return loop.now_ns()

    assert run(main, start_ns=123) == 123 + 100 * 1_000_000_000


def test_a_timer_in_the_past_runs_now_and_time_does_not_go_back() -> None:
    async def main(loop: VirtualLoop) -> list[int]:
        await asyncio.sleep(1.0)
        seen: list[int] = []
        loop.call_at_ns(5, lambda: seen.append(loop.now_ns()))
        await asyncio.sleep(0.001)
        return seen

    assert run(main) == [1_000_000_000]


def test_cancelled_timers_do_not_run_and_do_not_move_time() -> None:
    async def main(loop: VirtualLoop) -> tuple[list[int], int, bool]:
        ran: list[int] = []
        handles = [loop.call_at_ns(n * MS, ran.append, n) for n in range(1000)]
        for handle in handles[::2] + handles[501:]:
            handle.cancel()
            handle.cancel()
        last = loop.call_later(50.0, ran.append, -1)
        last.cancel()
        await asyncio.sleep(0.6)
        return ran, loop.now_ns(), last.cancelled()

    ran, now_ns, cancelled = run(main)
    assert ran == list(range(1, 501, 2))
    assert now_ns == 600 * MS
    assert cancelled


def test_a_timer_that_cancels_its_neighbour_at_the_same_instant() -> None:
    async def main(loop: VirtualLoop) -> list[str]:
        ran: list[str] = []
        later: list[asyncio.TimerHandle] = []
        loop.call_at_ns(MS, lambda: later[0].cancel())
        later.append(loop.call_at_ns(MS, ran.append, "cancelled"))
        loop.call_at_ns(MS, ran.append, "kept")
        await asyncio.sleep(0.002)
        return ran

    assert run(main) == ["kept"]


def test_many_cancelled_timers_do_not_pile_up() -> None:
    async def main(loop: VirtualLoop) -> int:
        for _ in range(5000):
            loop.call_later(1000.0, print).cancel()
        await asyncio.sleep(0.001)
        return len(loop._timers)

    assert run(main) < 300


def test_timeouts_task_groups_and_wait_for_are_unchanged() -> None:
    async def slow() -> None:
        await asyncio.sleep(10.0)

    async def main(loop: VirtualLoop) -> list[int]:
        at: list[int] = []
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.25):
                await slow()
        at.append(loop.now_ns())
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(slow(), 0.5)
        at.append(loop.now_ns())
        with pytest.raises(ExceptionGroup):
            async with asyncio.TaskGroup() as group:
                group.create_task(slow())
                group.create_task(fails())
        at.append(loop.now_ns())
        return at

    async def fails() -> None:
        await asyncio.sleep(1.0)
        raise ValueError("on purpose")

    assert run(main) == [250 * MS, 750 * MS, 1750 * MS]


def test_sleeping_for_ever_can_be_cancelled() -> None:
    async def main(loop: VirtualLoop) -> int:
        task = asyncio.create_task(asyncio.sleep(math.inf))
        await asyncio.sleep(2.0)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        return loop.now_ns()

    assert run(main) == 2_000_000_000


@pytest.mark.parametrize("pace", [0.0, -1.0, math.inf, math.nan])
def test_a_pace_that_cannot_be_is_refused(pace: float) -> None:
    with pytest.raises(ValueError, match="pace must be above 0"):
        virtual_loop(pace)


def test_a_closed_loop_takes_no_timer() -> None:
    loop = virtual_loop()
    loop.close()
    with pytest.raises(RuntimeError, match="closed"):
        loop.call_at_ns(1, print)


# ---------------------------------------------------------------------------------- pace and idle readers


async def _workload(loop: VirtualLoop) -> str:
    """Timers that collide, tasks that hand over, cancelled timeouts: the digest tells their order and instants."""
    digest = hashlib.sha256()
    chance = random.Random(7)
    queue: asyncio.Queue[int] = asyncio.Queue()

    def note(what: int) -> None:
        digest.update(struct.pack("<qq", loop.now_ns(), what))

    def lidar(number: int) -> None:
        note(number)
        queue.put_nowait(number)
        if number < 120:
            loop.call_at_ns(loop.now_ns() + 5 * MS, lidar, number + 1)

    async def consumer() -> None:
        while True:
            try:
                async with asyncio.timeout(0.003 + chance.random() * 0.01):
                    note(1000 + await queue.get())
            except TimeoutError:
                note(-1)

    async def ticker(name: int) -> None:
        while True:
            await asyncio.sleep(0.01)
            note(name)

    lidar(0)
    tasks = [asyncio.create_task(consumer()), *(asyncio.create_task(ticker(n)) for n in (-2, -3, -4))]
    await asyncio.sleep(0.6)
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
    return digest.hexdigest()


def test_the_same_order_at_any_pace() -> None:
    wanted = run(_workload)
    assert run(_workload) == wanted
    for pace in (4.0, 50.0):
        began = time.monotonic()
        assert run(_workload, pace=pace) == wanted
        assert time.monotonic() - began >= 0.6 / pace - 0.001
    assert run(_workload, debug=True) == wanted


@pytest.mark.parametrize("pace", [None, 20.0])
def test_an_idle_reader_and_a_signal_handler_change_nothing(pace: float | None) -> None:
    async def main(loop: VirtualLoop) -> str:
        left, right = socket.socketpair()
        with left, right:
            left.setblocking(False)
            loop.add_reader(left, lambda: None)
            loop.add_signal_handler(signal.SIGUSR1, lambda: None)
            try:
                return await _workload(loop)
            finally:
                loop.remove_reader(left)
                assert loop.remove_signal_handler(signal.SIGUSR1)

    assert run(main, pace=pace) == run(_workload)


@pytest.mark.parametrize("pace", [None, 10.0])
def test_bytes_through_a_socketpair_arrive_at_the_instant_they_were_sent(pace: float | None) -> None:
    async def main(loop: VirtualLoop) -> list[tuple[int, bytes]]:
        left, right = socket.socketpair()
        got: list[tuple[int, bytes]] = []
        with left, right:
            right.setblocking(False)
            loop.add_reader(right, lambda: got.append((loop.now_ns(), right.recv(100))))
            for n in range(20):
                loop.call_at_ns(n * 25 * MS, left.send, b"%d" % n)
            await asyncio.sleep(0.5)
            loop.remove_reader(right)
        return got

    assert run(main, pace=pace) == [(n * 25 * MS, b"%d" % n) for n in range(20)]


def test_a_reader_is_served_while_the_loop_waits_for_the_wall() -> None:
    async def main(loop: VirtualLoop) -> tuple[bytes, int, float]:
        left, right = socket.socketpair()
        with left, right:
            right.setblocking(False)
            began = time.monotonic()
            thread = threading.Timer(0.02, left.send, (b"hello",))
            thread.start()
            keep = loop.call_later(30.0, lambda: None)
            data = await loop.sock_recv(right, 100)
            keep.cancel()
            thread.join()
            return data, loop.now_ns(), time.monotonic() - began

    data, now_ns, wall_s = run(main, pace=1.0)
    assert data == b"hello"
    assert now_ns == 0
    assert wall_s < 5.0


hold_the_loop = time.sleep


def test_a_late_paced_loop_goes_on_from_where_it_is() -> None:
    async def main(loop: VirtualLoop) -> float:
        await asyncio.sleep(0.01)
        hold_the_loop(0.3)
        began = time.monotonic()
        for _ in range(10):
            await asyncio.sleep(0.01)
        return time.monotonic() - began

    assert run(main, pace=1.0) >= 0.085


# ---------------------------------------------------------------------------------------------- threads


def test_time_stands_still_while_an_executor_works() -> None:
    async def main(loop: VirtualLoop) -> tuple[int, int, int]:
        ticks = 0

        def tick() -> None:
            nonlocal ticks
            ticks += 1
            loop.call_later(0.01, tick)

        loop.call_later(0.01, tick)
        await asyncio.sleep(0.1)
        before = ticks
        await asyncio.to_thread(time.sleep, 0.02)
        return before, ticks, loop.now_ns()

    before, after, now_ns = run(main)
    assert before == after
    assert now_ns == 100 * MS


def test_an_executor_that_raises_lets_time_go_on() -> None:
    def fails() -> None:
        raise OSError("on purpose")

    async def main(loop: VirtualLoop) -> int:
        with pytest.raises(OSError, match="on purpose"):
            await loop.run_in_executor(None, fails)
        await asyncio.sleep(1.0)
        return loop.now_ns()

    assert run(main) == 1_000_000_000


def test_freeze_holds_time_for_a_thread_of_ones_own() -> None:
    async def main(loop: VirtualLoop) -> tuple[int, int]:
        came: asyncio.Future[int] = loop.create_future()
        thread = threading.Thread(target=lambda: (time.sleep(0.02), loop.call_soon_threadsafe(came.set_result, 7)))
        loop.call_later(0.5, lambda: None)
        with loop.freeze():
            thread.start()
            value = await came
        thread.join()
        return value, loop.now_ns()

    assert run(main) == (7, 0)


def test_a_thread_can_wake_a_loop_without_timers() -> None:
    async def main(loop: VirtualLoop) -> int:
        came: asyncio.Future[int] = loop.create_future()
        thread = threading.Thread(target=lambda: (time.sleep(0.02), loop.call_soon_threadsafe(came.set_result, 7)))
        thread.start()
        value = await came
        thread.join()
        return value

    assert run(main) == 7


def test_thread_calls_are_heard_while_time_runs_freely() -> None:
    async def main(loop: VirtualLoop) -> bool:
        heard = asyncio.Event()
        thread = threading.Thread(target=lambda: [loop.call_soon_threadsafe(lambda: None) for _ in range(300)])
        thread.start()
        last = threading.Thread(target=lambda: (thread.join(), loop.call_soon_threadsafe(heard.set)))
        last.start()
        ticks = 0

        def tick() -> None:
            nonlocal ticks
            ticks += 1
            loop.call_later(0.001, tick)

        tick()
        await heard.wait()
        last.join()
        return ticks > 0

    assert run(main)


# ---------------------------------------------------------------------------------------------- signals


@pytest.mark.parametrize("pace", [None, 1.0])
def test_signals_are_handled(pace: float | None) -> None:
    async def main(loop: VirtualLoop) -> str:
        got: asyncio.Future[str] = loop.create_future()
        loop.add_signal_handler(signal.SIGUSR1, got.set_result, "usr1")
        loop.call_later(0.01, os.kill, os.getpid(), signal.SIGUSR1)

        def tick() -> None:
            loop.call_later(0.001, tick)

        tick()
        try:
            return await got
        finally:
            loop.remove_signal_handler(signal.SIGUSR1)

    assert run(main, pace=pace) == "usr1"


def test_an_interrupt_ends_a_running_simulation() -> None:
    async def main(loop: VirtualLoop) -> None:
        loop.call_later(0.01, os.kill, os.getpid(), signal.SIGINT)

        def tick() -> None:
            loop.call_later(0.001, tick)

        tick()
        await loop.create_future()

    with pytest.raises(KeyboardInterrupt):
        run(main)


# --------------------------------------------------------------------------------------------- deadlock


async def _wait_for_nothing(loop: VirtualLoop) -> None:
    await loop.create_future()


async def _freeze_for_nothing(loop: VirtualLoop) -> None:
    with loop.freeze():
        await asyncio.sleep(1.0)


async def _wait_after_a_thread_ended(loop: VirtualLoop) -> None:
    await asyncio.to_thread(lambda: None)
    threading.Thread(target=time.sleep, args=(0.01,)).start()
    await loop.create_future()


@pytest.mark.parametrize(
    ("main", "cause"),
    [
        (_wait_for_nothing, "no timer is set"),
        (_freeze_for_nothing, "time is frozen"),
        (_wait_after_a_thread_ended, "no timer is set"),
    ],
)
def test_waiting_for_nothing_is_an_error_that_names_the_waiting(
    main: Callable[[VirtualLoop], Awaitable[None]], cause: str
) -> None:
    with pytest.raises(VirtualDeadlock, match=cause) as error:
        run(main)
    wanted = "sleep" if main is _freeze_for_nothing else getattr(main, "__name__", "")
    assert re.search(rf"waiting: Task-\d+ in {wanted} line \d+", str(error.value))


def test_running_loop_names_the_mend() -> None:
    async def main() -> None:
        running_loop()

    with pytest.raises(RuntimeError, match=r"robotd\.testing\.run_virtual"):
        asyncio.run(main())
