"""The simulated twins: a flat world, and the sensors and bases that live in it."""

from robotd_devices.sim.base import SimBase, SimBaseConfig
from robotd_devices.sim.body_sensors import (
    SimBattery,
    SimBatteryConfig,
    SimBumper,
    SimBumperConfig,
    SimImu,
    SimImuConfig,
)
from robotd_devices.sim.camera import SimCamera, SimCameraConfig
from robotd_devices.sim.car import SimCar, SimCarConfig
from robotd_devices.sim.lidar import SimLidar, SimLidarConfig
from robotd_devices.sim.maps import Card, FloorLine, MapError, WorldMap, load_map, route_world
from robotd_devices.sim.people import Person, Walk, walk_along
from robotd_devices.sim.route import random_route
from robotd_devices.sim.world import FlatWorld, FlatWorldConfig, world_from_segments

__all__ = [
    "Card",
    "FlatWorld",
    "FlatWorldConfig",
    "FloorLine",
    "MapError",
    "Person",
    "SimBase",
    "SimBaseConfig",
    "SimBattery",
    "SimBatteryConfig",
    "SimBumper",
    "SimBumperConfig",
    "SimCamera",
    "SimCameraConfig",
    "SimCar",
    "SimCarConfig",
    "SimImu",
    "SimImuConfig",
    "SimLidar",
    "SimLidarConfig",
    "Walk",
    "WorldMap",
    "load_map",
    "random_route",
    "route_world",
    "walk_along",
    "world_from_segments",
]
