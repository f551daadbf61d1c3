"""The simulated camera: floor, tape, gloss and room as a wide-angle camera on the robot sees them."""

from __future__ import annotations

import math

import numpy as np
from pydantic import Field, model_validator

from robotd.authoring.config import Config
from robotd.authoring.device import DeviceContext, DeviceMisconfigured, Sensor
from robotd.world.clock import ns
from robotd.world.messages import Bytes2D, CameraFrame
from robotd.world.robot import Mount
from robotd_devices.sim.lens import FloorCamera, Lens
from robotd_devices.sim.render import Look, Renderer
from robotd_devices.sim.ticks import Ticker
from robotd_devices.sim.world import FlatWorld, flat_world


class SimCameraConfig(Config):
    """A simulated camera; the defaults resemble a JetBot's wide-angle one over white vinyl with black tape."""

    rate_hz: float = Field(default=20.0, gt=0.0, le=200.0)
    """Pictures a second."""
    width_px: int = Field(default=320, ge=16, le=1920)
    height_px: int = Field(default=240, ge=16, le=1440)
    fov_rad: float = Field(default=2.1, gt=0.1, le=3.5)
    """Horizontal field of view, from edge to edge."""
    vertical_fov_rad: float | None = Field(default=None, gt=0.1, le=3.5)
    """Only for pictures that were squeezed to another shape; otherwise pixels are square."""
    distortion: tuple[float, float, float, float] | None = (0.0, 0.0, 0.0, 0.0)
    """Terms k1 to k4 of the wide-angle model (zeros: equidistant); null: a pinhole without distortion."""
    latency_s: float = Field(default=0.02, ge=0.0, le=0.5)
    """From the middle of the exposure, which is the stamp, to publication."""
    frame_loss: float = Field(default=0.0, ge=0.0, lt=1.0)
    """Share of pictures that never arrive; their numbers are missing in `sequence`."""
    texel_m: float = Field(default=0.002, ge=0.0005, le=0.02)
    """Size of the drawn floor's smallest part."""
    tape_grey: float = Field(default=82.0, ge=0.0, le=255.0)
    """Grey level of tape in full light."""
    floor_grey: float = Field(default=200.0, ge=0.0, le=255.0)
    """Grey level of floor in full light."""
    grain_std: float = Field(default=6.0, ge=0.0, le=60.0)
    """The weave of floor and tape, standard deviation in grey levels."""
    patches_std: float = Field(default=4.0, ge=0.0, le=60.0)
    """Slow unevenness of the floor, standard deviation in grey levels."""
    gloss: float = Field(default=40.0, ge=0.0, le=200.0)
    """Strongest streak of a lamp mirrored in the floor, in grey levels; 0 is a dull floor."""
    vignette: float = Field(default=0.32, ge=0.0, le=0.9)
    """Share of light lost in the corners."""
    brightness: float = Field(default=1.0, gt=0.0, le=4.0)
    """Factor on all light."""
    noise_std: float = Field(default=3.0, ge=0.0, le=60.0)
    """Sensor noise, standard deviation in grey levels."""

    @model_validator(mode="after")
    def _lens_is_possible(self) -> SimCameraConfig:
        self.lens()
        return self

    def lens(self) -> Lens:
        """The lens that these values describe."""
        return Lens(self.width_px, self.height_px, self.fov_rad, self.vertical_fov_rad, self.distortion)

    def look(self) -> Look:
        """The values that say what the picture looks like."""
        return Look(
            tape=self.tape_grey,
            floor=self.floor_grey,
            grain_std=self.grain_std,
            patches_std=self.patches_std,
            texel_m=self.texel_m,
            gloss=self.gloss,
            vignette=self.vignette,
            brightness=self.brightness,
            noise_std=self.noise_std,
        )


class SimCamera(Sensor[SimCameraConfig, CameraFrame]):
    """Pictures of the world's floor from the true pose at the stamp.

    Height, pitch and place come from the robot's mount of this device; a camera at height 0 cannot see the floor
    and raises DeviceMisconfigured.
    """

    def __init__(self, config: SimCameraConfig, context: DeviceContext | None = None) -> None:
        super().__init__(config, context)
        self._world: FlatWorld | None = None
        self._renderer: Renderer | None = None
        self._rng = np.random.default_rng(0)
        self._sequence = 0
        self._latency_ns = ns(config.latency_s)
        self._ticker = Ticker(1.0 / config.rate_hz, self._show, delay_s=config.latency_s)

    @classmethod
    def load(cls, config: SimCameraConfig) -> None:
        import cv2  # noqa: F401  # the import is the work

    @classmethod
    def publish_period_s(cls, config: SimCameraConfig) -> float | None:
        return 1.0 / config.rate_hz

    async def open(self) -> None:
        world = flat_world(self.context)
        mount = self.context.mount
        check_mount(self.context.name, mount)
        self._rng = world.generator(self.context.name)
        camera = FloorCamera(self.config.lens(), mount)
        self._renderer = Renderer(camera, world.map, self.config.look(), self._rng)
        self._world = world
        self._sequence = 0
        self._ticker.start()

    async def close(self) -> None:
        self._ticker.stop()
        self._world = self._renderer = None

    def picture(self, pose: tuple[float, float, float]) -> Bytes2D:
        """What the camera sees with the base at `pose` in the map, uint8 (height, width, 3); only while open."""
        if self._renderer is None:
            raise RuntimeError(f"{self.context.name} is not open")
        return self._renderer.picture(pose)

    def _show(self) -> None:
        if self._world is None:
            return
        stamp_ns = self.context.clock.now_ns() - self._latency_ns
        self._sequence += 1
        if self.config.frame_loss > 0.0 and self._rng.random() < self.config.frame_loss:
            return
        x_m, y_m, yaw_rad = self._world.poses(np.array([stamp_ns]))[0]
        bgr = self.picture((float(x_m), float(y_m), math.remainder(float(yaw_rad), math.tau)))
        self.publish(CameraFrame(stamp_ns, bgr, self._sequence, self.context.name))


def check_mount(name: str, mount: Mount) -> None:
    """Raises DeviceMisconfigured for a camera that would lie on the floor."""
    if not mount.z_m > 0.0:
        raise DeviceMisconfigured(
            f"{name}: a camera needs its height above the floor; write for example "
            f"`robot: {{mounts: {{{name}: {{x_m: 0.06, z_m: 0.11, pitch_rad: 0.35}}}}}}`"
        )
