"""Plugins and configs rich in kinds of parameters, for mutating; registered through entry points of no distribution."""

from __future__ import annotations

from importlib.metadata import EntryPoint
from typing import Annotated, ClassVar, Literal

from pydantic import Field, FilePath

from robotd.authoring.behaviour import Behaviour
from robotd.authoring.bridge import Bridge
from robotd.authoring.config import Config, FileKey, Goal, NoConfig
from robotd.authoring.device import Actuator, Sensor, World
from robotd.authoring.perceptor import Perceptor
from robotd.authoring.view import View, every, latest
from robotd.setup.registry import GROUPS
from robotd.world.messages import Battery, CameraFrame, Detections, Drive, LidarScan, Message, Odometry, Steer, Target
from robotd.world.topics import Topic

REAR = Topic("rear_scan", LidarScan)


class LidarConfig(Config):
    port: str = Field(min_length=1)
    baud: int = Field(default=230_400, ge=9600, le=2_000_000)
    range_min_m: float = Field(default=0.05, ge=0.0, le=1.0)
    range_max_m: float = Field(default=12.0, ge=1.0, le=40.0)
    mask_rad: tuple[tuple[float, float], ...] = ()
    inverted: bool = False
    model: Literal["ld06", "ld19", "stl27"] = "ld19"


class Lidar(Sensor[LidarConfig, LidarScan]):
    sim_twin = "bench_sim_lidar"


class SimLidarConfig(Config):
    rate_hz: float = Field(default=10.0, gt=0.0, le=100.0)
    beams: int = Field(default=450, ge=1, le=20_000)
    noise_m: float = Field(default=0.01, ge=0.0, le=1.0)


class SimLidar(Sensor[SimLidarConfig, LidarScan]):
    pass


class CameraConfig(Config):
    source: int = Field(default=0, ge=0, le=64)
    width_px: int = Field(default=640, ge=16, le=4096)
    height_px: int = Field(default=480, ge=16, le=4096)
    rate_hz: float = Field(default=30.0, gt=0.0, le=240.0)
    exposure_ms: float | None = Field(default=None, gt=0.0, le=1000.0)


class Camera(Sensor[CameraConfig, CameraFrame]):
    sim_twin = "bench_sim_camera"


class SimCamera(Sensor[CameraConfig, CameraFrame]):
    pass


class BaseConfig(Config):
    port: str = Field(min_length=1)
    gain: float = Field(default=1.0, ge=0.5, le=2.0)
    currents_a: tuple[float, float] = (2.0, 2.0)
    ramp: bool = True


class MecanumBase(Actuator[BaseConfig, Drive]):
    emits: ClassVar[tuple[type[Message], ...]] = (Odometry, Battery)
    sim_twin = "bench_sim_base"


class SimBaseConfig(Config):
    lag_s: float = Field(default=0.08, ge=0.0, le=1.0)


class SimBase(Actuator[SimBaseConfig, Drive]):
    emits: ClassVar[tuple[type[Message], ...]] = (Odometry,)


class VescConfig(Config):
    port: str = Field(min_length=1)
    erpm_per_mps: float = Field(default=4614.0, gt=0.0, le=100_000.0)
    servo: tuple[float, float] = (-1.2135, 0.5304)
    timeout_ms: int = Field(default=100, ge=20, le=1000)


class Vesc(Actuator[VescConfig, Steer]):
    emits: ClassVar[tuple[type[Message], ...]] = (Odometry,)
    sim_twin = "bench_sim_car"


class SimCar(Actuator[SimBaseConfig, Steer]):
    emits: ClassVar[tuple[type[Message], ...]] = (Odometry,)


class HallConfig(Config):
    map: Annotated[str, FileKey("maps")] = "line_track"
    seed: int = Field(default=0, ge=0, le=1_000_000)
    step_s: float = Field(default=0.005, ge=0.0005, le=0.02)


class Hall(World[HallConfig]):
    pass


class SeesFrame(View):
    frame: CameraFrame = every(within_s=0.5)


class SeesScan(View):
    scan: LidarScan = every(within_s=0.5)
    target: Target | None = latest(within_s=0.5)


class SeesBoth(View):
    scan: LidarScan = every(within_s=0.5)
    rear: LidarScan | None = latest(REAR, within_s=0.5)


