"""The last of a picture's way: light lost in the corners, brightness, white balance, sensor noise and JPEG."""

from __future__ import annotations

import numpy as np

from robotd.world.messages import Bytes2D
from robotd_devices.sim.light import drawn_drift
from robotd_devices.sim.look import SensorLook

_NOISE_SPARE_PX = 61
_NOISE_ZERO = 128


class Sensor:
    """From what comes to the lens, in full light, to the picture that is published.

    size: width and height. Light and white balance wander with the world's time. The noise picture is drawn from `rng`
    once, its place in each frame anew.
    """

    def __init__(self, look: SensorLook, size: tuple[int, int], rng: np.random.Generator) -> None:
        self._look = look
        self._size = size
        self._rng = rng
        self._brightness, self._balance = (drawn_drift(look.light_drift_s, rng) for _ in range(2))
        self._light = self._lit()
        self._noise = self._make_noise()

    def picture(self, bgr: Bytes2D, when_s: float) -> Bytes2D:
        """uint8 (height, width, 3), a new array; `when_s`: second of the world."""
        import cv2

        brightness = self._look.brightness * (1.0 + self._look.light_drift * self._brightness.at(when_s))
        seen = cv2.multiply(bgr, self._light, scale=brightness / 255.0)
        if self._look.tint_drift > 0.0:
            seen = cv2.LUT(seen, _balance(self._look.tint_drift * self._balance.at(when_s)))
        if self._look.noise_std > 0.0:
            seen = cv2.addWeighted(seen, 1.0, self._some_noise(), 1.0, -_NOISE_ZERO)
        if self._look.jpeg_quality is not None:
            _, packed = cv2.imencode(".jpg", seen, (cv2.IMWRITE_JPEG_QUALITY, self._look.jpeg_quality))
            return np.asarray(cv2.imdecode(packed, cv2.IMREAD_COLOR), dtype=np.uint8)
        return np.asarray(seen, dtype=np.uint8)

    def _lit(self) -> Bytes2D:
        """Loss of light towards the corners, (height, width, 3), 255 = none."""
        width, height = self._size
        across = (np.arange(width) - (width - 1) / 2.0) / (width / 2.0)
        down = (np.arange(height) - (height - 1) / 2.0) / (height / 2.0)
        loss = self._look.vignette * (across[None, :] ** 2 + down[:, None] ** 2) / 2.0
        return _threefold(np.round(255.0 * (1.0 - loss)).astype(np.uint8))

    def _make_noise(self) -> Bytes2D:
        width, height = self._size
        shape = (height + _NOISE_SPARE_PX, width + _NOISE_SPARE_PX)
        noise = self._look.noise_std * self._rng.standard_normal(shape, dtype=np.float32)
        return _threefold(np.clip(np.round(noise + _NOISE_ZERO), 0, 255).astype(np.uint8))

    def _some_noise(self) -> Bytes2D:
        """A stretch of one larger noise picture, at a place drawn anew for each frame."""
        down, right = self._rng.integers(0, _NOISE_SPARE_PX + 1, 2).tolist()
        return self._noise[down : down + self._size[1], right : right + self._size[0]]


def _threefold(grey: Bytes2D) -> Bytes2D:
    return np.ascontiguousarray(np.repeat(grey[..., None], 3, axis=2))


def _balance(tint: float) -> Bytes2D:
    """(1, 256, 3): blue up and red down by a share, or the other way round."""
    levels = np.arange(256.0)[:, None] * (1.0 + tint, 1.0, 1.0 - tint)
    return np.asarray(np.clip(np.round(levels), 0.0, 255.0), dtype=np.uint8).reshape(1, 256, 3)
