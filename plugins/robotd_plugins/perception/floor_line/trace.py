"""Follow the line upwards through a picture: from the robot's nose, over bars if there are any, to where it ends.

Everything is in cells of the grid that `look` makes of the picture: columns from the left edge, rows from the top.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from robotd_plugins.perception.floor_line.runs import Run, overlapping

GAP_ROWS = 4
"""So many rows of something else than the line end it."""
_WIDE = 1.35  # a run wider than this times the line is something that lies over it
_BAR_ROWS_SHARE = 0.65  # of all rows: more of that, and it is no bar
_SLOPE_ROWS = 10  # last rows that tell the direction
_STEADY = 0.7  # how much of the width so far each row keeps

# where a line may begin, and what makes it one
_SEED_ROWS_SHARE = 0.7
_SEED_STEP = 2
_SEEDS = 10
_LENGTH_MIN = 6
_SLANT_MAX = 2.2  # columns a row: a bar's arm before the robot's nose is flatter
_ENOUGH_SHARE = 0.5  # of the rows above its beginning: no better line is looked for
_CUT_OFF_SHARE = 0.3  # of all rows, off the score of a line that the picture's edge cuts


class Piece(NamedTuple):
    """Dark columns [left, right) of one row."""

    row: int
    left: int
    right: int

    @property
    def centre(self) -> float:
        """Middle, in columns (0 is the left edge of the first one)."""
        return (self.left + self.right) / 2.0


class Trace(NamedTuple):
    """The line from the bottom up.

    pieces: the line, row by row, without the rows of `bars`: stretches in which something wide lies over it, each from
    its lowest row up. empty: rows of something else after the last of it. clipped: it leaves the picture by a side.
    """

    pieces: list[Piece]
    bars: list[list[Piece]]
    empty: int
    clipped: bool


def find_line(
    runs: list[list[Run]], width: int, narrowest: float, widest: float, focus: tuple[float, float], expected: float
) -> Trace | None:
    """The best line that begins in the lower part of the grid.

    narrowest, widest: bounds for its width in columns where it begins. focus: columns in which it may begin.
    expected: column where it should be; of two lines of one length the nearer one is taken.
    """
    best, best_score, tried = None, -math.inf, 0
    for row in range(len(runs) - 1, int(len(runs) * (1.0 - _SEED_ROWS_SHARE)), -_SEED_STEP):
        for left, right in runs[row]:
            centre = (left + right) / 2.0
            if not (narrowest <= right - left <= widest and focus[0] <= centre <= focus[1]):
                continue
            if best is not None and (row, left, right) in best.pieces:
                continue
            trace = follow(runs, width, Piece(row, left, right))
            tried += 1
            score = len(trace.pieces) - abs(centre - expected) * len(runs) / width
            if left == 0 or right == width:
                score -= _CUT_OFF_SHARE * len(runs)
            if _is_line(trace) and score > best_score:
                best, best_score = trace, score
        if tried >= _SEEDS or (best is not None and len(best.pieces) >= _ENOUGH_SHARE * (row + 1)):
            break
    return best


def _is_line(trace: Trace) -> bool:
    """Whether it is long enough, and leads away from the robot: the arm of a bar before its nose lies across."""
    if len(trace.pieces) < _LENGTH_MIN:
        return False
    first, later = trace.pieces[0], trace.pieces[_LENGTH_MIN - 1]
    return abs(later.centre - first.centre) <= _SLANT_MAX * (first.row - later.row)


def follow(runs: list[list[Run]], width: int, first: Piece) -> Trace:
    """The line upwards from `first`: each row's run must lie where the last rows point to, and be as wide."""
    pieces = [first]
    bars: list[list[Piece]] = []
    centres, bar_rows, empty, clipped = [first.centre], 0, 0, False
    steady = float(first.right - first.left)
    in_bar = False
    for row in range(first.row - 1, -1, -1):
        last_row = pieces[-1].row
        back = max(0, len(pieces) - _SLOPE_ROWS)
        rows = last_row - pieces[back].row
        centre = centres[-1]
        if rows:
            centre += (centre - centres[back]) / rows * (row - last_row)
        if not 0.0 <= centre < width:
            clipped = True
            break
        half = steady / 2.0
        found = overlapping(runs[row], centre - half, centre + half)
        if found is None:
            empty += 1
            if empty >= GAP_ROWS:
                break
            continue
        empty = 0
        left, right = found
        if right - left > _WIDE * steady + 2.0:
            bar_rows += 1
            if bar_rows > _BAR_ROWS_SHARE * len(runs):
                break
            if not in_bar:
                bars.append([])
            in_bar = True
            bars[-1].append(Piece(row, left, right))
            continue
        in_bar = False
        clipped = left == 0 or right == width
        pieces.append(Piece(row, left, right))
        centres.append((left + right) / 2.0)
        steady += (1.0 - _STEADY) * (right - left - steady)
    return Trace(pieces, bars, empty, clipped)


class Band(NamedTuple):
    """A straight band: centre and width in columns at `row`, and what they grow by for each row further down."""

    row: float
    centre: float
    width: float
    slope: float = 0.0
    widening: float = 0.0

    def at(self, row: float) -> tuple[float, float]:
        """Centre and width at a row; the width is at least one column."""
        down = row - self.row
        return self.centre + self.slope * down, max(self.width + self.widening * down, 1.0)


def fit(pieces: Sequence[Piece]) -> Band:
    """The straight band through at least one piece, by least squares."""
    count = len(pieces)
    rows, lefts, rights = zip(*pieces, strict=True)
    row, left, right = sum(rows) / count, sum(lefts) / count, sum(rights) / count
    spread = left_slope = right_slope = 0.0
    for at, a, b in pieces:
        off = at - row
        spread += off * off
        left_slope += off * a
        right_slope += off * b
    centre, width = (left + right) / 2.0, right - left
    if spread == 0.0:
        return Band(row, centre, width)
    return Band(row, centre, width, (left_slope + right_slope) / 2.0 / spread, (right_slope - left_slope) / spread)
