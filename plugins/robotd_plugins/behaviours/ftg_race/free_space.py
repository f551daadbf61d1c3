"""Free distance by bearing, exact in bearing: each return blocks the bearings on which the car would touch it.

A return at distance r from the middle of the car blocks the bearings within asin(R / r) of its own, R being half the
car's width and a margin (Minguez and Montano, Nearness Diagram Navigation, IEEE T-RA 2004, and the seed's section 5,
which writes atan2 for it). One pass does inflation, bubble and disparity extender at once.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from robotd.world.messages import Float64s

STEP_RAD: Final = math.radians(0.5)
"""Between the bearings of a profile."""
HALF: Final = 280
"""Bearings to each side of straight ahead: 140 degrees."""
BEARINGS: Final = 2 * HALF + 1
_LEVELS: Final = 10
_ALMOST: Final = 0.95
"""Of the distance to a return that is nearer than R: what is taken for R there, so that a way out remains."""
_ALONG_M: Final = 0.3
_WIDENS: Final = 0.25
"""A car inside its margin may go on along what is near for so far; then the margin comes back by so much a metre."""
_NEIGHBOURS: Final = 100.0
"""Bins; what is farther apart in bearing is no hidden strip between neighbours but a field of view's end."""
_PER_RAD: Final = 1.0 / STEP_RAD


class FreeSpace:
    """Makes profiles; keeps its arrays between them."""

    def __init__(self) -> None:
        self._table = np.empty((_LEVELS, BEARINGS))
        self._flat = self._table.reshape(-1)

    def profile(
        self,
        x_m: Float64s,
        y_m: Float64s,
        is_hit: NDArray[np.bool_],
        reach_m: float,
        most_m: float,
        bin_rad: float = 0.0,
        near_m: float | None = None,
    ) -> Float64s:
        """How far the middle of the car may go on each bearing, float64 (BEARINGS,), from right to left.

        x_m, y_m: (n,) in the frame of the car's middle, in order of bearing as the lidar sees them; what is no hit is
        the end of what is seen there. reach_m: R. Behind an edge that hides something nothing is free; a return stands
        for its bin, `bin_rad` wide. near_m: what is beside a car inside its margin is so near; no more is asked of
        returns within reach then, and R is asked again of those farther on: a way out of the margin, not a full stop.
        """
        r = np.sqrt(x_m * x_m + y_m * y_m)
        at = np.arctan2(y_m, x_m)
        at *= _PER_RAD
        reach = np.minimum(reach_m, _ALMOST * r) * is_hit
        if near_m is not None:
            np.minimum(reach, near_m + _WIDENS * np.maximum(r - near_m - _ALONG_M, 0.0), out=reach)
        half = np.arcsin(reach / np.maximum(r, 1e-6))
        half *= _PER_RAD
        value = np.minimum(r - reach, most_m)
        low, high = at - half, at + half
        # what lies between a near return and its farther neighbour was hidden by the near one
        step = at[1:] - at[:-1]
        nearer = value[:-1] < value[1:]
        close = np.abs(step) < _NEIGHBOURS
        half_bin = 0.5 * bin_rad * _PER_RAD
        np.copyto(high[:-1], np.maximum(high[:-1], at[1:] - half_bin), where=nearer & close)
        np.copyto(low[1:], np.minimum(low[1:], at[:-1] + half_bin), where=close > nearer)
        return self._spread(low, high, value, most_m)

    def _spread(self, low: Float64s, high: Float64s, value: Float64s, most_m: float) -> Float64s:
        """The least value of all runs low..high that hold a bearing: a sparse table, filled from the top down."""
        table, flat = self._table, self._flat
        first = np.ceil(np.maximum(low, -float(HALF))).astype(np.intp)
        last = np.floor(np.minimum(high, float(HALF))).astype(np.intp)
        width = last - first + 1
        if width.min() <= 0:
            seen = width > 0
            first, last, width, value = first[seen], last[seen], width[seen], value[seen]
        level = _LOG2.take(width)
        top = int(level.max(initial=0))
        table[: top + 1].fill(most_m)
        row = level * BEARINGS + HALF
        np.minimum.at(flat, row + first, value)
        np.minimum.at(flat, row + last - _LESS_ONE.take(level), value)
        for k in range(top, 0, -1):
            half = 1 << (k - 1)
            upper, lower = table[k], table[k - 1]
            np.minimum(lower, upper, out=lower)
            np.minimum(lower[half:], upper[:-half], out=lower[half:])
        free: Float64s = table[0].copy()
        return free


_LOG2: Final = np.array([0] + [int(math.log2(n)) for n in range(1, BEARINGS + 1)])
_LESS_ONE: Final = np.array([(1 << k) - 1 for k in range(_LEVELS)])
