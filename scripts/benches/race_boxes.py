"""Boxes on the track of a car that races on its learned line: they appear in its sight, or stand behind a bend."""

from __future__ import annotations

import copy
import math
import random
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benches.race_cases import BOX_HALF_M, stopping_m
from benches.race_drivers import Behaving
from benches.race_plant import Conditions, Floats, Ground, Race
from robotd_devices.sim.single_track import RaceCar, RaceTrack

_ASIDE_M = 0.4
"""Of a box's middle beside the way that the car took a lap before, at most."""
_SPARE_M = 1.0
_NEAREST_M, _FARTHEST_M = 12.0, 2.0
"""A box is put at least so far ahead of the car, and at most so much less than a lap."""
_LOOK_M, _LOOK_STEP_M = 14.0, 0.2
_BLINDEST = 0.1
"""A box behind a bend stands where, of all places, the car sees it so late."""
_ROOM_M = 0.65
"""Beside a box that may be passed: the car, what it keeps beside itself, and a little."""
_SHORT_S = 1.0
"""The line counts as driven towards a box until so long before it counts; then it may have been seen."""
_NEAR_M = 2.0
"""A box that stands counts from here at the latest, however slowly the car comes."""
_GONE_BY_M, _AFTER_S, _LAPS = 2.0, 12.0, 7


@dataclass(slots=True)
class Lap:
    """One lap as it was driven: base, speed, and the way since its beginning, a point each physics step."""

    poses: list[tuple[float, float, float, float]] = field(default_factory=list)
    at: Floats = field(default_factory=lambda: np.zeros((0, 4)))
    way_m: Floats = field(default_factory=lambda: np.zeros(0))
    length_m: float = 0.0

    def close(self) -> None:
        """The lap is complete."""
        self.at = np.array(self.poses)
        steps = np.hypot(np.diff(self.at[:, 0]), np.diff(self.at[:, 1]))
        self.way_m = np.concatenate(([0.0], np.cumsum(steps)))
        first, last = self.at[0], self.at[-1]
        self.length_m = float(self.way_m[-1] + math.hypot(first[0] - last[0], first[1] - last[1]))

    def nearest(self, x_m: float, y_m: float) -> int:
        """The point nearest to a place."""
        return int(((self.at[:, 0] - x_m) ** 2 + (self.at[:, 1] - y_m) ** 2).argmin())

    def index(self, way_m: Floats) -> NDArray[np.intp]:
        """Of the points at ways, which may be of another round."""
        return np.searchsorted(self.way_m, way_m % self.length_m).clip(0, len(self.way_m) - 1)


@dataclass(frozen=True, slots=True)
class Place:
    """Where a box may be: its point of the lap, its middle on the map; how long before it the car sees it all, or
    anything of it, and how long before it the car must brake to stand. half_m: of the box along the way.
    """

    point: int
    x_m: float
    y_m: float
    half_m: float
    seen_m: float
    seen_part_m: float
    needed_m: float


def places(
    ground: Ground, car: RaceCar, conditions: Conditions, lap: Lap, aside_m: float, room_m: float
) -> list[Place]:
    """All places `aside_m` to the left of the way of a lap where a box stands free on the track with room beside it."""
    found = []
    back_m = np.arange(_LOOK_STEP_M, _LOOK_M, _LOOK_STEP_M)
    for way in np.arange(0.0, lap.length_m, 0.5):
        point = int(lap.index(np.array([way]))[0])
        x, y, yaw, _ = lap.at[point]
        x, y = float(x - aside_m * math.sin(yaw)), float(y + aside_m * math.cos(yaw))
        half = BOX_HALF_M * (abs(math.cos(yaw)) + abs(math.sin(yaw)))
        beside = ground.ranges_m(x, y, yaw + np.array([0.5, -0.5]) * math.pi, 9.0) - half
        if beside.min() < 0.05 or beside.max() < room_m:
            continue
        before = lap.at[lap.index(way - back_m)]
        parts = seen_parts(ground, before[:, :3], car.rear_m, (x, y), yaw)
        whole, part = (_without_a_break(back_m, seen) for seen in (parts.all(axis=0), parts.any(axis=0)))
        gap = back_m - car.footprint_m()[0][0] - half
        needed = gap <= [stopping_m(car, conditions, float(v)) for v in before[:, 3]]
        found.append(Place(point, x, y, half, whole, part, float(back_m[needed].max(initial=0.0))))
    return found


