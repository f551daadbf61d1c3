"""From a map file to the plain geometry of a flat world: walls, posts, tape, cards, people, and the robot's start."""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from robotd.world.messages import Float64s
from robotd_devices.sim.grid import read_grid
from robotd_devices.sim.map_file import CardEntry, MapFile, PersonEntry, RouteLaying
from robotd_devices.sim.people import Person, Walk, walk_along
from robotd_devices.sim.polyline import box_segments_m, distance_to_segments_m, rounded
from robotd_devices.sim.route import HEADING_RAD, Route, read_route, route_from

_GRID_KEYS = {"image", "resolution", "origin"}


class MapError(ValueError):
    """A map that cannot be used; the message names the file, the place and the mend."""


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


@dataclass(frozen=True, slots=True)
class Card:
    """An upright card: the middle of its lower edge, where its face looks, and what is on it.

    picture: an image file; text: printed letters; neither: bare in `grey`.
    """

    x_m: float
    y_m: float
    yaw_rad: float
    width_m: float = 0.10
    height_m: float = 0.10
    bottom_m: float = 0.03
    picture: str | None = None
    text: str | None = None
    grey: float = 235.0

    @property
    def segment_m(self) -> Float64s:
        """Its lower edge seen from above, (4,): left end then right end as its reader sees them."""
        half = self.width_m / 2.0
        # the reader's right is the face's left
        across = np.array((-math.sin(self.yaw_rad), math.cos(self.yaw_rad))) * half
        middle = np.array((self.x_m, self.y_m))
        return np.concatenate((middle - across, middle + across))


@dataclass(frozen=True, slots=True, eq=False)
class Box:
    """Four sides (4, 4) that are there from one second of the world to another."""

    segments_m: Float64s
    from_s: float = 0.0
    until_s: float = math.inf


@dataclass(frozen=True, slots=True, eq=False)
class WorldMap:
    """Geometry in the map frame, metres.

    segments_m: float64 (m, 4), x0, y0, x1, y1 of each wall. circles_m: float64 (k, 3), x, y, radius of each post.
    start: x, y, yaw of the base at the beginning. structure_height_m: of walls, posts and boxes, for the camera.
    """

    segments_m: Float64s
    circles_m: Float64s
    lines: tuple[FloorLine, ...] = ()
    start: tuple[float, float, float] = (0.0, 0.0, 0.0)
    name: str = "map"
    boxes: tuple[Box, ...] = ()
    cards: tuple[Card, ...] = ()
    people: tuple[Person, ...] = ()
    structure_height_m: float = 0.3

    def line_distance_m(self, points_m: Float64s) -> Float64s:
        """Distance of each point (n, 2) to the middle of the nearest tape, float64 (n,); inf where there is none."""
        nearest = np.full(len(points_m), math.inf)
        for line in self.lines:
            nearest = np.minimum(nearest, distance_to_segments_m(points_m, line.segments_m))
        return nearest

    def bounds_m(self) -> tuple[float, float, float, float]:
        """Least and greatest x and y of everything but people: x0, y0, x1, y1."""
        corners = [self.segments_m[:, :2], self.segments_m[:, 2:], *(line.points_m for line in self.lines)]
        corners += [self.circles_m[:, :2] + sign * self.circles_m[:, 2:] for sign in (-1.0, 1.0)]
        corners += [box.segments_m[:, :2] for box in self.boxes]
        corners += [card.segment_m.reshape(2, 2) for card in self.cards]
        corners.append(np.array([self.start[:2]]))
        all_m = np.vstack(corners)
        low, high = all_m.min(axis=0), all_m.max(axis=0)
        return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def map_from(content: MapFile, folder: Path | None = None) -> WorldMap:
    """The geometry that a checked file describes; files that it names count from `folder`.

    Raises ValueError, or pydantic's ValidationError, for a file among them that cannot be used.
    """
    folder = folder if folder is not None else Path()
    walls = [FloorLine(rounded(wall.points_m, 0.0, wall.closed)).segments_m for wall in content.walls]
    posts = [(post.x_m, post.y_m, post.radius_m) for post in content.posts]
    lines = [
        FloorLine(rounded(line.points_m, line.corner_radius_m, line.closed), line.width_m, line.closed)
        for line in content.lines
    ]
    start = (0.0, 0.0, 0.0)
    if content.grid is not None:
        file = _beside(folder, content.grid.file, "grid.file")
        walls.append(read_grid(file, _read_yaml(file)).segments_m())
    if content.route is not None:
        route = read_route(_beside(folder, content.route.file, "route.file"))
        laid = lay_route(route, content.route)
        lines += laid.lines
        posts += [(float(x), float(y), float(radius)) for x, y, radius in laid.circles_m]
        start = laid.start
    if content.start is not None:
        start = (content.start.x_m, content.start.y_m, content.start.yaw_rad)
    return WorldMap(
        segments_m=np.vstack(walls) if walls else np.empty((0, 4)),
        circles_m=np.array(posts, dtype=np.float64).reshape(-1, 3),
        lines=tuple(lines),
        start=start,
        name=content.name,
        boxes=tuple(
            Box(
                box_segments_m(box.x_m, box.y_m, box.yaw_rad, box.length_m, box.width_m),
                box.from_s,
                math.inf if box.until_s is None else box.until_s,
            )
            for box in content.boxes
        ),
        cards=tuple(_card(entry, folder, at) for at, entry in enumerate(content.cards)),
        people=tuple(_person(entry, folder, at) for at, entry in enumerate(content.people)),
        structure_height_m=content.structure_height_m,
    )


