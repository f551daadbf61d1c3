"""What does not come out again is named: where, who, what was recorded and replayed, and what cannot be compared."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recorded import GainConfig, Idle, Nearest, SeesScan, Slow, again, asks, commands, record, rich
from small_robot import OFF, QUICK, FakeBase, S, behaviour

from robotd import Drive, Target
from robotd.engine import replay as replay_module
from robotd.engine.codec import RecordError, encode
from robotd.engine.journal import FORMAT, RunJournal
from robotd.engine.parts import Parts
from robotd.engine.record_file import Entry, RecordWriter, read_record
from robotd.engine.replay import platform_notes, replay, same_arithmetic, turns
from robotd.safety.operator import EStop
from robotd.world.messages import Applied


def rewrite(path: Path, change: Callable[[Entry], Entry | None], **header: Any) -> Path:
    """A copy with each entry as `change` returns it (None leaves it out), and other words in the header."""
    recording = read_record(path)
    copy = path.with_name("changed.mcap")
    writer = RecordWriter(copy, {**recording.header, **header}, synchronous=True)
    for entry in recording:
        changed = change(entry)
        if changed is not None:
            writer.write(changed.kind, changed.sequence, changed.now_ns, changed.payload, changed.topic)
    assert writer.close()
    return copy


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "run.mcap"


def test_a_changed_gain_is_found_at_the_step_where_it_first_counts(path: Path) -> None:
    # a body without ramps, so that the guard does not hide the first difference
    written = record(path, replace(rich(), robot=QUICK, guard=OFF), 3.5)
    report = again(path, replace(rich(gain=GainConfig(late_gain=0.6)), robot=QUICK, guard=OFF))
    difference = report.first_difference
    assert difference is not None
    first = next(i for i, applied in enumerate(written) if applied.stamp_ns >= 3 * S)
    assert report.compared == first
    assert (difference.recorded, difference.now_ns) == (written[first], written[first].stamp_ns)
    assert difference.replayed is not None and difference.replayed.command != written[first].command
    assert difference.entered[-1].startswith("message lidar_scan")
    text = str(difference)
    assert f"turn {difference.turn} at 3.000000 s" in text
    assert "recorded Drive(" in text and "replayed Drive(" in text and "by follow" in text
    assert "the turn of message lidar_scan (0 ms old), before that message camera_frame (0 ms old), tick" in text


def test_a_plugin_that_changed_is_found_at_its_first_other_step(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written = record(path, rich(), 2.0)

    def step(self: Nearest, seen: SeesScan) -> Target | None:
        made = original(self, seen)
        return made if seen.now_ns < S or made is None else replace(made, bearing_rad=made.bearing_rad + 1e-12)

    original = Nearest.step
    monkeypatch.setattr(Nearest, "step", step)
    difference = again(path, rich()).first_difference
    first = next(applied for applied in written if applied.by == "follow" and applied.stamp_ns >= S)
    assert difference is not None and difference.recorded == first
    assert again(path, rich(), tolerance=1e-9).first_difference is None


def test_a_sign_of_zero_is_a_difference(path: Path) -> None:
    record(path, Parts(rich().robot, rich().devices[:2], (), (behaviour(Idle),), guard=rich().guard), 0.5)
    halts = commands(path, rich())
    assert halts[0].command == Drive(0.0)

    def other_zero(entry: Entry) -> Entry:
        if entry.kind != "command":
            return entry
        return replace(entry, payload=encode(replace(halts[0], command=Drive(-0.0))))

    changed = rewrite(path, other_zero)
    parts = Parts(rich().robot, rich().devices[:2], (), (behaviour(Idle),), guard=rich().guard)
    assert again(path, parts).first_difference is None
    difference = again(changed, parts).first_difference
    assert difference is not None and "vx_mps=-0.0" in str(difference)


@pytest.mark.parametrize("who", ["recorded", "replayed"])
def test_a_command_that_one_side_lacks_is_a_difference(path: Path, who: str) -> None:
    written = record(path, rich(), 1.0)
    middle = next(a.stamp_ns for a in written if a.stamp_ns > S // 2 and a.stamp_ns % (S // 10) == 0)

    def drop(entry: Entry) -> Entry | None:
        kind = "command" if who == "recorded" else "message"
        return None if entry.kind == kind and entry.now_ns == middle else entry

    difference = again(rewrite(path, drop), rich()).first_difference
    assert difference is not None
    if who == "recorded":
        assert difference.recorded is None and "recorded no command" in str(difference)
    else:
        assert difference.recorded is not None and difference.recorded.stamp_ns == middle
        assert difference.replayed is None and "replayed no command" in str(difference)


def test_a_perceptor_that_is_played_back_must_be_asked_as_often_as_it_was(path: Path) -> None:
    record(path, rich(), 1.0)
    seen = [entry.sequence for entry in read_record(path) if entry.kind == "perceived"]
    fewer = rewrite(path, lambda e: None if e.kind == "perceived" and e.sequence == seen[3] else e)
    difference = again(fewer, rich()).first_difference
    assert difference is not None
    assert difference.turn == seen[3] and "stepped more often than recorded" in str(difference)
    tick = next(e for e in read_record(path) if e.kind == "tick" and e.sequence > seen[3])

    def once_more(entry: Entry) -> Entry:
        return replace(entry, sequence=tick.sequence) if entry.sequence == seen[3] + 1 else entry

    assert again(rewrite(path, once_more), rich()).first_difference is None, "numbers of turns are for people"


# ------------------------------------------------------------------------------- what cannot be compared


def test_a_cut_file_is_replayed_up_to_its_end(path: Path) -> None:
    written = record(path, rich(), 3.5)
    whole = path.read_bytes()
    counts = []
    for share in (0.4, 0.6, 0.8):
        path.write_bytes(whole[: int(len(whole) * share)])
        report = again(path, rich())
        assert report.first_difference is None
        assert any("the file ends too early (byte" in note for note in report.notes)
        counts.append(report.compared)
    assert 0 < counts[0] < counts[1] < counts[2] < len(written)


def test_drops_end_what_can_be_compared_and_the_rest_is_counted(path: Path) -> None:
    written = record(path, rich(), 3.0)
    told = {"count": 4, "first_sequence": 100, "last_sequence": 103, "reason": "queue full"}

    def gap(entry: Entry) -> Entry | None:
        if entry.sequence == 100 and entry.kind in ("message", "tick"):
            return replace(entry, kind="dropped", topic="", payload=encode(told))
        return None if 100 <= entry.sequence <= 103 else entry

    changed = rewrite(path, gap)
    assert [turn.broken != "" for turn in turns(read_record(changed))] == [False] * 100 + [True]
    report = again(changed, rich())
    assert report.first_difference is None
    before = [e for e in read_record(path) if e.kind == "command" and e.sequence < 100]
    after = [e for e in read_record(path) if e.kind == "command" and e.sequence > 103]
    assert (report.compared, report.uncompared) == (len(before), len(after))
    assert 0 < report.compared < len(written)
    assert any("4 entries are missing from turn 100 on (queue full)" in note for note in report.notes)
    assert f"{len(after)} commands after that were not compared" in report.notes


def test_what_cannot_be_kept_ends_what_can_be_compared(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Strange(Target):
        """Holds something that no recording can."""

    def step(self: Any, seen: Any) -> Target | None:
        made = Strange(seen.now_ns, 0.0)
        object.__setattr__(made, "range_m", object() if seen.now_ns > S else 1.0)
        return made

    monkeypatch.setattr(Slow, "step", step)
    record(path, rich(), 2.0)
    report = again(path, rich())
    assert report.first_difference is None
    assert report.compared > 5 and report.uncompared > 5
    assert any("range_m: a builtins:object cannot be recorded" in note for note in report.notes)


def test_a_run_that_broke_is_compared_up_to_the_fault(path: Path) -> None:
    class Typo(FakeBase):
        def apply(self, command: Drive) -> None:
            super().apply(command)
            if len(self.log) == 12:
                raise TypeError("a fault of the driver")

    with pytest.raises(BaseExceptionGroup):
        record(path, rich(base=Typo), 2.0)
    report = again(path, rich())
    assert report.first_difference is None
    assert report.compared > 5
    assert any("the run ended with a fault: TypeError: a fault of the driver" in note for note in report.notes)


# ---------------------------------------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda e: None if e.kind == "started" else e, "begins with 'opened' of turn 1, not a start"),
        (lambda e: replace(e, topic="radar") if e.kind == "message" else e, "this robot has no topic 'radar'"),
        (lambda e: replace(e, topic="arm") if e.kind == "opened" else e, "this robot has no device 'arm'"),
        (lambda e: replace(e, topic="x") if e.kind == "timer" else e, "this robot has no 'x' at"),
        (lambda e: replace(e, kind="dance") if e.kind == "tick" else e, "holds a 'dance', which is unknown"),
        (lambda e: replace(e, payload=b"?") if e.kind == "message" else e, "message lidar_scan: byte 1: cut off"),
        (lambda e: None, "holds no run"),
    ],
)
def test_a_recording_of_another_robot_is_refused(
    path: Path, change: Callable[[Entry], Entry | None], words: str
) -> None:
    record(path, rich(), 1.0)
    with pytest.raises(RecordError, match=words):
        again(rewrite(path, change), rich())


def test_another_format_is_refused(path: Path) -> None:
    record(path, rich(), 0.2)
    with pytest.raises(RecordError, match=f"a run of format 99, this robotd replays format {FORMAT}"):
        again(rewrite(path, lambda e: e, format=99), rich())


def test_another_platform_is_said(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    record(path, rich(), 0.2)
    header = read_record(path).header
    assert platform_notes(header) == () and same_arithmetic(header)
    other = {**header, "numpy": "0.1", "python": "2.7"}
    assert not same_arithmetic(other)
    assert same_arithmetic({**header, "python": "2.7"})
    assert platform_notes(other) == (
        f"recorded with python 2.7, replayed with {header['python']}",
        f"recorded with numpy 0.1, replayed with {np.__version__}",
    )
    assert set(replay_module.ARITHMETIC) <= header.keys()


# ---------------------------------------------------------------------------------- journal and watchers


def test_frames_are_kept_without_their_picture_unless_asked(tmp_path: Path) -> None:
    sizes = {}
    for frames in (False, True):
        path = tmp_path / f"{frames}.mcap"
        record(path, rich(), 1.0, frames=frames)
        kept = [e for e in read_record(path) if e.topic == "camera_frame"]
        sizes[frames] = max(len(entry.payload) for entry in kept)
        assert len(kept) == 8
    assert sizes[True] - sizes[False] > 12 * 16 * 3 - 50


def test_a_watcher_sees_each_turn(path: Path) -> None:
    record(path, rich(), 1.0, asks(0.5, EStop("button")))
    seen: list[tuple[int, str]] = []
    replay(read_record(path), rich(), watch=lambda core, turn: seen.append((core.turns, core.operator.mode.value)))
    assert len(seen) == sum(1 for e in read_record(path) if e.kind not in ("perceived", "command"))
    assert [mode for _, mode in seen].count("estop") > 20


def test_a_journal_numbers_turns_and_closes(path: Path) -> None:
    journal = RunJournal(RecordWriter(path, {}, synchronous=True))
    assert (journal.path, journal.turn, journal.dropped, journal.failure) == (path, -1, 0, None)
    journal.note("started", "", 5, None)
    journal.note("command", "follow", 5, Applied(5, Drive(0.1), "follow"))
    journal.note("tick", "", 9, None)
    assert journal.close() and journal.close()
    assert [(e.kind, e.topic, e.sequence, e.now_ns) for e in read_record(path)] == [
        ("started", "", 0, 5),
        ("command", "", 0, 5),
        ("tick", "", 1, 9),
    ]
