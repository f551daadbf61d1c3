"""Log lines: what they look like, which repetitions are left out, and that a stuck reader holds nobody up."""

from __future__ import annotations

import json
import logging
import sys
import threading
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotd.engine.logs import (
    Installed,
    JsonFormatter,
    LineHandler,
    LineWriter,
    Repeats,
    TextFormatter,
    install,
    levels,
    printable,
)

WAIT_S = 10.0


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("plain", "plain"),
        ("two\nlines\tand a tab", "two lines and a tab"),
        ("\x1b[2Jcleared", "?[2Jcleared"),
        ("right to left \u202e", "right to left ?"),
        ("Nguyễn 東京", "Nguyễn 東京"),
        ("", ""),
    ],
)
def test_printable(text: str, shown: str) -> None:
    assert printable(text) == shown


@given(st.text())
def test_printable_never_leaves_anything_that_moves_a_cursor(text: str) -> None:
    shown = printable(text)
    assert len(shown) == len(text)
    assert not any(ord(char) < 32 or 0x7F <= ord(char) < 0xA0 for char in shown)


@pytest.mark.parametrize(
    ("first", "second", "same"),
    [
        ("held up for 31 ms", "held up for 78.5 ms", True),
        ("lidar1 is lost", "lidar2 is lost", False),
        ("lidar is lost", "camera is lost", False),
        ("again in 0.2 s", "again in 1e+01 s", True),
        ("open 192.168.0.7", "open 192.168.0.8", False),
        ("off by -3", "off by 4", True),
    ],
)
def test_which_messages_are_repetitions(first: str, second: str, same: bool) -> None:
    repeats = Repeats(window_s=5.0)
    assert repeats.judge("robotd", logging.WARNING, first, 0.0) == (True, 0)
    assert repeats.judge("robotd", logging.WARNING, second, 1.0)[0] is not same


def test_a_repetition_comes_back_with_its_count() -> None:
    repeats = Repeats(window_s=5.0)
    judged = [repeats.judge("robotd", 30, "lost", t) for t in (0.0, 1.0, 4.9, 5.0, 6.0, 10.0)]
    assert judged == [(True, 0), (False, 0), (False, 0), (True, 2), (False, 0), (True, 1)]


@pytest.mark.parametrize(
    "other", [("elsewhere", 30, "lost"), ("robotd", 40, "lost")], ids=["another logger", "another level"]
)
def test_other_sources_are_no_repetition(other: tuple[str, int, str]) -> None:
    repeats = Repeats()
    repeats.judge("robotd", 30, "lost", 0.0)
    assert repeats.judge(*other, 0.0)[0]


def test_a_clock_set_back_does_not_silence_the_log() -> None:
    repeats = Repeats(window_s=5.0)
    repeats.judge("robotd", 30, "lost", 1000.0)
    assert repeats.judge("robotd", 30, "lost", 10.0) == (True, 0)


def test_memory_is_bounded() -> None:
    repeats = Repeats(kept=4)
    for word in "abcdefgh":
        repeats.judge("robotd", 30, word, 0.0)
    assert len(repeats._seen) == 4
    assert not repeats.judge("robotd", 30, "h", 1.0)[0]
    assert repeats.judge("robotd", 30, "a", 1.0)[0]


def _record(
    level: int = logging.WARNING, text: str = "lidar: %s", *args: object, error: BaseException | None = None
) -> logging.LogRecord:
    info = (type(error), error, error.__traceback__) if error is not None else None
    record = logging.LogRecord("robotd", level, "a.py", 1, text, args or ("unplugged",), info)
    record.created = 1_700_000_000.25
    return record


def _raised() -> ValueError:
    try:
        raise ValueError("too \x1b[31mred")
    except ValueError as error:
        return error


@pytest.mark.parametrize(("level", "written"), [(logging.CRITICAL, 3), (logging.ERROR, 1), (logging.WARNING, 1)])
def test_a_repetition_is_left_out_unless_it_is_critical(level: int, written: int) -> None:
    lines: list[str] = []
    handler = LineHandler(lines.append)
    for _ in range(3):
        handler.handle(_record(level))
    assert len(lines) == written


def test_text_line() -> None:
    line = TextFormatter().format(_record())
    assert line[8:] == ".250 warning lidar: unplugged"


def test_text_line_of_an_error_is_one_line_without_escapes() -> None:
    line = TextFormatter().format(_record(error=_raised()))
    assert line.endswith("lidar: unplugged: ValueError: too ?[31mred")
    assert "\n" not in line


def test_an_error_that_the_message_names_already_is_not_repeated() -> None:
    error = _raised()
    error.args = ("too red",)
    assert TextFormatter().format(_record(logging.ERROR, "benched: %s", error, error=error)).count("too red") == 1


