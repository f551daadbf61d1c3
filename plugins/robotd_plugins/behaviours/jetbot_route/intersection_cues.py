"""What one lidar scan says about standing on a crossing, by two strategies: opposite markers, and opposite open space.

A cue is evidence, not a decision: people's legs stand opposite each other too, and a door opens a side. Whoever fuses
cues weighs this one against the camera's and the distance travelled. Bearings are in base (0 ahead, left positive).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from robotd import Config, LidarScan
from robotd.world.geometry import wrap_rad
from robotd.world.messages import Float64s

Bools: TypeAlias = NDArray[np.bool_]

_DIAGONAL_RAD = math.pi / 4
_BREAK_RAD = 0.5


@dataclass(frozen=True, slots=True)
class Sighting:
    """Something that speaks for or against a crossing. width_m: nan for what has no width (an open side: range inf)."""

    what: str
    bearing_rad: float
    range_m: float
    width_m: float = math.nan


@dataclass(frozen=True, slots=True)
class LidarCue:
    """The answer of one strategy. `seen`: True, False, or None where the scan does not tell."""

    strategy: str
    seen: bool | None
    reason: str
    evidence: tuple[Sighting, ...] = ()


class IntersectionDetector(Protocol):
    """A strategy: a scan in, a cue out; no memory."""

    def look(self, scan: LidarScan) -> LidarCue:
        """What the scan says."""


class OppositeMarkersConfig(Config):
    """Two narrow things, alone in their direction, on opposite sides of the robot and near."""

    range_min_m: float = Field(default=0.25, gt=0.0)
    """A marker is at least this far from the base's origin."""
    range_max_m: float = Field(default=0.35, gt=0.0)
    """A marker is at most this far from the base's origin."""
    width_min_m: float = Field(default=0.06, ge=0.0)
    """Narrower things are no markers (the seed: 15 points, 7 cm at one point a degree)."""
    width_max_m: float = Field(default=0.20, gt=0.0)
    """Wider things are no markers but walls and boxes."""
    gap_m: float = Field(default=0.10, gt=0.0)
    """Neighbouring points farther apart than this belong to two things."""
    points_min: int = Field(default=3, ge=2)
    """A thing of fewer points is noise."""
    opposite_tolerance_rad: float = Field(default=0.14, gt=0.0, le=math.pi / 4)
    """By how much the angle between the two may differ from half a turn."""
    diagonals_only: bool = True
    """Markers stand on the crossing's corners: only bearings near 45, 135, 225, 315 degrees count."""
    diagonal_tolerance_rad: float = Field(default=0.26, gt=0.0, le=math.pi / 4)
    """How near to a diagonal."""
    measured_share_min: float = Field(default=0.6, gt=0.0, le=1.0)
    """A scan that measured less than this share of the whole circle does not tell."""

    @model_validator(mode="after")
    def _spans_are_ordered(self) -> OppositeMarkersConfig:
        if self.range_min_m >= self.range_max_m:
            raise ValueError(f"range_min_m {self.range_min_m} must be below range_max_m {self.range_max_m}")
        if self.width_min_m >= self.width_max_m:
            raise ValueError(f"width_min_m {self.width_min_m} must be below width_max_m {self.width_max_m}")
        return self


class OpenSpaceConfig(Config):
    """Both sides open, and corners that show that elsewhere they are not."""

    open_from_m: float = Field(default=0.6, gt=0.0)
    """A beam to the side is open when nothing is nearer than this."""
    side_half_rad: float = Field(default=0.26, gt=0.0, le=math.pi / 4)
    """Half of the angle around straight left and straight right that must be open."""
    open_share_min: float = Field(default=0.8, gt=0.0, le=1.0)
    """Share of a side's measured beams that must be open."""
    corner_within_m: float = Field(default=0.6, gt=0.0)
    """A corner counts when something stands there at most this far away."""
    corner_half_rad: float = Field(default=0.35, gt=0.0, le=math.pi / 4)
    """Half of the angle around each diagonal that is a corner."""
    corners_min: int = Field(default=2, ge=1, le=4)
    """With fewer corners it is open ground, which says nothing."""
    measured_share_min: float = Field(default=0.5, gt=0.0, le=1.0)
    """A side of which less than this share was measured does not tell."""


