"""One look at one picture: from pixels to the line, its crossing bar and its end, in shares of the picture. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robotd.world.messages import Bytes2D
from robotd_plugins.perception.floor_line.bar import STEP, Bar, Scene, find_bar
from robotd_plugins.perception.floor_line.config import FloorLineConfig
from robotd_plugins.perception.floor_line.runs import runs_of
from robotd_plugins.perception.floor_line.threshold import (
    FULL,
    Split,
    floor_along,
    histogram,
    shares,
    split,
    value_rows,
    without_glints,
)
from robotd_plugins.perception.floor_line.trace import GAP_ROWS, Trace, find_line, fit

COLUMNS = 160
ROWS = 56
_WINDOW_ROWS = 21
_END_MARGIN_ROWS = 3
_END_LENGTH_MIN = 8
_END_SIDES = 1.5


@dataclass(frozen=True, slots=True)
class Grid:
    """How cells and picture correspond: `rows` of the picture that were taken, cells across, size of the picture."""

    rows: np.ndarray[tuple[int], np.dtype[np.intp]]
    width: int
    width_px: int
    height_px: int

    @classmethod
    def of(cls, width_px: int, height_px: int, look_from_share: float) -> Grid:
        """The grid for pictures of one size. Raises ValueError for pictures too small to see anything on."""
        first = math.ceil(look_from_share * height_px)
        if width_px < 32 or height_px - first < 12:
            raise ValueError(f"a picture of {width_px} x {height_px} is too small to find a line on")
        taken = np.linspace(first, height_px - 1, min(ROWS, height_px - first)).round().astype(np.intp)
        return cls(taken, min(COLUMNS, width_px), width_px, height_px)

    def x(self, column: float) -> float:
        """Column of the grid (0: left edge) to picture share -1..1."""
        return 2.0 * column / self.width - 1.0

    def column(self, x: float) -> float:
        """Picture share -1..1 to column of the grid."""
        return (x + 1.0) / 2.0 * self.width

    def row_share(self, row: float) -> float:
        """Row of the grid (0: middle of the first one) to picture share 0..1."""
        first, last = float(self.rows[0]), float(self.rows[-1])
        return (first + row * (last - first) / (len(self.rows) - 1) + 0.5) / self.height_px

    def row(self, share: float) -> float:
        """Picture share 0..1 to row of the grid."""
        first, last = float(self.rows[0]), float(self.rows[-1])
        return (share * self.height_px - 0.5 - first) * (len(self.rows) - 1) / (last - first)

    @property
    def tall(self) -> float:
        """Height over width of a cell, in pixels."""
        return float(self.rows[-1] - self.rows[0]) / (len(self.rows) - 1) * self.width / self.width_px


@dataclass(frozen=True, slots=True)
class Look:
    """What one picture shows, in cells of its grid. `reason`: one sentence for people."""

    split: Split
    floor_grey: float
    reason: str
    trace: Trace | None = None
    bar: Bar | None = None
    end: tuple[float, float] | None = None
    bends: int = 0


def look(bgr: Bytes2D, grid: Grid, config: FloorLineConfig, expected_x: float | None) -> Look:
    """Find the line in a picture uint8 (height, width, 3).

    expected_x: where the line is expected at the bottom (-1..1), the middle of the focus mask; None: anywhere.
    """
    value = without_glints(value_rows(bgr, grid.rows, grid.width))
    across = round((config.line_width_max_share + 0.05) * grid.width)
    floor = floor_along(value, across, min(_WINDOW_ROWS, len(grid.rows) // 2))
    floor_grey = float(np.median(floor[::4, ::4]))
    if floor_grey < config.floor_grey_min:
        return Look(Split(math.nan, math.nan, math.nan), floor_grey, "too dark to see a line")
    share = shares(value, floor)
    found = split(histogram(share), config.ratio_min, config.ratio_max)
    if found.why:
        return Look(found, floor_grey, f"no line: {found.why}")
    dark = share < round(found.ratio * FULL)
    if config.line_v_max is not None:
        dark &= value <= config.line_v_max
    expected = grid.column(expected_x if expected_x is not None else 0.0)
    half = config.roi_center_width_share * grid.width / 2.0 if expected_x is not None else float(grid.width)
    trace = find_line(
        runs_of(dark),
        grid.width,
        config.line_width_min_share * grid.width,
        config.line_width_max_share * grid.width,
        (expected - half, expected + half),
        expected,
    )
    if trace is None:
        return Look(found, floor_grey, "no line: nothing dark that is shaped like one")
    scene = Scene(
        value,
        share,
        runs_of(dark[:, ::STEP].T) if trace.bars else [],
        grid.tall,
        config.bar_arm_share * grid.width,
        grid.row(config.bar_lowest_share),
    )
    bar, why = find_bar(trace, scene)
    end = _end(trace, dark) if bar is None else None
    bends = _bends(trace, grid.width) if bar is None and end is None else 0
    return Look(found, floor_grey, _sentence(bar, why, end, bends), trace, bar, end, bends)


def _end(trace: Trace, dark: NDArray[np.bool_]) -> tuple[float, float] | None:
    """(column, row) of the line's end: enough of it was seen, and floor lies beyond it and well to both sides."""
    last = trace.pieces[-1]
    if trace.bars or trace.clipped or trace.empty < GAP_ROWS or len(trace.pieces) < _END_LENGTH_MIN:
        return None
    if last.row < _END_MARGIN_ROWS + GAP_ROWS:
        return None
    centre, _ = fit(trace.pieces[-_END_LENGTH_MIN:]).at(last.row - 2)
    # glare may split the tape lengthwise: what ends is then only a part of it
    width = _END_SIDES * max(piece.right - piece.left for piece in trace.pieces[-2 * _END_LENGTH_MIN :])
    low, high = max(0, round(centre - width)), round(centre + width) + 1
    if dark[last.row - GAP_ROWS : last.row - 1, low:high].any():
        return None
    return last.centre, float(last.row)


