"""Camera and lidar of the same flat world, seen by MuJoCo: so that vision is not tested on our own renderer alone."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from pydantic import Field

from robotd.authoring.device import DeviceContext, DeviceMisconfigured, Sensor
from robotd.world.messages import Bytes2D, CameraFrame, Float64s
from robotd_devices.sim.lens import FloorCamera
from robotd_devices.sim.lidar import HEIGHT_M, SimLidar, SimLidarConfig
from robotd_devices.sim.look import SensorLook
from robotd_devices.sim.mujoco_model import MujocoWorld, Surface, import_mujoco
from robotd_devices.sim.mujoco_view import MujocoView
from robotd_devices.sim.shutter import CameraSettings, Pose, Shutter, check_mount
from robotd_devices.sim.world import FlatWorld, flat_world

_BLOCK_M = 0.001
_BLOCK_RAD = 0.001
"""Beams that are sent within so much motion share an origin."""


class MujocoCameraConfig(CameraSettings, SensorLook):
    """A simulated camera whose pictures MuJoCo renders."""

    reflectance: float = Field(default=0.1, ge=0.0, le=1.0)
    """Share of what stands on the floor that the floor mirrors."""
    specular: float = Field(default=0.3, ge=0.0, le=1.0)
    """Strength of the lamps' highlights on floor and tape."""
    shadows: bool = False
    """Whether lamps cast shadows; makes a picture several times as dear."""
    samples: int = Field(default=0, ge=0, le=16)
    """Samples a pixel against jagged edges; 0: one."""

    def surface(self) -> Surface:
        """The values that the model needs."""
        return Surface(self.tape_grey, self.floor_grey, self.reflectance, self.specular, self.shadows, self.samples)


class MujocoCamera(Sensor[MujocoCameraConfig, CameraFrame]):
    """Like `SimCamera`, from the same world, map, mount and lens. Needs the extra `sim`.

    Things that a test puts into the world while it runs are not in the picture.
    """

    sim_twin: ClassVar[str | None] = "mujoco_camera"

    def __init__(self, config: MujocoCameraConfig, context: DeviceContext | None = None) -> None:
        super().__init__(config, context)
        self._view: MujocoView | None = None
        self._shutter = Shutter(config, self.context, self.publish)

    @classmethod
    def load(cls, config: MujocoCameraConfig) -> None:
        import cv2  # noqa: F401  # the import is the work

        import_mujoco()

    @classmethod
    def publish_period_s(cls, config: MujocoCameraConfig) -> float | None:
        return 1.0 / config.rate_hz

    async def open(self) -> None:
        world = flat_world(self.context)
        check_mount(self.context.name, self.context.mount)
        rng = world.generator(self.context.name)
        camera = FloorCamera(self.config.lens(), self.context.mount)
        try:
            view = MujocoView(camera, world.scene, self.config.surface(), self.config, rng)
        except ValueError as error:
            raise DeviceMisconfigured(f"{self.context.name}: map {world.map.name}: {error}") from error
        self._view = view
        self._shutter.start(world, view.picture, rng)

    async def close(self) -> None:
        self._shutter.stop()
        if self._view is not None:
            self._view.close()
            self._view = None

    def picture(self, pose: Pose) -> Bytes2D:
        """What the camera sees now if the base rests at `pose` in map, uint8 (height, width, 3); only while open."""
        return self._shutter.picture(pose)


class MujocoLidar(SimLidar):
    """Like `SimLidar`, with ranges that MuJoCo casts; noise, dropout and sweep are the same. Needs the extra `sim`.

    A wall is a box of 0.8 mm here. Structures have their height, so that a lidar above them sees over them.
    """

    sim_twin: ClassVar[str | None] = "mujoco_lidar"

    def __init__(self, config: SimLidarConfig, context: DeviceContext | None = None) -> None:
        super().__init__(config, context)
        self._model: MujocoWorld | None = None

    @classmethod
    def load(cls, config: SimLidarConfig) -> None:
        import_mujoco()

    async def open(self) -> None:
        world = flat_world(self.context)
        try:
            self._model = MujocoWorld(world.scene, Surface(), (), world.generator(f"{self.context.name} model"))
        except ValueError as error:
            raise DeviceMisconfigured(f"{self.context.name}: map {world.map.name}: {error}") from error
        await super().open()

    async def close(self) -> None:
        await super().close()
        self._model = None

    def cast(self, world: FlatWorld, end_ns: int, origins_m: Float64s, bearings_rad: Float64s) -> Float64s:
        model = self._model
        assert model is not None
        mujoco = import_mujoco()
        mount = self.context.mount
        height_m = mount.z_m if mount.z_m > 0.0 else HEIGHT_M
        beams = len(bearings_rad)
        origins_m = np.broadcast_to(origins_m, (beams, 2))
        turned_rad = float(np.abs(bearings_rad[-1] - bearings_rad[0] - (self._exact_rad[-1] - self._exact_rad[0])))
        moved_m = float(np.hypot(*(origins_m[-1] - origins_m[0])))
        moved_m = max(moved_m, world.scene.top_speed_mps * (end_ns - self._start_ns(end_ns)) / 1e9)
        blocks = min(beams, 1 + math.ceil(moved_m / _BLOCK_M) + math.ceil(turned_rad / _BLOCK_RAD))
        ways = np.stack((np.cos(bearings_rad), np.sin(bearings_rad), np.zeros(beams)), axis=1)
        ranges_m = np.full(beams, -1.0)
        geom = np.zeros(beams, dtype=np.int32)
        start_s, end_s = world.second(self._start_ns(end_ns)), world.second(end_ns)
        for block in np.array_split(np.arange(beams), blocks):
            first, last = int(block[0]), int(block[-1]) + 1
            middle = int(block[len(block) // 2])
            when_s = start_s + (end_s - start_s) * float(self._shares[middle])
            model.place((0.0, 0.0, 0.0), when_s)
            mujoco.mj_multiRay(
                model.model, model.data, np.array((*origins_m[middle], height_m)), ways[first:last].ravel(), None, True,
                -1, geom[first:last], ranges_m[first:last], None, last - first, 1e3,
            )  # fmt: skip
        return np.where(ranges_m < 0.0, math.inf, ranges_m)