def lay_route(route: Route, how: RouteLaying) -> WorldMap:
    """A route map as tape and markers, with the start that it names; the map frame's y grows to the north."""
    posts: list[tuple[float, float, float]] = []
    marked = {"none": [], "crossings": route.crossings(), "all": list(route.places)}[how.markers]
    aside_m = how.marker_distance_m / math.sqrt(2.0)
    for node in marked:
        x_m, y_m = route.place_m(node, how.pitch_m)
        posts += [(x_m + side * aside_m, y_m + side * aside_m, how.marker_radius_m) for side in (1.0, -1.0)]
    start_m = route.place_m(route.start, how.pitch_m) if route.start is not None else (0.0, 0.0)
    return WorldMap(
        np.empty((0, 4)),
        np.array(posts, dtype=np.float64).reshape(-1, 3),
        tuple(FloorLine(tape_m, how.tape_width_m) for tape_m in route.tape_m(how.pitch_m, how.tape_width_m)),
        (*start_m, HEADING_RAD[how.heading]),
        "route",
    )


def route_world(content: Any, how: RouteLaying | None = None, margin_m: float = 1.0) -> WorldMap:
    """The floor of a route map as read from JSON, such as `random_route` makes, with walls around it.

    margin_m: from the outermost nodes to the walls. Raises ValueError naming what cannot be laid.
    """
    laid = lay_route(route_from(content), how if how is not None else RouteLaying())
    x0, y0, x1, y1 = laid.bounds_m()
    x0, y0, x1, y1 = x0 - margin_m, y0 - margin_m, x1 + margin_m, y1 + margin_m
    walls_m = box_segments_m((x0 + x1) / 2.0, (y0 + y1) / 2.0, 0.0, x1 - x0, y1 - y0)
    return replace(laid, segments_m=walls_m)


def _beside(folder: Path, name: str, place: str) -> Path:
    path = folder / name
    if not path.is_file():
        raise ValueError(f"{place}: {name}: there is no such file in {folder}")
    return path


def _card(entry: CardEntry, folder: Path, at: int) -> Card:
    content = entry.model_dump()
    if entry.picture is not None:
        content["picture"] = str(_beside(folder, entry.picture, f"cards[{at}].picture"))
    return Card(**content)


def _person(entry: PersonEntry, folder: Path, at: int) -> Person:
    picture = None
    if entry.picture is not None:
        picture = str(_beside(folder, entry.picture, f"people[{at}].picture"))
    walk: Walk = walk_along(
        entry.points_m, entry.speed_mps, pause_s=entry.pause_s, from_s=entry.from_s, then=entry.then
    )
    return Person(walk, entry.height_m, entry.radius_m, picture=picture)


def map_from_segments(
    segments_m: Sequence[Sequence[float]] | Float64s = (),
    *,
    circles_m: Sequence[Sequence[float]] | Float64s = (),
    lines: Sequence[FloorLine] = (),
    start: tuple[float, float, float] = (0.0, 0.0, 0.0),
    cards: Sequence[Card] = (),
    people: Sequence[Person] = (),
) -> WorldMap:
    """A map from plain numbers: walls as x0, y0, x1, y1, posts as x, y, radius. For tests and measurements."""
    return WorldMap(
        np.asarray(segments_m, dtype=np.float64).reshape(-1, 4),
        np.asarray(circles_m, dtype=np.float64).reshape(-1, 3),
        tuple(lines),
        start,
        "segments",
        cards=tuple(cards),
        people=tuple(people),
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
    """Read, check and build a map by path or shipped name: ours, or the YAML file of a map_server picture.

    Raises MapError naming the file and each bad place.
    """
    path = find_map(name)
    try:
        content = _read_yaml(path)
        if not isinstance(content, dict):
            raise MapError(
                f"map {path}: expected keys such as start, walls, posts, lines; found {type(content).__name__}"
            )
        if content.keys() >= _GRID_KEYS:
            return WorldMap(read_grid(path, content).segments_m(), np.empty((0, 3)), name=path.stem)
        return map_from(MapFile.model_validate(content), path.parent)
    except ValidationError as error:
        places = "; ".join(
            f"{'.'.join(str(part) for part in item['loc']) or 'map'}: {item['msg']}" for item in error.errors()
        )
        raise MapError(f"map {path}: {places}") from error
    except MapError:
        raise
    except ValueError as error:
        raise MapError(f"map {path}: {error}") from error


def _read_yaml(path: Path) -> Any:
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        return YAML(typ="safe", pure=True).load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, YAMLError) as error:
        raise MapError(f"map {path}: {error}") from error
