"""What a map file may say: the entries of one YAML file in `maps/`, checked and nothing else."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from robotd.authoring.config import Config
from robotd_devices.sim.polyline import Point


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


class BoxEntry(Config):
    """A rectangular thing on the floor, which may come and go while the world runs."""

    x_m: float
    y_m: float
    yaw_rad: float = 0.0
    length_m: float = Field(gt=0.0, le=50.0)
    """Along its own x axis."""
    width_m: float = Field(gt=0.0, le=50.0)
    from_s: float = Field(default=0.0, ge=0.0)
    """It is there from this second of the world on."""
    until_s: float | None = Field(default=None, gt=0.0)
    """And is gone from this one on; null: it stays."""

    @model_validator(mode="after")
    def _comes_before_it_goes(self) -> BoxEntry:
        if self.until_s is not None and self.until_s <= self.from_s:
            raise ValueError(f"until_s {self.until_s} must be later than from_s {self.from_s}")
        return self


class LineEntry(PolylineEntry):
    """Tape on the floor along a polyline; it may end anywhere and cross other tape."""

    width_m: float = Field(default=0.05, gt=0.0, le=1.0)
    """Width of the tape."""
    corner_radius_m: float = Field(default=0.0, ge=0.0, le=10.0)
    """Corners become arcs of this radius (smaller where the sides are too short for it)."""


class CardEntry(Config):
    """A flat card that stands upright: a sign, a code, a poster. Its face looks along `yaw_rad`."""

    x_m: float
    """The middle of its lower edge."""
    y_m: float
    yaw_rad: float
    """Where its face looks; from behind it is blank."""
    width_m: float = Field(default=0.10, gt=0.0, le=5.0)
    height_m: float = Field(default=0.10, gt=0.0, le=5.0)
    bottom_m: float = Field(default=0.03, ge=0.0, le=5.0)
    """Height of its lower edge above the floor."""
    picture: str | None = None
    """A picture file, relative to the map's folder; transparent parts are not there."""
    text: str | None = Field(default=None, min_length=1, max_length=40)
    """Letters, digits and signs printed on the face instead of a picture."""
    grey: float = Field(default=235.0, ge=0.0, le=255.0)
    """The bare card in full light; print is black on a light card and white on a dark one."""

    @model_validator(mode="after")
    def _one_face(self) -> CardEntry:
        if self.picture is not None and self.text is not None:
            raise ValueError("a card has a picture or a text, not both: remove one")
        return self


class PersonEntry(Config):
    """Somebody who walks a polyline, or stands where it has one point. People do not make way for the robot."""

    points_m: tuple[Point, ...] = Field(min_length=1)
    speed_mps: float = Field(default=1.2, gt=0.0, le=10.0)
    pause_s: float = Field(default=0.0, ge=0.0)
    """Stands this long at each corner."""
    from_s: float = Field(default=0.0, ge=0.0)
    """Stands at the first corner until this second of the world."""
    then: Literal["back", "round", "stay"] = "back"
    """At the last corner: walks back the way it came, goes round to the first one, or stays."""
    height_m: float = Field(default=1.7, gt=0.3, le=2.5)
    radius_m: float = Field(default=0.2, gt=0.0, le=1.0)
    """Of the disc that counts for contact."""
    picture: str | None = None
    """A picture of the whole person for the camera, relative to the map's folder; a drawn figure otherwise."""


class GridEntry(Config):
    """An occupancy picture with its YAML file, as ROS map_server writes and reads it."""

    file: str
    """The map_server YAML, relative to the map's folder."""


class RouteLaying(Config):
    """How the route map of a JetBot (nodes on a grid, edges N, E, S, W) is laid on the floor as tape."""

    pitch_m: float = Field(default=0.9, gt=0.1, le=10.0)
    """Metres of one step of the grid."""
    tape_width_m: float = Field(default=0.05, gt=0.0, le=1.0)
    heading: Literal["N", "E", "S", "W"] = "E"
    """Where the robot looks when it starts, which is at the route's start node unless `start` says otherwise."""
    markers: Literal["none", "crossings", "all"] = "none"
    """Nodes with a pair of round posts north-east and south-west of them."""
    marker_distance_m: float = Field(default=0.30, gt=0.0, le=5.0)
    """From the node to the middle of each post."""
    marker_radius_m: float = Field(default=0.04, gt=0.0, le=1.0)


class RouteEntry(RouteLaying):
    """A route map and how it is laid."""

    file: str
    """The JSON file, relative to the map's folder."""


class MapFile(Config):
    """The content of one file in `maps/`."""

    name: str = "map"
    start: StartPose | None = None
    walls: tuple[WallEntry, ...] = ()
    posts: tuple[PostEntry, ...] = ()
    boxes: tuple[BoxEntry, ...] = ()
    lines: tuple[LineEntry, ...] = ()
    cards: tuple[CardEntry, ...] = ()
    people: tuple[PersonEntry, ...] = ()
    grid: GridEntry | None = None
    route: RouteEntry | None = None
    structure_height_m: float = Field(default=0.3, gt=0.0, le=5.0)
    """How high walls, posts and boxes stand for the camera; a lidar meets them at any height."""

    @model_validator(mode="after")
    def _no_repeated_corner(self) -> MapFile:
        named = [(f"walls[{index}]", wall.points_m) for index, wall in enumerate(self.walls)]
        named += [(f"lines[{index}]", line.points_m) for index, line in enumerate(self.lines)]
        named += [(f"people[{index}]", person.points_m) for index, person in enumerate(self.people)]
        for place, points_m in named:
            for at in range(1, len(points_m)):
                if points_m[at] == points_m[at - 1]:
                    raise ValueError(f"{place}.points_m[{at}] repeats the corner before it: remove one")
        return self
