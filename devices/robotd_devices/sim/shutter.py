"""When a simulated camera looks: rate, exposure, latency and loss of pictures, whoever renders them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np
from pydantic import Field, model_validator

from robotd.authoring.config import Config
from robotd.authoring.device import DeviceContext, DeviceMisconfigured
from robotd.world.clock import ns
from robotd.world.lens import Lens
from robotd.world.messages import Bytes2D, CameraFrame, Float64s
from robotd.world.robot import Mount
from robotd_devices.ports.ticker import Ticker
from robotd_devices.sim.world import FlatWorld

Pose: TypeAlias = tuple[float, float, float]
Render: TypeAlias = Callable[[Pose, float, Sequence[Pose]], Bytes2D]
"""From the base's pose in the middle of the exposure, the world's second then, and poses over the exposure."""

_MOST_VIEWS = 4
"""Mixed for the blur of one exposure; beyond it the blur is a little uneven."""


class CameraSettings(Config):
    """Lens and timing of a simulated camera; the defaults are those of a JetBot's wide-angle one."""

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
    exposure_s: float = Field(default=0.01, ge=0.0, le=0.2)
    """How long light is gathered: what moves in that time is blurred. The stamp is its middle."""

    @model_validator(mode="after")
    def _lens_is_possible(self) -> CameraSettings:
        self.lens()
        return self

    def lens(self) -> Lens:
        """The lens that these values describe."""
        return Lens.of_fov(
            self.width_px,
            self.height_px,
            self.fov_rad,
            "pinhole" if self.distortion is None else "fisheye",
            vertical_fov_rad=self.vertical_fov_rad,
            distortion=self.distortion or (),
        )


class Shutter:
    """Opens `rate_hz` times a second, has each picture rendered after the latency and hands it to `publish`."""

    def __init__(
        self, settings: CameraSettings, context: DeviceContext, publish: Callable[[CameraFrame], None]
    ) -> None:
        self._settings = settings
        self._context = context
        self._publish = publish
        self._world: FlatWorld | None = None
        self._render: Render | None = None
        self._rng = np.random.default_rng(0)
        self._sequence = 0
        self._latency_ns = ns(settings.latency_s)
        self._exposure_ns = ns(settings.exposure_s)
        self._focal_px = settings.lens().fx_px
        self._ticker = Ticker(1.0 / settings.rate_hz, self._show, delay_s=settings.latency_s)

    def start(self, world: FlatWorld, render: Render, rng: np.random.Generator) -> None:
        """Begins to look at `world`; `rng` says which pictures are lost."""
        self._world, self._render, self._rng, self._sequence = world, render, rng, 0
        self._ticker.start()

    def stop(self) -> None:
        """No picture after this."""
        self._ticker.stop()
        self._world = self._render = None

    def picture(self, pose: Pose) -> Bytes2D:
        """What the camera sees now if the base rests at `pose`; RuntimeError while it is not started."""
        if self._render is None or self._world is None:
            raise RuntimeError(f"{self._context.name} is not open")
        return self._render(pose, self._world.second(self._context.clock.now_ns()), ())

    def _show(self) -> None:
        if self._world is None or self._render is None:
            return
        stamp_ns = self._context.clock.now_ns() - self._latency_ns
        self._sequence += 1
        if self._settings.frame_loss > 0.0 and self._rng.random() < self._settings.frame_loss:
            return
        half_ns = self._exposure_ns // 2
        # where the latency is shorter than half the exposure, the rest of it is as the last instant
        begin, middle, end = self._world.poses(np.array([stamp_ns - half_ns, stamp_ns, stamp_ns + half_ns]))
        views = self._views(begin, end)
        shares = (np.arange(views) + 0.5) / views
        during = [_wrapped(begin + share * (end - begin)) for share in shares] if views > 1 else ()
        bgr = self._render(_wrapped(middle), self._world.second(stamp_ns), during)
        self._publish(CameraFrame(stamp_ns, bgr, self._sequence, self._context.name))

    def _views(self, begin: Float64s, end: Float64s) -> int:
        """How many views the blur of an exposure needs: about one for each pixel that the picture moves."""
        if self._exposure_ns == 0:
            return 1
        moved_m = math.hypot(*(end - begin)[:2])
        moved_rad = abs(float(end[2] - begin[2])) + moved_m / self._context.mount.z_m / 2.0
        return min(_MOST_VIEWS, max(1, round(moved_rad * self._focal_px)))


def check_mount(name: str, mount: Mount) -> None:
    """Raises DeviceMisconfigured for a camera that would lie on the floor."""
    if not mount.z_m > 0.0:
        raise DeviceMisconfigured(
            f"{name}: a camera needs its height above the floor; write for example "
            f"`robot: {{mounts: {{{name}: {{x_m: 0.06, z_m: 0.11, pitch_rad: 0.35}}}}}}`"
        )


def _wrapped(pose: Float64s) -> Pose:
    return float(pose[0]), float(pose[1]), math.remainder(float(pose[2]), math.tau)
