"""robotd turns a small robot's sensors into safe motion. This module is the whole API for authors of plugins.

What fewer authors need is one level down: more messages in `robotd.world.messages`, drawings in
`robotd.authoring.explain`, simulated worlds and kinds of device errors in `robotd.authoring.device`.

Each name is imported when it is first asked for, so that `robotd --help` does not wait for numpy and pydantic.
"""

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
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
else:
    _HOMES = {
        "authoring.behaviour": "Behaviour Done Failed Plan Sequence",
        "authoring.bridge": "Bridge RuntimeLink",
        "authoring.config": "Config Goal NoConfig",
        "authoring.device": "Actuator DeviceContext Sensor Watchdog",
        "authoring.perceptor": "Perceptor",
        "authoring.view": "View every latest needed",
        "world.messages": "Battery CameraFrame Detections Drive Imu LidarScan Message Odometry Steer Target",
        "world.topics": "Topic",
    }

    def __getattr__(name: str) -> object:
        for home, names in _HOMES.items():
            if name in names.split():
                value = getattr(importlib.import_module(f"robotd.{home}"), name)
                globals()[name] = value
                return value
        raise AttributeError(f"module 'robotd' has no attribute {name!r}")

    def __dir__() -> list[str]:
        return sorted({*globals(), *__all__})


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