class DetectorConfig(Config):
    weights: FilePath
    labels: tuple[str, ...] = ("person",)
    score: float = Field(default=0.4, ge=0.0, le=1.0)
    iou: float = Field(default=0.5, ge=0.0, le=1.0)
    size_px: int = Field(default=320, ge=32, le=1280)


class Detector(Perceptor[DetectorConfig, SeesFrame, Detections]):
    pass


class TrackerConfig(Config):
    memory_s: float = Field(default=2.0, gt=0.0, le=30.0)
    gate_m: float = Field(default=0.6, gt=0.0, le=5.0)
    prefer: Literal["near", "large", "first"] = "near"


class SeesDetections(View):
    seen: Detections = every(within_s=0.5)


class Tracker(Perceptor[TrackerConfig, SeesDetections, Target]):
    pass


class Band(Config):
    near_m: float = Field(ge=0.1, le=5.0)
    far_m: float = Field(ge=0.1, le=10.0)


class FollowConfig(Config):
    window_m: float = Field(default=2.0, ge=0.2, le=8.0)
    sectors: int = Field(default=72, ge=8, le=720)
    cost_goal: float = Field(default=5.0, ge=0.0, le=100.0)
    cost_turn: float = Field(default=2.0, ge=0.0, le=100.0)
    band: Band = Band(near_m=0.8, far_m=1.6)
    speed_mps: float = Field(default=0.6, gt=0.0, le=3.0)
    turn_radps: float = Field(default=1.5, gt=0.0, le=10.0)
    search: bool = True


class FollowGoal(Goal):
    distance_m: float = Field(default=1.2, ge=0.3, le=5.0)
    label: str = "person"


class Follow(Behaviour[FollowConfig, SeesScan, FollowGoal]):
    pass


class WaypointConfig(Config):
    x_m: float
    y_m: float
    yaw_rad: float = Field(default=0.0, ge=-3.15, le=3.15)
    pause_s: float = Field(default=0.0, ge=0.0, le=600.0)


class PatrolConfig(Config):
    waypoints: tuple[WaypointConfig, ...] = Field(min_length=1)
    loop: bool = True
    speeds: dict[str, float] = Field(default_factory=dict)


class Patrol(Behaviour[PatrolConfig, SeesBoth]):
    pass


class RaceConfig(Config):
    bubble_m: float = Field(default=0.3, ge=0.05, le=2.0)
    gap_min_m: float = Field(default=0.6, ge=0.1, le=5.0)
    grip_mps2: float = Field(default=6.0, gt=0.0, le=30.0)
    speed_max_mps: float = Field(default=6.0, gt=0.0, le=20.0)
    look_ahead_s: float = Field(default=0.4, gt=0.0, le=3.0)
    track: Annotated[str, FileKey("maps")] | None = None


class Race(Behaviour[RaceConfig, SeesScan]):
    emits = Steer


class Creep(Behaviour[NoConfig, SeesScan]):
    emits = Steer


class BrokerConfig(Config):
    host: str = "127.0.0.1"
    port: int = Field(default=1883, ge=1, le=65_535)
    keepalive_s: float = Field(default=5.0, ge=1.0, le=600.0)
    tls: bool = False
    password_file: FilePath | None = None


class Broker(Bridge[BrokerConfig]):
    pass


_PLUGINS: dict[str, dict[str, type]] = {
    "devices": {
        "bench_lidar": Lidar,
        "bench_sim_lidar": SimLidar,
        "bench_camera": Camera,
        "bench_sim_camera": SimCamera,
        "bench_mecanum": MecanumBase,
        "bench_sim_base": SimBase,
        "bench_vesc": Vesc,
        "bench_sim_car": SimCar,
        "bench_hall": Hall,
    },
    "perception": {"bench_detector": Detector, "bench_tracker": Tracker},
    "behaviours": {"bench_follow": Follow, "bench_patrol": Patrol, "bench_race": Race, "bench_creep": Creep},
    "bridges": {"bench_broker": Broker},
}
POINTS: tuple[EntryPoint, ...] = tuple(
    EntryPoint(name, f"{cls.__module__}:{cls.__name__}", GROUPS[section])
    for section, plugins in _PLUGINS.items()
    for name, cls in plugins.items()
)
FILES = ("weights.onnx", "secret.txt")
"""Files that the configs below name; they stand beside them."""

