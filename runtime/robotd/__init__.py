"""robotd turns a small robot's sensors into safe motion. This module is the whole API for authors of plugins."""

from robotd.authoring.behaviour import Behaviour, Done, Failed, Plan, Sequence
from robotd.authoring.bridge import Bridge
from robotd.authoring.config import Config, Goal, NoConfig, NoGoal
from robotd.authoring.device import Actuator, DeviceError, Sensor, Watchdog, World
from robotd.authoring.perceptor import Perceptor
from robotd.authoring.view import View, every, latest, needed
from robotd.world.messages import (
    Battery,
    CameraFrame,
    Detections,
    Drive,
    Imu,
    LidarScan,
    Message,
    Odometry,
    Steer,
    Target,
)
from robotd.world.topics import Topic

__all__ = [
    "Actuator",
    "Battery",
    "Behaviour",
    "Bridge",
    "CameraFrame",
    "Config",
    "Detections",
    "DeviceError",
    "Done",
    "Drive",
    "Failed",
    "Goal",
    "Imu",
    "LidarScan",
    "Message",
    "NoConfig",
    "NoGoal",
    "Odometry",
    "Perceptor",
    "Plan",
    "Sensor",
    "Sequence",
    "Steer",
    "Target",
    "Topic",
    "View",
    "Watchdog",
    "World",
    "every",
    "latest",
]
__all__ += ["needed"]
