"""Parameters of the behaviour `ftg_race`, in two profiles; the seed's names stand in docs/behaviours/ftg_race.md."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final, Literal

from pydantic import Field, model_validator

from robotd import Config
from robotd.authoring.config import Goal

SEED_SAFE: Final[Mapping[str, Any]] = {
    "method": "patches",
    "median_bins": 3,
    "vehicle_width_m": 0.190,
    "safety_margin_m": 0.030,
    "range_max_m": 6.0,
    "beyond_range_is_free": False,
    "stop_distance_m": 0.300,
    "v_max_mps": 2.0,
    "accel_mps2": 0.5,
    "brake_mps2": 2.0,
    "accel_response_s": 0.0,
    "brake_response_s": 0.0,
    "steer_iir_beta": 0.25,
    "steer_rate_radps": math.radians(50.0),
    "learn": False,
}
"""Where the profile `seed_safe` differs from `race`: the seed's section 8."""


class FtgRaceConfig(Config):
    """The defaults are the profile `race` for an f1tenth car; `profile: seed_safe` is the seed's initial values."""

    profile: Literal["race", "seed_safe"] = "race"
    """Where the other parameters start from; each may still be set."""
    planner: Literal["ftg", "baseline"] = "ftg"
    """`baseline` is the rule before follow-the-gap: away from the nearest, speed by the farthest."""
    method: Literal["free_space", "patches"] = "free_space"
    """How `ftg` finds its way: exact free space and a fan of paths, or the seed's bubble, disparities and gap."""

    fov_rad: float = Field(default=math.pi / 2.0, gt=0.3, le=math.pi)
    """Half the field of view in which it plans (fov_min_deg, fov_max_deg)."""
    angle_step_rad: float = Field(default=math.radians(1.0), ge=math.radians(0.25), le=math.radians(3.0))
    """Width of a bin of bearing (angle_step_deg)."""
    range_min_m: float = Field(default=0.150, ge=0.0, le=1.0)
    """What is nearer is touching (range_min_mm)."""
    range_max_m: float = Field(default=12.0, gt=1.0, le=50.0)
    """Farther is not looked at (range_max_mm)."""
    beyond_range_is_free: bool = True
    """False: no return counts as an obstacle, as the seed has it; the straight ahead is a wall then."""
    median_bins: int = Field(default=1, ge=1, le=9)
    """Ranges are smoothed over so many bins, towards nearer only."""
    confirm_single: bool = False
    """A return that stands alone counts when it is seen twice: for lidars with stray returns."""

    vehicle_width_m: float | None = Field(default=None, gt=0.05, le=2.0)
    """In place of the footprint's (vehicle_width_mm); TT-02D: 0.182 or 0.190."""
    safety_margin_m: float = Field(default=0.120, ge=0.0, le=0.5)
    """Beside the car (safety_margin_mm)."""

    free_threshold_m: float = Field(default=0.700, gt=0.0, le=10.0)
    """`patches`: a gap is where the range is at least this (free_threshold_mm)."""
    bubble_radius_m: float = Field(default=0.250, ge=0.0, le=2.0)
    """`patches`: round the nearest return nothing is free (bubble_radius_mm)."""
    disparity_threshold_m: float = Field(default=0.300, gt=0.0, le=5.0)
    """`patches`: a step of range beyond which an edge is taken for wide (disparity_threshold_mm)."""
    centre_pull: float = Field(default=0.3, ge=0.0, le=1.0)
    """`patches`: share of the way from the farthest bearing to the gap's middle."""
    target_keep_rad: float = Field(default=math.radians(8.0), ge=0.0, le=1.0)
    """`patches`: a target within this of the last one is preferred where it is almost as far."""

    stop_distance_m: float = Field(default=0.200, ge=0.0, le=2.0)
    """It can stop so far before everything (stop_distance_mm)."""
    front_sector_rad: float = Field(default=math.radians(15.0), gt=0.0, le=1.5)
    """`patches`: half the sector that is ahead (front_sector_deg)."""
    v_max_mps: float = Field(default=8.0, gt=0.0, le=20.0)
    """V_MAX."""
    front_gain_ps: float = Field(default=1.0, gt=0.0, le=20.0)
    """k1: 1/s of the free distance ahead."""
    steer_slowdown_mps_per_rad: float = Field(default=4.0, ge=0.0, le=50.0)
    """k2: m/s for each radian of steering (steer_slowdown_gain)."""
    target_gain_ps: float = Field(default=1.0, gt=0.0, le=20.0)
    """k3: 1/s of the distance to the target."""

    mu: float = Field(default=1.0489, gt=0.05, le=2.0)
    """Friction between tyre and floor; the shares below are of mu g."""
    lateral_share: float = Field(default=0.860, gt=0.0, le=1.0)
    """Of it is planned with in bends."""
    brake_share: float = Field(default=0.560, gt=0.0, le=1.0)
    """Of it is planned with before the end of what is free."""
    corner_brake_share: float = Field(default=0.660, gt=0.0, le=1.0)
    """Of it is planned with on the way to a bend."""
    accel_mps2: float = Field(default=9.4, gt=0.0, le=20.0)
    """It speeds up no faster (accel_limit)."""
    brake_mps2: float = Field(default=9.0, gt=0.0, le=20.0)
    """It slows down no harder, but for a stop."""
    accel_response_s: float = Field(default=0.21, ge=0.0, le=2.0)
    """How slack the car's speed controller is, upwards: m/s that are missing for 1 m/s^2; 0: it keeps its speed."""
    brake_response_s: float = Field(default=0.053, ge=0.0, le=2.0)
    """The same downwards."""
    actuation_s: float = Field(default=0.090, ge=0.0, le=0.5)
    """From a command to wheels that turn and tyres that hold."""
    caution_ps: float = Field(default=3.0, ge=0.0, le=10.0)
    """Share of grip that it plans without for each second by which a scan is late or a command must hold."""
    rear_slip_rad: float = Field(default=0.183, ge=0.0, le=1.0)
    """At the limit of grip the rear axle drifts outwards by this angle; below it in proportion."""
    understeer_rad: float = Field(default=0.031, ge=-0.5, le=1.0)
    """At the limit of grip the front wheels are turned farther by this; below it in proportion."""
    load_shift_rad: float = Field(default=0.14, ge=0.0, le=1.0)
    """Speeding up with all the grip in a bend with all the grip the front wheels would be turned farther by this; less,
    in proportion to both; on the line also turned back for the brakes."""
    yaw_gain_s: float = Field(default=0.03, ge=0.0, le=0.5)
    """The front wheels are turned back by this for each rad/s of yaw rate that is too much."""

    steer_iir_beta: float = Field(default=1.0, gt=0.0, le=1.0)
    """Share of a new steering angle that is taken over in one cycle of 0.1 s; 1: all."""
    steer_rate_radps: float = Field(default=0.0, ge=0.0, le=50.0)
    """The steering angle changes no faster; 0: as fast as the servo."""

    curvatures: int = Field(default=8, ge=3, le=12)
    """`free_space`: bends of the fan to each side."""
    bends_m: tuple[float, ...] = (1.0, 2.0)
    """`free_space`: where the second bend may begin."""
    reach_m: float = Field(default=10.0, ge=2.0, le=20.0)
    """`free_space`: length of the paths."""
    compare_m: float = Field(default=4.0, ge=0.5, le=20.0)
    """`free_space`: paths are compared by their time over so many metres, or `compare_share` of the longest."""
    compare_share: float = Field(default=0.6, gt=0.1, le=1.0)
    keep_s: float = Field(default=0.05, ge=0.0, le=1.0)
    """`free_space`: what a change of curvature by 1/m costs, in seconds."""
    blend_s: float = Field(default=0.05, gt=0.0, le=1.0)
    """`free_space`: neighbouring paths that cost little more than the best have their say."""

    learn: bool = True
    """From lap 2 on it follows the line that the perceptor `race_track` learned, while `track_position` is sure."""
    line_lateral_share: float = Field(default=0.78, gt=0.0, le=1.0)
    """Of the grip is planned with in bends of the learned line."""
    line_brake_share: float = Field(default=0.75, gt=0.0, le=1.0)
    """Of it for braking on the line."""
    line_accel_share: float = Field(default=0.85, gt=0.0, le=1.0)
    """Of it for speeding up on the line."""
    line_grip_share: float = Field(default=0.94, gt=0.0, le=1.0)
    """Of it for both together: radius of the friction circle on the line."""
    line_stop_share: float = Field(default=0.70, gt=0.0, le=1.0)
    """Of it for a stop before the end of what is seen to be free: on the line nobody counts on needing it."""
    line_yaw_share: float = Field(default=1.0, ge=0.0, le=2.0)
    """Of the curvature that the car's yaw rate shows to be missing on the line, so much is steered in addition."""
    line_bound_m: float = Field(default=0.50, gt=0.0, le=1.0)
    """Farther off the line the car is driven by follow-the-gap."""
    line_clear_m: float = Field(default=0.05, ge=0.0, le=0.5)
    """The way along the line must be free by so much beside the car."""

    recover: bool = True
    """When it stands before a wall it drives back and tries again; false: it stands."""
    can_reverse: bool = True
    """False for a car whose motor controller has no reverse."""
    stuck_s: float = Field(default=0.5, gt=0.0, le=10.0)
    """It counts as stuck after standing for so long."""
    reverse_mps: float = Field(default=0.6, gt=0.0, le=3.0)
    """Backwards, no faster."""
    reverse_m: float = Field(default=0.8, gt=0.0, le=5.0)
    """Backwards, no farther at a time."""
    reverse_blind_m: float = Field(default=0.4, ge=0.0, le=5.0)
    """And no farther than this where no beam sees what is behind."""
    retries: int = Field(default=10, ge=1, le=50)
    """So often in one place, then the goal has failed."""

    @model_validator(mode="before")
    @classmethod
    def _start_from_the_profile(cls, given: Any) -> Any:
        if isinstance(given, Mapping) and given.get("profile") == "seed_safe":
            return {**SEED_SAFE, **given}
        return given

    @model_validator(mode="after")
    def _makes_sense(self) -> FtgRaceConfig:
        if self.range_min_m >= self.range_max_m:
            raise ValueError(f"range_min_m {self.range_min_m} must be below range_max_m {self.range_max_m}")
        if list(self.bends_m) != sorted(set(self.bends_m)) or not self.bends_m or self.bends_m[0] <= 0.0:
            raise ValueError("bends_m must rise from above 0")
        if self.bends_m[-1] >= self.reach_m:
            raise ValueError(f"bends_m must end before reach_m {self.reach_m}")
        return self


class RaceGoal(Goal):
    """Drive until cancelled."""
