"""Hands JPEGs from the loop to the camera's thread, newest only, and decodes them there: a capture like OpenCV's."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np

from robotd.authoring.device import DeviceLost


class JpegSlot:
    """A `Capture` whose pictures are put in on the loop. `number`: of the picture that was grabbed last, from 1."""

    def __init__(self) -> None:
        self.number = 0
        self._come = threading.Condition()
        self._count = self._number = 0
        self._jpeg: bytes | None = None
        self._stamp_ns = 0
        self._end: str | None = None
        self._held = b""
        self._held_ns = 0

    def count(self) -> None:
        """One more picture came, whether it is put in or not."""
        self._count += 1

    def put(self, jpeg: bytes, stamp_ns: int) -> None:
        """The picture that was counted last; one that nobody took is forgotten."""
        with self._come:
            self._number = self._count
            self._jpeg, self._stamp_ns = jpeg, stamp_ns
            self._come.notify()

    def end(self, reason: str) -> None:
        """No picture comes any more."""
        with self._come:
            self._end = reason if self._end is None else self._end
            self._come.notify()

    # ------------------------------------------------------------------------------------- on the thread

    def grab(self) -> bool:
        """Wait for a picture. Raises DeviceLost at the end."""
        with self._come:
            self._come.wait_for(lambda: self._jpeg is not None or self._end is not None)
            if self._jpeg is None:
                raise DeviceLost(self._end or "")
            self._held, self._held_ns, self._jpeg = self._jpeg, self._stamp_ns, None
            self.number = self._number
            return True

    def retrieve(self) -> tuple[bool, Any]:
        """The picture that was grabbed, decoded: (False, None) where it is no JPEG."""
        import cv2

        flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
        try:
            picture = cv2.imdecode(np.frombuffer(self._held, dtype=np.uint8), flags)
        except cv2.error:
            return False, None
        return picture is not None, picture

    def get(self, propId: int, /) -> float:
        """When the grabbed picture arrived, in milliseconds: what a V4L2 driver's stamp is for the others."""
        return self._held_ns / 1e6

    def release(self) -> None:
        """Nothing is held."""
