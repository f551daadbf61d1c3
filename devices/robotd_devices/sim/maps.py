"""From a map file to the plain geometry of a flat world: walls, posts, floor lines and where the robot starts."""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from pydantic import Field, ValidationError, model_validator

from robotd.authoring.config import Config
from robotd.world.messages import Float64s

Point: TypeAlias = tuple[float, float]

_ARC_STEP_RAD = math.radians(4.0)


class MapError(ValueError):
    """A map that cannot be used; the message names the file, the place and the mend."""


class StartPose(Config):
    """Where the base stands when the world opens."""

    x_m: float = 0.0
    y_m: float = 0.0
    yaw_rad: float = 0.0


class PolylineEntry(Config):
    """What walls and tape have in common."""

    points_m: tuple[Point, ...] = Field(min_length=2)
    """Corners in the map frame, in metres; of tape, those of its middle."""
    closed: bool = False
    """Joins the last corner to the first."""


class WallEntry(PolylineEntry):
    """A wall without thickness along a polyline."""


class PostEntry(Config):
    """A round post."""

    x_m: float
    y_m: float
    radius_m: float = Field(gt=0.0, le=10.0)


class LineEntry(PolylineEntry):
    """Tape on the floor along a polyline; it may end anywhere and cross other tape."""

    width_m: float = Field(default=0.05, gt=0.0, le=1.0)
    """Width of the tape."""
    corner_radius_m: float = Field(default=0.0, ge=0.0, le=10.0)
    """Corners become arcs of this radius (smaller where the sides are too short for it)."""


class MapFile(Config):
    """The content of one file in `maps/`."""

    name: str = "map"
    start: StartPose = StartPose()
    walls: tuple[WallEntry, ...] = ()
    posts: tuple[PostEntry, ...] = ()
    lines: tuple[LineEntry, ...] = ()

    @model_validator(mode="after")
    def _no_repeated_corner(self) -> MapFile:
        named = [(f"walls[{index}]", wall.points_m) for index, wall in enumerate(self.walls)]
        named += [(f"lines[{index}]", line.points_m) for index, line in enumerate(self.lines)]
        for place, points_m in named:
            for at in range(1, len(points_m)):
                if points_m[at] == points_m[at - 1]:
                    raise ValueError(f"{place}.points_m[{at}] repeats the corner before it: remove one")
        return self


@dataclass(frozen=True, slots=True, eq=False)
class FloorLine:
    """One tape after its corners were rounded: `points_m` float64 (n, 2); a closed line repeats its first point."""

    points_m: Float64s
    width_m: float = 0.05
    closed: bool = False

    @property
    def segments_m(self) -> Float64s:
        """(n - 1, 4): x0, y0, x1, y1 of each straight piece."""
        return np.hstack((self.points_m[:-1], self.points_m[1:]))


@dataclass(frozen=True, slots=True, eq=False)
class WorldMap:
    """Geometry in the map frame, metres.

    segments_m: float64 (m, 4), x0, y0, x1, y1 of each wall. circles_m: float64 (k, 3), x, y, radius of each post.
    start: x, y, yaw of the base at the beginning.
    """

    segments_m: Float64s
    circles_m: Float64s
    lines: tuple[FloorLine, ...] = ()
    start: tuple[float, float, float] = (0.0, 0.0, 0.0)
    name: str = "map"

    def line_distance_m(self, points_m: Float64s) -> Float64s:
        """Distance of each point (n, 2) to the middle of the nearest tape, float64 (n,); inf where there is none."""
        nearest = np.full(len(points_m), math.inf)
        for line in self.lines:
            nearest = np.minimum(nearest, distance_to_segments_m(points_m, line.segments_m))
        return nearest

    def bounds_m(self) -> tuple[float, float, float, float]:
        """Least and greatest x and y of everything: x0, y0, x1, y1."""
        corners = [self.segments_m[:, :2], self.segments_m[:, 2:], *(line.points_m for line in self.lines)]
        corners += [self.circles_m[:, :2] + sign * self.circles_m[:, 2:] for sign in (-1.0, 1.0)]
        corners.append(np.array([self.start[:2]]))
        all_m = np.vstack(corners)
        low, high = all_m.min(axis=0), all_m.max(axis=0)
        return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def distance_to_segments_m(points_m: Float64s, segments_m: Float64s) -> Float64s:
    """Distance of each point (n, 2) to the nearest of the segments (m, 4), float64 (n,)."""
    start, along = segments_m[:, :2], segments_m[:, 2:] - segments_m[:, :2]
    offset = points_m[:, None, :] - start[None, :, :]
    share = np.einsum("nmk,mk->nm", offset, along) / np.einsum("mk,mk->m", along, along)
    gap = offset - np.clip(share, 0.0, 1.0)[:, :, None] * along[None, :, :]
    nearest: Float64s = np.sqrt(np.einsum("nmk,nmk->nm", gap, gap).min(axis=1))
    return nearest