def _without_a_break(back_m: Floats, seen: NDArray[np.bool_]) -> float:
    """From how far on it is seen at every step."""
    return float(back_m[-1] if seen.all() else back_m[int(seen.argmin())] - _LOOK_STEP_M)


def seen_parts(
    ground: Ground, poses: Floats, lidar_x_m: float, box: tuple[float, float], yaw_rad: float
) -> NDArray[np.bool_]:
    """(3, n): what the lidar sees of a box from poses of base (n, 3): its middle and both its ends across `yaw_rad`."""
    x = poses[:, 0] + lidar_x_m * np.cos(poses[:, 2])
    y = poses[:, 1] + lidar_x_m * np.sin(poses[:, 2])
    seen = np.zeros((3, len(poses)), dtype=np.bool_)
    for row, share in enumerate((-1.0, 0.0, 1.0)):
        dx = box[0] - share * BOX_HALF_M * math.sin(yaw_rad) - x
        dy = box[1] + share * BOX_HALF_M * math.cos(yaw_rad) - y
        seen[row] = ground.ranges_m(x, y, np.arctan2(dy, dx), 30.0) >= np.hypot(dx, dy) - 0.05
    return seen


def chosen(found: list[Place], lap: Lap, at_m: float, stands: bool, rng: random.Random) -> Place | None:
    """One of the places ahead of a car at `at_m`: the blindest for a box that stands, one seen in time otherwise."""
    ahead = [
        place
        for place in found
        if _NEAREST_M <= (lap.way_m[place.point] - at_m) % lap.length_m <= lap.length_m - _FARTHEST_M
    ]
    if stands:
        ahead.sort(key=lambda place: place.seen_part_m - place.needed_m)
        ahead = ahead[: max(1, round(_BLINDEST * len(ahead)))] if ahead else []
    else:
        ahead = [place for place in ahead if place.seen_m >= place.needed_m + _SPARE_M]
    return rng.choice(ahead) if ahead else None


