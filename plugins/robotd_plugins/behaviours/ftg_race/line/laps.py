"""Lap times on the line and off it: the line is kept only as long as it is not slower than follow-the-gap was."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from robotd.world.clock import NS_PER_S

_EVERY_M = 1.0
_KEPT_M = 5000.0
_PAUSE_NS = NS_PER_S // 2
_ON_SHARE = 0.5
"""A lap counts for the line when more of its time was driven on it; for follow-the-gap when none was."""
_MOVES_MPS = 0.1


@dataclass(slots=True)
class Laps:
    """Times in seconds; `best_s` is of follow-the-gap alone, inf until a lap of it is known."""

    best_s: float = math.inf
    line_s: float = math.nan
    """Of the last lap on the line."""
    _way_m: float = 0.0
    _log: list[tuple[float, int]] = field(default_factory=list)
    _before_ns: int | None = None
    _lap_ns: int | None = None
    _s_m: float = 0.0
    _done_m: float = 0.0
    _on_ns: int = 0

    def drive(self, now_ns: int, speed_mps: float) -> None:
        """Before there is a line: the way driven, from the first motion on."""
        if not self._log:
            if abs(speed_mps) < _MOVES_MPS:
                return
            self._log.append((0.0, now_ns))
        elif self._way_m < _KEPT_M and self._before_ns is not None:
            self._way_m += abs(speed_mps) * (now_ns - self._before_ns) / NS_PER_S
            if self._way_m >= self._log[-1][0] + _EVERY_M:
                self._log.append((self._way_m, now_ns))
        self._before_ns = now_ns

    def first_lap(self, length_m: float) -> None:
        """The survey's lap was `length_m` long: its time is the first to beat."""
        if self._log and self._log[-1][0] >= length_m:
            until_ns = next(ns for way, ns in self._log if way >= length_m)
            self.best_s = min(self.best_s, (until_ns - self._log[0][1]) / NS_PER_S)
        self._log.clear()
        self._way_m = 0.0
        self.again()

    def again(self) -> None:
        """What was driven of a lap is forgotten."""
        self._lap_ns = None

    def step(self, now_ns: int, s_m: float, length_m: float, is_on: bool) -> bool:
        """Once a plan, with the place on the line; true where a lap on the line has been the slower one."""
        if self._lap_ns is None or self._before_ns is None or now_ns - self._before_ns > _PAUSE_NS:
            self._lap_ns, self._done_m, self._on_ns = now_ns, 0.0, 0
        else:
            self._done_m += (s_m - self._s_m + length_m / 2.0) % length_m - length_m / 2.0
            self._on_ns += (now_ns - self._before_ns) if is_on else 0
        self._before_ns, self._s_m = now_ns, s_m
        if self._done_m < length_m:
            return False
        lap_s, on_s = (now_ns - self._lap_ns) / NS_PER_S, self._on_ns / NS_PER_S
        self._lap_ns, self._done_m, self._on_ns = now_ns, self._done_m - length_m, 0
        if on_s == 0.0:
            self.best_s = min(self.best_s, lap_s)
        elif on_s > _ON_SHARE * lap_s:
            self.line_s = lap_s
            return lap_s > self.best_s
        return False
