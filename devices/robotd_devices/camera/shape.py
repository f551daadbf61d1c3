"""From a picture as a source gives it to the picture that is published: three channels, turned, in the right size."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robotd.world.messages import Bytes2D, read_only


@dataclass(frozen=True, slots=True)
class Shape:
    """Rotation (clockwise degrees), then size; None leaves it, one None follows in proportion."""

    width_px: int | None = None
    height_px: int | None = None
    rotate_deg: int = 0

    @property
    def asked_px(self) -> tuple[int | None, int | None]:
        """Width and height to ask of a camera, before the rotation."""
        size = self.width_px, self.height_px
        return size if self.rotate_deg % 180 == 0 else size[::-1]

    def size_px(self, width: int, height: int) -> tuple[int, int]:
        """Published width and height of a (turned) picture of this size."""
        if self.width_px is not None and self.height_px is not None:
            return self.width_px, self.height_px
        if self.width_px is not None:
            return self.width_px, max(1, round(height * self.width_px / width))
        if self.height_px is not None:
            return max(1, round(width * self.height_px / height)), self.height_px
        return width, height

    def apply(self, raw: NDArray[Any]) -> Bytes2D:
        """A read-only uint8 (height, width, 3) picture; `raw` itself where nothing is to be done.

        Takes one channel (grey), three (BGR) and four (BGRA, whose alpha is dropped). Raises ValueError for others.
        """
        import cv2

        picture = to_bgr(raw)
        if self.rotate_deg:
            turn = {90: cv2.ROTATE_90_CLOCKWISE, 180: cv2.ROTATE_180, 270: cv2.ROTATE_90_COUNTERCLOCKWISE}
            picture = np.asarray(cv2.rotate(picture, turn[self.rotate_deg]), dtype=np.uint8)
        height, width = picture.shape[:2]
        size = self.size_px(width, height)
        if size != (width, height):
            way = cv2.INTER_AREA if size[0] < width or size[1] < height else cv2.INTER_LINEAR
            picture = np.asarray(cv2.resize(picture, size, interpolation=way), dtype=np.uint8)
        return read_only(picture)


def to_bgr(raw: NDArray[Any]) -> Bytes2D:
    """Three channels, blue first. Raises ValueError for what is no 8-bit picture of one, three or four channels."""
    import cv2

    channels = 1 if raw.ndim == 2 else raw.shape[2] if raw.ndim == 3 else 0
    if raw.dtype != np.uint8 or channels not in (1, 3, 4) or raw.size == 0:
        raise ValueError(f"a picture of {raw.dtype} {raw.shape} is not 8 bits of one, three or four channels")
    if channels == 3:
        return raw
    way = cv2.COLOR_GRAY2BGR if channels == 1 else cv2.COLOR_BGRA2BGR
    return np.asarray(cv2.cvtColor(raw, way), dtype=np.uint8)
