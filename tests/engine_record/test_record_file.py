"""The record file: what is written is read, drops are marked, and neither a cut file nor a failing disk does harm."""

from __future__ import annotations

import errno
import io
import json
import logging
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robotd import Drive, LidarScan, Odometry
from robotd.engine import record_file
from robotd.engine.codec import RecordError, allow, decode, encode
from robotd.engine.record_file import DROPPED, Entry, RecordWriter, platform_header, read_record

MS = 1_000_000
CLASSES = allow(LidarScan, Odometry, Drive)


def scan(number: int) -> LidarScan:
    ranges = np.full(60, 1.0 + number, np.float32)
    return LidarScan(number * 25 * MS, ranges, np.linspace(0, 6, 60, dtype=np.float32))


def write_some(path: Path, count: int, *, synchronous: bool = True, **more: Any) -> RecordWriter:
    """Scans at 40 Hz with a tick and a command beside each."""
    writer = RecordWriter(path, {"config": {"robot": "test"}}, synchronous=synchronous, **more)
    for number in range(count):
        now_ns = number * 25 * MS + 1
        writer.write("message", number, now_ns, scan(number), topic="lidar_scan")
        writer.write("tick", number, now_ns, b"")
        writer.write("command", number, now_ns, Drive(number / 3.0))
    return writer


def check_some(entries: list[Entry], count: int) -> None:
    kinds = [("message", "lidar_scan"), ("tick", ""), ("command", "")]
    assert [(e.kind, e.topic) for e in entries] == (kinds * count)[: len(entries)]
    for at, entry in enumerate(entries):
        number = at // 3
        assert (entry.sequence, entry.now_ns) == (number, number * 25 * MS + 1)
        if entry.kind == "message":
            assert np.array_equal(decode(entry.payload, CLASSES).ranges_m, scan(number).ranges_m)
        elif entry.kind == "command":
            assert decode(entry.payload, CLASSES) == Drive(number / 3.0)
        else:
            assert entry.payload == b""


@pytest.mark.parametrize("synchronous", [True, False])
def test_what_is_written_is_read_in_order(tmp_path: Path, synchronous: bool) -> None:
    path = tmp_path / "run.mcap"
    writer = write_some(path, 100, synchronous=synchronous)
    assert writer.close()
    assert writer.close()
    assert (writer.written, writer.dropped) == (300, 0)
    recording = read_record(path)
    assert recording.header["config"] == {"robot": "test"}
    assert {key: recording.header[key] for key in platform_header()} == platform_header()
    assert ("started" in recording.header) is not synchronous
    for _ in range(2):
        check_some(list(recording), 100)
        assert recording.end.is_complete
        assert (recording.end.entries, recording.end.last_ns) == (300, 99 * 25 * MS + 1)


def test_the_same_run_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_some(tmp_path / name, 100).close()
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_nothing_is_written_after_the_end(tmp_path: Path) -> None:
    writer = write_some(tmp_path / "run.mcap", 3)
    writer.close()
    size = (tmp_path / "run.mcap").stat().st_size
    writer.write("tick", 4, 5, b"")
    assert (tmp_path / "run.mcap").stat().st_size == size


@pytest.mark.parametrize("synchronous", [True, False])
def test_a_killed_writer_loses_at_most_a_second(tmp_path: Path, synchronous: bool) -> None:
    path = tmp_path / "run.mcap"
    writer = write_some(path, 400, synchronous=synchronous)
    if not synchronous:
        wait_until(lambda: writer.written == 1200)
    # as if killed now: neither close nor finish
    recording = read_record(path)
    entries = list(recording)
    check_some(entries, 400)
    assert 399 * 25 * MS - entries[-1].now_ns <= 1000 * MS
    assert not recording.end.is_complete
    writer.close()


@pytest.mark.parametrize("cut", [0.05, 0.3, 0.6, 0.9, 0.999])
def test_a_cut_file_gives_its_entries_up_to_there(tmp_path: Path, cut: float) -> None:
    path = tmp_path / "run.mcap"
    write_some(path, 400).close()
    whole = path.read_bytes()
    path.write_bytes(whole[: int(len(whole) * cut)])
    recording = read_record(path)
    entries = list(recording)
    check_some(entries, 400)
    end = recording.end
    assert end.entries == len(entries)
    assert end.offset <= len(whole) * cut
    assert end.reason == f"byte {end.offset}: the file is cut off"


