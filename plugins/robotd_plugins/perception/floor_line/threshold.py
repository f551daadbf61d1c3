"""What is tape and what is floor: brightness as a share of the floor around it, and a threshold between the two.

Method: Otsu (IEEE Trans. SMC 9(1), 1979) on the histogram of that share instead of on grey levels, so that shadows,
vignetting and exposure are gone before the threshold is chosen; its answer counts only within bounds and only where
two kinds of pixel were really seen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from robotd.world.messages import Bytes2D, Float64s

FULL = 200
"""The share 1.0 (as bright as the floor around) in the bytes of a share picture."""

_BINS = np.arange(256, dtype=np.float64)
_BINS_SQUARED = _BINS * _BINS
_TAPE_PIXELS_MIN = 0.004
_FLOOR_RATIO_MIN = 0.80
_SEPARATION_MIN = 0.18
_DARKEST_SHARE = 0.25
_DARKEST_WIDTH = 10
_THIRD_SHARE = 0.15
_PEAK_OVER_VALLEY = 4.0
_SMOOTH = np.full(9, 1.0 / 9.0)


@dataclass(frozen=True, slots=True)
class Split:
    """A threshold between tape and floor as shares of the floor's brightness; `why` is empty where it can be used."""

    ratio: float
    tape_ratio: float
    floor_ratio: float
    why: str = ""


def value_rows(bgr: Bytes2D, rows: np.ndarray[tuple[int], np.dtype[np.intp]], width: int) -> Bytes2D:
    """Chosen rows of a picture as brightness (the V of HSV), uint8 (len(rows), width), lightly smoothed."""
    import cv2

    blue, green, red = cv2.split(bgr[rows])
    value = cv2.max(cv2.max(blue, green), red)
    if value.shape[1] != width:
        value = cv2.resize(value, (width, len(rows)), interpolation=cv2.INTER_AREA)
    return cv2.blur(value, (3, 3)).astype(np.uint8, copy=False)


def without_glints(value: Bytes2D) -> Bytes2D:
    """Without the thin bright streaks that lamps draw along glossy tape: an opening over five cells of a row."""
    import cv2

    return cv2.morphologyEx(value, cv2.MORPH_OPEN, np.ones((1, 5), np.uint8)).astype(np.uint8, copy=False)


def floor_along(value: Bytes2D, across_px: int, down_px: int) -> Bytes2D:
    """The floor's brightness under everything dark that is narrower than a window of `across_px` x `down_px`.

    A grey closing: dark runs shorter than the window are filled from their sides, steps (shadows) stay where they are.
    """
    import cv2

    window = np.ones((down_px | 1, across_px | 1), np.uint8)
    return cv2.morphologyEx(value, cv2.MORPH_CLOSE, window).astype(np.uint8, copy=False)


def shares(value: Bytes2D, floor: Bytes2D) -> Bytes2D:
    """Brightness over the floor's, in 1/`FULL`; 0 where the floor itself is black."""
    import cv2

    return cv2.divide(value, floor, scale=float(FULL)).astype(np.uint8, copy=False)


def histogram(share: Bytes2D) -> Float64s:
    """Counts of each byte, float64 (256,)."""
    import cv2

    return cv2.calcHist([share], [0], None, [256], [0.0, 256.0]).ravel().astype(np.float64)


def _valley(counts: Float64s, first: int, last: int) -> int:
    """The threshold `last`, or the valley below it where a third class lies between tape and `last`: a shadow.

    Otsu weighs two classes; a dark shadow beside the tape makes its answer lie above the shadow's pixels. Only a class
    with a peak of its own counts, well above the valley that parts it from the darkest one.
    """
    below = np.cumsum(counts[: last + 1])
    first = max(first, int(np.searchsorted(below, _DARKEST_SHARE * below[-1])) + _DARKEST_WIDTH)
    if below[-1] <= 0.0 or first >= last:
        return last
    smooth = np.convolve(counts, _SMOOTH, mode="same")[first : last + 1]
    lowest = float(smooth.min())
    valley = round(float(np.flatnonzero(smooth <= lowest + 1e-9).mean()))
    peak = float(smooth[valley:].max())
    third = float(below[last] - below[first + valley])
    if third < _THIRD_SHARE * below[-1] or peak < _PEAK_OVER_VALLEY * lowest:
        return last
    return first + valley


def split(counts: Float64s, ratio_min: float, ratio_max: float) -> Split:
    """Otsu's threshold on a histogram of shares, within [ratio_min, ratio_max], below a third class (a shadow).

    Refused with a reason: hardly any dark pixel; a floor that is not evenly bright (noise, no picture); two classes
    that are too alike.
    """
    total = float(counts.sum())
    if total <= 0.0:
        return Split(math.nan, math.nan, math.nan, "no picture")
    below = np.cumsum(counts)
    weighted = np.cumsum(counts * _BINS)
    first, last = round(ratio_min * FULL), round(ratio_max * FULL)
    dark, light = below[first : last + 1], total - below[first : last + 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        between = (weighted[-1] * dark - total * weighted[first : last + 1]) ** 2 / (dark * light)
    between[~np.isfinite(between)] = -1.0
    best = float(between.max())
    if best < 0.0:
        return Split(math.nan, math.nan, float(weighted[-1]) / total / FULL, "nothing darker than the floor")
    # where many thresholds are equally good, the middle one is the safest
    at = first + round(float(np.flatnonzero(between >= best * (1.0 - 1e-9)).mean()))
    at = _valley(counts, first, at)
    ratio = (at + 1) / FULL
    n_dark = float(below[at])
    n_light = total - n_dark
    if n_dark < _TAPE_PIXELS_MIN * total:
        return Split(ratio, math.nan, float(weighted[-1]) / total / FULL, "nothing darker than the floor")
    if n_light <= 0.0:
        return Split(ratio, float(weighted[-1]) / total / FULL, math.nan, "no floor to be seen")
    tape = float(weighted[at]) / n_dark / FULL
    floor = float(weighted[-1] - weighted[at]) / n_light / FULL
    if floor < _FLOOR_RATIO_MIN:
        return Split(ratio, tape, floor, "no even floor to be seen")
    if floor - tape < _SEPARATION_MIN:
        return Split(ratio, tape, floor, "too little contrast")
    return Split(ratio, tape, floor)
