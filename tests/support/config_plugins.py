"""Small plugins for the tests of configs, registered through entry points that no distribution has."""

from __future__ import annotations

from importlib.metadata import EntryPoint
from typing import Annotated, ClassVar, Literal

from pydantic import Field, FilePath, model_validator

from robotd.authoring.behaviour import Behaviour
from robotd.authoring.bridge import Bridge
from robotd.authoring.config import Config, FileKey, Goal, NoConfig
from robotd.authoring.device import Actuator, Sensor, World
from robotd.authoring.perceptor import Perceptor
from robotd.authoring.view import View, every, latest
from robotd.setup.registry import GROUPS, Registry
from robotd.world.messages import Battery, Drive, LidarScan, Message, Odometry, Steer, Target


class LidarConfig(Config):
    port: str
    range_max_m: float = Field(default=12.0, ge=0.1, le=40.0)
    range_min_m: float = Field(default=0.02, ge=0.0, le=1.0)
    rate_hz: float = Field(default=10.0, gt=0.0, le=50.0)
    timeout_s: float = Field(default=0.5, gt=0.0, le=10.0)
    baud: int = 230_400
    back: Literal["serial", "fast"] = "serial"
    invert: bool = False


class Lidar(Sensor[LidarConfig, LidarScan]):
    sim_twin = "fake_sim_lidar"

    @classmethod
    def publish_period_s(cls, config: LidarConfig) -> float | None:
        return 1.0 / config.rate_hz


class SimLidarConfig(Config):
    beams: int = Field(default=360, ge=1)
    noise_m: float = Field(default=0.01, ge=0.0)


class SimLidar(Sensor[SimLidarConfig, LidarScan]):
    pass


class MotorConfig(Config):
    bus: int = Field(default=1, ge=0, le=20)
    gains: tuple[float, float] = (1.0, 1.0)
    top_mps: float = Field(default=0.5, gt=0.0, le=5.0)


class Motors(Actuator[MotorConfig, Drive]):
    emits: ClassVar[tuple[type[Message], ...]] = (Odometry, Battery)
    sim_twin = "fake_sim_motors"


class SimMotors(Actuator[NoConfig, Drive]):
    emits: ClassVar[tuple[type[Message], ...]] = (Odometry,)


class Servo(Actuator[NoConfig, Steer]):
    """A car's base without a twin."""


class RoomConfig(Config):
    map: Annotated[str, FileKey("maps")] = "line_track"
    seed: int = Field(default=0, ge=0)


class Room(World[RoomConfig]):
    pass


class PersonConfig(Config):
    model: FilePath
    labels: tuple[FilePath, ...] = ()
    score: float = Field(default=0.5, ge=0.0, le=1.0)


class PersonSees(View):
    scan: LidarScan = every(within_s=0.3)


class Person(Perceptor[PersonConfig, PersonSees, Target]):
    pass


class Zone(Config):
    name: str
    radius_m: float = Field(gt=0.0, le=5.0)


class Circle(Config):
    radius_m: float


class Box(Config):
    width_m: float
    height_m: float


class FollowConfig(Config):
    range_max_m: float = Field(default=3.0, ge=0.3, le=12.0)
    """How far it looks."""
    speed_mps: float = Field(default=0.4, gt=0.0, le=2.0)
    pitch_rad: float = Field(default=0.0, ge=-1.6, le=1.6)
    window: int = Field(default=5, ge=1, le=100)
    gains: tuple[float, float, float] = (1.0, 0.0, 0.0)
    zones: tuple[Zone, ...] = ()
    shape: Circle | Box | None = None
    pace: float | tuple[float, ...] = 1.0
    careful: bool = True
    side: Literal["left", "right"] = "left"
    keep_m: float = 1.0

    @model_validator(mode="after")
    def _keeps_inside(self) -> FollowConfig:
        if self.keep_m > self.range_max_m:
            raise ValueError("keep_m must not be more than range_max_m")
        return self


class FollowSees(View):
    scan: LidarScan = every(within_s=0.3)
    target: Target | None = latest(within_s=0.5)


class FollowGoal(Goal):
    distance_m: float = Field(default=1.0, gt=0.0, le=5.0)


class Follow(Behaviour[FollowConfig, FollowSees, FollowGoal]):
    pass


class Race(Behaviour[NoConfig, PersonSees]):
    emits = Steer


class PageConfig(Config):
    port: int = Field(default=8080, ge=1, le=65_535)
    host: str = "127.0.0.1"


class Page(Bridge[PageConfig]):
    pass


class HiddenConfig(Config):
    start: bool = False


class Hidden(Behaviour[HiddenConfig, PersonSees]):
    """Has a parameter that robotd keeps for itself."""


NOT_A_PLUGIN = 3

_NAMES = {
    "devices": {
        "fake_lidar": "Lidar",
        "fake_sim_lidar": "SimLidar",
        "fake_motors": "Motors",
        "fake_sim_motors": "SimMotors",
        "fake_servo": "Servo",
        "fake_room": "Room",
    },
    "perception": {"person": "Person"},
    "behaviours": {"follow": "Follow", "race": "Race", "hidden": "Hidden", "number": "NOT_A_PLUGIN"},
    "bridges": {"page": "Page"},
}


def points() -> list[EntryPoint]:
    """The entry points of this module, and two that cannot be imported."""
    found = [
        EntryPoint(name, f"config_plugins:{target}", GROUPS[section])
        for section, names in _NAMES.items()
        for name, target in names.items()
    ]
    found.append(EntryPoint("needs_more", "config_plugins_missing_module:Thing", GROUPS["devices"]))
    found.append(EntryPoint("no_such_class", "config_plugins:Absent", GROUPS["bridges"]))
    return found


def registry() -> Registry:
    """A registry that knows only the plugins of this module."""
    return Registry(points())


FILE = """\
robot:
  name: tester
  kinematics: {type: differential, track_m: 0.12}
  footprint_m: [[0.1, 0.07], [0.1, -0.07], [-0.1, -0.07], [-0.1, 0.07]]
  mounts:
    lidar: {x_m: 0.03, z_m: 0.1}
  limits: {vx_mps: 0.4, wz_radps: 2}
devices:
  lidar:
    use: fake_lidar
    port: /dev/ttyUSB0
    range_max_m: 8
  motors:
    use: fake_motors
    gains: [1.0, 0.98]
perception:
  person:
    model: model.onnx
behaviours:
  follow:
    priority: 10
    start: true
    goal: {distance_m: 1.2}
    range_max_m: 4
    zones:
      - {name: door, radius_m: 0.5}
guard:
  zones:
    stop: {sources: [lidar_scan], margin_m: 0.05}
    slow: {sources: [lidar_scan], margin_m: 0.3}
operator: {arm_at_start: false}
bridges:
  page: {port: 8081}
recorder: {frames: none}
act_hz: 50
simulation:
  use: fake_room
  seed: 3
  devices:
    lidar: {beams: 90}
"""
"""A good config that uses most of the plugins above; it needs a file model.onnx beside it."""
