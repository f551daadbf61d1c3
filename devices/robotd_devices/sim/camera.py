"""The simulated camera: floor, tape, cards, people and room as a wide-angle camera on the robot sees them."""

from __future__ import annotations

from typing import ClassVar

from robotd.authoring.device import DeviceContext, DeviceMisconfigured, Sensor
from robotd.world.messages import Bytes2D, CameraFrame
from robotd_devices.sim.lens import FloorCamera
from robotd_devices.sim.look import Look
from robotd_devices.sim.render import Renderer
from robotd_devices.sim.shutter import CameraSettings, Pose, Shutter, check_mount
from robotd_devices.sim.world import flat_world


class SimCameraConfig(CameraSettings, Look):
    """A simulated camera; the defaults resemble a JetBot's wide-angle one over white vinyl with black tape."""

    def look(self) -> Look:
        """The values that say what the picture looks like."""
        return self


class SimCamera(Sensor[SimCameraConfig, CameraFrame]):
    """Pictures of the world from the true pose at the stamp, with motion blur over the exposure around it.

    Height, pitch and place come from the robot's mount of this device; a camera at height 0 cannot see the floor
    and raises DeviceMisconfigured.
    """

    sim_twin: ClassVar[str | None] = "sim_camera"

    def __init__(self, config: SimCameraConfig, context: DeviceContext | None = None) -> None:
        super().__init__(config, context)
        self._shutter = Shutter(config, self.context, self.publish)

    @classmethod
    def load(cls, config: SimCameraConfig) -> None:
        import cv2  # noqa: F401  # the import is the work

    @classmethod
    def publish_period_s(cls, config: SimCameraConfig) -> float | None:
        return 1.0 / config.rate_hz

    async def open(self) -> None:
        world = flat_world(self.context)
        check_mount(self.context.name, self.context.mount)
        rng = world.generator(self.context.name)
        camera = FloorCamera(self.config.lens(), self.context.mount)
        try:
            renderer = Renderer(camera, world.map, self.config.look(), rng, world.scene)
        except ValueError as error:
            raise DeviceMisconfigured(f"map {world.map.name}: {error}") from error
        self._shutter.start(world, renderer.picture, rng)

    async def close(self) -> None:
        self._shutter.stop()

    def picture(self, pose: Pose) -> Bytes2D:
        """What the camera sees now if the base rests at `pose` in map, uint8 (height, width, 3); only while open."""
        return self._shutter.picture(pose)