def _bends(trace: Trace, width: int) -> int:
    """1 or -1 where the line leaves the traced rows to the left or right."""
    if trace.clipped:
        return 1 if trace.pieces[-1].centre < width / 2.0 else -1
    if trace.bars and trace.bars[-1][-1].row < trace.pieces[-1].row:
        # it grew too wide to be followed: where most of that lies, it goes
        first = trace.bars[-1][0]
        return 1 if first.left + first.right < 2.0 * trace.pieces[-1].centre else -1
    return 0


def _sentence(bar: Bar | None, why: str, end: tuple[float, float] | None, bends: int) -> str:
    if bar is not None:
        return "a crossing"
    if end is not None:
        return "the line ends"
    said = "the line"
    if bends:
        said = f"the line bends to the {'left' if bends > 0 else 'right'}"
    return f"{said}; no crossing: {why}" if why else said


def line_in(trace: Trace, top: float, bottom: float) -> tuple[float, float, float]:
    """Centre and width in columns at the middle of rows [top, bottom], and the share of rows in which it was seen."""
    inside = [piece for piece in trace.pieces if top <= piece.row <= bottom]
    middle = (top + bottom) / 2.0
    total = max(1.0, math.floor(bottom) - math.ceil(top) + 1.0)
    if inside:
        seen = min(1.0, len(inside) / total)
        if abs(sum(piece.row for piece in inside) / len(inside) - middle) <= (bottom - top) / 4.0:
            return *fit(inside).at(middle), seen
        return math.nan, math.nan, 0.0
    below = [piece for piece in trace.pieces if piece.row > bottom][-6:]
    beyond = [piece for piece in trace.pieces if piece.row < top][:6]
    if len(below) >= 3 and len(beyond) >= 3:
        # a bar covers the whole region: the line is known from both sides of it
        return *fit([*below, *beyond]).at(middle), 0.5
    return math.nan, math.nan, 0.0
