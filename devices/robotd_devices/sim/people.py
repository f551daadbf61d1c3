"""People who walk: where somebody and each of the two legs are at any instant, as a function of time alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Literal

import numpy as np

from robotd.world.messages import Float64s
from robotd_devices.sim.polyline import Point

STRIDE_M = 1.3
"""Way walked from one step of the left foot to the next."""

_SWING_M = 0.2
"""How far a leg is before or behind the body at most."""
_STANCE_M = 0.1
"""How far a leg is beside the body's middle."""
LEG_RADIUS_M = 0.06
TORSO_RADIUS_M = 0.18
_HIP_SHARE = 0.5
"""Share of the height below which there are two legs rather than a torso."""
_LOOK_S = 0.2
"""Heading and gait are told from where somebody was and will be by so much, so that neither jumps."""
_MOVING_MPS = 0.05

After = Literal["back", "round", "stay"]


@dataclass(frozen=True, slots=True, eq=False)
class Walk:
    """A way in time: at `times_s` (k,), rising from 0, somebody is at `points_m` (k, 2), in between on a straight line.

    Before the first instant and after the last they stand, unless `repeats`: then the way begins anew.
    """

    times_s: Float64s
    points_m: Float64s
    repeats: bool = False
    from_s: float = 0.0
    along_m: Float64s = field(init=False)
    """Length of the way up to each of its points, (k,)."""

    def __post_init__(self) -> None:
        steps = np.hypot(*np.diff(self.points_m, axis=0).T)
        object.__setattr__(self, "along_m", np.concatenate(([0.0], np.cumsum(steps))))

    def places_m(self, when_s: Float64s) -> Float64s:
        """Where they are, float64 (n, 2)."""
        since = self._since(when_s)
        return np.stack([np.interp(since, self.times_s, self.points_m[:, axis]) for axis in (0, 1)], axis=1)

    def walked_m(self, when_s: Float64s) -> Float64s:
        """Length of the way so far, float64 (n,)."""
        since = self._since(when_s)
        rounds = np.floor(np.maximum(when_s - self.from_s, 0.0) / self.times_s[-1]) if self._goes_round else 0.0
        walked: Float64s = np.interp(since, self.times_s, self.along_m) + rounds * self.along_m[-1]
        return walked

    @property
    def top_speed_mps(self) -> float:
        """The fastest that they ever are."""
        if len(self.times_s) < 2:
            return 0.0
        return float((np.diff(self.along_m) / np.diff(self.times_s)).max())

    @property
    def _goes_round(self) -> bool:
        return self.repeats and bool(self.times_s[-1] > 0.0)

    def _since(self, when_s: Float64s) -> Float64s:
        since = np.maximum(when_s - self.from_s, 0.0)
        return since % self.times_s[-1] if self._goes_round else since


def walk_along(
    points_m: Sequence[Point], speed_mps: float, *, pause_s: float = 0.0, from_s: float = 0.0, then: After = "back"
) -> Walk:
    """The way through corners at one speed, with a pause at each; what comes `then` is `back`, `round` or `stay`."""
    ring = [np.array(point, dtype=np.float64) for point in points_m]
    if len(ring) == 1:
        return Walk(np.zeros(1), np.array(ring), from_s=from_s)
    if then == "back":
        ring += ring[-2::-1]
    elif then == "round":
        ring.append(ring[0])
    times, places = [0.0], [ring[0]]
    for here, there in pairwise(ring):
        if pause_s > 0.0:
            times.append(times[-1] + pause_s)
            places.append(here)
        times.append(times[-1] + float(np.hypot(*(there - here))) / speed_mps)
        places.append(there)
    return Walk(np.array(times), np.array(places), then != "stay", from_s)


@dataclass(frozen=True, slots=True, eq=False)
class Person:
    """Somebody on a walk. phase_rad: where in the gait they begin; `picture`: a file, or None for a drawn figure.

    greys: jacket and trousers of a drawn figure, in full light.
    """

    walk: Walk
    height_m: float = 1.7
    radius_m: float = 0.2
    phase_rad: float = 0.0
    greys: tuple[float, float] = (120.0, 60.0)
    picture: str | None = None

    def headings_rad(self, when_s: Float64s) -> tuple[Float64s, Float64s]:
        """Where they look and how fast they walk, (n,) each; somebody who stands looks the way they will go or came."""
        ahead = self.walk.places_m(when_s + _LOOK_S) - self.walk.places_m(when_s - _LOOK_S)
        speed = np.hypot(ahead[:, 0], ahead[:, 1]) / (2.0 * _LOOK_S)
        heading = np.arctan2(ahead[:, 1], ahead[:, 0])
        for at in np.flatnonzero(speed < _MOVING_MPS):
            heading[at] = self._facing_rad(float(when_s[at]))
        return heading, speed

    def gait_rad(self, when_s: Float64s) -> Float64s:
        """Phase of the gait, (n,): a whole turn is a stride."""
        phase: Float64s = self.phase_rad + math.tau / STRIDE_M * self.walk.walked_m(when_s)
        return phase

    def circles_m(self, when_s: float, at_height_m: float) -> Float64s:
        """What a plane at this height cuts: two legs (2, 3), a torso (1, 3), or nothing (0, 3) above the head."""
        if at_height_m > self.height_m:
            return np.empty((0, 3))
        when = np.array([when_s])
        place = self.walk.places_m(when)[0]
        if at_height_m > _HIP_SHARE * self.height_m:
            return np.array([(*place, TORSO_RADIUS_M)])
        heading, speed = self.headings_rad(when)
        swing_m = _SWING_M * min(1.0, float(speed[0]) / 0.6) * math.sin(float(self.gait_rad(when)[0]))
        forward = np.array((math.cos(heading[0]), math.sin(heading[0])))
        left = np.array((-forward[1], forward[0]))
        legs = [place + side * (swing_m * forward + _STANCE_M * left) for side in (1.0, -1.0)]
        return np.array([(*leg, LEG_RADIUS_M) for leg in legs])

    def _facing_rad(self, when_s: float) -> float:
        """From the nearest stretch of the way that is walked at all, later ones first; 0 where there is none."""
        walk = self.walk
        steps = np.diff(walk.points_m, axis=0)
        moving = np.flatnonzero(np.hypot(steps[:, 0], steps[:, 1]) > 0.0)
        if len(moving) == 0:
            return 0.0
        since = float(walk._since(np.array([when_s]))[0])
        later = moving[walk.times_s[moving + 1] > since]
        step = steps[later[0] if len(later) else moving[-1]]
        return math.atan2(float(step[1]), float(step[0]))


def clothed(person: Person, rng: np.random.Generator) -> Person:
    """The same person with gait and clothes drawn at random."""
    jacket, trousers = rng.uniform(40.0, 220.0), rng.uniform(20.0, 120.0)
    return replace(person, phase_rad=float(rng.uniform(0.0, math.tau)), greys=(jacket, trousers))