class Watch:
    """Lets the car learn, drive one lap on its line, and puts the box on its way in the next."""

    def __init__(self, race: Race, driver: Behaving, rng: random.Random, stands: bool, blocks: bool) -> None:
        self.race, self.driver, self._rng = race, driver, rng
        self.stands, self.blocks = stands, blocks
        self._aside_m = rng.uniform(-_ASIDE_M, _ASIDE_M)
        self._spare_m = 0.0 if stands else rng.uniform(0.0, _SPARE_M)
        self._from_m: float | None = None
        self._lap = Lap()
        self._found: list[Place] | None = None
        self.place: Place | None = None
        self.told: dict[str, Any] = {}
        """Of the instant from which the box counts."""
        self.passed = self.stood = False
        self._on_line_s = -math.inf

    def step(self, now_s: float, pose: tuple[float, float, float], track: RaceTrack) -> None:
        if self.driver.is_on_line:
            self._on_line_s = now_s
        if self._found is None:
            self._record(pose, track)
            return
        here = float(self._lap.way_m[self._lap.nearest(pose[0], pose[1])])
        if self.place is None:
            self.place = chosen(self._found, self._lap, here, self.stands, self._rng)
            if self.place is not None and self.stands:
                self._put(self.place)
            return
        length = self._lap.length_m
        way = (float(self._lap.way_m[self.place.point]) - here) % length
        if not self.told:
            gap = way - self.race.car.footprint_m()[0][0] - self.place.half_m
            needed = stopping_m(self.race.car, self.race.conditions, track.vx_mps) + self._spare_m
            if gap <= (max(needed, _NEAR_M) if self.stands else needed):
                self._count(now_s, pose, track, gap)
            return
        self.passed |= _GONE_BY_M < length - way < _NEAREST_M
        self.stood |= track.vx_mps < 0.1

    def over(self, now_s: float, track: RaceTrack) -> bool:
        """Passed, or long enough after the box counts, or the line was not driven for a lap."""
        if not self.told:
            return self.race.progress_m > _LAPS * self.race.length_m
        return self.passed or now_s > self.told["s"] + _AFTER_S

    def _record(self, pose: tuple[float, float, float], track: RaceTrack) -> None:
        if self._from_m is None:
            if not self.driver.is_on_line:
                return
            self._from_m = self.race.progress_m
        self._lap.poses.append((*pose, track.vx_mps))
        if self.race.progress_m >= self._from_m + self.race.length_m:
            self._lap.close()
            race = self.race
            room = 0.0 if self.blocks else _ROOM_M
            self._found = places(race.ground, race.car, race.conditions, self._lap, self._aside_m, room)

    def _count(self, now_s: float, pose: tuple[float, float, float], track: RaceTrack, gap_m: float) -> None:
        assert self.place is not None
        yaw = float(self._lap.at[self.place.point, 2])
        box = (self.place.x_m, self.place.y_m)
        if not self.stands:
            if not seen_parts(self.race.ground, np.array([pose]), self.race.car.rear_m, box, yaw).all():
                # it would appear in a blind place: another is looked for
                self.place = None
                return
            self._put(self.place)
        self.told = {
            "s": now_s, "speed_mps": track.vx_mps, "gap_m": gap_m, "on_line": now_s - self._on_line_s < _SHORT_S,
            "seen_m": self.place.seen_m, "seen_part_m": self.place.seen_part_m, "needed_m": self.place.needed_m,
            "box": box,
        }  # fmt: skip

    def _put(self, place: Place) -> None:
        """One box, or a row of them from wall to wall."""
        yaw = float(self._lap.at[place.point, 2])
        at = [(place.x_m, place.y_m)]
        if self.blocks:
            sides = self.race.ground.ranges_m(place.x_m, place.y_m, yaw + np.array([0.5, -0.5]) * math.pi, 9.0)
            for side, room in zip((1.0, -1.0), sides, strict=True):
                for step in range(1, math.ceil(room / (2.0 * BOX_HALF_M)) + 1):
                    off = side * min(step * 2.0 * BOX_HALF_M, float(room))
                    at.append((place.x_m - off * math.sin(yaw), place.y_m + off * math.cos(yaw)))
        self.race.ground.add_boxes(at, BOX_HALF_M)


def box_on_the_line(ground: Ground, car: RaceCar, seed: int, **keys: Any) -> dict[str, Any]:
    """One car that learns its line, and in its second lap on it a box: every third stands behind a bend, the others
    appear where the car sees them, farther off than it needs to stop; half of all block the track from wall to wall.
    """
    rng = random.Random(f"learned box {seed}")
    stands, blocks = seed % 3 == 0, rng.random() < 0.5
    race = Race(copy.copy(ground), car, Conditions(seed=seed))
    driver = Behaving(car, learn=True, **keys)
    watch = Watch(race, driver, rng, stands, blocks)
    run = race.drive(driver, _LAPS + 3, limit_s=_LAPS * 300.0, stop_when=watch.over, on_step=watch.step)
    return {
        "stands": stands, "blocks": blocks, **watch.told, "passed": watch.passed, "stood": watch.stood,
        "crashed": run.crashed, "unfinished": not watch.told and not run.crashed, "clearance_m": run.clearance_m,
        "laps_s": run.laps_s, "failed": driver.failed,
    }  # fmt: skip
