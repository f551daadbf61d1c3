"""The config's own sections, those that no plugin owns, as they stand in the file."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

from pydantic import Field, field_validator

from robotd.authoring.config import Config
from robotd.world.geometry import convex_hull
from robotd.world.kinematics import Ackermann, Differential, Kinematics, Mecanum
from robotd.world.robot import Limits, Mount, Robot

Metres: TypeAlias = Annotated[float, Field(ge=-3.0, le=3.0)]
Angle: TypeAlias = Annotated[float, Field(ge=-math.pi, le=math.pi)]
Width: TypeAlias = Annotated[float, Field(gt=0.0, le=3.0)]

PLUGIN_SECTIONS = ("devices", "perception", "behaviours", "bridges")


class DifferentialSection(Config):
    """Two driven wheels."""

    type: Literal["differential"]
    track_m: Width
    """Distance between the middles of the left and the right wheel, in metres."""
    wheel_radius_m: Annotated[float, Field(gt=0.0, le=1.0)] = 0.0325
    """Radius of a driven wheel, in metres."""

    def build(self) -> Kinematics:
        """The same as the rest of robotd takes it."""
        return Differential(self.track_m, self.wheel_radius_m)


class MecanumSection(Config):
    """Four mecanum wheels whose rollers form an X seen from above."""

    type: Literal["mecanum"]
    wheelbase_m: Width
    """Distance between the front and the rear axle, in metres."""
    track_m: Width
    """Distance between the middles of the left and the right wheels, in metres."""
    wheel_radius_m: Annotated[float, Field(gt=0.0, le=1.0)]
    """Radius of a wheel, in metres."""

    def build(self) -> Kinematics:
        """The same as the rest of robotd takes it."""
        return Mecanum(self.wheelbase_m, self.track_m, self.wheel_radius_m)


class AckermannSection(Config):
    """A car; its origin is the middle of the rear axle."""

    type: Literal["ackermann"]
    wheelbase_m: Width
    """Distance between the front and the rear axle, in metres."""
    track_m: Width
    """Distance between the middles of the left and the right wheels, in metres."""
    max_steering_rad: Annotated[float, Field(gt=0.0, le=1.3)]
    """Largest angle of the front wheels to either side, in radians."""

    def build(self) -> Kinematics:
        """The same as the rest of robotd takes it."""
        return Ackermann(self.wheelbase_m, self.track_m, self.max_steering_rad)


class MountSection(Config):
    """Where a device sits, seen in base: x forward, y left, z up from the floor; pitch with the nose down positive."""

    x_m: Metres = 0.0
    """Forward of the base's origin, in metres."""
    y_m: Metres = 0.0
    """Left of the base's origin, in metres."""
    z_m: Metres = 0.0
    """Above the floor, in metres."""
    roll_rad: Angle = 0.0
    """About the x axis, in radians."""
    pitch_rad: Angle = 0.0
    """About the y axis, nose down positive, in radians."""
    yaw_rad: Angle = 0.0
    """About the z axis, counter-clockwise positive, in radians."""


class LimitsSection(Config):
    """What the base may do, whoever asks for it."""

    vx_mps: Annotated[float, Field(gt=0.0, le=20.0)] = 0.5
    """Highest speed forward and backward, in metres per second."""
    vy_mps: Annotated[float, Field(ge=0.0, le=20.0)] = 0.0
    """Highest speed sideways, in metres per second; 0 unless the base has mecanum wheels."""
    wz_radps: Annotated[float, Field(gt=0.0, le=30.0)] = 2.0
    """Fastest turn, in radians per second."""
    accel_mps2: Annotated[float, Field(gt=0.0, le=50.0)] = 1.0
    """Highest acceleration, in metres per second squared."""
    decel_mps2: Annotated[float, Field(gt=0.0, le=50.0)] = 1.0
    """What the brakes hold for sure, in metres per second squared; the stop zone is laid out by it."""
    angular_accel_radps2: Annotated[float, Field(gt=0.0, le=500.0)] = 8.0
    """Highest angular acceleration, in radians per second squared."""