def test_a_damaged_chunk_ends_the_recording_before_it(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    write_some(path, 400).close()
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0x55
    path.write_bytes(data)
    recording = read_record(path)
    entries = list(recording)
    check_some(entries, 400)
    assert 0 < len(entries) < 1200
    assert "damaged" in recording.end.reason


@pytest.mark.parametrize("data", [b"", b"\x89MCAP0\r\n", b"not a recording at all, only text"])
def test_what_is_no_recording_is_refused(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(data)
    with pytest.raises(RecordError, match=r"run\.mcap: byte 0: no recording of robotd"):
        read_record(path)


def test_a_file_of_another_program_is_refused(tmp_path: Path) -> None:
    from mcap.writer import Writer

    stream = io.BytesIO()
    writer = Writer(stream)
    writer.start()
    writer.finish()
    path = tmp_path / "foreign.mcap"
    path.write_bytes(stream.getvalue())
    with pytest.raises(RecordError, match="it has no header"):
        read_record(path)


def test_a_place_that_cannot_be_written_is_an_error_at_once(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        RecordWriter(tmp_path / "nowhere" / "run.mcap", {}, synchronous=True)
    full = Path("/dev/full")
    if full.exists():
        with pytest.raises(OSError, match="No space left"):
            RecordWriter(full, {}, synchronous=True)


# ------------------------------------------------------------------------------------------- slow disks


class Disk:
    """Stands in for the file: blocks while `gate` is closed, fails after `room` bytes."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.gate = threading.Event()
        self.gate.set()
        self.room: int | None = None
        real = record_file._File.write

        def write(file: Any, data: bytes) -> int:
            assert self.gate.wait(20.0)
            if self.room is not None:
                self.room -= len(data)
                if self.room < 0:
                    raise OSError(errno.ENOSPC, "No space left on device")
            return real(file, data)

        monkeypatch.setattr(record_file._File, "write", write)


def wait_until(condition: Callable[[], bool]) -> None:
    tick = threading.Event()
    for _ in range(2000):
        if condition():
            return
        tick.wait(0.005)
    raise AssertionError("waited 10 s in vain")


def test_a_blocked_disk_never_blocks_the_caller_and_the_gap_is_marked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    disk = Disk(monkeypatch)
    writer = RecordWriter(tmp_path / "run.mcap", {}, synchronous=False, queue_entries=50)
    for number in range(40):
        writer.write("tick", number, number * 10 * MS, b"x")
    wait_until(lambda: not writer._queue)
    disk.gate.clear()
    # more than a second of record time: the flush at the end of the first chunk hangs the writing thread
    for number in range(40, 300):
        writer.write("tick", number, number * 10 * MS, b"x")
    assert writer.dropped > 0
    before = writer.dropped
    disk.gate.set()
    wait_until(lambda: not writer._queue)
    writer.write("tick", 300, 3000 * MS, b"x")
    assert writer.close(10.0)
    assert writer.dropped == before

    entries = list(read_record(tmp_path / "run.mcap"))
    at = [e.kind for e in entries].index(DROPPED)
    told = decode(entries[at].payload, {})
    assert told == {
        "count": before,
        "first_sequence": entries[at - 1].sequence + 1,
        "last_sequence": 299,
        "reason": "queue full",
    }
    assert entries[at].sequence == told["first_sequence"]
    assert [e.sequence for e in entries[at + 1 :]] == [300]
    assert len(entries) - 1 + before == 301
    assert sum("dropped" in r.message for r in caplog.records) == 1


def test_a_gap_at_the_very_end_is_marked_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    gate = threading.Event()
    monkeypatch.setattr(record_file, "encode", lambda value: encode(value) if gate.wait(20.0) else b"")
    writer = RecordWriter(tmp_path / "run.mcap", {}, synchronous=False, queue_entries=1_000_000, queue_bytes=10_000)
    for number in range(100):
        writer.write("message", number, number, Odometry(number, 0.0, 0.0, 0.0))
    assert writer.dropped > 0
    gate.set()
    assert writer.close(10.0)
    entries = list(read_record(tmp_path / "run.mcap"))
    marked = [decode(e.payload, {})["count"] for e in entries if e.kind == DROPPED]
    assert sum(marked) == writer.dropped
    assert len(entries) - len(marked) + writer.dropped == 100


def test_one_entry_larger_than_the_queue_is_kept(tmp_path: Path) -> None:
    writer = RecordWriter(tmp_path / "run.mcap", {}, synchronous=False, queue_bytes=1000)
    writer.write("frame", 1, 1, b"x" * 5000)
    assert writer.close(10.0)
    assert [len(e.payload) for e in read_record(tmp_path / "run.mcap")] == [5000]


def test_closing_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    disk = Disk(monkeypatch)
    writer = write_some(tmp_path / "run.mcap", 10, synchronous=False)
    disk.gate.clear()
    assert writer.close(0.05) is False
    assert "not finished after 0.05 s" in caplog.text
    disk.gate.set()
    thread = writer._thread
    assert thread is not None
    thread.join(10.0)
    check_some(list(read_record(tmp_path / "run.mcap")), 10)


@pytest.mark.parametrize("synchronous", [True, False])
def test_a_full_disk_ends_the_recording_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, synchronous: bool
) -> None:
    disk = Disk(monkeypatch)
    told: list[OSError] = []
    path = tmp_path / "run.mcap"
    writer = RecordWriter(path, {}, synchronous=synchronous, on_failure=told.append)
    disk.room = 30_000
    with caplog.at_level(logging.INFO):
        for number in range(600):
            writer.write("message", number, number * 25 * MS, scan(number), topic="lidar_scan")
        if not synchronous:
            wait_until(lambda: writer.failure is not None)
        writer.write("tick", 600, 600 * 25 * MS, b"")
        assert writer.close() is False
    assert [error.errno for error in told] == [errno.ENOSPC]
    assert writer.failure is told[0]
    stopped = [r for r in caplog.records if "stopped" in r.message]
    assert len(stopped) == 1
    assert not any("dropped" in r.message for r in caplog.records)
    recording = read_record(path)
    assert 0 < len(list(recording)) < 600
    assert not recording.end.is_complete


def test_what_the_codec_refuses_is_marked_and_said_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    writer = RecordWriter(tmp_path / "run.mcap", {}, synchronous=True)
    for number in range(3):
        writer.write("goal", number, number, {1, 2}, topic="visit")
    writer.write("tick", 3, 3, b"")
    assert writer.close()
    entries = list(read_record(tmp_path / "run.mcap"))
    assert [e.kind for e in entries] == [DROPPED, DROPPED, DROPPED, "tick"]
    assert "cannot be recorded" in decode(entries[0].payload, {})["reason"]
    assert writer.dropped == 3
    assert sum("goal/visit cannot be kept" in r.message for r in caplog.records) == 1


# ------------------------------------------------------------------------------------------ for viewers


def test_foreign_readers_see_channels_schemas_and_thinned_json(tmp_path: Path) -> None:
    from mcap.reader import make_reader

    path = tmp_path / "run.mcap"
    write_some(path, 80).close()
    with path.open("rb") as file:
        reader = make_reader(file)
        seen = [(schema, channel, message) for schema, channel, message in reader.iter_messages()]
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
    assert json.loads(metadata["robotd"]["config"]) == {"robot": "test"}
    topics = {channel.topic: (channel.message_encoding, schema.name) for schema, channel, _ in seen if schema}
    assert topics == {
        "robotd/message/lidar_scan": ("robotd", "robotd.world.messages:LidarScan"),
        "robotd/tick/": ("robotd", "builtins:bytes"),
        "robotd/command/": ("robotd", "robotd.world.messages:Drive"),
        "/lidar_scan": ("json", "robotd.LidarScan"),
        "/command": ("json", "robotd.Drive"),
    }
    copies = [(m.log_time, json.loads(m.data)) for _, c, m in seen if c.topic == "/lidar_scan"]
    gaps = np.diff([time for time, _ in copies])
    assert (gaps >= 100 * MS).all()
    assert len(copies) == 20
    assert all(copy["stamp_ns"] + 1 == time for time, copy in copies)
    schemas = {schema.name: schema for schema, _, _ in seen if schema}
    assert "ranges_m" in json.loads(schemas["robotd.LidarScan"].data)["properties"]


def test_viewer_copies_can_be_left_out(tmp_path: Path) -> None:
    writer = write_some(tmp_path / "with.mcap", 40)
    writer.close()
    without = write_some(tmp_path / "without.mcap", 40, viewer_hz=0.0)
    without.close()
    assert (tmp_path / "without.mcap").stat().st_size < (tmp_path / "with.mcap").stat().st_size
    check_some(list(read_record(tmp_path / "without.mcap")), 40)


def test_encoding_needs_no_file() -> None:
    assert decode(encode(Drive(0.5)), CLASSES) == Drive(0.5)
