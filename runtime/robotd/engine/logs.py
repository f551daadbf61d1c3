"""Log records for people (one line each) or for programs (JSON lines), written by a thread of their own.

The loop that drives the robot must never wait for whoever reads its log: a full pipe, a terminal stopped with Ctrl-S.
So a record is formatted where it arises and handed to a `LineWriter`, which keeps a bounded number of lines and counts
what it had to drop. Importing this module installs nothing; `install` does, and `Installed.remove` undoes it.
"""

from __future__ import annotations

import json
import logging
import re
import threading
import unicodedata
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

REPEAT_WINDOW_S = 5.0
"""The same message is written once in this time; how often it came again follows."""
REPEATS_KEPT = 256
LINES_KEPT = 2000
CLOSE_LIMIT_S = 1.0
OWN = ("robotd", "robotd_plugins", "robotd_devices")
"""Loggers that speak from the start; all others only from WARNING on."""

_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w.]*\d)")


def printable(text: str) -> str:
    """`text` on one line, without anything that moves a cursor: control and format characters become spaces or '?'."""
    if text.isascii() and text.isprintable():
        return text
    return "".join(
        " " if char in "\n\r\t" else "?" if unicodedata.category(char) in ("Cc", "Cf", "Cs", "Zl", "Zp") else char
        for char in text
    )


# -------------------------------------------------------------------------------------------- repeats


class Repeats:
    """Decides which messages are repetitions; a pure function of the times that it is told.

    Two messages are the same when only their numbers differ: "held up for 31 ms" is "held up for 78 ms", while
    "lidar1" is not "lidar2".
    """

    def __init__(self, window_s: float = REPEAT_WINDOW_S, kept: int = REPEATS_KEPT) -> None:
        self._window_s = window_s
        self._kept = kept
        self._seen: dict[tuple[str, int, str], tuple[float, int]] = {}

    def judge(self, source: str, level: int, text: str, now_s: float) -> tuple[bool, int]:
        """(whether to write it, how many like it were left out since the last one that was written)."""
        key = (source, level, _NUMBER.sub("#", text))
        since_s, missed = self._seen.get(key, (-float("inf"), 0))
        if 0.0 <= now_s - since_s < self._window_s:
            self._seen[key] = (since_s, missed + 1)
            return False, 0
        self._seen.pop(key, None)
        self._seen[key] = (now_s, 0)
        if len(self._seen) > self._kept:
            del self._seen[next(iter(self._seen))]
        return True, missed


# ------------------------------------------------------------------------------------------ formatting


def _error_text(record: logging.LogRecord) -> str:
    error = record.exc_info[1] if record.exc_info else None
    return f"{type(error).__name__}: {error}" if error is not None else ""


class TextFormatter(logging.Formatter):
    """`12:31:05.123 warning lidar: unplugged`; a traceback only where `tracebacks` is set."""

    def __init__(self, *, tracebacks: bool = False) -> None:
        super().__init__()
        self.tracebacks = tracebacks

    def format(self, record: logging.LogRecord) -> str:
        time = datetime.fromtimestamp(record.created)
        source = "" if record.name in ("robotd", "root") else f"{record.name}: "
        text = printable(record.getMessage())
        error = _error_text(record)
        if error and not self.tracebacks and str(record.exc_info and record.exc_info[1]) not in text:
            text = f"{text}: {printable(error)}"
        if missed := getattr(record, "repeated", 0):
            text = f"{text} (and {missed} more like it)"
        line = f"{time:%H:%M:%S}.{time.microsecond // 1000:03d} {record.levelname.lower():<7} {source}{text}"
        if self.tracebacks and record.exc_info:
            line = f"{line}\n{self.formatException(record.exc_info)}"
        return line


class JsonFormatter(logging.Formatter):
    """One JSON object a line: time (ISO 8601, UTC), level, logger, message, and error, repeated, traceback if any."""

    def __init__(self, *, tracebacks: bool = False) -> None:
        super().__init__()
        self.tracebacks = tracebacks

    def format(self, record: logging.LogRecord) -> str:
        fields: dict[str, Any] = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
        }
        if error := _error_text(record):
            fields["error"] = error
        if missed := getattr(record, "repeated", 0):
            fields["repeated"] = missed
        if self.tracebacks and record.exc_info:
            fields["traceback"] = self.formatException(record.exc_info)
        return json.dumps(fields, ensure_ascii=False)


