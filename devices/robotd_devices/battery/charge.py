"""How full a pack is, from its voltage at rest. Pure functions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

LITHIUM: tuple[tuple[float, float], ...] = (
    (3.00, 0.00),
    (3.40, 0.05),
    (3.60, 0.15),
    (3.70, 0.35),
    (3.80, 0.55),
    (3.90, 0.70),
    (4.00, 0.83),
    (4.10, 0.93),
    (4.20, 1.00),
)
"""Volts of one cell at rest, and its charge: rounded from the common curve of lithium-ion and lithium-polymer cells."""


def charge(cell_v: float, table: Sequence[tuple[float, float]] = LITHIUM) -> float:
    """Charge 0 to 1 of a cell by its voltage at rest, straight between the table's rows; nan for nan.

    Raises ValueError for a table of fewer than two rows, or one that does not rise.
    """
    if len(table) < 2 or any(b[0] <= a[0] or b[1] < a[1] for a, b in pairwise(table)):
        raise ValueError("a charge table needs two or more rows of (volts, charge), both rising")
    if math.isnan(cell_v):
        return math.nan
    if cell_v <= table[0][0]:
        return table[0][1]
    for (low_v, low), (high_v, high) in pairwise(table):
        if cell_v <= high_v:
            return low + (high - low) * (cell_v - low_v) / (high_v - low_v)
    return table[-1][1]
