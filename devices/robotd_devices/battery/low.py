"""Whether a pack is low: below its limit for some seconds, since motors that start pull it down for a moment. Pure."""

from __future__ import annotations

import math

BACK = 1.03
"""So far over the limit it must come before it is not low any more: at rest a pack recovers a little."""


class LowBattery:
    """low_v: the limit; 0: never low. after_ns: for so long without a break it must be below."""

    def __init__(self, low_v: float, after_ns: int) -> None:
        self._low_v = low_v
        self._after_ns = after_ns
        self._since_ns: int | None = None
        self._is_low = False

    def take(self, voltage_v: float, now_ns: int) -> bool:
        """Whether it is low, with this reading; one that is nan changes nothing."""
        if math.isnan(voltage_v):
            return self._is_low
        if voltage_v >= self._low_v * (BACK if self._is_low else 1.0):
            self._since_ns, self._is_low = None, False
        elif self._since_ns is None:
            self._since_ns = now_ns
        if self._since_ns is not None and now_ns - self._since_ns >= self._after_ns:
            self._is_low = True
        return self._is_low
