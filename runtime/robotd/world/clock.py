"""The one time of a robot: integer nanoseconds on the monotonic clock of the event loop."""

from __future__ import annotations

from typing import Protocol

NS_PER_S = 1_000_000_000


class Clock(Protocol):
    """Only devices and the engine hold a clock; plugins get `now_ns` inside their view."""

    def now_ns(self) -> int:
        """Nanoseconds since an arbitrary start; never goes back."""
        ...


class ManualClock:
    """A clock that a test or a replay sets by hand."""

    def __init__(self, now_ns: int = 0) -> None:
        self._now_ns = now_ns

    def now_ns(self) -> int:
        return self._now_ns

    def set_ns(self, now_ns: int) -> None:
        """Move to `now_ns`; raises ValueError for a step back."""
        if now_ns < self._now_ns:
            raise ValueError(f"time went back from {self._now_ns} to {now_ns} ns")
        self._now_ns = now_ns


def ns(seconds: float) -> int:
    """Seconds to the nearest whole nanosecond."""
    return round(seconds * NS_PER_S)


def seconds(nanoseconds: int) -> float:
    """Nanoseconds to seconds."""
    return nanoseconds / NS_PER_S
