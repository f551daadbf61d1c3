"""robotd turns a small robot's sensors into safe motion. This module is the whole API for authors of plugins.

What fewer authors need is one level down: more messages in `robotd.world.messages`, drawings in
`robotd.authoring.explain`, simulated worlds and kinds of device errors in `robotd.authoring.device`.
"""

from robotd.authoring.behaviour import Behaviour, Done, Failed, Plan, Sequence
from robotd.authoring.bridge import Bridge, RuntimeLink
from robotd.authoring.config import Config, Goal, NoConfig
from robotd.authoring.device import Actuator, DeviceContext, Sensor, Watchdog
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
    "DeviceContext",
    "Done",
    "Drive",
    "Failed",
    "Goal",
    "Imu",
    "LidarScan",
    "Message",
    "NoConfig",
    "Odometry",
    "Perceptor",
    "Plan",
    "RuntimeLink",
    "Sensor",
    "Sequence",
    "Steer",
    "Target",
    "Topic",
    "View",
    "Watchdog",
    "every",
    "latest",
    "needed",
]
