"""The text commands of ros_arduino_bridge's firmware, as a sans-IO codec.

A command is a letter, blanks, at most two arguments, and CR (a line feed does not end it). Every one is answered by a
line that ends in CR LF: `OK`, numbers, or `Invalid Command`. There is no checksum.

Source: hbrobotics/ros_arduino_bridge (BSD), ROSArduinoBridge.ino and commands.h.
"""

from __future__ import annotations

from collections.abc import Sequence

END = b"\r"
AUTO_STOP_MS = 2000
"""The firmware stops the motors this long after the last `m` command."""
FRAMES_HZ = 30.0
"""How often its PID runs; speeds are encoder counts a frame."""
LONGEST_LINE = 128


def motors(left: int, right: int) -> bytes:
    """Turn at so many counts a frame."""
    return b"m %d %d\r" % (left, right)


def encoders() -> bytes:
    """How far have the wheels turned?"""
    return b"e\r"


def gains(kp: int, kd: int, ki: int, ko: int) -> bytes:
    """Set the PID's gains, until the board restarts."""
    return b"u %d:%d:%d:%d\r" % (kp, kd, ki, ko)


STOP = END + motors(0, 0)
"""The CR ends a command that was cut in two, as it is; what it then says holds only until the stop right behind it."""


class LineReader:
    """Cuts what the board sends into lines, without their ends."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> list[bytes]:
        """The lines that these bytes complete."""
        *lines, rest = (self._rest + data).split(b"\n")
        self._rest = rest[-LONGEST_LINE:]
        return [line.rstrip(b"\r") for line in lines]


def counts_of(line: bytes) -> tuple[int, int] | None:
    """Left and right count of an answer to `e`; None for any other line."""
    words: Sequence[bytes] = line.split()
    if len(words) != 2 or not all(word.removeprefix(b"-").isdigit() and len(word) <= 11 for word in words):
        return None
    return int(words[0]), int(words[1])
