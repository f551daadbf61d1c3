"""Dark runs of a mask, row by row: all that tracing needs to know of a picture."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Run: TypeAlias = tuple[int, int]
"""First cell, and the cell after the last."""


def runs_of(dark: NDArray[np.bool_]) -> list[list[Run]]:
    """The dark runs of each row, from left to right."""
    height, width = dark.shape
    # one light cell after each row (and before the first), so that starts and ends alternate in the flat array
    padded = np.zeros((height, width + 1), dtype=np.bool_)
    padded[:, :width] = dark
    flat = padded.ravel()
    changes = (np.flatnonzero(flat[1:] != flat[:-1]) + 1).tolist()
    if flat[0]:
        changes.insert(0, 0)
    found: list[list[Run]] = [[] for _ in range(height)]
    for start, end in zip(changes[0::2], changes[1::2], strict=True):
        row, first = divmod(start, width + 1)
        found[row].append((first, first + end - start))
    return found


def overlapping(runs: list[Run], low: float, high: float) -> Run | None:
    """The run that shares most with [low, high); None where none does."""
    if len(runs) == 1:
        run = runs[0]
        return run if run[0] < high and low < run[1] else None
    best, most = None, 0.0
    for run in runs:
        shared = min(run[1], high) - max(run[0], low)
        if shared > most:
            best, most = run, shared
    return best