def test_traceback_only_where_wanted() -> None:
    assert "Traceback" in TextFormatter(tracebacks=True).format(_record(error=_raised()))
    assert "traceback" in json.loads(JsonFormatter(tracebacks=True).format(_record(error=_raised())))
    assert "traceback" not in json.loads(JsonFormatter().format(_record(error=_raised())))


def test_json_line() -> None:
    record = _record()
    record.repeated = 3
    assert json.loads(JsonFormatter().format(record)) == {
        "time": "2023-11-14T22:13:20.250+00:00",
        "level": "warning",
        "logger": "robotd",
        "message": "lidar: unplugged",
        "repeated": 3,
    }


@pytest.fixture
def installed() -> Iterator[tuple[list[str], list[Installed]]]:
    lines: list[str] = []
    handles: list[Installed] = []
    yield lines, handles
    for handle in handles:
        handle.remove()


@pytest.mark.parametrize(
    ("verbosity", "heard"),
    [
        (-1, ["own warning"]),
        (0, ["own info", "own warning", "other warning"]),
        (1, ["own debug", "own info", "own warning", "other info", "other warning"]),
        (2, ["own debug", "own info", "own warning", "other debug", "other info", "other warning"]),
        (9, ["own debug", "own info", "own warning", "other debug", "other info", "other warning"]),
    ],
)
def test_verbosity(installed: tuple[list[str], list[Installed]], verbosity: int, heard: list[str]) -> None:
    lines, handles = installed
    handles.append(install(lines.append, verbosity=verbosity))
    for source, name in (("own", "robotd.some.module"), ("other", "third_party")):
        for level in ("debug", "info", "warning"):
            getattr(logging.getLogger(name), level)("%s %s", source, level)
    assert [line.split(": ")[-1] for line in lines] == heard


def test_remove_leaves_logging_as_it_was(installed: tuple[list[str], list[Installed]]) -> None:
    lines, _ = installed
    root = logging.getLogger()
    before = (root.level, list(root.handlers), logging.getLogger("robotd").level)
    install(lines.append, verbosity=2).remove()
    assert (root.level, list(root.handlers), logging.getLogger("robotd").level) == before


def test_a_faulty_log_call_is_told_and_does_not_raise() -> None:
    lines: list[str] = []
    LineHandler(lines.append).handle(_record(logging.WARNING, "%d apples", "three"))
    assert lines == ["faulty log call at a.py:1: %d format: a real number is required, not str"]


def test_importing_installs_nothing() -> None:
    import subprocess

    code = (
        "import logging, robotd.engine.logs; print(logging.getLogger().handlers, logging.getLogger('robotd').handlers)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[] []"


def test_levels_are_bounded() -> None:
    assert levels(-5) == levels(-1)


# --------------------------------------------------------------------------------------------- writer


class StuckPipe:
    """Takes nothing until released."""

    def __init__(self) -> None:
        self.reached = threading.Event()
        self.release = threading.Event()
        self.written = b""

    def write(self, data: bytes) -> None:
        self.reached.set()
        assert self.release.wait(WAIT_S)
        self.written += data


def test_lines_come_out_in_order_before_close_returns() -> None:
    out: list[bytes] = []
    writer = LineWriter(out.append)
    for i in range(100):
        writer.put(f"line {i}")
    writer.close()
    assert b"".join(out).decode().splitlines() == [f"line {i}" for i in range(100)]


def test_a_stuck_reader_costs_lines_and_nothing_else() -> None:
    pipe = StuckPipe()
    writer = LineWriter(pipe.write, kept=3)
    writer.put("first")
    assert pipe.reached.wait(WAIT_S)
    for i in range(10):
        writer.put(f"line {i}")
    pipe.release.set()
    writer.close(WAIT_S)
    assert pipe.written.decode().splitlines() == [
        "first",
        "... 7 log lines were dropped: nobody read them in time",
        "line 7",
        "line 8",
        "line 9",
    ]


def test_close_does_not_wait_for_a_stuck_reader() -> None:
    pipe = StuckPipe()
    writer = LineWriter(pipe.write)
    writer.put("first")
    assert pipe.reached.wait(WAIT_S)
    writer.close(limit_s=0.01)
    assert pipe.written == b""
    pipe.release.set()


def test_a_reader_that_went_away_ends_the_writing() -> None:
    tries: list[bytes] = []

    def write(data: bytes) -> None:
        tries.append(data)
        raise BrokenPipeError

    writer = LineWriter(write)
    writer.put("a")
    writer.close(WAIT_S)
    writer.put("b")
    assert len(tries) == 1
