"""Decodes and encodes the samples inside RPLIDAR capsules, many capsules in one numpy call.

All values are the device's own integers: angles in 1/64 degree clockwise in [0, 23040), distances in 1/4 mm, 0 where
nothing came back. `cur` below is the head's angle in 1/65536 degree. Source: Slamtec's protocol manual LR001 and
rplidar_sdk 2.1.0 (BSD-2); the results are the SDK's to the last digit, but for one thing: near returns of the
ultra-dense format are not averaged with their neighbours (the SDK does so where they differ by 2 mm or less).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from robotd_devices.lidar.rplidar_capsules import DENSE, EXPRESS, TURN_Q6, ULTRA, ULTRA_DENSE, CapsuleFormat

Ints: TypeAlias = NDArray[np.int64]

#: Level 4 to 0 of the ultra format's scaled distances: from this code on, from this many mm on.
_LEVELS = ((3328, 1 << 14, 4), (1792, 1 << 12, 3), (1280, 1 << 11, 2), (512, 1 << 9, 1), (0, 0, 0))
#: From this many quarters of a mm on (a level each) ultra-dense distances are coarser: 2, 3, 4, 5 mm.
_SCALES_MM = (0, 2046, 8187, 24567)
_NO_RETURN = (-512, 511)
_CABIN = np.dtype([("words", "<u2", (2,)), ("low", "u1")])
_NIBBLES = np.array([0, 4], dtype=np.uint8)


class Samples(NamedTuple):
    """Samples of some capsules, row by row: all (capsules, samples of one).

    head_q16: where the head stood, 1/65536 degree, clockwise, in [0, 360 degrees) per row's start, rising;
    angle_q6: where it looked; distance_q2: quarters of a mm, 0 = no return; quality: 0..255, or None.
    """

    head_q16: Ints
    angle_q6: Ints
    distance_q2: Ints
    quality: NDArray[np.uint8] | None


def decode_samples(form: CapsuleFormat, data: bytes, start_q6: Ints, gap_q6: Ints, behind: bytes = b"") -> Samples:
    """The samples of capsules that lie one behind the other in `data`.

    start_q6: (n,) angle of each first sample; gap_q6: (n,) angle to the next capsule's first sample, not negative.
    behind: data of the capsule after the last one; without it the last two samples of an ultra capsule are not right.
    """
    head = head_q16(form, start_q6, gap_q6)
    rows = np.frombuffer(data, dtype=np.uint8).reshape(len(start_q6), -1)
    return _DECODERS[form.kind](rows, head, behind)


def head_q16(form: CapsuleFormat, start_q6: Ints, gap_q6: Ints) -> Ints:
    """Where the head stands at each sample, (n, samples): spread evenly, in whole steps as the SDK rounds them."""
    step = (gap_q6 << 5) // 3 if form is ULTRA else (gap_q6 << 10) // form.samples
    return (start_q6 << 10)[:, None] + step[:, None] * np.arange(form.samples)


def _turned(angle_q16: Ints) -> Ints:
    return (angle_q16 >> 10) % TURN_Q6


def _express(rows: NDArray[np.uint8], head: Ints, behind: bytes) -> Samples:
    cabins = rows.view(_CABIN)
    words = cabins["words"].astype(np.int64)
    # the offset's lower four bits lie in the fifth byte, its upper two beside the distance
    offset_q3 = cabins["low"][:, :, None] >> _NIBBLES & 0xF | (words & 3) << 4
    angle = _turned(head - (offset_q3.reshape(head.shape) << 13))
    return Samples(head, angle, (words & 0xFFFC).reshape(head.shape), None)


def _ultra(rows: NDArray[np.uint8], head: Ints, behind: bytes) -> Samples:
    words = rows.view("<u4").astype(np.int64)
    majors = words & 0xFFF
    nexts = np.append(majors.ravel()[1:], int.from_bytes(behind[:2], "little") & 0xFFF).reshape(majors.shape)
    base, level = _unscaled(majors)
    next_base, next_level = _unscaled(nexts)
    first = (words >> 12 & 0x3FF ^ 0x200) - 0x200
    second = (words >> 22 ^ 0x200) - 0x200
    borrowed = (base == 0) & (next_base != 0)
    one = (first << np.where(borrowed, next_level, level)) + np.where(borrowed, next_base, base)
    two = (second << next_level) + next_base
    one[np.isin(first, _NO_RETURN)] = 0
    two[np.isin(second, _NO_RETURN)] = 0
    distance = np.stack((base, one, two), axis=2).reshape(head.shape) << 2
    return Samples(head, _turned(head - optical_offset_q16(distance)), distance, None)


def _unscaled(code: Ints) -> tuple[Ints, Ints]:
    """Millimetres and level of distances that are coded more coarsely the larger they are."""
    which = [code >= start for start, _, _ in _LEVELS]
    value = np.select(which, [base + (code - start << level) for start, base, level in _LEVELS])
    return value, np.select(which, [np.int64(level) for _, _, level in _LEVELS])


def optical_offset_q16(distance_q2: Ints) -> Ints:
    """By how much an A2's or A3's beam lags behind its head at a distance, 1/65536 degree (the SDK's formula)."""
    near = np.maximum(distance_q2, 200)
    k = 98361 // near
    lag = int(8 * 3.1415926535 * (1 << 16) / 180) - (k << 6) - k * k * k // 98304
    lag = np.where(distance_q2 >= 200, lag, int(7.5 * 3.1415926535 * (1 << 16) / 180.0))
    return (lag * 180 / 3.14159265).astype(np.int64)


def _dense(rows: NDArray[np.uint8], head: Ints, behind: bytes) -> Samples:
    return Samples(head, _turned(head), rows.view("<u2").astype(np.int64) << 2, None)


def _ultra_dense(rows: NDArray[np.uint8], head: Ints, behind: bytes) -> Samples:
    cabins = rows.reshape(len(rows), 32, 5).astype(np.int64)
    high = cabins[:, :, 4]
    words = np.stack(
        (
            cabins[:, :, 0] | cabins[:, :, 1] << 8 | (high & 0xF) << 16,
            cabins[:, :, 2] | cabins[:, :, 3] << 8 | (high >> 4) << 16,
        ),
        axis=2,
    ).reshape(head.shape)
    scale = words & 3
    field = words & (1 << 12 + scale) - 4
    distance = field * (2 + scale) + (np.array(_SCALES_MM)[scale] << 2)
    quality = words >> 12 + scale << scale
    return Samples(head, _turned(head), distance, quality.astype(np.uint8))


_DECODERS: dict[int, Callable[[NDArray[np.uint8], Ints, bytes], Samples]] = {
    EXPRESS.kind: _express,
    ULTRA.kind: _ultra,
    DENSE.kind: _dense,
    ULTRA_DENSE.kind: _ultra_dense,
}


# ------------------------------------------------------------------------------------------ for fakes and tests


def encode_express(distance_q2: NDArray[Any], offset_q3: NDArray[Any]) -> bytes:
    """The data of an express capsule: 32 distances and the lags of their beams (1/8 degree, 0..63)."""
    words = (distance_q2.astype(np.int64) & 0xFFFC | offset_q3 >> 4 & 3).reshape(16, 2)
    low = (offset_q3 & 0xF).reshape(16, 2)
    cabins = np.empty((16, 5), dtype=np.uint8)
    cabins[:, 0:4:2], cabins[:, 1:4:2] = words & 0xFF, words >> 8
    cabins[:, 4] = low[:, 0] | low[:, 1] << 4
    return cabins.tobytes()


def encode_ultra(distance_mm: NDArray[Any], next_mm: int) -> bytes:
    """The data of an ultra capsule: 96 distances, and the first one of the capsule behind."""
    mm = distance_mm.astype(np.int64).reshape(32, 3)
    code, base, level = _scaled(np.append(mm[:, 0], next_mm))
    borrowed = (base[:-1] == 0) & (base[1:] != 0)
    near_base, near_level = np.where(borrowed, base[1:], base[:-1]), np.where(borrowed, level[1:], level[:-1])
    one = _predicted(mm[:, 1], near_base, near_level)
    two = _predicted(mm[:, 2], base[1:], level[1:])
    words = code[:-1] | (one & 0x3FF) << 12 | (two & 0x3FF) << 22
    return words.astype("<u4").tobytes()


def _scaled(mm: Ints) -> tuple[Ints, Ints, Ints]:
    """Code, what it decodes to, and level of distances."""
    which = [mm >= base for _, base, _ in _LEVELS]
    level = np.select(which, [np.int64(level) for _, _, level in _LEVELS])
    code = np.select(which, [start + (mm - base >> level) for start, base, level in _LEVELS])
    return code, _unscaled(code)[0], level


def _predicted(mm: Ints, base: Ints, level: Ints) -> Ints:
    step = mm - base >> level
    return np.where((mm == 0) | (step <= -512) | (step >= 511), -512, step)


def encode_dense(distance_mm: NDArray[Any]) -> bytes:
    """The data of a dense capsule: 40 distances."""
    return distance_mm.astype("<u2").tobytes()


def encode_ultra_dense(distance_q2: NDArray[Any], quality: NDArray[Any]) -> bytes:
    """The data of an ultra-dense capsule: 64 distances, 64 qualities (0..255)."""
    q2 = distance_q2.astype(np.int64)
    scale = np.searchsorted(np.array(_SCALES_MM[1:]) * 4, q2, side="right")
    field = (q2 - np.array(_SCALES_MM)[scale] * 4) // (2 + scale) & ((1 << 12 + scale) - 4)
    words = (scale | field | (quality.astype(np.int64) >> scale) << 12 + scale).reshape(32, 2)
    cabins = np.empty((32, 5), dtype=np.uint8)
    cabins[:, 0:4:2], cabins[:, 1:4:2] = words & 0xFF, words >> 8 & 0xFF
    cabins[:, 4] = words[:, 0] >> 16 | words[:, 1] >> 16 << 4
    return cabins.tobytes()


def lag_deg(distance_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """`optical_offset_q16` in degrees of distances in metres, for a fake that must place its samples."""
    q2 = np.where(np.isfinite(distance_m), np.rint(np.where(np.isfinite(distance_m), distance_m, 0.0) * 4000.0), 0.0)
    return optical_offset_q16(q2.astype(np.int64)) / math.ldexp(1.0, 16)
