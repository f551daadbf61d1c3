"""Parameters of the perceptor `track_survey`."""

from __future__ import annotations

from pydantic import Field

from robotd import Config


class TrackSurveyConfig(Config):
    """How the first lap is surveyed. The defaults do for a 1/10 car at up to 8 m/s and lidars of 10 Hz and faster."""

    beams: int = Field(default=90, ge=30, le=400)
    """So many beams of each scan are laid on the walls of its key frame."""
    range_max_m: float = Field(default=12.0, gt=2.0, le=60.0)
    """Returns farther than this have no say."""
    key_m: float = Field(default=1.0, gt=0.1, le=5.0)
    """A new key frame after so much way,"""
    key_turn_rad: float = Field(default=0.35, gt=0.05, le=1.5)
    """or after so much turning."""
    key_points: int = Field(default=240, ge=60, le=1500)
    """So many returns of each key frame go into the survey."""
    key_points_m: float = Field(default=12.0, gt=1.0, le=60.0)
    """And none farther away than this."""
    lap_min_m: float = Field(default=12.0, gt=3.0, le=1000.0)
    """No lap is shorter."""
    lap_max_m: float = Field(default=1000.0, gt=10.0, le=10000.0)
    """After so much way without a closed lap the survey begins anew."""
    overlap_m: float = Field(default=4.0, ge=0.0, le=50.0)
    """The survey goes on for so much way over its own beginning, so that the two ends are well tied."""
    search_m: float = Field(default=1.5, gt=0.0, le=20.0)
    """The beginning is looked for within this and `drift_share` of the way, about where odometry has it."""
    drift_share: float = Field(default=0.01, ge=0.0, le=0.2)
    """What odometry may have lost, as a share of the way."""
    attempts: int = Field(default=2, ge=1, le=10)
    """So many laps of a goal are surveyed, in case that no map could be made of the first."""
    explained_share_min: float = Field(default=0.85, gt=0.0, le=1.0)
    """Two scans show one place where so many of the returns agree."""
    odometry_share: float = Field(default=0.03, gt=0.0, le=1.0)
    """Standard deviation of the way that odometry tells, as a share of it."""
    command_lag_s: float = Field(default=0.12, ge=0.0, le=1.0)
    """Without odometry: how slowly the car follows its commands."""
    accel_mps2: float = Field(default=8.0, gt=0.0, le=50.0)
    """Without odometry: the car speeds up and slows down no harder."""
