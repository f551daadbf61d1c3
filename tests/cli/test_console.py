"""The live picture on a terminal: drawn in place, whole after a resize, and never in the robot's way."""

from __future__ import annotations

import errno
import io
import logging
import os
import pty
import re
import threading
from typing import Any

import pytest

from robotd.engine.console import ChangeLog, Console, Frames, Screen, wants_picture, write_all
from robotd.engine.status import Status
from robotd.world.messages import Drive, Mode

WAIT_S = 10.0


def state(mode: Mode = Mode.DISARMED, reason: str = "not armed yet", now_ns: int = 0) -> Status:
    return Status(now_ns, mode, reason, (), (), (), Drive(), "", (), 0.0, 0, False)


class Terminal:
    """Enough of a terminal to see what stands on it: CR, LF, cursor up, clear to end of line and of screen."""

    def __init__(self) -> None:
        self.rows: list[str] = [""]
        self.row = self.column = 0

    def feed(self, text: str) -> None:
        for token in re.findall(r"\x1b\[[?0-9;]*[A-Za-z]|.|\n", text, re.S):
            if token == "\n":
                self.row, self.column = self.row + 1, 0
                while len(self.rows) <= self.row:
                    self.rows.append("")
            elif token == "\r":
                self.column = 0
            elif token.startswith("\x1b"):
                self._control(token)
            else:
                line = self.rows[self.row].ljust(self.column)
                self.rows[self.row] = line[: self.column] + token + line[self.column + 1 :]
                self.column += 1

    def _control(self, token: str) -> None:
        if token.endswith("A"):
            self.row = max(0, self.row - int(token[2:-1]))
        elif token.endswith("K"):
            self.rows[self.row] = self.rows[self.row][: self.column]
        elif token.endswith("J"):
            self.rows[self.row] = self.rows[self.row][: self.column]
            del self.rows[self.row + 1 :]
        else:
            assert token.endswith(("m", "h", "l")), token

    @property
    def shown(self) -> list[str]:
        return [row.rstrip() for row in self.rows if row.strip()]


def test_the_next_picture_takes_the_place_of_the_last() -> None:
    frames, terminal = Frames(), Terminal()
    terminal.feed("$ robotd\n")
    terminal.feed(frames.draw("", ["one", "two", "three"], 80))
    terminal.feed(frames.draw("", ["1", "2"], 80))
    assert terminal.shown == ["$ robotd", "1", "2"]


def test_log_lines_scroll_away_above_the_picture() -> None:
    frames, terminal = Frames(), Terminal()
    terminal.feed(frames.draw("", ["a long first line", "two"], 80))
    terminal.feed(frames.draw("log 1\nlog 2\n", ["one", "two"], 80))
    terminal.feed(frames.draw("log 3\n", ["one", "two"], 80))
    assert terminal.shown == ["log 1", "log 2", "log 3", "one", "two"]


@pytest.mark.parametrize(
    ("widths", "columns", "up"),
    [([10, 10], 80, 2), ([80, 10], 80, 2), ([81, 10], 80, 3), ([100, 10, 0], 30, 6), ([], 80, 0)],
)
def test_the_way_up_counts_rows_that_a_narrower_terminal_wrapped(widths: list[int], columns: int, up: int) -> None:
    frames = Frames()
    frames.draw("", ["x" * width for width in widths], 200)
    text = frames.draw("", ["new"], columns)
    assert (f"\x1b[{up}A" in text) if up else ("A" not in text.replace("\x1b[J", ""))


def test_every_frame_gives_the_cursor_back() -> None:
    text = Frames().draw("", ["one"], 80, first_colour="\x1b[1m")
    assert text.index("\x1b[?25l") < text.index("one") < text.index("\x1b[?25h")
    assert "\x1b[1mone\x1b[0m" in text


def test_screen_shows_the_newest_state_and_all_log_lines() -> None:
    terminal = Terminal()
    screen = Screen(lambda data: terminal.feed(data.decode()), lambda: (80, 24), colour=False)
    for i in range(50):
        screen.update(state(reason=f"reason {i}"))
        screen.put(f"log {i}")
    screen.close(WAIT_S)
    assert terminal.shown[:50] == [f"log {i}" for i in range(50)]
    assert terminal.shown[51] == "standing still: reason 49"


