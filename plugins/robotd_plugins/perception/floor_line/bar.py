"""Positive evidence for a crossing: arms of tape that leave the line's sides, seen along their length.

Something wide over the line is only a candidate. An arm counts when it can be followed column by column for a stretch,
keeps a tape's thickness, has floor above and below, and is as dark as the line. A shadow over the line fails one of
two ways: wide ones are part of the floor's own brightness, and where a narrow one meets the tape both darken, while
tape on tape does not.
"""

from __future__ import annotations

from typing import NamedTuple

from robotd.world.messages import Bytes2D
from robotd_plugins.perception.floor_line.runs import Run, overlapping
from robotd_plugins.perception.floor_line.threshold import FULL
from robotd_plugins.perception.floor_line.trace import GAP_ROWS, Band, Piece, Trace, fit

STEP = 2
"""Every so many columns of the grid are looked at."""

# an arm, in terms of the line's width where the arm leaves it (cells made square)
_THIN, _THICK = 0.12, 1.3
_GROWS = 1.6  # no column is thicker than this times the first one
_TAPER = 0.4  # its last third is at least this times as thick as its first: shadows have corners
_STEEP = 0.7  # rows a column
_FLOOR_BESIDE_SHARE = 0.7  # of its columns show floor above and below
_AS_DARK = 0.68  # times the line's darkness; real glossy arms have 0.71 and more, hard shadows 0.62 and less

_DARKENED = 0.80  # the line under a shadow is darker than this times the line beside it
_STRAIGHT_ROWS = 3  # of line beyond the bar make a way straight on,
_ASIDE = 0.5  # if they are not farther than this times the width from the line prolonged
_AROUND_ROWS = 8  # of the line on either side tell where it is inside the bar
_BESIDE_ROWS = 3
_STRETCH_ROWS = 16

# at a corner the outer edge runs straight on through most of the bar's rows, in a bend it leans over (in line widths)
_CORNER_ROWS = 3
_CORNER_SHARE = 0.7
_LEANS_FIRST, _LEANS = 0.10, 0.16


class Arm(NamedTuple):
    """One arm from the line outwards: rows of its middle at the inner and outer end, its outer column."""

    inner_row: float
    outer_row: float
    outer_column: int


class Bar(NamedTuple):
    """A crossing in cells of the grid; `straight` as in `CrossingBar`."""

    column: float
    row: float
    left: Arm | None
    right: Arm | None
    straight: bool | None


class Scene(NamedTuple):
    """One grid: brightness, brightness over the floor's, dark runs of every `STEP`-th column.

    tall: height over width of a cell. arm_columns: how far a bar must reach. lowest_row: bars below do not count.
    """

    value: Bytes2D
    share: Bytes2D
    columns: list[list[Run]]
    tall: float
    arm_columns: float
    lowest_row: float


class _Place(NamedTuple):
    """A candidate: its rows from the bottom up, the line below and beyond it, and whether nothing is beyond.

    line: the line inside the candidate, from both sides of it, or the line below prolonged.
    """

    rows: list[Piece]
    below: list[Piece]
    beyond: list[Piece]
    empty: bool
    line: Band


def find_bar(trace: Trace, scene: Scene) -> tuple[Bar | None, str]:
    """The nearest crossing over a traced line, or None and why what lies there is none (empty: nothing lies there)."""
    first_why = ""
    for index, rows in enumerate(trace.bars):
        bar, why = _judge(_place(trace, index, rows), scene)
        if bar is not None:
            return bar, ""
        first_why = first_why or why
    return None, first_why


def _place(trace: Trace, index: int, rows: list[Piece]) -> _Place:
    stop = trace.bars[index + 1][0].row if index + 1 < len(trace.bars) else -1
    below = [piece for piece in trace.pieces if piece.row > rows[0].row]
    beyond = [piece for piece in trace.pieces if stop < piece.row < rows[0].row]
    around = below[-_AROUND_ROWS:]
    if len(beyond) >= _STRAIGHT_ROWS:
        around = around + beyond[:_AROUND_ROWS]
    return _Place(rows, below, beyond, stop < 0 and trace.empty >= GAP_ROWS, fit(around))


def _judge(place: _Place, scene: Scene) -> tuple[Bar | None, str]:
    tape = _darkness(scene, [(piece.row, int(piece.centre)) for piece in place.below[-_STRETCH_ROWS:]])
    left, why_left = _arm(place, scene, -1, tape)
    right, why_right = _arm(place, scene, 1, tape)
    if left is None and right is None:
        return None, why_left or why_right or "no arm beside the line"
    rows = [arm.inner_row for arm in (left, right) if arm is not None]
    row = sum(rows) / len(rows)
    if row > scene.lowest_row:
        return None, "the bar is under the robot's nose"
    straight = _straight(place)
    if len(rows) == 1 and not straight:
        if straight is None:
            return None, "one arm, and what is beyond it is out of sight"
        if not _sharp(place, -1 if left is not None else 1):
            return None, "a bend"
    if _shadowed(place, scene):
        return None, "darker where it meets the line, as under a shadow"
    return Bar(place.line.at(row)[0], row, left, right, straight), ""


