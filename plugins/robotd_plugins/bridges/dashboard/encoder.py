"""Turns camera frames into JPEG on a thread of its own: one at a time, nothing waits in line.

A plain thread and not an executor's job, because in virtual time an outstanding job holds the clock.
"""

from __future__ import annotations

import asyncio
import queue
import threading
from collections.abc import Callable
from typing import Any, TypeAlias

from robotd import CameraFrame

Encoded: TypeAlias = Callable[[CameraFrame, "bytes | str"], None]
"""Called on the loop with the frame and its JPEG, or the text of what went wrong."""


class PictureEncoder:
    """All methods belong on the loop. The thread, and OpenCV with it, starts with the first frame that is wanted."""

    def __init__(self, width_px: int, quality: int) -> None:
        self._busy = False
        self._width_px = width_px
        self._quality = quality
        self._work: queue.SimpleQueue[tuple[CameraFrame, Encoded] | None] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None
        self._closed = False

    def submit(self, frame: CameraFrame, encoded: Encoded) -> bool:
        """Encode this frame and call back; False, and nothing happens, while another one is being encoded."""
        if self._busy or self._closed:
            return False
        self._busy = True
        if self._thread is None:
            loop = asyncio.get_running_loop()
            self._thread = threading.Thread(target=self._run, args=(loop,), name="robotd-page-jpeg", daemon=True)
            self._thread.start()
        self._work.put((frame, encoded))
        return True

    def close(self) -> None:
        """Ends the thread after the frame in hand, without waiting for it."""
        self._closed = True
        self._work.put(None)

    def _run(self, loop: asyncio.AbstractEventLoop) -> None:
        while (work := self._work.get()) is not None:
            frame, encoded = work
            try:
                result: bytes | str = encode(frame, self._width_px, self._quality)
            except Exception as error:
                result = f"{type(error).__name__}: {error}"
            try:
                loop.call_soon_threadsafe(self._done, frame, result, encoded)
            except RuntimeError:  # the loop was closed meanwhile
                return

    def _done(self, frame: CameraFrame, result: bytes | str, encoded: Encoded) -> None:
        self._busy = False
        if not self._closed:
            encoded(frame, result)


def encode(frame: CameraFrame, width_px: int, quality: int) -> bytes:
    """JPEG of a frame, scaled down to `width_px` where it is wider. Raises ValueError where OpenCV cannot."""
    import cv2

    picture: Any = frame.bgr
    height, width = picture.shape[:2]
    if width > width_px:
        size = (width_px, max(1, round(height * width_px / width)))
        picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    good, jpeg = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not good:
        raise ValueError("OpenCV made no JPEG of it")
    return bytes(jpeg)