class SimpleOppositeDetector:
    """The seed's detector by its name: two markers (flags) on opposite sides, a quarter to a third of a metre away.

    Unlike the seed, which counted scan points in windows of 20 degrees: a thing is a run of points without a gap, its
    size is in metres and has an upper bound, its bearing is its middle, and touching beams are not markers.
    """

    name = "opposite_markers"

    def __init__(self, config: OppositeMarkersConfig | None = None) -> None:
        self.config = config or OppositeMarkersConfig()

    def look(self, scan: LidarScan) -> LidarCue:
        """Whether the base's origin is between two markers."""
        config = self.config
        polar = _polar_base(scan)
        if polar.covered_rad() < config.measured_share_min * math.tau:
            told = f"only {math.degrees(polar.covered_rad()):.0f} degrees were measured"
            return LidarCue(self.name, None, told)
        things = [thing for thing in _things(polar, config.gap_m) if thing.points >= config.points_min]
        markers = [thing for thing in things if not _why_no_marker(thing, config)]
        pairs = [
            (abs(wrap_rad(a.bearing_rad - b.bearing_rad - math.pi)), a, b)
            for index, a in enumerate(markers)
            for b in markers[index + 1 :]
        ]
        off_rad, *pair = min(pairs, key=lambda p: p[0], default=(math.inf,))
        if off_rad <= config.opposite_tolerance_rad:
            told = f"two markers {math.degrees(math.pi - off_rad):.0f} degrees apart"
            return LidarCue(self.name, True, told, tuple(_sighting("marker", thing) for thing in pair))
        near = [thing for thing in things if thing.range_m <= 1.5 * config.range_max_m]
        evidence = tuple(_sighting(_why_no_marker(thing, config) or "marker", thing) for thing in near)
        if len(markers) >= 2:
            off_deg = math.degrees(off_rad)
            told = f"{len(markers)} markers, none opposite another; the best pair is off by {off_deg:.0f} degrees"
        elif markers:
            told = "one marker, and nothing opposite"
        else:
            told = "no marker"
        return LidarCue(self.name, False, told, evidence)


class OpenSpaceDetector:
    """What the seed's text describes: open space to the left and to the right, where corners are not open."""

    name = "open_space"

    def __init__(self, config: OpenSpaceConfig | None = None) -> None:
        self.config = config or OpenSpaceConfig()

    def look(self, scan: LidarScan) -> LidarCue:
        """Whether both sides are open between standing corners."""
        config = self.config
        polar = _polar_base(scan)
        shares, evidence = [], []
        for name, bearing_rad in (("left", math.pi / 2), ("right", -math.pi / 2)):
            there = polar.around(bearing_rad, config.side_half_rad)
            measured = there & polar.measured
            if not there.any() or measured.sum() < config.measured_share_min * there.sum():
                return LidarCue(self.name, None, f"the {name} side was not measured")
            ranges_m = polar.range_m[measured]
            shares.append(float(np.mean(ranges_m >= config.open_from_m)))
            evidence.append(Sighting(f"{name} side", bearing_rad, float(ranges_m.min())))
        is_open = [share >= config.open_share_min for share in shares]
        if not all(is_open):
            closed = " and ".join(side for side, free in zip(("left", "right"), is_open, strict=True) if not free)
            return LidarCue(self.name, False, f"the {closed} side is not open", tuple(evidence))
        corners = []
        for bearing_rad in (_DIAGONAL_RAD, -_DIAGONAL_RAD, 3 * _DIAGONAL_RAD, -3 * _DIAGONAL_RAD):
            there = polar.around(bearing_rad, config.corner_half_rad) & polar.measured
            nearest_m = float(np.min(polar.range_m[there], initial=math.inf))
            if nearest_m <= config.corner_within_m:
                corners.append(Sighting("corner", bearing_rad, nearest_m))
        evidence += corners
        if len(corners) < config.corners_min:
            told = f"both sides are open and only {len(corners)} corners stand: this may be open ground"
            return LidarCue(self.name, None, told, tuple(evidence))
        return LidarCue(self.name, True, f"both sides are open between {len(corners)} corners", tuple(evidence))


#: The strategies by the name that a config gives.
DETECTORS: dict[str, Callable[[], IntersectionDetector]] = {
    SimpleOppositeDetector.name: SimpleOppositeDetector,
    OpenSpaceDetector.name: OpenSpaceDetector,
}


# -------------------------------------------------------------------------------------------------- geometry


