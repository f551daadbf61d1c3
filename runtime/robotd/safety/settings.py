"""Parameters of the guard and of the guardian, as they stand in a config's `guard:` and `guardian:`."""

from __future__ import annotations

from pydantic import Field, model_validator

from robotd.authoring.config import Config


class StopZone(Config):
    """Nothing may come nearer to the outline than `margin_m`; the braking envelope is added by speed."""

    sources: tuple[str, ...] = ("lidar_scan",)
    """Topics of the scans that feed this zone."""
    margin_m: float = Field(default=0.04, ge=0.0, le=1.0)
    """Clearance that is always kept, in metres."""


class SlowZone(Config):
    """Motion towards something nearer than `margin_m` is held to `speed_mps`."""

    sources: tuple[str, ...] = ("lidar_scan",)
    """Topics of the scans that feed this zone."""
    margin_m: float = Field(default=0.25, ge=0.0, le=5.0)
    """Distance at which slow motion begins, in metres."""
    speed_mps: float = Field(default=0.15, gt=0.0, le=5.0)
    """Highest speed of any corner of the outline inside the zone."""


class ContactAllowance(Config):
    """Lets named behaviours touch on purpose (docking), no faster than a creep."""

    behaviours: tuple[str, ...]
    """Names of the behaviours that may touch."""
    creep_mps: float = Field(default=0.05, gt=0.0, le=0.15)
    """Highest speed inside the stop zone, in metres per second."""


class Zones(Config):
    """Either `off: reason`, or a stop zone and perhaps a slow zone."""

    off: str | None = Field(default=None, min_length=3)
    """Why this robot drives without zones; the reason is shown wherever the robot's state is shown."""
    stop: StopZone | None = None
    slow: SlowZone | None = None

    @model_validator(mode="after")
    def _one_or_the_other(self) -> Zones:
        if (self.off is None) == (self.stop is None):
            raise ValueError("say either `off: the reason` or `stop: {sources: [lidar_scan]}`, one of the two")
        if self.off is not None and self.slow is not None:
            raise ValueError("`off` switches all zones off; remove `slow` or remove `off`")
        return self


class GuardConfig(Config):
    """The last word before the motors."""

    zones: Zones = Field(default_factory=lambda: Zones(stop=StopZone(), slow=SlowZone()))
    scan_within_s: float = Field(default=0.25, gt=0.0, le=2.0)
    """A zone whose scan is older than this stops every motion, in seconds."""
    latency_s: float = Field(default=0.1, ge=0.0, le=1.0)
    """From the light that hit the sensor to the wheels that obey, in seconds; part of the braking envelope."""
    contact: ContactAllowance | None = None


class GuardianConfig(Config):
    """The process that stops the motors when robotd is blocked, frozen or killed. Real hardware only."""

    off: str | None = Field(default=None, min_length=3)
    """Why this robot drives without it; a base whose driver offers no stop line has none either."""
    deadline_ms: int = Field(default=100, ge=40, le=1000)
    """Without a sign of life for this long it stops the motors, in ms; never less than two and a half act ticks."""
