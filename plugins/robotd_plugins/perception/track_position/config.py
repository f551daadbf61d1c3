"""Parameters of the perceptor `track_position`."""

from __future__ import annotations

from pydantic import Field

from robotd import Config


class TrackPositionConfig(Config):
    """How the car is located on its learned track, and when that is to be believed."""

    beams: int = Field(default=90, ge=30, le=400)
    """So many beams of each scan are laid on the walls."""
    range_max_m: float = Field(default=12.0, gt=2.0, le=60.0)
    """Returns farther than this have no say."""
    explained_share_min: float = Field(default=0.80, gt=0.0, le=1.0)
    """Sure only where so many of the returns lie on walls,"""
    residual_max_m: float = Field(default=0.09, gt=0.0, le=1.0)
    """no farther from them than this, in the middle,"""
    along_max_m: float = Field(default=0.30, gt=0.0, le=2.0)
    """and where the way along a corridor without features is known as well as this (standard deviation)."""
    surprise_m: float = Field(default=0.03, gt=0.0, le=1.0)
    """A scan may lie this and four standard deviations from where the car was expected."""
    surprise_rad: float = Field(default=0.02, gt=0.0, le=1.0)
    """The same of its heading."""
    lie_share: float = Field(default=0.08, gt=0.0, le=1.0)
    """Odometry that tells more or less way than the walls by this share, scan after scan, is not believed."""
    stands_m: float = Field(default=0.20, gt=0.0, le=2.0)
    """Returns side by side that stand so far into the free track are something new: not sure."""
    prove_m: float = Field(default=2.0, ge=0.0, le=50.0)
    """After it was looked for, the place must hold for so much way before it is sure."""
    odometry_share: float = Field(default=0.03, gt=0.0, le=1.0)
    """Standard deviation of the way that odometry tells, as a share of it."""
    command_lag_s: float = Field(default=0.12, ge=0.0, le=1.0)
    """Without odometry: how slowly the car follows its commands."""
    accel_mps2: float = Field(default=8.0, gt=0.0, le=50.0)
    """Without odometry: the car speeds up and slows down no harder."""