def test_a_stopped_terminal_never_holds_up_the_robot() -> None:
    reached, release, out = threading.Event(), threading.Event(), []

    def write(data: bytes) -> None:
        reached.set()
        assert release.wait(WAIT_S)
        out.append(data.decode())

    screen = Screen(write, lambda: (80, 24))
    screen.update(state(reason="first"))
    assert reached.wait(WAIT_S)
    for i in range(1000):
        screen.update(state(reason=f"reason {i}"))
    release.set()
    screen.close(WAIT_S)
    assert "first" in out[0]
    assert "reason 999" in out[-1]
    assert len(out) <= 3


class Tty(io.StringIO):
    def __init__(self, is_tty: bool) -> None:
        super().__init__()
        self._is_tty = is_tty

    def isatty(self) -> bool:
        return self._is_tty


@pytest.mark.parametrize(
    ("out", "err", "headless", "as_json", "term", "picture"),
    [
        (True, True, False, False, "xterm-256color", True),
        (True, True, True, False, "xterm", False),
        (False, True, False, False, "xterm", False),
        (True, True, False, False, "dumb", False),
        (True, True, False, False, None, False),
        (True, True, False, True, "xterm", False),
        (True, False, False, True, "xterm", True),
    ],
)
def test_when_a_picture_is_drawn(
    out: bool, err: bool, headless: bool, as_json: bool, term: str | None, picture: bool
) -> None:
    environ = {"TERM": term} if term is not None else {}
    assert wants_picture(Tty(out), Tty(err), headless=headless, as_json=as_json, environ=environ) is picture


def test_change_log(caplog: pytest.LogCaptureFixture) -> None:
    view = ChangeLog()
    moving = Status(0, Mode.AUTO, "", (), (), (), Drive(0.1), "wander", (), 0.0, 0, False)
    with caplog.at_level(logging.INFO, "robotd"):
        for status in (state(), moving, moving):
            view.update(status)
    assert caplog.messages == ["driving: wander"]


def _read_all(descriptor: int) -> str:
    data = b""
    while True:
        try:
            chunk = os.read(descriptor, 65536)
        except OSError as error:
            assert error.errno == errno.EIO  # the other end of a pty closed
            break
        if not chunk:
            break
        data += chunk
    return data.decode()


@pytest.mark.parametrize("options", [{}, {"headless": True}], ids=["picture", "headless"])
def test_on_a_real_pty(options: dict[str, Any]) -> None:
    ours, theirs = pty.openpty()
    with os.fdopen(theirs, "w") as terminal:
        with Console(stdout=terminal, stderr=terminal, environ={"TERM": "xterm"}, **options) as console:
            console.update(state())
            logging.getLogger("robotd").info("a log line")
        drawn: list[str] = []
        reader = threading.Thread(target=lambda: drawn.append(_read_all(ours)))
        reader.start()
    reader.join(WAIT_S)
    os.close(ours)
    screen = Terminal()
    screen.feed(drawn[0].replace("\r\n", "\n"))
    assert screen.shown[0].endswith("info    a log line")
    if options:
        assert len(screen.shown) == 1
        assert "\x1b" not in drawn[0]
    else:
        assert screen.shown[2] == "standing still: not armed yet"
        assert drawn[0].rindex("\x1b[?25h") > drawn[0].rindex("\x1b[?25l")
    assert not logging.getLogger("robotd").isEnabledFor(logging.DEBUG)


def test_json_log_beside_a_picture_goes_to_its_own_file(tmp_path: Any) -> None:
    ours, theirs = pty.openpty()
    log = tmp_path / "log.json"
    with (
        os.fdopen(theirs, "w") as terminal,
        log.open("w") as file,
        Console(stdout=terminal, stderr=file, as_json=True, environ={"TERM": "xterm"}) as console,
    ):
        console.update(state())
        logging.getLogger("robotd").info("a log line")
    os.close(ours)
    assert '"message": "a log line"' in log.read_text()
    assert "\x1b" not in log.read_text()


def test_write_all_finishes_what_a_pipe_takes_in_parts() -> None:
    reading, writing = os.pipe()
    data = bytes(range(256)) * 1024  # four times what a pipe holds
    got: list[bytes] = []

    def read() -> None:
        while chunk := os.read(reading, 4096):
            got.append(chunk)

    reader = threading.Thread(target=read)
    reader.start()
    write_all(writing)(data)
    os.close(writing)
    reader.join(WAIT_S)
    os.close(reading)
    assert b"".join(got) == data
