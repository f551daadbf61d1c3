"""Believing what pictures say: k of the last n must agree, and a place counts only if they agree where it is."""

from __future__ import annotations

import math
from collections import deque


class Votes:
    """k of the last n say yes. Once believed, it is dropped only when at most `k // 2` still do (hysteresis)."""

    def __init__(self, needed: int, of: int) -> None:
        self._needed = needed
        self._cast: deque[bool] = deque(maxlen=of)
        self.believed = False

    def cast(self, yes: bool) -> None:
        """One picture's vote."""
        self._cast.append(yes)
        count = sum(self._cast)
        self.believed = count > self._needed // 2 if self.believed else count >= self._needed

    def clear(self) -> None:
        """Forget everything."""
        self._cast.clear()
        self.believed = False


class Place:
    """Something on the line ahead, by the odometer reading at which the axle will be over it.

    holds: once believed, not seeing it any more does not count against it; only seeing it elsewhere does.
    """

    def __init__(
        self, needed: int, of: int, tolerance_m: float, sight_m: tuple[float, float], *, holds: bool = False
    ) -> None:
        self._votes = Votes(needed, of)
        self._tolerance_m = tolerance_m
        self._sight_m = sight_m
        self._holds = holds
        self._at_m = math.nan
        self._straight = 0

    @property
    def at_m(self) -> float:
        """Odometer reading of the place; nan unless it is believed."""
        return self._at_m if self._votes.believed else math.nan

    @property
    def straight(self) -> bool | None:
        """What most pictures said about a way straight on; None where none did."""
        return None if self._straight == 0 else self._straight > 0

    def look(self, travelled_m: float, ahead_m: float | None, straight: bool | None = None) -> None:
        """One picture, taken at an odometer reading: the place is `ahead_m` ahead of the axle; None: not seen.

        Not seeing counts against a place only while it should be in sight.
        """
        if ahead_m is None or math.isnan(ahead_m):
            low_m, high_m = self._sight_m
            held = self._holds and self._votes.believed
            if not held and low_m <= self._at_m - travelled_m <= high_m:
                self._votes.cast(False)
            return
        seen_at_m = travelled_m + ahead_m
        if math.isnan(self._at_m) or abs(seen_at_m - self._at_m) > self._tolerance_m:
            if self._votes.believed:
                # one odd picture does not move what others agreed on
                self._votes.cast(False)
                if self._votes.believed:
                    return
            self.clear()
            self._at_m = seen_at_m
        # the nearer, the better it is seen
        self._at_m += 0.5 * (seen_at_m - self._at_m)
        self._votes.cast(True)
        if straight is not None:
            self._straight += 1 if straight else -1

    def clear(self) -> None:
        """Forget the place."""
        self._votes.clear()
        self._at_m = math.nan
        self._straight = 0
