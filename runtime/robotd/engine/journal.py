"""Writes down a run: every input of every turn, and between two inputs what came of the first."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from robotd.engine.record_file import RecordWriter
from robotd.world.messages import CameraFrame

FORMAT = 1
"""Version of what a recording of a run holds; in its header as `format`."""

INPUTS = frozenset(
    ("started", "message", "tick", "timer", "expiry", "offloaded", "request", "opened", "lost"),
)
"""Kinds that begin a turn. What may follow before the next: `perceived`, `command`, and `failed` where a turn broke."""

_NO_PICTURE = np.zeros((0, 0, 3), np.uint8)
_NO_PICTURE.flags.writeable = False


class RunJournal:
    """The `Journal` of a running robot on top of a `RecordWriter`; an entry's sequence is the number of its turn.

    frames: keep the pixels of camera frames, without loss. Otherwise a frame is kept with an empty picture, and a
    replay plays back what the perceptors made of it. Call everything from the loop's thread.
    """

    def __init__(self, writer: RecordWriter, *, frames: bool = False) -> None:
        self.turn = -1
        """The turn that goes on; `started` is turn 0."""
        self._writer = writer
        self._frames = frames

    @property
    def path(self) -> Path:
        return self._writer.path

    @property
    def dropped(self) -> int:
        """Entries that are missing in the file so far."""
        return self._writer.dropped

    @property
    def failure(self) -> OSError | None:
        """What ended the recording before its time, or None."""
        return self._writer.failure

    def note(self, kind: str, ref: str, now_ns: int, payload: object) -> None:
        """One entry; see `robotd.engine.core.Journal`. Never waits on a real loop, never raises."""
        if kind in INPUTS:
            self.turn += 1
        if not self._frames:
            payload = _without_picture(payload)
        if payload is None:
            payload = b""
        # who drove stands inside a command: all commands are one stream
        self._writer.write(kind, self.turn, now_ns, payload, "" if kind == "command" else ref)

    def close(self, timeout_s: float = 2.0) -> bool:
        """Finish the file; True where all of it is written. Blocks: halt the motors before."""
        return self._writer.close(timeout_s)


def _without_picture(payload: object) -> object:
    if isinstance(payload, CameraFrame):
        return replace(payload, bgr=_NO_PICTURE)
    if isinstance(payload, tuple):
        return tuple([_without_picture(item) for item in payload])
    return payload
