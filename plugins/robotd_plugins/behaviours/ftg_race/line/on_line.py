"""The car beside its line: where along it, how far off, how much turned, and the line ahead as the car sees it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from robotd.world.geometry import wrap_rad
from robotd.world.messages import Float64s
from robotd_plugins.behaviours.ftg_race.line.profile import LineLimits, lap_s, speeds_mps
from robotd_plugins.toolkit.race_track import RaceTrack


@dataclass(frozen=True, slots=True)
class Place:
    """s_m: along the line; aside_m: to the left of it; turned_rad: course less the line's direction, left positive."""

    s_m: float
    aside_m: float
    turned_rad: float


@dataclass(frozen=True, slots=True, eq=False)
class Ahead:
    """Points of the line before the car, (k,) each, x along its course and y to its left."""

    way_m: Float64s
    """From the car, along the line."""
    x_m: Float64s
    y_m: Float64s
    turned_rad: Float64s
    """Direction of the line, from the car's course."""
    curvature_pm: Float64s


class TrackLine:
    """The line of a `RaceTrack` with the speeds that this car's own limits allow.

    Raises ValueError for a track without a line.
    """

    def __init__(self, track: RaceTrack, limits: LineLimits) -> None:
        if not track.has_line:
            raise ValueError(f"the track has no line: {track.reason}")
        self.version = track.version
        self.length_m = track.length_m
        self._n = len(track.s_m)
        self.step_m = track.length_m / self._n
        speed = speeds_mps(track.curvature_pm, self.step_m, limits)
        self.lap_s = lap_s(speed, self.step_m)
        # once more round, so that what lies ahead is one slice
        self._x, self._y, self._kappa, self._v = (
            np.concatenate((a, a)) for a in (track.x_m, track.y_m, track.curvature_pm, speed)
        )
        self._yaw = np.unwrap(np.concatenate((track.yaw_rad, track.yaw_rad)))
        self._sin, self._cos = np.sin(self._yaw), np.cos(self._yaw)

    def place(self, x_m: float, y_m: float, course_rad: float) -> Place:
        """The nearest place on the line, linear between its points."""
        n = self._n
        near = int(((self._x[:n] - x_m) ** 2 + (self._y[:n] - y_m) ** 2).argmin())
        yaw = float(self._yaw[near])
        dx, dy = x_m - float(self._x[near]), y_m - float(self._y[near])
        along = dx * math.cos(yaw) + dy * math.sin(yaw)
        aside = dy * math.cos(yaw) - dx * math.sin(yaw)
        # on the circle that the line is here, not on its tangent
        kappa = float(self._kappa[near])
        if abs(kappa) > 1e-3:
            toward = 1.0 - kappa * aside
            turn = math.atan2(kappa * along, toward)
            aside = (1.0 - math.hypot(toward, kappa * along)) / kappa
            along = turn / kappa
        along = min(max(along, -self.step_m), self.step_m)
        s = (near * self.step_m + along) % self.length_m
        return Place(s, aside, wrap_rad(course_rad - yaw - kappa * along))

    def curvature_pm(self, s_m: float) -> float:
        """Of the line, linear between its points."""
        return self._between(self._kappa, s_m)

    def speed_mps(self, s_m: float) -> float:
        """That the limits allow."""
        return self._between(self._v, s_m)

    def ahead(self, place: Place, way_m: float, most_m: float, back_m: float) -> Ahead:
        """The line before the car, for `way_m`, as the car sees it.

        The car's distance from the line is taken out little by little, as it will drive: beyond `most_m` evenly, by
        `most_m` over `back_m`, then by an e-th part over `back_m`.
        """
        first = int(place.s_m / self.step_m) + 1
        count = min(max(int(way_m / self.step_m), 2), self._n)
        at = first % self._n
        way: Float64s = np.arange(first, first + count, dtype=np.float64) * self.step_m - place.s_m
        part = slice(at, at + count)
        yaw = self._yaw[part]
        aside = abs(place.aside_m)
        even_m = max(aside / most_m - 1.0, 0.0) * back_m
        off = min(aside, most_m) * np.exp(np.minimum(even_m - way, 0.0) / back_m)
        if even_m > 0.0:
            off += np.maximum(even_m - way, 0.0) * (most_m / back_m)
        off = math.copysign(1.0, place.aside_m) * off
        # the car's own place and course
        here = self._between(self._yaw, place.s_m)
        course = here + place.turned_rad
        x0 = self._between(self._x, place.s_m) - place.aside_m * math.sin(here)
        y0 = self._between(self._y, place.s_m) + place.aside_m * math.cos(here)
        cos, sin = math.cos(course), math.sin(course)
        x = self._x[part] - off * self._sin[part] - x0
        y = self._y[part] + off * self._cos[part] - y0
        # the yaw of the line runs on where it has gone once round
        turned = yaw - (course + math.tau * round((float(yaw[0]) - course) / math.tau))
        return Ahead(way, cos * x + sin * y, cos * y - sin * x, turned, self._kappa[part])

    def _between(self, values: Float64s, s_m: float) -> float:
        at, share = divmod(s_m / self.step_m, 1.0)
        i = int(at) % self._n
        return float((1.0 - share) * values[i] + share * values[i + 1])