FOLLOWER = """\
# A mecanum robot that follows people and patrols when nobody is there.
robot:
  name: follower
  kinematics: {type: mecanum, wheelbase_m: 0.22, track_m: 0.26, wheel_radius_m: 0.04}
  footprint_m: [[0.2, 0.16], [0.2, -0.16], [-0.2, -0.16], [-0.2, 0.16]]
  mounts:
    front: {x_m: 0.15, z_m: 0.2}
    rear: {x_m: -0.15, z_m: 0.2, yaw_rad: 3.14}
    camera:
      x_m: 0.18
      z_m: 0.35
      pitch_rad: 0.1
  limits: {vx_mps: 1.0, vy_mps: 0.6, wz_radps: 2.0, accel_mps2: 1.5, decel_mps2: 2.0}
devices:
  front:
    use: bench_lidar
    port: /dev/ttyUSB0
    range_max_m: 12.0
    mask_rad: [[1.2, 1.4], [-1.4, -1.2]]
  rear:
    use: bench_lidar
    as: rear_scan
    port: /dev/ttyUSB1
    inverted: true
    model: ld06
  camera:
    use: bench_camera
    width_px: 640
    height_px: 480
    rate_hz: 15
  base:
    use: bench_mecanum
    as: {Odometry: wheels}
    port: /dev/ttyACM0
    gain: 1.05
    currents_a: [2.5, 2.5]
perception:
  bench_detector:
    weights: weights.onnx
    labels: [person, dog]
    score: 0.35
    size_px: 320
  bench_tracker:
    memory_s: 3.0
    gate_m: 0.5
    prefer: large
behaviours:
  bench_follow:
    priority: 20
    start: true
    goal: {distance_m: 1.5, label: person}
    window_m: 2.5
    sectors: 72
    cost_goal: 5
    band: {near_m: 0.9, far_m: 1.8}
    speed_mps: 0.8
    turn_radps: 1.2
  bench_patrol:
    priority: 10
    timeout_s: 600
    waypoints:
      - {x_m: 0.0, y_m: 0.0}
      - {x_m: 2.0, y_m: 0.5, yaw_rad: 1.57, pause_s: 2.0}
    speeds: {hall: 0.5, door: 0.2}
guard:
  zones:
    stop: {sources: [lidar_scan, rear_scan], margin_m: 0.06}
    slow: {sources: [lidar_scan], margin_m: 0.4, speed_mps: 0.3}
  scan_within_s: 0.3
  latency_s: 0.12
operator: {arm_at_start: false}
bridges:
  bench_broker:
    host: localhost
    port: 1883
    keepalive_s: 10
    password_file: secret.txt
recorder: {frames: lossless}
act_hz: 50
simulation:
  use: bench_hall
  map: line_loop
  seed: 7
  devices:
    front: {rate_hz: 12.0, beams: 360}
    base: {lag_s: 0.05}
"""

RACER = """\
robot:
  name: racer
  kinematics:
    type: ackermann
    wheelbase_m: 0.257
    track_m: 0.19
    max_steering_rad: 0.41
  footprint_m: [[0.35, 0.1], [0.35, -0.1], [-0.1, -0.1], [-0.1, 0.1]]
  mounts:
    lidar: {x_m: 0.27, z_m: 0.12}
  limits:
    vx_mps: 8.0
    wz_radps: 6.0
    accel_mps2: 6.0
    decel_mps2: 8.0
    angular_accel_radps2: 60.0

devices:
  lidar:
    use: bench_lidar
    port: /dev/serial/by-id/usb-lidar
    baud: 230400
    range_min_m: 0.1
    range_max_m: 30.0
  car:
    use: bench_vesc
    port: /dev/serial/by-id/usb-vesc
    erpm_per_mps: 4614.0
    servo: [-1.2135, 0.5304]
    timeout_ms: 100

behaviours:
  bench_race:
    priority: 10
    start: true
    bubble_m: 0.35
    gap_min_m: 0.7
    grip_mps2: 6.5
    speed_max_mps: 7.0
    look_ahead_s: 0.5
    track: line_loop
  crawl:
    use: bench_creep
    priority: 1

guard:
  zones: {off: "a race car between walls of foam"}

operator: {arm_at_start: false}
recorder: {frames: none}
act_hz: 100

simulation:
  use: bench_hall
  map: line_loop
  step_s: 0.002
  arm_at_start: true
  devices:
    lidar:
      rate_hz: 40.0
      beams: 1080
      noise_m: 0.02
"""
BASES: dict[str, str] = {"follower": FOLLOWER, "racer": RACER}
