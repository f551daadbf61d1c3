"""What a person who started robotd sees: one live picture with the log above it, or the log alone.

All writing happens in one thread (`LineWriter`), so that a terminal that takes nothing (Ctrl-S, a full pipe) never
holds up the robot. Every frame is complete in itself: it hides the cursor, draws and shows it again, so that a process
that dies between two frames leaves a usable terminal.
"""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Callable, Mapping
from types import TracebackType
from typing import Protocol, Self, TextIO

from robotd.engine.logs import Installed, LineWriter, install
from robotd.engine.status import Status
from robotd.engine.status_view import Scale, changes, render, width_of
from robotd.world.messages import Mode

log = logging.getLogger("robotd")

_HIDE, _SHOW = "\x1b[?25l", "\x1b[?25h"
_BEGIN, _END = "\x1b[?2026h", "\x1b[?2026l"  # one synchronised update, where the terminal knows it
_TO_END_OF_LINE, _TO_END_OF_SCREEN = "\x1b[K", "\x1b[J"
_COLOURS: Mapping[Mode, str] = {
    Mode.ESTOP: "\x1b[1;97;41m",
    Mode.DISARMED: "\x1b[1;33m",
    Mode.MANUAL: "\x1b[1;36m",
    Mode.PAUSED: "\x1b[1;33m",
    Mode.AUTO: "\x1b[1;32m",
}


class View(Protocol):
    """Who is told about the robot's state, about five times a second."""

    def update(self, status: Status) -> None:
        """Take one state; never blocks, never raises."""
        ...


Size = Callable[[], tuple[int, int]]


class Frames:
    """Turns pictures into bytes for a terminal: moves up over the last picture, draws the next. Pure text."""

    def __init__(self) -> None:
        self._widths: list[int] = []
        self._columns = 0

    def draw(self, above: str, lines: list[str], columns: int, *, first_colour: str = "") -> str:
        """Text that replaces the last picture by `above` (whole log lines, scrolling away) and then `lines`.

        A terminal that became narrower has wrapped the old lines: the way up counts the rows that they take now.
        """
        rows = sum(max(1, -(-width // max(1, columns))) for width in self._widths)
        up = f"\x1b[{rows}A" if rows else ""
        if columns != self._columns:
            up += _TO_END_OF_SCREEN  # what a resize left of the last picture
            self._columns = columns
        # a log line is cleared behind its text, and all below it before anything is drawn there
        cleared = above.replace("\n", f"{_TO_END_OF_LINE}\n")
        painted = [f"{first_colour}{line}\x1b[0m" if first_colour and i == 0 else line for i, line in enumerate(lines)]
        body = "".join(f"{line}{_TO_END_OF_LINE}\n" for line in painted)
        self._widths = [width_of(line) for line in lines]
        return f"{_BEGIN}{_HIDE}\r{up}{cleared}{body}{_TO_END_OF_SCREEN}{_SHOW}{_END}"


class Screen(LineWriter):
    """A terminal with one live picture at its lower end; log lines scroll away above it. Only the newest state counts.

    write: takes bytes and may block. size: (columns, rows) of the terminal now.
    """

    def __init__(
        self, write: Callable[[bytes], object], size: Size, *, scale: Scale | None = None, colour: bool = True
    ) -> None:
        self._size = size
        self._scale = scale
        self._colour = colour
        self._newest: Status | None = None
        self._fresh = False
        self._since_ns: int | None = None
        self._frames = Frames()
        super().__init__(write)

    def update(self, status: Status) -> None:
        """Show this state as soon as the terminal takes it; a state that never got its turn is forgotten."""
        with self._wake:
            if self._since_ns is None:
                self._since_ns = status.now_ns
            self._newest, self._fresh = status, True
            self._wake.notify()

    def _has_work(self) -> bool:
        return self._fresh or super()._has_work()

    def _compose(self, lines: list[str], closing: bool) -> str:
        with self._wake:
            status, since_ns, self._fresh = self._newest, self._since_ns or 0, False
        text = super()._compose(lines, closing)
        if status is None:
            return text
        columns, rows = self._size()
        # one column and one row stay free: a full last column wraps on some terminals, a full last row scrolls
        picture = render(status, columns - 1, rows - 1, scale=self._scale, since_ns=since_ns)
        colour = _COLOURS[status.mode] if self._colour else ""
        return self._frames.draw(text, picture, columns, first_colour=colour)


class ChangeLog:
    """The view where there is no terminal: one log line for each change."""

    def __init__(self) -> None:
        self._before: Status | None = None

    def update(self, status: Status) -> None:
        """Log what changed since the last state."""
        for sentence in changes(self._before, status):
            log.info("%s", sentence)
        self._before = status


# --------------------------------------------------------------------------------------------- set-up


def wants_picture(stdout: TextIO, stderr: TextIO, *, headless: bool, as_json: bool, environ: Mapping[str, str]) -> bool:
    """Whether a live picture is drawn: on a capable terminal that nothing else for programs is written to."""
    if headless or not stdout.isatty() or environ.get("TERM", "dumb") == "dumb":
        return False
    return not (as_json and stderr.isatty())


def write_all(descriptor: int) -> Callable[[bytes], None]:
    """A `write` for `LineWriter` past Python's buffers, so that a stuck reader cannot hold the exit up either."""

    def write(data: bytes) -> None:
        while data:
            data = data[os.write(descriptor, data) :]

    return write


def _put(stream: TextIO, text: str) -> None:
    stream.write(text)
    stream.flush()


def write_to(stream: TextIO) -> Callable[[bytes], None]:
    """`write_all` to the stream's descriptor, or through the stream itself where it has none."""
    try:
        return write_all(stream.fileno())
    except (OSError, ValueError):
        return lambda data: _put(stream, data.decode())


def _size_of(descriptor: int) -> Size:
    def size() -> tuple[int, int]:
        try:
            columns, rows = os.get_terminal_size(descriptor)
        except OSError:
            columns = rows = 0
        return columns or 80, rows or 24

    return size


class Console:
    """The log and, on a terminal, the picture, from entering to leaving: `with Console(...) as console`."""

    def __init__(
        self,
        *,
        headless: bool = False,
        verbosity: int = 0,
        as_json: bool = False,
        scale: Scale | None = None,
        stdout: TextIO | None = None,
        stderr: TextIO | None = None,
        environ: Mapping[str, str] | None = None,
    ) -> None:
        out = stdout if stdout is not None else sys.stdout
        err = stderr if stderr is not None else sys.stderr
        env = environ if environ is not None else os.environ
        self._verbosity = verbosity
        self._as_json = as_json
        self._writers: list[LineWriter] = []
        self._installed: Installed | None = None
        self.view: View
        if wants_picture(out, err, headless=headless, as_json=as_json, environ=env):
            out.flush()
            screen = Screen(
                write_all(out.fileno()), _size_of(out.fileno()), scale=scale, colour=not env.get("NO_COLOR")
            )
            self.view = screen
            self._writers.append(screen)
        else:
            self.view = ChangeLog()
        if self._writers and err.isatty():
            self._log = self._writers[0]
        else:
            err.flush()
            self._log = LineWriter(write_to(err))
            self._writers.append(self._log)

    def update(self, status: Status) -> None:
        """Pass a state to the view."""
        self.view.update(status)

    def __enter__(self) -> Self:
        self._installed = install(self._log.put, verbosity=self._verbosity, as_json=self._as_json)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._installed is not None:
            self._installed.remove()
        for writer in self._writers:
            writer.close()
