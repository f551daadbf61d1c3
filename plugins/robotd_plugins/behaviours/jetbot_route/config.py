"""Parameters of the behaviour `jetbot_route`; the names of the seed stand in docs/behaviours/jetbot_route.md."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from robotd import Config
from robotd.authoring.config import FileKey, Goal
from robotd.setup.resources import find_shipped
from robotd_plugins.behaviours.jetbot_route.intersection_cues import OpenSpaceConfig, OppositeMarkersConfig
from robotd_plugins.behaviours.jetbot_route.node_cues import CueWeights
from robotd_plugins.behaviours.jetbot_route.route_map_file import read_route_map_file
from robotd_plugins.behaviours.jetbot_route.route_plan import PlanCosts

Heading = Literal["N", "E", "S", "W"]


class JetBotRouteConfig(Config):
    """How the robot drives. Distances are along the floor, measured by odometry, never by time."""

    map: Annotated[str, FileKey("maps", ".json")] | None = None
    """The route map, a file or the name of a shipped one; null: along the line to its end, without a map."""
    pitch_m: float = Field(default=0.9, gt=0.1, le=10.0)
    """Metres of one unit of the map."""
    heading: Heading = "E"
    """Where the robot looks at the start, unless the goal says otherwise."""
    costs: PlanCosts = Field(default_factory=PlanCosts)
    """What turns cost in a plan."""
    base_speed_mps: float = Field(default=0.20, gt=0.0, le=1.0)
    """Speed along the line (BASE_SPEED)."""
    slow_speed_mps: float = Field(default=0.08, gt=0.0, le=1.0)
    """Speed without a line in sight, and the least speed in bends and before the line's end."""
    turn_speed_radps: float = Field(default=1.2, gt=0.0, le=5.0)
    """Turning on the spot, while it looks about for a lost line (TURN_SPEED)."""
    correction_gain: float = Field(default=1.0, gt=0.0, le=5.0)
    """How strongly a lateral error is steered against; 1 with `heading_gain` 1 is the arc to the line at `reach_m`
    (CORRECTION_GAIN)."""
    heading_gain: float = Field(default=1.0, gt=0.0, le=5.0)
    """How strongly an error of heading is steered against."""
    drift_gain_pm: float = Field(default=1.5, ge=0.0, le=10.0)
    """How fast it learns a base's steady pull to one side, as a share of the lateral steering for each metre driven."""
    drift_max_pm: float = Field(default=1.0, ge=0.0, le=5.0)
    """The strongest such pull that it steers against, as a curvature."""
    reach_m: float = Field(default=0.20, gt=0.05, le=1.0)
    """Distance ahead of the axle at which it aims for the line: longer is calmer and cuts bends."""
    max_correction_radps: float = Field(default=1.5, gt=0.0, le=5.0)
    """Steering never turns faster than this; in tighter bends the robot slows down instead (MAX_CORRECTION_ADJ)."""
    safe_zone_m: float = Field(default=0.004, ge=0.0, le=0.1)
    """Lateral errors below this are steered against more softly, without a dead band (SAFE_ZONE_PERCENT)."""
    picture_half_width_m: float = Field(default=0.13, gt=0.01, le=1.0)
    """Floor from the middle of the near region to its edge; counts only where the camera's mount is unknown."""
    confirm_frames: int = Field(default=3, ge=1, le=20)
    """So many of the last `of_frames` pictures must agree before a line, a crossing or an end is believed."""
    of_frames: int = Field(default=5, ge=1, le=40)
    """Pictures that are counted."""
    place_tolerance_m: float = Field(default=0.06, gt=0.0, le=0.5)
    """Sightings of one crossing or end lie within this of one another."""
    clearance_m: float = Field(default=0.08, ge=0.0, le=1.0)
    """So far beyond a crossing it is left behind (INTERSECTION_CLEARANCE_DURATION, as a distance)."""
    crossing_distance_m: float = Field(default=0.25, ge=0.05, le=5.0)
    """Two crossings are at least so far apart: none is counted twice (INTERSECTION_COOLDOWN, as a distance)."""
    lost_m: float = Field(default=0.08, ge=0.0, le=1.0)
    """Without a line in sight it drives on slowly for so far before it counts as lost."""
    reacquire_m: float = Field(default=0.20, gt=0.0, le=1.0)
    """It goes no farther than this without a line, then looks about for it (LINE_REACQUIRE_TIMEOUT, as a distance)."""
    reacquire_heading_rad: float = Field(default=0.52, gt=0.0, le=1.57)
    """On and after a crossing only a line within this of the course is the right one."""
    search_rad: float = Field(default=0.7, gt=0.0, le=3.0)
    """How far to each side it turns to look for a lost line."""
    stop_before_end_m: float = Field(default=0.03, ge=-0.2, le=0.5)
    """The axle stops so far before the line's end."""
    wait_for_line_s: float = Field(default=10.0, gt=0.0, le=600.0)
    """It waits so long at the start for a line in both regions."""
    odometry_error_share: float = Field(default=0.2, ge=0.0, lt=0.5)
    """Odometry may be off by this share of a way before the robot has learned its scale on the first edges."""
    node_tolerance_m: float = Field(default=0.08, gt=0.0, le=1.0)
    """Beyond that a node may be so far from where the map has it; what is seen elsewhere is no node."""
    distance_near_m: float = Field(default=0.10, ge=0.0, le=1.0)
    """The distance travelled speaks for a node within this of where the map has it."""
    distance_sure_m: float = Field(default=0.05, ge=0.0, le=0.5)
    """Where the distance is known to this (standard deviation), it is enough for a node that the sensors do not see; a
    turn there still ends on a line, or fails."""
    road_heading_rad: float = Field(default=0.2, gt=0.0, le=1.57)
    """Roads are straight: while one is driven, a line that is off its direction by more is not it."""
    road_jump_m: float = Field(default=0.04, gt=0.0, le=0.5)
    """A line that is more than this beside where it was is not the road that is driven."""
    cues: CueWeights = Field(default_factory=CueWeights)
    """What each sign of a node weighs."""
    lidar: Literal["opposite_markers", "open_space"] | None = "opposite_markers"
    """The strategy by which the lidar knows a crossing; null: it is not asked."""
    opposite_markers: OppositeMarkersConfig = Field(default_factory=OppositeMarkersConfig)
    open_space: OpenSpaceConfig = Field(default_factory=OpenSpaceConfig)
    brake_mps2: float = Field(default=0.25, gt=0.0, le=5.0)
    """It slows down so softly before a node at which it stops."""
    arrive_m: float = Field(default=0.012, ge=0.0, le=0.1)
    """It stops so far before a node's centre, for what it rolls on (INTERSECTION_APPROACH_DURATION, as a distance)."""
    settle_s: float = Field(default=0.15, ge=0.0, le=5.0)
    """At rest for so long on a node before it decides; pictures taken before the robot rested do not count."""
    turn_slack_rad: float = Field(default=0.5, gt=0.0, le=1.2)
    """The new line is looked for so far to both sides of a turn's angle."""
    turn_timeout_s: float = Field(default=15.0, gt=0.0, le=120.0)
    """A turn that takes longer has failed."""
    turn_retries: int = Field(default=1, ge=0, le=5)
    """So often it looks about for the new line once more before it gives up."""
    validation_s: float = Field(default=1.5, gt=0.0, le=30.0)
    """It looks so long for the new line before it moves on to it."""

    @model_validator(mode="after")
    def _makes_sense(self) -> JetBotRouteConfig:
        if self.confirm_frames > self.of_frames:
            raise ValueError(f"confirm_frames {self.confirm_frames} of of_frames {self.of_frames} can never happen")
        if self.slow_speed_mps > self.base_speed_mps:
            raise ValueError(
                f"slow_speed_mps {self.slow_speed_mps} must not be above base_speed_mps {self.base_speed_mps}"
            )
        if self.lost_m > self.reacquire_m:
            raise ValueError(f"lost_m {self.lost_m} must not be above reacquire_m {self.reacquire_m}")
        return self

    @field_validator("map")
    @classmethod
    def _map_is_right(cls, name: str | None) -> str | None:
        if name is not None:
            # a file that is not there is told by `FileKey`
            errors = [error for error in read_route_map_file(map_path(name)).errors if error.code != "file_unreadable"]
            if errors:
                raise ValueError("\n".join(str(error) for error in errors))
        return name


class JetBotRouteGoal(Goal):
    """From a node to a node of the map; without a map, follow the line to its end."""

    start_node: str | int | None = None
    """Where the robot stands; default: the map's start."""
    end_node: str | int | None = None
    """Where it shall go; default: the map's end, of several the nearest."""
    heading: Heading | None = None
    """Where it looks; default: the config's `heading`."""


def map_path(name: str) -> Path:
    """The file of a map: by path, else the shipped one of that name."""
    return find_shipped("maps", name, ".json") or Path(name)
