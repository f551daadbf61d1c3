"""What a camera saw of the line on the floor: the message between the perceptor `floor_line` and those who steer by it.

Two measures stand side by side. Picture shares need no calibration: `x` runs from -1 (left edge) over 0 (middle) to 1
(right edge), rows from 0 (top) to 1 (bottom). Metres and radians are in the base frame (x forward, y left) and need the
camera's mount and lens; they are nan where those are unknown. `nan` always means not seen or not known, never zero.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from robotd import Message


@dataclass(frozen=True, slots=True)
class RoiLine:
    """The line in one region of interest, taken at the region's middle row.

    top, bottom: rows of the region. x: middle of the line. width: the line's width as a share of the picture's.
    confidence: 0 (not seen) to 1 (seen in every row, at full contrast). ahead_m, left_m: the same place on the floor.
    """

    top: float
    bottom: float
    x: float = math.nan
    width: float = math.nan
    confidence: float = 0.0
    ahead_m: float = math.nan
    left_m: float = math.nan

    @property
    def is_seen(self) -> bool:
        """Whether the region shows the line."""
        return not math.isnan(self.x)


@dataclass(frozen=True, slots=True)
class CrossingBar:
    """A bar that was seen to cross the line or to branch from it: positive evidence, never a guess from an absence.

    x, row: where the bar's middle meets the line. ahead_m: distance of that place from the base's origin.
    left, right: arms that were seen. straight: the line was seen beyond the bar (True), floor was seen there (False),
    or the picture does not tell (None). left_end, right_end: (x, row) of the outermost part seen of each arm.
    """

    x: float
    row: float
    left: bool
    right: bool
    straight: bool | None
    confidence: float
    ahead_m: float = math.nan
    left_end: tuple[float, float] = (math.nan, math.nan)
    right_end: tuple[float, float] = (math.nan, math.nan)

    @property
    def exits(self) -> str:
        """The exits for people, such as 'left, right'."""
        seen = [
            name for name, there in (("left", self.left), ("straight", self.straight), ("right", self.right)) if there
        ]
        return ", ".join(seen)


@dataclass(frozen=True, slots=True)
class LineEnd:
    """The line was seen to end, with plain floor beyond and no bar. x, row: the last of it; ahead_m: its distance."""

    x: float
    row: float
    ahead_m: float = math.nan


@dataclass(frozen=True, slots=True)
class LineSeen(Message):
    """All that one picture says about the line; the stamp is the picture's.

    near, far: EXECUTION_ROI and LOOKAHEAD_ROI. heading_rad: direction of the line between the two, counter-clockwise
    from straight ahead. bar: the nearest crossing bar. end: the line's end. bends: the line turns off to the left (1)
    or right (-1) so sharply that it leaves the traced rows, without being a crossing.
    threshold, floor_grey, tape_grey: grey levels at the line (threshold: darker is tape). reason: one sentence.
    """

    near: RoiLine
    far: RoiLine
    heading_rad: float = math.nan
    bar: CrossingBar | None = None
    end: LineEnd | None = None
    bends: int = 0
    threshold: float = math.nan
    floor_grey: float = math.nan
    tape_grey: float = math.nan
    width_px: int = 0
    height_px: int = 0
    source: str = ""
    reason: str = ""
