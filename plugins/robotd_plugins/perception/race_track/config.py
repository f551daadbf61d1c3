"""Parameters of the perceptor `race_track`."""

from __future__ import annotations

from pydantic import Field

from robotd import Config


class RaceTrackConfig(Config):
    """The map's grain, and what the line's shape is planned for; its speeds are the behaviour's own."""

    resolution_m: float = Field(default=0.05, ge=0.02, le=0.2)
    """Size of the distance field's cells."""
    reach_m: float = Field(default=3.0, ge=1.0, le=30.0)
    """The field ends so far beside the driven way."""
    contradicted_share_max: float = Field(default=0.09, gt=0.0, le=1.0)
    """A map is refused where so many beams of one key frame would have passed through its walls."""
    margin_m: float = Field(default=0.20, ge=0.0, le=1.0)
    """Between the car's side and a wall, on the line."""
    vehicle_width_m: float | None = Field(default=None, gt=0.05, le=2.0)
    """In place of the footprint's."""
    v_max_mps: float = Field(default=8.0, gt=0.0, le=20.0)
    """The line is the quickest for this top speed,"""
    mu: float = Field(default=1.0489, gt=0.05, le=2.0)
    """this friction,"""
    lateral_share: float = Field(default=0.88, gt=0.0, le=1.0)
    """of which so much in bends,"""
    brake_share: float = Field(default=0.75, gt=0.0, le=1.0)
    """so much for braking,"""
    accel_share: float = Field(default=0.75, gt=0.0, le=1.0)
    """so much for speeding up,"""
    grip_share: float = Field(default=0.95, gt=0.0, le=1.0)
    """and so much for all together."""
