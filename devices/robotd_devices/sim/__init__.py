"""The simulated twins: a flat world, and a lidar, a camera and a base that live in it."""

from robotd_devices.sim.base import SimBase, SimBaseConfig
from robotd_devices.sim.camera import SimCamera, SimCameraConfig
from robotd_devices.sim.lidar import SimLidar, SimLidarConfig
from robotd_devices.sim.maps import FloorLine, MapError, WorldMap, load_map
from robotd_devices.sim.world import FlatWorld, FlatWorldConfig, world_from_segments

__all__ = [
    "FlatWorld",
    "FlatWorldConfig",
    "FloorLine",
    "MapError",
    "SimBase",
    "SimBaseConfig",
    "SimCamera",
    "SimCameraConfig",
    "SimLidar",
    "SimLidarConfig",
    "WorldMap",
    "load_map",
    "world_from_segments",
]
