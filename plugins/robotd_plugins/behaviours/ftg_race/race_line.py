"""The fan of candidate paths, each one bend and then another: how far each is free, and which is the quickest.

A path leaves the car's middle along its course with curvature k1 for s1 metres and goes on with k2. The fan is made
once; a plan looks up the free distance of all its points in one profile and compares closed-form times, so that the
car swings wide before a corner and lets the bend open behind it where there is room. (A fan of precomputed paths:
von Hundelshausen et al., Driving with Tentacles, J. Field Robotics 2008. The times and the two bends are ours.)
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from robotd.world.messages import Float64s
from robotd_plugins.behaviours.ftg_race.free_space import BEARINGS, HALF, STEP_RAD

_BACK_RAD: Final = 3.3
"""A path that has turned so far meets itself: it ends there."""
_LEAST_MPS: Final = 0.05
_MOST_GAIN_S: Final = 0.2


@dataclass(frozen=True, slots=True)
class RaceLimits:
    """What the tyres may be asked for, in m/s and m/s^2."""

    top_mps: float
    lateral_mps2: float
    """In a bend that is planned."""
    accel_mps2: float
    brake_mps2: float
    """Towards the end of what is free."""
    corner_brake_mps2: float
    """On a straight towards a bend; on the way through a bend less, see `grip_mps2`."""
    grip_mps2: float
    """Radius of the friction circle."""


class Fan:
    """All candidate paths of one car, mirrored exactly about straight ahead.

    least_radius_m: turning circle of its middle. reach_m: length of each path.
    """

    def __init__(self, least_radius_m: float, reach_m: float, curvatures: int, bends_m: tuple[float, ...]) -> None:
        most = 1.0 / least_radius_m
        half = most * np.linspace(0.0, 1.0, curvatures + 1)[1:] ** 1.6
        ks = np.concatenate((-half[::-1], [0.0], half)).tolist()
        rows = [(k, reach_m, k) for k in ks]
        rows += [(k1, s1, k2) for s1 in bends_m for k1 in ks for k2 in ks if k1 != k2 and abs(k1) <= 0.75 * most]
        k1, s1, k2 = (np.array(column) for column in zip(*rows, strict=True))
        way = np.concatenate(
            (np.arange(0.15, 1.5, 0.15), np.arange(1.5, 4.0, 0.25), np.arange(4.0, reach_m + 1e-9, 0.5))
        )
        x, y, turned = _two_bends(k1[:, None], s1[:, None], k2[:, None], way[None, :])
        index = np.rint(np.arctan2(y, x) / STEP_RAD).astype(np.intp) + HALF
        ends = (np.abs(turned) > _BACK_RAD) | (np.abs(index - HALF) > HALF)
        # beyond its end a path is blocked, whatever the profile says; so is the column behind the last point: the reach
        radius = np.where(np.maximum.accumulate(ends, axis=1), np.inf, np.hypot(x, y))
        self._radius_m = np.pad(radius, ((0, 0), (0, 1)), constant_values=np.inf)
        self._index = np.pad(np.clip(index, 0, BEARINGS - 1), ((0, 0), (0, 1)))
        self._way_m = np.concatenate(([0.0], way, [reach_m]))
        self._x_m, self._y_m, self._turned_rad = x, y, turned
        # point by point, for `gained_s`
        self._xs_m, self._ys_m = np.ascontiguousarray(x.T), np.ascontiguousarray(y.T)
        self._seen_m = np.empty(self._index.shape)
        self._blocked = np.empty(self._index.shape, dtype=np.bool_)
        self.k1_pm: Float64s = k1
        self.k2_pm: Float64s = k2
        self._size1_pm, self._size2_pm = np.abs(k1), np.abs(k2)
        self._radius1_m = 1.0 / np.maximum(self._size1_pm, 1e-6)
        self._radius2_m = 1.0 / np.maximum(self._size2_pm, 1e-6)
        self._first_m = np.where(s1 < reach_m, s1, 1e-3)
        self._held_for = (0.0, 0.0)
        self._held = (k1, k2)
        self._alike: dict[tuple[float, float], NDArray[np.intp]] = {}

    def __len__(self) -> int:
        return len(self.k1_pm)

    def alike(self, path: int, within_pm: float) -> NDArray[np.intp]:
        """Paths whose first bend differs by less than `within_pm`."""
        key = (float(self.k1_pm[path]), within_pm)
        found = self._alike.get(key)
        if found is None:
            found = self._alike[key] = np.flatnonzero(np.abs(self.k1_pm - key[0]) < within_pm)
        return found

    def points_m(self, path: int, free_m: float) -> list[tuple[float, float]]:
        """The part of a path that is free, in the frame of the car's middle."""
        n = int(np.searchsorted(self._way_m[1:-1], free_m, side="right"))
        return [(0.0, 0.0), *zip(self._x_m[path, :n].tolist(), self._y_m[path, :n].tolist(), strict=True)]

    def free_m(self, profile: Float64s) -> Float64s:
        """How far along each path the car's middle may go, (len,)."""
        profile.take(self._index, out=self._seen_m, mode="clip")
        np.less_equal(self._seen_m, self._radius_m, out=self._blocked)
        free: Float64s = self._way_m.take(self._blocked.argmax(axis=1))
        return free

    def times_s(
        self, free_m: Float64s, speed_mps: float, limits: RaceLimits, over_m: float, short_m: float
    ) -> tuple[Float64s, Float64s]:
        """Time of each path's first `over_m`, less its gain on the quickest; square of the speed to enter it with.

        short_m: the car must be able to stop so far before the end of what is free. Speeds are held by friction in
        both bends, by braking towards the second, and by braking towards the end; one that is over must brake at once.
        """
        lateral, accel, brake = limits.lateral_mps2, 2.0 * limits.accel_mps2, 2.0 * limits.brake_mps2
        top2, now2 = limits.top_mps**2, speed_mps**2
        first = self._first_m
        c1, c2 = self._held2(lateral, top2)
        left = np.maximum(free_m - short_m, 0.0)
        # backwards: at the change of bend, and now
        u2 = np.minimum(c2, brake * np.maximum(left - first, 0.0))
        used = np.minimum(self._size1_pm * (now2 / limits.grip_mps2), 1.0)
        slower = np.maximum(2.0 * limits.corner_brake_mps2 * np.sqrt(1.0 - used * used), 0.3 * brake)
        u1 = np.minimum(np.minimum(c1, u2 + slower * first), brake * left)
        # forwards from the present speed
        v1 = np.minimum(u1, now2)
        v2 = np.minimum(np.minimum(u2, c1), v1 + accel * first)
        then = np.maximum(over_m - first, 0.0)
        v3 = np.minimum(np.minimum(c2, v2 + accel * then), brake * np.maximum(left - over_m, 0.0))
        r2 = np.sqrt(v2) + _LEAST_MPS
        time = first / (np.sqrt(v1) + r2) + then / (r2 + np.sqrt(v3))
        time *= 2.0
        time -= self._gained_s(time, v3, free_m, over_m)
        return time, u1

    def _held2(self, lateral_mps2: float, top2: float) -> tuple[Float64s, Float64s]:
        """Squares of the speeds that friction holds in both bends; kept while the limits stay."""
        if self._held_for != (lateral_mps2, top2):
            self._held_for = (lateral_mps2, top2)
            self._held = (
                np.minimum(self._radius1_m * lateral_mps2, top2),
                np.minimum(self._radius2_m * lateral_mps2, top2),
            )
        return self._held

    def _gained_s(self, time_s: Float64s, then2: Float64s, free_m: Float64s, over_m: float) -> Float64s:
        """What a path is ahead of the quickest one after `over_m`, measured the way that one heads there, in seconds.

        All have come equally far along themselves, but not along the track: the inner one is farther round the bend.
        """
        at = min(int(self._way_m[1:-1].searchsorted(over_m)), len(self._xs_m) - 1)
        quickest = int(time_s.argmin())
        heading = float(self._turned_rad[quickest, at])
        along: Float64s = math.cos(heading) * self._xs_m[at] + math.sin(heading) * self._ys_m[at]
        along -= along[quickest]
        along *= 1.0 / max(math.sqrt(float(then2[quickest])), 1.0)
        np.minimum(np.maximum(along, -_MOST_GAIN_S, out=along), _MOST_GAIN_S, out=along)
        along *= free_m > over_m
        return along


def _two_bends(k1: Float64s, s1: Float64s, k2: Float64s, s: Float64s) -> tuple[Float64s, Float64s, Float64s]:
    """Positions and headings at way s along a bend k1 for s1, then a bend k2."""
    x1, y1, turn1 = _bend(k1, np.minimum(s, s1))
    x2, y2, turn2 = _bend(k2, np.maximum(s - s1, 0.0))
    cos, sin = np.cos(turn1), np.sin(turn1)
    return x1 + cos * x2 - sin * y2, y1 + sin * x2 + cos * y2, turn1 + turn2


def _bend(k: Float64s, s: Float64s) -> tuple[Float64s, Float64s, Float64s]:
    turn = k * s
    straight = np.abs(k) < 1e-9
    safe = np.where(straight, 1.0, k)
    return np.where(straight, s, np.sin(turn) / safe), np.where(straight, 0.0, (1.0 - np.cos(turn)) / safe), turn
