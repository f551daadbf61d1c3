"""What a picture looks like: materials, light and sensor of a simulated camera, each imperfection with its value."""

from __future__ import annotations

from pydantic import Field

from robotd.authoring.config import Config


class SensorLook(Config):
    """What every renderer's pictures have: two materials, the strength of light, and the sensor."""

    tape_grey: float = Field(default=82.0, ge=0.0, le=255.0)
    """Grey level of tape in full light."""
    floor_grey: float = Field(default=200.0, ge=0.0, le=255.0)
    """Grey level of floor in full light."""
    vignette: float = Field(default=0.32, ge=0.0, le=0.9)
    """Share of light lost in the corners."""
    brightness: float = Field(default=1.0, gt=0.0, le=4.0)
    """Factor on all light."""
    light_drift: float = Field(default=0.04, ge=0.0, le=0.8)
    """All light becomes stronger and weaker in time by up to this share."""
    light_drift_s: float = Field(default=7.0, gt=0.0, le=600.0)
    """The time in which it does so, slower and faster waves around it."""
    tint_drift: float = Field(default=0.02, ge=0.0, le=0.3)
    """White balance wanders between bluish and reddish by up to this share, in the same time."""
    noise_std: float = Field(default=3.0, ge=0.0, le=60.0)
    """Sensor noise, standard deviation in grey levels."""
    jpeg_quality: int | None = Field(default=90, ge=5, le=100)
    """The picture went through JPEG of this quality; null: it did not."""


class Look(SensorLook):
    """What our own renderer adds; the defaults resemble a JetBot's camera over white vinyl with black tape."""

    texel_m: float = Field(default=0.002, ge=0.0005, le=0.02)
    """Size of the drawn floor's smallest part."""
    grain_std: float = Field(default=6.0, ge=0.0, le=60.0)
    """The weave of floor and tape, standard deviation in grey levels."""
    patches_std: float = Field(default=4.0, ge=0.0, le=60.0)
    """Slow unevenness of the floor, standard deviation in grey levels."""
    gloss: float = Field(default=40.0, ge=0.0, le=200.0)
    """Strongest streak of a lamp mirrored in the floor, in grey levels; 0 is a dull floor."""
    shadows_per_m2: float = Field(default=0.1, ge=0.0, le=5.0)
    """Shadows on the floor; each is a four-sided stretch up to a metre long."""
    shadow_depth: float = Field(default=0.12, ge=0.0, le=0.95)
    """Share of light that the deepest shadow takes."""
    shadow_edge_m: float = Field(default=0.03, gt=0.0, le=0.5)
    """Width of the half-shadow at its edge."""
    shadow_speed_mps: float = Field(default=0.05, ge=0.0, le=2.0)
    """How fast a shadow wanders to and fro at most."""