@dataclass(frozen=True, slots=True, eq=False)
class _Polar:
    """A scan around the base's origin, in the order of bearings. All (n,). range_m: inf where nothing is within range;
    measured: neither nan nor touching. step_rad: the angle between two beams."""

    bearing_rad: Float64s
    range_m: Float64s
    measured: Bools
    step_rad: float

    def covered_rad(self) -> float:
        """How much of the circle was measured."""
        return float(self.measured.sum()) * self.step_rad

    def around(self, bearing_rad: float, half_rad: float) -> Bools:
        """Beams within an angle of a bearing."""
        off = np.mod(self.bearing_rad - bearing_rad + math.pi, math.tau) - math.pi
        return np.abs(off) <= half_rad


@dataclass(frozen=True, slots=True)
class _Thing:
    """A run of points without a gap; bearing and range of its middle."""

    bearing_rad: float
    range_m: float
    width_m: float
    points: int


def _polar_base(scan: LidarScan) -> _Polar:
    ranges = scan.ranges_m.astype(np.float64)
    bearing = scan.angles_rad.astype(np.float64) + scan.yaw_rad
    hit = np.isfinite(ranges) & (ranges >= scan.range_min_m) & (ranges > 0.0)
    reach = np.where(hit, ranges, 0.0)
    x = scan.x_m + reach * np.cos(bearing)
    y = scan.y_m + reach * np.sin(bearing)
    # what was not hit is far away or unknown: where the lidar stands on the base makes no difference to its bearing
    at_rad = np.where(hit, np.arctan2(y, x), np.mod(bearing + math.pi, math.tau) - math.pi)
    range_m = np.where(hit, np.hypot(x, y), np.where(np.isposinf(ranges), math.inf, math.nan))
    order = np.argsort(at_rad, kind="stable")
    steps = np.abs(np.diff(scan.angles_rad.astype(np.float64)))
    step_rad = float(np.median(steps)) if len(steps) else 0.0
    measured: Bools = hit | np.isposinf(ranges)
    return _Polar(at_rad[order], range_m[order], measured[order], step_rad)


def _things(polar: _Polar, gap_m: float) -> list[_Thing]:
    """Runs of neighbouring hits that lie at most `gap_m` apart, once round.

    A beam that hit nothing ends no run: a lidar drops some, and the gap tells.
    """
    hit = polar.measured & np.isfinite(polar.range_m)
    bearing, range_m = polar.bearing_rad[hit], polar.range_m[hit]
    if not len(range_m):
        return []
    x, y = range_m * np.cos(bearing), range_m * np.sin(bearing)
    apart = np.hypot(x - np.roll(x, 1), y - np.roll(y, 1)) > gap_m
    # the two ends of a lone narrow thing are near each other as well, but not as neighbours
    apart |= np.mod(bearing - np.roll(bearing, 1), math.tau) > _BREAK_RAD
    firsts = np.flatnonzero(apart)
    if not len(firsts):
        # all around is one thing
        return [_Thing(0.0, float(range_m.mean()), math.inf, len(range_m))]
    # begin with a run's first point, so that a run across the seam is one
    x, y = np.roll(x, -firsts[0]), np.roll(y, -firsts[0])
    begins = firsts - firsts[0]
    counts = np.diff(begins, append=len(x))
    ends = begins + counts - 1
    mid_x, mid_y = np.add.reduceat(x, begins) / counts, np.add.reduceat(y, begins) / counts
    # on either side the thing reaches half a beam beyond its last hit, in the mean
    widths = np.hypot(x[ends] - x[begins], y[ends] - y[begins]) + polar.step_rad * np.hypot(mid_x, mid_y)
    return [
        _Thing(math.atan2(my, mx), math.hypot(mx, my), float(width), int(count))
        for mx, my, width, count in zip(mid_x.tolist(), mid_y.tolist(), widths, counts, strict=True)
    ]


def _why_no_marker(thing: _Thing, config: OppositeMarkersConfig) -> str:
    """Why a thing is no marker; empty where it is one."""
    if not config.range_min_m <= thing.range_m <= config.range_max_m:
        return "too near" if thing.range_m < config.range_min_m else "too far"
    if not config.width_min_m <= thing.width_m <= config.width_max_m:
        return "too narrow" if thing.width_m < config.width_min_m else "too wide"
    off_rad = abs(math.remainder(thing.bearing_rad - _DIAGONAL_RAD, math.pi / 2))
    if config.diagonals_only and off_rad > config.diagonal_tolerance_rad:
        return "off the diagonals"
    return ""


def _sighting(what: str, thing: _Thing) -> Sighting:
    return Sighting(what, thing.bearing_rad, thing.range_m, thing.width_m)
