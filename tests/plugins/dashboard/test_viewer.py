"""One open page: beats, newest wins, bounded whatever it does or does not read."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotd_plugins.bridges.dashboard.viewer import ANSWERS_MAX, EVENTS, EVENTS_KEPT, EventLog, Viewer


def viewer() -> Viewer:
    return Viewer(1, "127.0.0.1", 0.0)


def beats(payloads: list[Any]) -> list[int]:
    told = [json.loads(p) for p in payloads if isinstance(p, str) and p.startswith("{")]
    return [m["n"] for m in told if m.get("kind") == "beat"]


def test_a_beat_waits_until_the_last_one_is_drawn() -> None:
    page = viewer()
    page.give("scan", 1, 0, b"one")
    assert beats(page.take()) == [1]
    page.give("scan", 2, 100, b"two")
    page.give("scan", 3, 200, b"three")
    page.give("status", 1, 200, "{}")
    assert page.take() == []
    page.drew(0)
    page.drew(7)
    assert page.take() == []
    page.drew(1)
    sent = page.take()
    assert b"three" in sent and b"two" not in sent and beats(sent) == [2]


def test_nothing_new_is_no_beat() -> None:
    page = viewer()
    assert page.take() == []
    page.answer("yes")
    assert page.take() == ["yes"]


@given(st.lists(st.sampled_from(["give", "answer", "draw", "take"]), max_size=300))
def test_what_waits_is_bounded_and_one_beat_at_most_is_out(acts: list[str]) -> None:
    page, out, drawn = viewer(), 0, 0
    for i, act in enumerate(acts):
        match act:
            case "give":
                page.give(f"channel {i % 3}", i, i, b"x")
            case "answer":
                page.answer("yes")
            case "draw":
                page.drew(out)
                drawn = out
            case "take":
                sent = page.take()
                assert len(sent) <= ANSWERS_MAX + 3 + 1
                out += len(beats(sent))
                assert out - drawn <= 1


def test_answers_to_a_page_that_does_not_read_are_dropped_oldest_first() -> None:
    page = viewer()
    for i in range(1000):
        page.answer(str(i))
    assert page.take() == [str(i) for i in range(1000 - ANSWERS_MAX, 1000)]


def test_a_channel_is_due_after_its_period_and_news_when_its_version_changed() -> None:
    page = viewer()
    assert page.is_due("scan", 0, 100) and page.lacks("scan", 1)
    page.give("scan", 1, 0, b"")
    assert not page.is_due("scan", 99, 100) and page.is_due("scan", 100, 100)
    assert not page.lacks("scan", 1) and page.lacks("scan", 2)
    page.forget("scan")
    assert page.is_due("scan", 1, 100) and page.lacks("scan", 1)


@pytest.mark.parametrize(("per_s", "is_kept"), [(25, True), (90, True), (400, False)])
def test_who_sends_more_than_a_page_is_noticed(per_s: int, is_kept: bool) -> None:
    page = viewer()
    assert all(page.hears(i / per_s) for i in range(10 * per_s)) is is_kept


def test_the_log_keeps_the_last_entries_and_numbers_all() -> None:
    log = EventLog()
    for i in range(EVENTS_KEPT + 20):
        log.add(i, "request", f"entry {i}")
    numbers = [entry["number"] for entry in json.loads(log.message(0))["entries"]]
    assert numbers == list(range(21, EVENTS_KEPT + 21))
    assert [entry["text"] for entry in json.loads(log.message(EVENTS_KEPT + 19))["entries"]] == ["entry 119"]


def test_events_that_wait_for_a_slow_page_are_told_together() -> None:
    page, log = viewer(), EventLog()
    for i in range(3):
        log.add(i, "request", f"entry {i}")
        page.give(EVENTS, log.last, i, log.message(page.events_told))
    assert "entry 0" in str(page.take()) and page.events_told == 3
    log.add(3, "request", "entry 3")
    assert [entry["number"] for entry in json.loads(log.message(page.events_told))["entries"]] == [4]