def rounded(points_m: Sequence[Point], radius_m: float, closed: bool) -> Float64s:
    """A polyline whose corners are arcs, float64 (n, 2); a closed one repeats its first point.

    An arc takes at most half of its shorter side, so that neighbouring arcs never overlap; straight corners stay.
    """
    corners = [np.array(point, dtype=np.float64) for point in points_m]
    if closed and not np.array_equal(corners[0], corners[-1]):
        corners.append(corners[0])
    if radius_m <= 0.0:
        return np.array(corners)
    ring = corners[:-1] if closed else corners
    out: list[Float64s] = []
    for index, corner in enumerate(ring):
        if not closed and index in (0, len(ring) - 1):
            out.append(corner)
        else:
            out.extend(_arc(ring[index - 1], corner, ring[(index + 1) % len(ring)], radius_m))
    if closed:
        out.append(out[0])
    return np.array(out)


def _arc(before: Float64s, corner: Float64s, after: Float64s, radius_m: float) -> list[Float64s]:
    into, out_of = corner - before, after - corner
    reach_m = min(float(np.hypot(*into)), float(np.hypot(*out_of))) / 2.0
    into, out_of = into / np.hypot(*into), out_of / np.hypot(*out_of)
    turn_rad = math.atan2(float(into[0] * out_of[1] - into[1] * out_of[0]), float(into @ out_of))
    if abs(turn_rad) < 1e-6 or abs(turn_rad) > math.pi - 1e-3:
        return [corner]
    cut_m = min(radius_m * math.tan(abs(turn_rad) / 2.0), reach_m)
    side = math.copysign(1.0, turn_rad)
    radius = cut_m / math.tan(abs(turn_rad) / 2.0)
    begin = corner - cut_m * into
    centre = begin + side * radius * np.array([-into[1], into[0]])
    steps = max(2, math.ceil(abs(turn_rad) / _ARC_STEP_RAD))
    first = math.atan2(float(begin[1] - centre[1]), float(begin[0] - centre[0]))
    angles = first + np.linspace(0.0, turn_rad, steps + 1)
    return list(centre + radius * np.stack((np.cos(angles), np.sin(angles)), axis=1))


def map_from(content: MapFile) -> WorldMap:
    """The geometry that a checked file describes."""
    walls = [FloorLine(rounded(wall.points_m, 0.0, wall.closed)).segments_m for wall in content.walls]
    return WorldMap(
        segments_m=np.vstack(walls) if walls else np.empty((0, 4)),
        circles_m=np.array([(p.x_m, p.y_m, p.radius_m) for p in content.posts], dtype=np.float64).reshape(-1, 3),
        lines=tuple(
            FloorLine(rounded(line.points_m, line.corner_radius_m, line.closed), line.width_m, line.closed)
            for line in content.lines
        ),
        start=(content.start.x_m, content.start.y_m, content.start.yaw_rad),
        name=content.name,
    )


def map_from_segments(
    segments_m: Sequence[Sequence[float]] | Float64s = (),
    *,
    circles_m: Sequence[Sequence[float]] | Float64s = (),
    lines: Sequence[FloorLine] = (),
    start: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> WorldMap:
    """A map from plain numbers: walls as x0, y0, x1, y1, posts as x, y, radius. For tests and measurements."""
    return WorldMap(
        np.asarray(segments_m, dtype=np.float64).reshape(-1, 4),
        np.asarray(circles_m, dtype=np.float64).reshape(-1, 3),
        tuple(lines),
        start,
        "segments",
    )


def find_map(name: str) -> Path:
    """The file that `name` means: a path, or a map shipped with robotd with or without `.yaml`.

    Raises MapError listing the shipped maps.
    """
    given = Path(name).expanduser()
    if given.is_file():
        return given
    shelves = [shelf for shelf in _shipped_shelves() if shelf.is_dir()]
    if given.name == name:
        for shelf in shelves:
            for candidate in (shelf / name, shelf / f"{name}.yaml"):
                if candidate.is_file():
                    return candidate
    shipped = ", ".join(sorted({file.stem for shelf in shelves for file in shelf.glob("*.yaml")})) or "none found"
    raise MapError(f"map {name!r}: no such file, and no such shipped map (shipped: {shipped})")


def _shipped_shelves() -> tuple[Path, ...]:
    """Where maps are when robotd is installed, and where they are in a checkout."""
    spec = importlib.util.find_spec("robotd")
    if spec is None or spec.origin is None:
        return ()
    package = Path(spec.origin).resolve().parent
    return package / "_data" / "maps", package.parents[1] / "maps"


def load_map(name: str) -> WorldMap:
    """Read, check and build a map by path or shipped name. Raises MapError naming the file and each bad place."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    path = find_map(name)
    try:
        content: Any = YAML(typ="safe", pure=True).load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, YAMLError) as error:
        raise MapError(f"map {path}: {error}") from error
    if not isinstance(content, dict):
        raise MapError(f"map {path}: expected keys such as start, walls, posts, lines; found {type(content).__name__}")
    try:
        return map_from(MapFile.model_validate(content))
    except ValidationError as error:
        places = "; ".join(
            f"{'.'.join(str(part) for part in item['loc']) or 'map'}: {item['msg']}" for item in error.errors()
        )
        raise MapError(f"map {path}: {places}") from error
