"""Parameters of the behaviour `jetbot_route`; the names of the seed stand in docs/behaviours/jetbot_route.md."""

from __future__ import annotations

from pydantic import Field, model_validator

from robotd import Config
from robotd.authoring.config import Goal


class JetBotRouteConfig(Config):
    """How the robot follows the line. Distances are along the floor, measured by odometry, never by time."""

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


class JetBotRouteGoal(Goal):
    """Follow the line to its end."""
