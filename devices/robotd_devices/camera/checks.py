"""Looks at each picture of a live camera for what no sensor sends: repeated, torn and black ones. Cheap and pure.

A live sensor never repeats its noise. So a picture that equals the one before in every byte is no new picture, and rows
that equal those of an older picture, in a picture that otherwise differs, were never written to. The rows of a sparse
grid stand for the picture; only where they agree is everything compared.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

ROWS, COLUMNS = 24, 32
_HISTORY = 4
"""As many buffers as OpenCV gives a V4L2 driver."""
_TORN_ROWS = ROWS // 4
_LIVELY_ROWS = 3
_FLAT = 2
_GREY = 128
"""What libjpeg fills in for blocks whose data are missing (jdhuff.c: all coefficients zero)."""


@dataclass(frozen=True, slots=True)
class CheckSettings:
    """frozen_ns 0: repeats are not judged (files, and codecs that leave still parts as they are). black_pictures 0: nor
    is darkness. partial: also look for rows of older pictures."""

    frozen_ns: int = 2_000_000_000
    black_below: float = 8.0
    black_pictures: int = 10
    torn: bool = True
    partial: bool = True


class Verdict(NamedTuple):
    """`publish`: whether it is a new, whole picture. `faults`: names and details to count. `lost`: a reason, if any."""

    publish: bool = True
    faults: tuple[tuple[str, str], ...] = ()
    lost: str = ""


_GOOD = Verdict()


class FrameCheck:
    """Judges the pictures of one source, in their order. One thread."""

    def __init__(self, settings: CheckSettings) -> None:
        self._settings = settings
        self._weights: NDArray[np.int64] = np.zeros(0, dtype=np.int64)
        self._past: deque[NDArray[np.int64]] = deque(maxlen=_HISTORY)
        self._before: NDArray[Any] | None = None
        self._since_ns = 0
        self._dark = 0

    def judge(self, raw: NDArray[Any], now_ns: int) -> Verdict:
        """raw: uint8 (height, width) or (height, width, channels), as the source gives it, before any rotation.

        now_ns: when it was read.
        """
        settings = self._settings
        sample = np.ascontiguousarray(raw[:: max(1, raw.shape[0] // ROWS), :: max(1, raw.shape[1] // COLUMNS)])
        sample = sample.reshape(sample.shape[0], -1)
        if settings.torn and _is_grey_below(raw):
            return Verdict(False, (("torn picture", "its lower part is missing"),))
        low, high = int(sample.min()), int(sample.max())
        rows = self._fingerprints(sample)
        # a picture without any contrast says nothing: darkness, a covered lens, the sun
        if high - low > _FLAT:
            if settings.frozen_ns and self._is_repeated(raw, rows):
                told = (("repeated picture", "the same in every byte: it is not passed on"),)
                if now_ns - self._since_ns >= settings.frozen_ns:
                    lasted = settings.frozen_ns / 1e9
                    return Verdict(False, told, f"frozen: the very same picture for {lasted:g} s, it is opened anew")
                return Verdict(False, told)
            if settings.torn and settings.partial and self._is_partial(sample, rows):
                self._past.append(rows)
                return Verdict(False, (("torn picture", "part of it is of an older one"),))
        self._before, self._since_ns = raw, now_ns
        self._past.append(rows)
        return self._darkness(sample) if settings.black_pictures else _GOOD

    def _fingerprints(self, sample: NDArray[Any]) -> NDArray[np.int64]:
        """One number a row; equal rows have equal numbers, others practically never."""
        if self._weights.shape[0] != sample.shape[1]:
            self._weights = np.asarray(np.random.default_rng(0).integers(1, 1 << 40, sample.shape[1], dtype=np.int64))
            self._past.clear()
        return np.asarray(sample.astype(np.int64) @ self._weights)

    def _is_repeated(self, raw: NDArray[Any], rows: NDArray[np.int64]) -> bool:
        if self._before is None or not self._past or not np.array_equal(rows, self._past[-1]):
            return False
        return raw.shape == self._before.shape and bool((raw == self._before).all())

    def _is_partial(self, sample: NDArray[Any], rows: NDArray[np.int64]) -> bool:
        for old in self._past:
            if old.shape != rows.shape or not (old[0] == rows[0] or old[-1] == rows[-1]):
                continue
            same = np.equal(old, rows)
            count = int(same.sum())
            if not _TORN_ROWS <= count <= len(rows) - _TORN_ROWS:
                continue
            # one piece at the upper or the lower edge, not all of it flat (sky that is too bright, a dark corner)
            in_one_piece = same[:count].all() or same[-count:].all()
            lively = np.ptp(sample[same].astype(np.int16), axis=1) > _FLAT
            if in_one_piece and int(lively.sum()) >= _LIVELY_ROWS:
                return True
        return False

    def _darkness(self, sample: NDArray[Any]) -> Verdict:
        mean = float(sample.mean())
        self._dark = self._dark + 1 if mean < self._settings.black_below else 0
        if self._dark < self._settings.black_pictures:
            return _GOOD
        return Verdict(True, (("black picture", f"mean {mean:.1f} of 255: is the lens covered, or the light off?"),))


def _is_grey_below(raw: NDArray[Any]) -> bool:
    """Whether the lowest two rows are what a JPEG decoder fills in, without any noise."""
    low = raw[-2:, ..., :3] if raw.ndim == 3 else raw[-2:]
    # two pixels tell most pictures
    if (low[-1, 0] != _GREY).any() or (low[-1, -1] != _GREY).any():
        return False
    return bool((low == _GREY).all())
