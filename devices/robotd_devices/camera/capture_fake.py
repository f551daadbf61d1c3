"""A V4L2 camera faked at the capture call: pictures come when a test sends them, and every fault by its name."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from robotd_devices.ports.breakable import Breakable

_LONGEST_WAIT_S = 5.0
_SIZE = (24, 32, 3)


class CaptureFake(Breakable):
    """What stands for `cv2.VideoCapture`, and, called, for what opens it: `Camera(..., open_capture=fake)`.

    Each picture is noise around a level, as a sensor's is; `odd` is given once in place of the next one. After `take()`
    returns, the grabber has handed the picture over and waits for the next one.
    """

    breaks: ClassVar[Mapping[str, str]] = MappingProxyType(
        {
            "torn picture": "is_torn",
            "frozen picture": "is_frozen",
            "camera hangs": "hangs",
            "camera out": "is_out",
        }
    )

    def __init__(self) -> None:
        self.opened = self.released = 0
        self.sent = 0
        """Pictures so far."""
        self.driver_ms = 0.0
        """The driver's stamp, as OpenCV gives it."""
        self.odd: Any = None
        self.decodes = True
        """Whether pictures can be decoded."""
        self.is_torn = self.is_frozen = self.hangs = False
        self._last: Any = None
        self._answers = 0
        self._come = threading.Condition()
        self._waiting = self._is_out = False

    def __call__(self) -> CaptureFake:
        self.opened += 1
        return self

    @property
    def is_out(self) -> bool:
        """Whether the camera is unplugged."""
        return self._is_out

    @is_out.setter
    def is_out(self, out: bool) -> None:
        with self._come:
            self._is_out = out
            self._come.notify_all()

    # ------------------------------------------------------------------------------- what the grabber calls

    def grab(self) -> bool:
        """Wait for a picture; False where the camera is out."""
        with self._come:
            self._waiting = True
            self._come.notify_all()
            self._come.wait_for(lambda: (self._answers > 0 and not self.hangs) or self._is_out)
            self._waiting = False
            if self._is_out:
                return False
            self._answers -= 1
            return True

    def retrieve(self) -> tuple[bool, Any]:
        """The picture that was grabbed."""
        self.sent += 1
        if self.odd is not None:
            odd, self.odd = self.odd, None
            return True, odd
        if not self.is_frozen or self._last is None:
            noise = np.random.default_rng(self.sent).integers(-6, 7, _SIZE)
            self._last = np.clip(noise + 60 + self.sent % 128, 0, 255).astype(np.uint8)
        picture = self._last.copy()
        if self.is_torn:
            picture[_SIZE[0] // 2 :] = 128  # what a JPEG decoder fills in for data that are missing
        return self.decodes, picture

    def get(self, propId: int, /) -> float:
        """The driver's stamp."""
        return self.driver_ms

    def release(self) -> None:
        """Let go."""
        self.released += 1

    # ---------------------------------------------------------------------------------- what a test calls

    def send(self) -> None:
        """A picture is there."""
        with self._come:
            self._come.wait_for(lambda: self._waiting or self._is_out, _LONGEST_WAIT_S)
            self._answers += 1
            self._waiting = False
            self._come.notify_all()

    def take(self) -> None:
        """`send`, and wait until the grabber is through with it. Blocks the loop, as a slow program does."""
        self.send()
        with self._come:
            if not self._come.wait_for(lambda: self._waiting or self._is_out, _LONGEST_WAIT_S):
                raise TimeoutError("the grabber did not come for another picture")
