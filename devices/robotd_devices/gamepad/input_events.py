"""Linux's input events as bytes, and what they say of a gamepad: a parser without input or output.

Sources: include/uapi/linux/input.h and input-event-codes.h; Documentation/input/event-codes.rst and gamepad.rst of the
Linux kernel. An event is 24 bytes on a 64-bit system, 16 on a 32-bit one; the native layout is what the kernel sends.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from typing import NamedTuple

EVENT = struct.Struct("@llHHi")
"""Seconds, microseconds, type, code, value."""

EV_SYN, EV_KEY, EV_ABS = 0x00, 0x01, 0x03
SYN_REPORT, SYN_DROPPED = 0, 3

AXES: Mapping[int, str] = {
    0x00: "x", 0x01: "y", 0x02: "z", 0x03: "rx", 0x04: "ry", 0x05: "rz",
    0x06: "throttle", 0x07: "rudder", 0x08: "wheel", 0x09: "gas", 0x0A: "brake",
    0x10: "hat0x", 0x11: "hat0y",
}  # fmt: skip
BUTTONS: Mapping[int, str] = {
    0x130: "south", 0x131: "east", 0x132: "c", 0x133: "north", 0x134: "west", 0x135: "btn_z",
    0x136: "tl", 0x137: "tr", 0x138: "tl2", 0x139: "tr2", 0x13A: "select", 0x13B: "start",
    0x13C: "mode", 0x13D: "thumbl", 0x13E: "thumbr",
    0x220: "dpad_up", 0x221: "dpad_down", 0x222: "dpad_left", 0x223: "dpad_right",
}  # fmt: skip


def axis_name(code: int) -> str:
    return AXES.get(code, f"abs_{code:02x}")


def button_name(code: int) -> str:
    """The kernel's name without BTN_; `btn_120` and the like for what has no fixed place on a gamepad."""
    return BUTTONS.get(code, f"btn_{code:x}")


class AxisRange(NamedTuple):
    """What the kernel says of an axis: the ends, the flat place about the middle, and where it is at opening."""

    low: int
    high: int
    flat: int = 0
    value: int = 0


TRIGGERS = frozenset({"z", "rz", "gas", "brake", "throttle"})
"""Axes that may rest at their lower end; on some pads these are a second stick, which rests in the middle."""
STICK = AxisRange(-32768, 32767, 128)
USUAL: Mapping[str, AxisRange] = {
    "z": AxisRange(0, 255), "rz": AxisRange(0, 255), "gas": AxisRange(0, 255), "brake": AxisRange(0, 255),
    "hat0x": AxisRange(-1, 1), "hat0y": AxisRange(-1, 1),
}  # fmt: skip
"""What is taken for the range of an axis where the kernel cannot be asked: an Xbox pad's."""


def position(name: str, value: int, axis: AxisRange, dead_zone: float) -> float:
    """-1 to 1 about the middle, or 0 to 1 for a trigger; 0 within the dead zone, from whose edge it rises anew."""
    span = axis.high - axis.low
    if span <= 0:
        return 0.0
    if name in TRIGGERS and axis.value < axis.low + span / 4.0:
        offset, zone = (value - axis.low) / span, dead_zone
    else:
        half = span / 2.0
        offset, zone = (value - axis.low - half) / half, max(dead_zone, axis.flat / half)
    moved = abs(offset) - zone
    if moved <= 0.0:
        return 0.0
    return math.copysign(min(1.0, moved / (1.0 - zone)), offset)


class PadState:
    """Bytes in, state out, however they are cut. A report counts as a whole, when its SYN_REPORT has come.

    After SYN_DROPPED (the kernel's queue ran over) the rest of that report is skipped, every button counts as released
    and every axis as at rest, and `must_ask` is set until somebody asks the kernel and calls `asked`.
    """

    def __init__(self) -> None:
        self.values: dict[str, int] = {}
        """Axes that moved, as the kernel numbers them."""
        self.held: set[str] = set()
        self.presses: dict[str, int] = {}
        self.reports = 0
        self.must_ask = False
        self._rest = b""
        self._pending: list[tuple[int, int, int]] = []
        self._skipping = False

    def feed(self, data: bytes) -> int:
        """Take bytes as they come; returns the number of reports that they completed."""
        data = self._rest + data
        whole = len(data) - len(data) % EVENT.size
        self._rest = data[whole:]
        before = self.reports
        for _, _, kind, code, value in EVENT.iter_unpack(data[:whole]):
            if kind == EV_SYN:
                self._syn(code)
            elif kind in (EV_KEY, EV_ABS) and not self._skipping:
                self._pending.append((kind, code, value))
        return self.reports - before

    def asked(self, values: Mapping[str, int]) -> None:
        """The axes as they are now. Buttons stay released: a dead-man's button must be pressed anew."""
        self.values = dict(values)
        self.must_ask = False

    def restart(self, values: Mapping[str, int]) -> None:
        """The pad was opened anew; what was pressed before stays counted."""
        self.held.clear()
        self._pending.clear()
        self._rest, self._skipping = b"", False
        self.asked(values)

    def _syn(self, code: int) -> None:
        if code == SYN_DROPPED:
            self._skipping = True
            self._pending.clear()
            self.held.clear()
            self.values.clear()
            self.must_ask = True
        elif code == SYN_REPORT:
            for kind, number, value in self._pending:
                self._apply(kind, number, value)
            self._pending.clear()
            self._skipping = False
            self.reports += 1

    def _apply(self, kind: int, code: int, value: int) -> None:
        if kind == EV_ABS:
            self.values[axis_name(code)] = value
            return
        name = button_name(code)
        if value == 0:
            self.held.discard(name)
        elif value == 1:
            self.held.add(name)
            self.presses[name] = self.presses.get(name, 0) + 1