# --------------------------------------------------------------------------------------------- writing


class LineWriter:
    """Hands lines to `write` from a thread of its own. `put` never waits; a reader that hangs costs only lines.

    write: takes UTF-8 bytes and may block; an OSError from it ends the writing for good (nobody reads any more).
    """

    def __init__(self, write: Callable[[bytes], object], kept: int = LINES_KEPT) -> None:
        self._write = write
        self._kept = kept
        self._lines: deque[str] = deque()
        self._dropped = 0
        self._wake = threading.Condition()
        self._closing = False
        self._thread = threading.Thread(target=self._run, name="robotd log", daemon=True)
        self._thread.start()

    def put(self, line: str) -> None:
        """Keep one line for writing; the oldest waiting line gives way where too many wait."""
        with self._wake:
            if len(self._lines) >= self._kept:
                self._lines.popleft()
                self._dropped += 1
            self._lines.append(line)
            self._wake.notify()

    def close(self, limit_s: float = CLOSE_LIMIT_S) -> None:
        """Write what waits, for at most `limit_s`; afterwards nothing is written any more."""
        with self._wake:
            self._closing = True
            self._wake.notify()
        self._thread.join(limit_s)

    def _has_work(self) -> bool:
        return bool(self._lines) or self._closing

    def _compose(self, lines: list[str], closing: bool) -> str:
        """What goes out for these lines; a subclass may draw more."""
        return "".join(f"{line}\n" for line in lines)

    def _run(self) -> None:
        while True:
            with self._wake:
                self._wake.wait_for(self._has_work)
                lines, dropped, closing = list(self._lines), self._dropped, self._closing
                self._lines.clear()
                self._dropped = 0
            if dropped:
                lines.insert(0, f"... {dropped} log lines were dropped: nobody read them in time")
            try:
                self._write(self._compose(lines, closing).encode("utf-8", "replace"))
            except OSError:
                return
            if closing:
                return


class LineHandler(logging.Handler):
    """Formats a record where it arises and hands the line on; leaves repetitions out, except of CRITICAL records."""

    def __init__(self, put: Callable[[str], None], window_s: float = REPEAT_WINDOW_S) -> None:
        super().__init__()
        self._put = put
        self._repeats = Repeats(window_s)

    def emit(self, record: logging.LogRecord) -> None:
        try:
            text = record.getMessage()
            if record.levelno < logging.CRITICAL:
                write, missed = self._repeats.judge(record.name, record.levelno, text, record.created)
                if not write:
                    return
                record.repeated = missed
            self._put(self.format(record))
        except Exception as error:
            # a faulty log call must not reach the code that made it, which may be driving; nor may it pass unseen
            self._put(f"faulty log call at {record.pathname}:{record.lineno}: {error}")


# ---------------------------------------------------------------------------------------- installation


def levels(verbosity: int) -> tuple[int, int]:
    """(level of robotd's own loggers, level of all others) for -q (-1), nothing (0), -v (1), -vv (2)."""
    table = {
        -1: (logging.WARNING, logging.ERROR),
        0: (logging.INFO, logging.WARNING),
        1: (logging.DEBUG, logging.INFO),
        2: (logging.DEBUG, logging.DEBUG),
    }
    return table[max(-1, min(2, verbosity))]


@dataclass(frozen=True, slots=True)
class Installed:
    """The handler that `install` added, and the levels that it found."""

    handler: logging.Handler
    before: dict[str, int]

    def remove(self) -> None:
        """Undo `install`."""
        logging.captureWarnings(False)
        logging.getLogger().removeHandler(self.handler)
        for name, level in self.before.items():
            logging.getLogger(name).setLevel(level)


def install(put: Callable[[str], None], *, verbosity: int = 0, as_json: bool = False) -> Installed:
    """Send every log record of this process to `put`, one line each. Tracebacks from verbosity 2 on."""
    handler = LineHandler(put)
    formatter = JsonFormatter if as_json else TextFormatter
    handler.setFormatter(formatter(tracebacks=verbosity >= 2))
    own, others = levels(verbosity)
    before = {name: logging.getLogger(name).level for name in ("", *OWN)}
    root = logging.getLogger()
    root.addHandler(handler)
    root.setLevel(others)
    for name in OWN:
        logging.getLogger(name).setLevel(own)
    logging.captureWarnings(True)
    return Installed(handler, before)
