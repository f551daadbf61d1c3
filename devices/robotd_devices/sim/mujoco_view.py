"""Pictures of a MuJoCo world through a wide-angle lens: one or more pinhole views, looked up ray by ray."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from robotd.authoring.device import DeviceUnavailable
from robotd.world.messages import Bytes2D, Float64s
from robotd_devices.sim.lens import FloorCamera
from robotd_devices.sim.look import SensorLook
from robotd_devices.sim.mujoco_model import Eye, MujocoWorld, Surface, import_mujoco
from robotd_devices.sim.scene import Scene
from robotd_devices.sim.sensor import Sensor
from robotd_devices.sim.shutter import Pose

_ONE_VIEW_RAD = 0.85
"""Rays farther than this off the axis need more than one pinhole view."""
_WIDEST_RAD = 1.3
"""A pinhole view that looks farther aside than this would be mostly wasted."""
_MOST_VIEWS = 4


class MujocoView:
    """Renders what one camera sees of a scene.

    A pinhole cannot show a wide angle well: its picture grows with the tangent. So the columns of the picture are
    shared among as few views as do, each turned to its share, and every pixel is looked up where its ray meets its
    view. Sensor, light drift and JPEG are those of our own renderer. Raises ValueError for a lens that sees too wide,
    or for a card's picture that cannot be read.
    """

    def __init__(
        self, camera: FloorCamera, scene: Scene, surface: Surface, look: SensorLook, rng: np.random.Generator
    ) -> None:
        lens = camera.lens
        for_world, for_sensor = rng.spawn(2)
        columns, rows = np.meshgrid(np.arange(lens.width_px), np.arange(lens.height_px))
        rays = lens.rays(np.stack((columns.ravel(), rows.ravel()), axis=1).astype(np.float64))
        turns = _views(rays.reshape(lens.height_px, lens.width_px, 3))
        shares = np.array_split(np.arange(lens.width_px), len(turns))
        seen = [
            rays.reshape(lens.height_px, lens.width_px, 3)[:, share] @ turn
            for share, turn in zip(shares, turns, strict=True)
        ]
        slopes = [part[..., :2] / part[..., 2:] for part in seen]
        reach = np.max([np.abs(part).max(axis=(0, 1)) for part in slopes], axis=0)
        self._size = (
            math.ceil(2.0 * reach[0] * lens.fx_px) + 2,
            math.ceil(2.0 * reach[1] * lens.fx_px) + 2,
        )
        width, height = self._size
        focal = lens.fx_px
        self._columns = np.concatenate(
            [at * width + part[..., 0] * focal + (width - 1) / 2.0 for at, part in enumerate(slopes)], axis=1
        ).astype(np.float32)
        self._rows = np.concatenate([part[..., 1] * focal + (height - 1) / 2.0 for part in slopes], axis=1).astype(
            np.float32
        )
        place_m = np.array((camera.mount.x_m, camera.mount.y_m, camera.mount.z_m))
        axes = [camera.camera_base @ turn for turn in turns]
        fov_rad = 2.0 * math.atan(height / 2.0 / focal)
        eyes = tuple(Eye(place_m, axis[:, 0], -axis[:, 1], fov_rad) for axis in axes)
        self._world = MujocoWorld(scene, surface, eyes, for_world)
        mujoco = import_mujoco()
        try:
            self._renderer: Any = mujoco.Renderer(self._world.model, height, width)
        except Exception as error:  # each way of having no OpenGL raises something else
            raise DeviceUnavailable(
                f"MuJoCo cannot draw without a screen ({error!r}): on Debian and Ubuntu sudo apt-get install libegl1"
            ) from error
        flags = self._renderer.scene.flags
        flags[mujoco.mjtRndFlag.mjRND_SHADOW] = surface.shadows
        flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = surface.reflectance > 0.0
        self._views = len(turns)
        self._whole = np.empty((height, width * len(turns), 3), dtype=np.uint8)
        self._sensor = Sensor(look, (lens.width_px, lens.height_px), for_sensor)

    def close(self) -> None:
        """Lets go of the graphics context."""
        self._renderer.close()

    def picture(self, pose: Pose, when_s: float = 0.0, during: Sequence[Pose] = ()) -> Bytes2D:
        """uint8 (height, width, 3), a new array; see `Renderer.picture`. Blur is mixed of two views: they are dear."""
        import cv2

        if len(during) > 1:
            mixed: Any = cv2.addWeighted(self._seen(during[0], when_s), 0.5, self._seen(during[-1], when_s), 0.5, 0.0)
        else:
            mixed = self._seen(pose, when_s)
        return self._sensor.picture(np.asarray(mixed, dtype=np.uint8), when_s)

    def _seen(self, pose: Pose, when_s: float) -> Bytes2D:
        import cv2

        self._world.place(pose, when_s)
        width = self._size[0]
        for view in range(self._views):
            self._renderer.update_scene(self._world.data, camera=f"eye{view}")
            self._whole[:, view * width : (view + 1) * width] = self._renderer.render()
        rgb = cv2.remap(self._whole, self._columns, self._rows, cv2.INTER_LINEAR)
        return np.asarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), dtype=np.uint8)


def _views(rays: Float64s) -> list[Float64s]:
    """Rotations (3, 3) of as few pinhole views as show all rays (h, w, 3) of the camera frame, from left to right.

    Columns are right, down and ahead of a view in the camera frame. Raises ValueError where four do not.
    """
    if not np.isfinite(rays).all():
        raise ValueError("the lens sees more than 180 degrees off its axis: lower fov_rad")
    for count in range(1, _MOST_VIEWS + 1):
        turns = [_turned_to(part) for part in np.array_split(rays, count, axis=1)]
        off = [
            float(np.arccos(np.clip(part @ turn[:, 2], -1.0, 1.0)).max())
            for part, turn in zip(np.array_split(rays, count, axis=1), turns, strict=True)
        ]
        if max(off) < (_ONE_VIEW_RAD if count == 1 else _WIDEST_RAD):
            return turns
    raise ValueError("the lens sees too wide for pinhole views: lower fov_rad or vertical_fov_rad")


def _turned_to(rays: Float64s) -> Float64s:
    """The rotation that looks into the middle of rays, level with the camera."""
    flat = rays.reshape(-1, 3)
    ahead = flat.mean(axis=0)
    ahead /= np.linalg.norm(ahead)
    right = np.cross((0.0, 1.0, 0.0), ahead)
    right /= np.linalg.norm(right)
    return np.stack((right, np.cross(ahead, right), ahead), axis=1)
