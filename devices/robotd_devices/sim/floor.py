"""The floor as a picture: tape drawn exactly, unevenness, and smaller copies for what is seen from afar."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from robotd.world.messages import Bytes2D, Float32s, Float64s
from robotd_devices.sim.maps import FloorLine, WorldMap

LEVELS = 6
"""Copies of the floor, each half as fine as the one before."""

_MARGIN_M = 0.3
_LONGEST_PX = 6000
_EDGE_PX = 4
"""Bare floor around each copy, which stands for everything beyond it."""
_GRAIN_PX = 256


@dataclass(frozen=True, slots=True, eq=False)
class Atlas:
    """All copies side by side in one picture, so that one lookup serves near and far.

    grey: uint8 (h, w). In copy k, map point (x, y) is (x - x0_m) / texel_m / 2^k columns right of `left_px[k]` and
    (y - y0_m) / texel_m / 2^k rows below `top_px`, both counted from a texel's edge; rows grow with y.
    width_px: each copy's width, (LEVELS,). Column `nothing_px` is black.
    """

    grey: Bytes2D
    texel_m: float
    x0_m: float
    y0_m: float
    left_px: Float64s
    width_px: Float64s
    top_px: float
    nothing_px: float


@dataclass(frozen=True, slots=True)
class FloorLook:
    """Grey levels of the bare picture, before light, lens and noise."""

    tape: float
    floor: float
    grain_std: float
    patches_std: float


def tape_cover(
    lines: tuple[FloorLine, ...], shape: tuple[int, int], texel_m: float, corner_m: tuple[float, float]
) -> Float32s:
    """Share of each texel that tape covers, float32 (rows, columns); edges are exact to a small part of a texel.

    A tape is everything within half its width of its middle line, cut off square at its two ends.
    """
    cover = np.zeros(shape, dtype=np.float32)
    for line in lines:
        pieces = line.segments_m
        for index, piece in enumerate(pieces):
            cut_start = index == 0 and not line.closed
            cut_end = index == len(pieces) - 1 and not line.closed
            _lay(cover, piece, line.width_m / 2.0, (cut_start, cut_end), texel_m, corner_m)
    return cover


def _lay(
    cover: Float32s,
    piece_m: Float64s,
    half_m: float,
    cut: tuple[bool, bool],
    texel_m: float,
    corner_m: tuple[float, float],
) -> None:
    """Adds one straight piece: a strip with round ends, or square ones where the tape is cut."""
    x0, y0, x1, y1 = piece_m
    reach_m = half_m + 2.0 * texel_m
    rows, columns = cover.shape
    left = max(0, math.floor((min(x0, x1) - reach_m - corner_m[0]) / texel_m))
    right = min(columns, math.ceil((max(x0, x1) + reach_m - corner_m[0]) / texel_m))
    top = max(0, math.floor((min(y0, y1) - reach_m - corner_m[1]) / texel_m))
    bottom = min(rows, math.ceil((max(y0, y1) + reach_m - corner_m[1]) / texel_m))
    if left >= right or top >= bottom:
        return
    x = corner_m[0] + (np.arange(left, right) + 0.5) * texel_m - x0
    y = (corner_m[1] + (np.arange(top, bottom) + 0.5) * texel_m - y0)[:, None]
    length_m = math.hypot(x1 - x0, y1 - y0)
    ex, ey = (x1 - x0) / length_m, (y1 - y0) / length_m
    along, across = x * ex + y * ey, y * ex - x * ey
    beyond = np.maximum(np.maximum(-along, along - length_m), 0.0)
    inside = np.clip(0.5 + (half_m - np.hypot(across, beyond)) / texel_m, 0.0, 1.0)
    if cut[0]:
        inside *= np.clip(0.5 + along / texel_m, 0.0, 1.0)
    if cut[1]:
        inside *= np.clip(0.5 + (length_m - along) / texel_m, 0.0, 1.0)
    window = cover[top:bottom, left:right]
    np.maximum(window, inside, out=window)


def draw_floor(world: WorldMap, look: FloorLook, texel_m: float, rng: np.random.Generator) -> Atlas:
    """The floor of a map. A map too large for `texel_m` gets coarser texels rather than a picture without end."""
    import cv2

    x0_m, y0_m, x1_m, y1_m = world.bounds_m()
    x0_m, y0_m, x1_m, y1_m = x0_m - _MARGIN_M, y0_m - _MARGIN_M, x1_m + _MARGIN_M, y1_m + _MARGIN_M
    texel_m = max(texel_m, max(x1_m - x0_m, y1_m - y0_m) / _LONGEST_PX)
    whole = 1 << (LEVELS - 1)
    rows = math.ceil((y1_m - y0_m) / texel_m / whole) * whole
    columns = math.ceil((x1_m - x0_m) / texel_m / whole) * whole
    cover = tape_cover(world.lines, (rows, columns), texel_m, (x0_m, y0_m))
    # millions of texels: each step works in place
    finest = _patches((rows, columns), texel_m, rng)
    finest *= look.patches_std
    finest += look.floor
    finest *= 1.0 - cover
    cover *= look.tape
    finest += cover
    if look.grain_std > 0.0:
        _add_grain(finest, look.grain_std, rng)
    copies: list[Float32s] = [np.clip(finest, 1.0, 255.0, out=finest)]
    while len(copies) < LEVELS:
        half = cv2.resize(copies[-1], None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        copies.append(np.asarray(half, dtype=np.float32))
    width_px = np.array([copy.shape[1] for copy in copies], dtype=np.float64)
    left_px = np.concatenate(([0.0], np.cumsum(width_px + 2 * _EDGE_PX)[:-1])) + _EDGE_PX
    total = int(left_px[-1] + width_px[-1]) + _EDGE_PX
    grey = np.full((rows + 2 * _EDGE_PX, total + 3), round(look.floor), dtype=np.uint8)
    for copy, left in zip(copies, left_px.astype(int), strict=True):
        grey[_EDGE_PX : _EDGE_PX + copy.shape[0], left : left + copy.shape[1]] = np.round(copy)
    grey[:, total:] = 0
    return Atlas(grey, texel_m, x0_m, y0_m, left_px, width_px, float(_EDGE_PX), total + 1.0)


def _patches(shape: tuple[int, int], texel_m: float, rng: np.random.Generator) -> Float32s:
    """Slow unevenness of a floor, about 0.25 m from patch to patch, unit variance."""
    import cv2

    coarse = (max(2, math.ceil(shape[0] * texel_m / 0.25)), max(2, math.ceil(shape[1] * texel_m / 0.25)))
    points = rng.standard_normal(coarse, dtype=np.float32)
    return np.asarray(cv2.resize(points, shape[::-1], interpolation=cv2.INTER_CUBIC), dtype=np.float32)


def _add_grain(picture: Float32s, std: float, rng: np.random.Generator) -> None:
    """The weave of vinyl: one tile of normal numbers, laid again and again, in place."""
    tile = rng.standard_normal((_GRAIN_PX, _GRAIN_PX), dtype=np.float32) * np.float32(std)
    for top in range(0, picture.shape[0], _GRAIN_PX):
        for left in range(0, picture.shape[1], _GRAIN_PX):
            part = picture[top : top + _GRAIN_PX, left : left + _GRAIN_PX]
            part += tile[: part.shape[0], : part.shape[1]]
