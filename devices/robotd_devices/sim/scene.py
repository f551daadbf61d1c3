"""What stands and walks in a flat world at one instant, for whoever measures it or runs into it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from robotd.world.messages import Float64s
from robotd_devices.sim.maps import Card, WorldMap
from robotd_devices.sim.people import clothed

_NO_SEGMENTS = np.empty((0, 4))
_NO_CIRCLES = np.empty((0, 3))
_ON_FLOOR_M = 0.10
"""Cards that begin above this height are nothing to run into."""


@dataclass(frozen=True, slots=True, eq=False)
class Things:
    """segments_m (m, 4), circles_m (k, 3) in the middle of a stretch of time, and how far each circle goes in it.

    moves_m: (k, 2), from the stretch's beginning to its end.
    """

    segments_m: Float64s = field(default_factory=lambda: _NO_SEGMENTS)
    circles_m: Float64s = field(default_factory=lambda: _NO_CIRCLES)
    moves_m: Float64s | None = None


class Scene:
    """Walls, posts and cards of a map; boxes that come and go; people; and what a test puts there while it runs.

    `rng` dresses the people and sets their gait.
    """

    def __init__(self, world: WorldMap, rng: np.random.Generator) -> None:
        self.map = world
        self.people = tuple(clothed(person, rng) for person in world.people)
        self.top_speed_mps = max((person.walk.top_speed_mps for person in self.people), default=0.0)
        self._put: dict[str, Things] = {}
        self._edges_s = sorted({edge for box in world.boxes for edge in (box.from_s, box.until_s) if edge > 0.0})
        self._fixed: dict[tuple[float | None, ...], Things] = {}

    def put(self, name: str, things: Things) -> None:
        """Sets something there under a name, in place of what had that name."""
        self._put[name] = things
        self._fixed.clear()

    def take_away(self, name: str) -> None:
        """Removes what was put there. Raises KeyError where there is nothing of that name."""
        del self._put[name]
        self._fixed.clear()

    def next_change_s(self, when_s: float) -> float:
        """When the next box comes or goes; inf where none does."""
        return next((edge for edge in self._edges_s if edge > when_s), math.inf)

    def standing(self, when_s: float, height_m: float | None = None) -> Things:
        """Everything that does not move: as a plane at this height cuts it; None: as a robot would run into it."""
        boxes = tuple(box.from_s <= when_s < box.until_s for box in self.map.boxes)
        found = self._fixed.get((height_m, *boxes))
        if found is None:
            put = self._put.values()
            segments = [self.map.segments_m, *(things.segments_m for things in put)]
            segments += [box.segments_m for box, there in zip(self.map.boxes, boxes, strict=True) if there]
            segments += [card.segment_m[None, :] for card in self.map.cards if _is_cut(card, height_m)]
            circles = [self.map.circles_m, *(things.circles_m for things in put)]
            found = self._fixed[(height_m, *boxes)] = Things(np.vstack(segments), np.vstack(circles))
        return found

    def seen(self, from_s: float, to_s: float, height_m: float) -> Things:
        """Everything as a plane at this height cuts it, from one instant to another."""
        standing = self.standing(to_s, height_m)
        if not self.people:
            return standing
        begin, end = (
            np.vstack([person.circles_m(when_s, height_m) for person in self.people]) for when_s in (from_s, to_s)
        )
        moves_m = np.vstack((np.zeros((len(standing.circles_m), 2)), (end - begin)[:, :2]))
        return Things(standing.segments_m, np.vstack((standing.circles_m, (begin + end) / 2.0)), moves_m)

    def people_circles_m(self, when_s: float) -> Float64s:
        """The discs of all people, (n, 3)."""
        when = np.array([when_s])
        return np.array([(*person.walk.places_m(when)[0], person.radius_m) for person in self.people]).reshape(-1, 3)


def _is_cut(card: Card, height_m: float | None) -> bool:
    if height_m is None:
        return card.bottom_m <= _ON_FLOOR_M
    return card.bottom_m <= height_m <= card.bottom_m + card.height_m
