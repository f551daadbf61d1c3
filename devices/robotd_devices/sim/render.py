"""One picture of the world: a table that is computed once, turned and shifted for each frame, and what stands on it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from robotd.world.messages import Bytes2D, Float64s
from robotd_devices.sim.billboards import Billboards
from robotd_devices.sim.floor import LEVELS, FloorLook, draw_floor
from robotd_devices.sim.lens import FloorCamera
from robotd_devices.sim.light import Shadows
from robotd_devices.sim.look import Look
from robotd_devices.sim.maps import WorldMap
from robotd_devices.sim.room import COLUMNS_PER_TURN, draw_room
from robotd_devices.sim.scene import Scene
from robotd_devices.sim.sensor import Sensor
from robotd_devices.sim.structures import Structures

_FAR_M = 12.0
"""Floor beyond this is not told from the horizon."""

_COARSE = 4
"""Room and gloss are soft: they are looked up for every fourth pixel in each direction."""

_HALF = 2
"""The soft edges of shadows are looked up for every second one."""

_TINT_TAPE = (0.87, 0.92)
_TINT_FLOOR = (0.957, 0.922)
"""Blue and green as shares of red, the brightest channel; both measured on real pictures of this floor."""


class Renderer:
    """Renders what one camera sees of one map.

    Each pixel's floor point in base never changes, lens and all; so that a frame is one linear map of that table (by
    the pose) and one lookup in the floor's atlas. The copy of the floor that a pixel reads is chosen once, by how much
    floor the pixel covers. Room and gloss depend on direction only: their table is shifted by the heading. Over that
    come walls and posts, then cards and people, then light, sensor and JPEG.
    Everything random follows from `rng`: floor, room and light when they are drawn, then the noise picture by picture.
    `scene`: who walks and what comes and goes; by default that of the map. Raises ValueError for a picture file of a
    card or a person that cannot be read.
    """

    def __init__(
        self,
        camera: FloorCamera,
        world: WorldMap,
        look: Look,
        rng: np.random.Generator,
        scene: Scene | None = None,
    ) -> None:
        self._look = look
        # each part has random numbers of its own, so that a larger floor changes no lamp
        for_people, for_floor, for_room, for_light, for_sensor = rng.spawn(5)
        self._size = (camera.lens.width_px, camera.lens.height_px)
        self._focal_px = camera.lens.fx_px
        self._scene = scene if scene is not None else Scene(world, for_people)
        self._atlas = draw_floor(
            world, FloorLook(look.tape_grey, look.floor_grey, look.grain_std, look.patches_std), look.texel_m, for_floor
        )
        self._room = np.round(draw_room(look.gloss, for_room)).astype(np.uint8)
        self._prepare_floor(camera)
        self._prepare_room(camera)
        self._tints = _tints(look.tape_grey, look.floor_grey)
        rays_base = camera.rays_base(_grid(*self._size, 1)).reshape(self._size[1], self._size[0], 3)
        self._structures = Structures(camera, rays_base, world.structure_height_m)
        self._billboards = Billboards(camera, rays_base, world.cards, self._scene.people)
        coarse = camera.floor_m(_grid(*self._size, _HALF)).astype(np.float32)
        coarse = coarse.reshape(math.ceil(self._size[1] / _HALF), math.ceil(self._size[0] / _HALF), 2)
        self._shadows = Shadows(look, world.bounds_m(), coarse[self._top // _HALF :], for_light)
        self._sensor = Sensor(look, self._size, for_sensor)

    def picture(
        self,
        pose: tuple[float, float, float],
        when_s: float = 0.0,
        during: Sequence[tuple[float, float, float]] = (),
    ) -> Bytes2D:
        """uint8 (height, width, 3), a new array, blue green red.

        pose: base in map in the middle of the exposure, at `when_s` of the world. during: poses at equal times over the
        exposure, whose views are mixed; none: a picture without motion blur.
        """
        import cv2

        poses = during if len(during) > 1 else (pose,)
        grey = cv2.add(self._floor_lit(pose, when_s, poses), self._room_seen(pose[2]))
        blue, green = (cv2.LUT(grey, tint) for tint in self._tints)
        bgr = np.asarray(cv2.merge([blue, green, grey]), dtype=np.uint8)
        self._stand(bgr, pose, when_s, poses)
        return self._sensor.picture(bgr, when_s)

    def _floor_lit(
        self, pose: tuple[float, float, float], when_s: float, during: Sequence[tuple[float, float, float]]
    ) -> Bytes2D:
        """The floor and its shadows, uint8 (height, width), black elsewhere."""
        import cv2

        grey = np.zeros(self._size[::-1], dtype=np.uint8)
        if self._top < self._size[1]:
            floor: Any = self._floor_seen(*during[0])
            for number, further in enumerate(during[1:], start=2):
                floor = cv2.addWeighted(floor, 1.0 - 1.0 / number, self._floor_seen(*further), 1.0 / number, 0.0)
            shade = self._shade(pose, when_s)
            grey[self._top :] = floor if shade is None else cv2.multiply(floor, shade, scale=1.0 / 255.0)
        return grey

    def _stand(
        self,
        bgr: Bytes2D,
        pose: tuple[float, float, float],
        when_s: float,
        during: Sequence[tuple[float, float, float]],
    ) -> None:
        """Draws what stands on the floor in place: seen from one pose, and blurred as far as the camera turns."""
        import cv2

        bare = bgr.copy() if len(during) > 1 else None
        hidden = self._structures.draw(bgr, pose, self._scene.standing(when_s, math.inf))
        self._billboards.draw(bgr, pose, when_s, hidden)
        if bare is None:
            return
        # a turn moves what is far by the same in the whole picture, a level lens given
        turn_rad = abs(math.remainder(during[-1][2] - during[0][2], math.tau)) * len(during) / (len(during) - 1)
        width_px = round(turn_rad * self._focal_px)
        if width_px > 1:
            bare_still = cv2.inRange(cv2.absdiff(bgr, bare), (0, 0, 0), (0, 0, 0))
            stands = cv2.blur(cv2.bitwise_not(bare_still), (width_px, 1))
            cv2.copyTo(cv2.blur(bgr, (width_px, 1)), stands, bgr)

    def _shade(self, pose: tuple[float, float, float], when_s: float) -> Bytes2D | None:
        """Light that shadows leave on the rows that show floor; None where all of it is left."""
        import cv2

        light = self._shadows.light(pose, when_s)
        if light is None:
            return None
        first = self._top - self._top // _HALF * _HALF
        whole = cv2.resize(light, (light.shape[1] * _HALF, light.shape[0] * _HALF), interpolation=cv2.INTER_LINEAR)
        return np.ascontiguousarray(whole[first : first + self._size[1] - self._top, : self._size[0]])

    # ------------------------------------------------------------------------------------------ floor

    def _prepare_floor(self, camera: FloorCamera) -> None:
        atlas = self._atlas
        width, height = self._size
        floor_m = camera.floor_m(_grid(width, height, 1)).reshape(height, width, 2)
        reach_m = np.hypot(floor_m[..., 0], floor_m[..., 1])
        shown = np.nan_to_num(reach_m, nan=math.inf) < _FAR_M
        level = np.clip(np.round(np.log2(_covered_m(floor_m) / atlas.texel_m)), 0, LEVELS - 1)
        level = np.where(np.isfinite(level), level, LEVELS - 1).astype(np.intp)
        share = np.where(shown, 0.5**level, 0.0)
        left = np.where(shown, atlas.left_px[level], atlas.nothing_px + 0.5)
        forward, sideways = (np.where(shown, floor_m[..., axis], 0.0) * share for axis in (0, 1))
        rows = np.flatnonzero(shown.any(axis=1))
        self._top = int(rows[0]) if len(rows) else height
        # beyond the drawn floor the bare edge of the same copy goes on
        low = np.where(shown, atlas.left_px[level] - 2.0, 0.0)
        high = np.where(shown, atlas.left_px[level] + atlas.width_px[level] + 1.0, atlas.grey.shape[1])
        tables = (forward, sideways, share, left, low, high)
        self._forward, self._sideways, self._share, self._left, self._low, self._high = (
            np.ascontiguousarray(table[self._top :], dtype=np.float32) for table in tables
        )
        # one blurred picture serves room and gloss: at the horizon the room must not brighten the floor
        self._room_cap = np.where(shown, round(self._look.gloss), 255).astype(np.uint8)

    def _floor_seen(self, x_m: float, y_m: float, yaw_rad: float) -> Bytes2D:
        import cv2

        atlas = self._atlas
        per_m = 1.0 / atlas.texel_m
        cos, sin = math.cos(yaw_rad) * per_m, math.sin(yaw_rad) * per_m
        # a texel's centre has whole coordinates in a lookup, its edge is half a texel before
        columns = cv2.addWeighted(self._forward, cos, self._sideways, -sin, -0.5)
        columns = cv2.add(cv2.scaleAdd(self._share, (x_m - atlas.x0_m) * per_m, columns), self._left)
        columns = cv2.min(cv2.max(columns, self._low), self._high)
        rows = cv2.addWeighted(self._forward, sin, self._sideways, cos, atlas.top_px - 0.5)
        rows = cv2.scaleAdd(self._share, (y_m - atlas.y0_m) * per_m, rows)
        seen = cv2.remap(atlas.grey, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(seen, dtype=np.uint8)

    # ------------------------------------------------------------------------------------------- room

    def _prepare_room(self, camera: FloorCamera) -> None:
        width, height = self._size
        rays = camera.rays_base(_grid(width, height, _COARSE))
        shape = (math.ceil(height / _COARSE), math.ceil(width / _COARSE))
        bearing_deg = np.degrees(np.arctan2(rays[:, 1], rays[:, 0]))
        down_deg = np.degrees(np.arcsin(np.clip(-rays[:, 2], -1.0, 1.0)))
        self._room_columns = np.nan_to_num(bearing_deg + 180.0).astype(np.float32).reshape(shape)
        self._room_rows = np.nan_to_num(down_deg + 90.0).astype(np.float32).reshape(shape)

    def _room_seen(self, yaw_rad: float) -> Bytes2D:
        import cv2

        turn = np.float32(math.degrees(yaw_rad) % 360.0 * (COLUMNS_PER_TURN / 360.0))
        soft = cv2.remap(
            self._room, self._room_columns + turn, self._room_rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        seen = cv2.resize(soft, self._size, interpolation=cv2.INTER_LINEAR)
        return np.asarray(cv2.min(seen, self._room_cap), dtype=np.uint8)


def _grid(width: int, height: int, step: int) -> Float64s:
    """Centres of blocks of `step` pixels, row by row, (n, 2)."""
    half = (step - 1) / 2.0
    columns, rows = np.meshgrid(np.arange(0, width, step) + half, np.arange(0, height, step) + half)
    return np.stack((columns.ravel(), rows.ravel()), axis=1).astype(np.float64)


def _covered_m(floor_m: Float64s) -> Float64s:
    """Size of the floor that each pixel shows, (h, w); nan beside the horizon.

    A far pixel shows a stretch that is long and narrow. The mean leans to its length: a little soft rather than dotted.
    """
    with np.errstate(invalid="ignore"):
        down, right = np.gradient(floor_m, axis=0), np.gradient(floor_m, axis=1)
    area = np.abs(down[..., 0] * right[..., 1] - down[..., 1] * right[..., 0])
    length = np.maximum(np.hypot(down[..., 0], down[..., 1]), np.hypot(right[..., 0], right[..., 1]))
    size: Float64s = np.maximum(area**0.4 * length**0.2, 1e-9)
    return size


def _tints(tape: float, floor: float) -> tuple[Bytes2D, Bytes2D]:
    """Blue and green, each (1, 256), of a grey level, which is also the red."""
    grey = np.arange(256.0)
    mix = np.clip((grey - tape) / max(floor - tape, 1.0), 0.0, 1.0)
    blue, green = ((1.0 - mix) * low + mix * high for low, high in zip(_TINT_TAPE, _TINT_FLOOR, strict=True))
    return (
        np.asarray(np.round(grey * blue), dtype=np.uint8).reshape(1, 256),
        np.asarray(np.round(grey * green), dtype=np.uint8).reshape(1, 256),
    )
