"""What is around: a far-off room behind the horizon, and its lamps and windows mirrored in a glossy floor."""

from __future__ import annotations

import numpy as np

from robotd.world.messages import Float32s, Float64s

COLUMNS_PER_TURN = 360
"""One column a degree; the picture holds two turns, so that every heading is one unbroken stretch of it."""

ROWS = 181
"""One row a degree, from straight up (0) over the horizon (90) to straight down (180)."""

_HORIZON = 90


def draw_room(gloss: float, rng: np.random.Generator) -> Float32s:
    """Grey levels float32 (ROWS, 2 * COLUMNS_PER_TURN) by direction: above the horizon what is seen there, below it
    what the floor's gloss adds. Column c looks to bearing c - 180 degrees of the map.

    It is infinitely far: it turns with the robot and does not come nearer. `gloss` is the strongest streak.
    """
    import cv2

    bearing = np.arange(COLUMNS_PER_TURN)
    room = np.zeros((ROWS, COLUMNS_PER_TURN), dtype=np.float64)
    up = np.arange(_HORIZON, -1, -1)[:, None]
    room[: _HORIZON + 1] = 95.0 + 0.6 * up
    for _ in range(28):
        middle, half, height = rng.uniform(0, COLUMNS_PER_TURN), rng.uniform(3, 14), rng.integers(6, 34)
        grey = rng.choice((38.0, 60.0, 130.0, 165.0))
        columns = _apart(bearing, middle) < half
        room[_HORIZON - height : _HORIZON + 1, columns] = grey
    lamps = rng.uniform(0, COLUMNS_PER_TURN, 9)
    for middle in lamps:
        low = int(rng.integers(28, 55))
        room[_HORIZON - low - 7 : _HORIZON - low, _apart(bearing, middle) < 6.0] = 245.0
        room[_HORIZON:] += _streak(bearing, middle, float(low), gloss * float(rng.uniform(0.5, 1.0)))
    blurred = cv2.blur(np.hstack((room, room, room)).astype(np.float32), (5, 1))
    blurred[_HORIZON + 1 :] = np.minimum(blurred[_HORIZON + 1 :], gloss)
    twice: Float32s = np.ascontiguousarray(blurred[:, COLUMNS_PER_TURN:])
    return twice


def _apart(bearing: np.typing.NDArray[np.int64], middle: float) -> Float64s:
    """Degrees between columns, around the turn."""
    half = COLUMNS_PER_TURN / 2.0
    apart: Float64s = np.abs((bearing - middle + half) % COLUMNS_PER_TURN - half)
    return apart


def _streak(bearing: np.typing.NDArray[np.int64], middle: float, low_deg: float, strength: float) -> Float64s:
    """A lamp in the floor: narrow across, long towards the camera, as vinyl with its fine weave shows it."""
    down = np.arange(ROWS - _HORIZON)[:, None]
    streak: Float64s = strength * np.exp(-((_apart(bearing, middle) / 3.0) ** 2) - ((down - low_deg) / 18.0) ** 2)
    return streak