def _straight(place: _Place) -> bool | None:
    if len(place.beyond) < _STRAIGHT_ROWS:
        return False if place.empty else None
    # what goes on beside the line's own direction is a bend, or another thing
    ahead = place.beyond[_STRAIGHT_ROWS - 1]
    centre, width = fit(place.below[-_STRETCH_ROWS:]).at(ahead.row)
    return True if abs(ahead.centre - centre) <= _ASIDE * max(width, ahead.right - ahead.left) else None


def _arm(place: _Place, scene: Scene, side: int, tape: float) -> tuple[Arm | None, str]:
    lowest, highest = place.rows[0].row + 1, place.rows[-1].row - 1
    edges = [centre + side * width / 2.0 for centre, width in (place.line.at(lowest), place.line.at(highest))]
    # beside the line's whole stretch over the candidate, so that a slanting line is not taken for part of the arm
    start = (int(max(edges)) + 1) // STEP + 1 if side > 0 else int(min(edges)) // STEP - 1
    total, runs = len(scene.columns), scene.columns
    if not 0 <= start < total:
        return None, ""
    run = overlapping(runs[start], highest + 1, lowest)
    if run is None:
        return None, ""
    path, column, thickest = [run], start + side, _GROWS * (run[1] - run[0]) + 2.0
    while 0 <= column < total:
        nxt = overlapping(runs[column], *run)
        if nxt is None or nxt[1] - nxt[0] > thickest:
            break
        run = nxt
        path.append(run)
        column += side
    outer, length = column - side, STEP * len(path)
    if length < (scene.arm_columns / 2.0 if outer in (0, total - 1) else scene.arm_columns):
        return None, "an arm too short for a bar"
    width = place.line.at(lowest)[1]
    thick = _median([bottom - top for top, bottom in path]) * scene.tall
    if not _THIN * width <= thick <= _THICK * width:
        return None, f"an arm too {'thick' if thick > width else 'thin'} for tape"
    inner_row, outer_row = sum(path[0]) / 2.0, sum(path[-1]) / 2.0
    if abs(outer_row - inner_row) > _STEEP * length:
        return None, "an arm too steep for a bar"
    height = scene.share.shape[0]
    if sum(top > 0 and bottom < height for top, bottom in path) < _FLOOR_BESIDE_SHARE * len(path):
        return None, "no floor above and below the arm"
    reach = path[: round(scene.arm_columns)]
    third = max(1, len(reach) // 3)
    if _thickness(reach[-third:]) < _TAPER * _thickness(reach[:third]):
        return None, "an arm that tapers off"
    dark = _darkness(scene, [((top + bottom) // 2, STEP * (start + side * i)) for i, (top, bottom) in enumerate(reach)])
    if dark < _AS_DARK * tape:
        return None, "an arm less dark than the line"
    return Arm(inner_row, outer_row, STEP * outer), ""


def _thickness(path: list[Run]) -> float:
    return sum(bottom - top for top, bottom in path) / len(path)


def _darkness(scene: Scene, cells: list[tuple[int, int]]) -> float:
    """How much darker than the floor, median over cells (row, column): 0 is floor, 1 is black."""
    share = scene.share
    return 1.0 - _median([share.item(row, column) for row, column in cells]) / FULL


def _shadowed(place: _Place, scene: Scene) -> bool:
    """Whether the line gets darker where the candidate lies over it, as under a shadow; by brightness itself."""
    beside = [piece.row for piece in (*place.below[-_BESIDE_ROWS:], *place.beyond[1 : 1 + _BESIDE_ROWS])]
    inside = [piece.row for piece in place.rows]
    return _brightness(place, scene, inside) < _DARKENED * _brightness(place, scene, beside)


def _brightness(place: _Place, scene: Scene, rows: list[int]) -> float:
    """Median brightness of the line's inner part in some rows."""
    last, found = scene.value.shape[1] - 1, []
    for row in rows:
        centre, width = place.line.at(row)
        for part in (-0.25, 0.0, 0.25):
            found.append(scene.value.item(row, min(max(int(centre + part * width), 0), last)))
    return _median(found)


def _sharp(place: _Place, side: int) -> bool:
    """Whether the line's outer edge runs straight on to a corner; in a bend it leans over to where the arm goes."""
    if len(place.below) < 2 * _BESIDE_ROWS or len(place.rows) < _CORNER_ROWS:
        return False
    straight = fit(place.below[-_STRETCH_ROWS:])
    leans = []
    for piece in place.rows:
        centre, width = straight.at(piece.row)
        edge = piece.right if side < 0 else piece.left
        leans.append((side * (edge - centre) + width / 2.0) / width)
    return leans[0] <= _LEANS_FIRST and max(leans[: round(_CORNER_SHARE * len(leans))]) <= _LEANS


def _median(values: list[float] | list[int]) -> float:
    ordered = sorted(values)
    return float(ordered[len(ordered) // 2])
