"""Pictures of a floor: rendered ones with known geometry, real ones, and what the perceptor says about them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
import pytest
from numpy.typing import NDArray

from robotd import CameraFrame
from robotd.world.robot import Mount, Robot
from robotd_devices.sim import FloorLine as Tape
from robotd_devices.sim import SimCameraConfig, WorldMap, load_map
from robotd_devices.sim.lens import FloorCamera
from robotd_devices.sim.maps import map_from_segments
from robotd_devices.sim.render import Renderer
from robotd_plugins.perception.floor_line import FloorLine, FloorLineConfig, Sees
from robotd_plugins.toolkit.line_seen import LineSeen

Picture: TypeAlias = NDArray[np.uint8]
Pose: TypeAlias = tuple[float, float, float]

MOUNT = Mount(x_m=0.06, z_m=0.11, pitch_rad=0.35)
ROBOT = Robot(mounts={"camera": MOUNT})


class Floor:
    """A map under a simulated camera: `picture` renders it, `seen` is what a fresh perceptor says about it."""

    def __init__(self, world_map: WorldMap, seed: int = 0, **look: Any) -> None:
        config = SimCameraConfig(**look)
        self.camera = FloorCamera(config.lens(), MOUNT)
        self._renderer = Renderer(self.camera, world_map, config.look(), np.random.default_rng(seed))

    def picture(self, pose: Pose = (0.0, 0.0, 0.0)) -> Picture:
        return self._renderer.picture(pose)

    def seen(self, pose: Pose = (0.0, 0.0, 0.0)) -> LineSeen:
        return see(self.picture(pose))


def see(picture: Picture, perceptor: FloorLine | None = None, stamp_ns: int = 0, **config: Any) -> LineSeen:
    perceptor = perceptor or FloorLine(FloorLineConfig(**config), ROBOT)
    return perceptor.step(Sees(frame=CameraFrame(stamp_ns, np.ascontiguousarray(picture)), now_ns=stamp_ns))


@pytest.fixture
def robot() -> Robot:
    return ROBOT


@pytest.fixture
def look() -> Callable[..., LineSeen]:
    return see


@pytest.fixture
def floor() -> Callable[..., Floor]:
    """Makes a floor: of a shipped map by name, or of tapes given as lists of corners."""

    def make(tapes: str | list[list[tuple[float, float]]], seed: int = 0, **how: Any) -> Floor:
        if isinstance(tapes, str):
            return Floor(load_map(tapes), seed, **how)
        lines = [Tape(np.array(corners, dtype=np.float64)) for corners in tapes]
        return Floor(map_from_segments(lines=lines), seed, **how)

    return make
