"""The guardian's decision: when the stop is written, how often, and when it may end."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotd.safety.guardian import LAST_STOPS, LONGEST_END_NS, Watch, open_line

MS = 1_000_000
DEADLINE_MS = 100


def beat(at_ms: int) -> tuple[int, Callable[[Watch], None]]:
    return at_ms, lambda watch: watch.beat(at_ms * MS)


def idle(at_ms: int) -> tuple[int, Callable[[Watch], None]]:
    return at_ms, lambda watch: watch.beat(None)


def acknowledged(at_ms: int) -> tuple[int, Callable[[Watch], None]]:
    return at_ms, lambda watch: watch.acknowledge(at_ms * MS)


def stop(at_ms: int) -> tuple[int, Callable[[Watch], None]]:
    return at_ms, lambda watch: watch.stop(at_ms * MS)


def end(at_ms: int, count: int = LAST_STOPS) -> tuple[int, Callable[[Watch], None]]:
    return at_ms, lambda watch: watch.end(at_ms * MS, count)


def play(
    events: Sequence[tuple[int, Callable[[Watch], None]]], until_ms: int, *, taken: bool = True
) -> tuple[list[int], Watch]:
    """The milliseconds in which the stop was written, looking as the process does: at each event, and when it asks."""
    watch = Watch(DEADLINE_MS * MS)
    written: list[int] = []
    todo = sorted(events, key=lambda event: event[0])
    now_ms = 0
    while now_ms <= until_ms and not watch.is_over:
        while todo and todo[0][0] <= now_ms:
            todo.pop(0)[1](watch)
        watch.look(now_ms * MS)
        if watch.is_due(now_ms * MS):
            written.append(now_ms)
            watch.wrote(now_ms * MS, taken=taken)
        if watch.is_over:
            break
        wait_ms = watch.wait_ms(now_ms * MS)
        nearest = [until_ms + 1 if wait_ms is None else now_ms + max(1, wait_ms), *(at for at, _ in todo[:1])]
        now_ms = min(nearest)
    return written, watch


@pytest.mark.parametrize(
    ("events", "until_ms", "written"),
    [
        pytest.param([], 1000, [], id="nothing before the first sign of life"),
        pytest.param([beat(at) for at in range(0, 1001, 20)], 1000, [], id="alive"),
        pytest.param([beat(0), idle(20)], 1000, [], id="disarmed, then silent"),
        pytest.param([beat(0)], 170, [101, 121, 141, 161], id="silent: the stop again and again"),
        pytest.param([beat(0), beat(110), beat(130)], 170, [101, 121, 141, 161], id="life that knows of no trip"),
        pytest.param([beat(0), idle(110)], 170, [101, 121, 141, 161], id="disarmed that knows of no trip"),
        pytest.param([beat(0), acknowledged(150)], 1000, [101, 121, 141, 150], id="acknowledged: one more"),
        pytest.param([beat(0), acknowledged(110), beat(120)], 230, [101, 110, 221], id="armed again, silent again"),
        pytest.param([beat(0), stop(50)], 1000, [50, 70, 90], id="asked to stop"),
        pytest.param([beat(0), stop(50), beat(60)], 160, [50], id="asked to stop, then armed again"),
        pytest.param([stop(50), beat(50)], 150, [50, 70, 90], id="asked to stop, armed before it was written"),
        pytest.param([beat(0), stop(110)], 170, [101, 121, 141, 161], id="asked to stop after a trip"),
        pytest.param([beat(0), end(30)], 1000, [30 + 20 * i for i in range(LAST_STOPS)], id="killed"),
        pytest.param([end(30)], 1000, [30 + 20 * i for i in range(LAST_STOPS)], id="killed while disarmed"),
        pytest.param([beat(0), end(130)], 1000, [101, 121, *range(130, 330, 20)], id="killed after a trip"),
        pytest.param([idle(0), end(30, 1)], 1000, [30], id="ended in good order"),
    ],
)
def test_when_the_stop_is_written(
    events: Sequence[tuple[int, Callable[[Watch], None]]], until_ms: int, written: list[int]
) -> None:
    assert play(events, until_ms)[0] == written


def test_a_sign_of_life_counts_from_when_it_was_sent() -> None:
    watch = Watch(DEADLINE_MS * MS)
    watch.beat(0)
    watch.beat(90 * MS)
    assert watch.look(150 * MS) is None, "the newest of those that waited"
    assert watch.look(191 * MS) == 101 * MS
    assert watch.look(192 * MS) is None, "a trip is told once"


def test_a_line_that_takes_nothing_is_tried_often_and_not_for_ever() -> None:
    written, watch = play([beat(0), end(10)], 10_000, taken=False)
    assert watch.is_over
    assert written[:4] == [10, 12, 14, 16]
    assert written[-1] == 10 + LONGEST_END_NS // MS


@given(st.lists(st.tuples(st.integers(1, 140), st.sampled_from(["beat", "idle", "acknowledge"])), max_size=40))
def test_never_silent_for_longer_than_the_deadline(steps: list[tuple[int, str]]) -> None:
    """While armed, unacknowledged silence beyond the deadline, and only that, makes stops due."""
    watch, now_ms, alive_ms = Watch(DEADLINE_MS * MS), 0, -1
    for gap_ms, what in steps:
        for _ in range(gap_ms):
            now_ms += 1
            was_tripped = watch.is_tripped
            watch.look(now_ms * MS)
            overdue = alive_ms >= 0 and now_ms - alive_ms > DEADLINE_MS
            assert watch.is_tripped == (was_tripped or overdue)
            if watch.is_tripped:
                alive_ms = -1
            if watch.is_due(now_ms * MS):
                watch.wrote(now_ms * MS, taken=True)
        if what == "acknowledge":
            watch.acknowledge(now_ms * MS)
            alive_ms = -1
        elif not watch.is_tripped:
            watch.beat(now_ms * MS if what == "beat" else None)
            alive_ms = now_ms if what == "beat" else -1


@pytest.mark.parametrize("packet", [b"", b"x", b"sSTOP"])
def test_no_line_in_a_packet(packet: bytes) -> None:
    with pytest.raises(ValueError, match="no line"):
        open_line(packet, [])