class RobotSection(Config):
    """One body, as every part sees it."""

    name: str = Field(default="robot", min_length=1, max_length=64)
    """What this robot is called."""
    kinematics: DifferentialSection | MecanumSection | AckermannSection = Field(discriminator="type")
    """How it moves: differential, mecanum or ackermann."""
    footprint_m: tuple[tuple[Metres, Metres], ...] = Field(min_length=3, max_length=64)
    """Corners [x, y] of its outline in base, in metres, wheels and bumpers included; the convex hull is used."""
    mounts: dict[str, MountSection] = Field(default_factory=dict)
    """Where each device sits, by the device's name."""
    limits: LimitsSection = Field(default_factory=LimitsSection)

    @field_validator("footprint_m")
    @classmethod
    def _spans_an_area(cls, corners: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
        convex_hull(corners)
        return corners

    def build(self) -> Robot:
        """The same as the rest of robotd takes it."""
        return Robot(
            name=self.name,
            kinematics=self.kinematics.build(),
            footprint_m=self.footprint_m,
            mounts={name: Mount(**mount.model_dump()) for name, mount in self.mounts.items()},
            limits=Limits(**self.limits.model_dump()),
        )


class OperatorSection(Config):
    """Who may begin."""

    arm_at_start: bool = False
    """Arm as soon as every needed device is open. Without it the robot waits for somebody to arm it."""


class RecorderSection(Config):
    """What is written down of each run."""

    folder: Path | None = None
    """Where recordings go; without it only `--record` records."""
    frames: Literal["none", "lossless"] = "none"
    """Camera pictures in the recording: none, or lossless so that perceptors can be replayed."""


class TopSection(Config):
    """Single values at the top of the file."""

    act_hz: float = Field(default=50.0, ge=5.0, le=500.0)
    """How often commands are renewed, ramped and expired, in hertz."""


class DeviceEntry(Config):
    """What every entry of `devices:` and `perception:` may say besides its own parameters."""

    use: str | None = None
    """The device or perceptor that does it, where that is not the entry's own name."""
    rename: str | dict[str, str] | None = Field(default=None, alias="as")
    """The topic to publish on instead of the message's own: a name, or message type to name."""


class BehaviourEntry(Config):
    """What every entry of `behaviours:` may say besides its own parameters."""

    use: str | None = None
    """The behaviour that does it, where that is not the entry's own name."""
    priority: int = Field(ge=-1000, le=1000)
    """Who drives when several want to: the highest number; no two may be equal."""
    start: bool = False
    """Begin with `goal` as soon as the robot is armed."""
    goal: dict[str, Any] | None = None
    """What to do, by the keys that this behaviour's goals have."""
    timeout_s: float | None = Field(default=None, gt=0.0)
    """The goal fails after this long, in seconds."""


class BridgeEntry(Config):
    """What every entry of `bridges:` may say besides its own parameters."""

    use: str | None = None
    """The bridge that does it, where that is not the entry's own name."""


class SimulationEntry(Config):
    """What `simulation:` may say besides the parameters of its world."""

    use: str = "flat_world"
    """The world."""
    devices: dict[str, dict[str, Any] | None] = Field(default_factory=dict)
    """Parameters of simulated devices, by the name of the device that each stands for."""
    arm_at_start: bool = True
    """A simulated robot arms itself unless this says false."""


ENTRIES: dict[str, type[Config]] = {
    "devices": DeviceEntry,
    "perception": DeviceEntry,
    "behaviours": BehaviourEntry,
    "bridges": BridgeEntry,
}
SECTIONS: tuple[str, ...] = (
    "robot",
    "devices",
    "perception",
    "behaviours",
    "guard",
    "guardian",
    "operator",
    "bridges",
    "recorder",
    "act_hz",
    "simulation",
)
"""Everything that may stand at the top of a file, in the order in which the shipped configs have it."""


def entry_keys(entry: type[Config]) -> tuple[str, ...]:
    """The keys of an entry as they stand in the file."""
    return tuple(info.alias or name for name, info in entry.model_fields.items())
