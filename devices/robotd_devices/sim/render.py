"""One picture of the floor: a lookup table that is computed once, turned and shifted for each frame."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from robotd.world.messages import Bytes2D, Float64s
from robotd_devices.sim.floor import LEVELS, FloorLook, draw_floor
from robotd_devices.sim.lens import FloorCamera
from robotd_devices.sim.maps import WorldMap
from robotd_devices.sim.room import COLUMNS_PER_TURN, draw_room

_FAR_M = 12.0
"""Floor beyond this is not told from the horizon."""

_COARSE = 4
"""Room and gloss are soft: they are looked up for every fourth pixel in each direction."""

_NOISE_SPARE_PX = 61
_NOISE_ZERO = 128

_TINT_TAPE = (0.87, 0.92)
_TINT_FLOOR = (0.957, 0.922)
"""Blue and green as shares of red, the brightest channel; both measured on real pictures of this floor."""


@dataclass(frozen=True, slots=True)
class Look:
    """Light, materials and sensor, as `SimCameraConfig` explains them."""

    tape: float
    floor: float
    grain_std: float
    patches_std: float
    texel_m: float
    gloss: float
    vignette: float
    brightness: float
    noise_std: float


class Renderer:
    """Renders what one camera sees of one map.

    Each pixel's floor point in base never changes, lens and all; so that a frame is one linear map of that table (by
    the pose) and one lookup in the floor's atlas. The copy of the floor that a pixel reads is chosen once, by how much
    floor the pixel covers. Room and gloss depend on direction only: their table is shifted by the heading.
    Everything random follows from `rng`: the floor when it is drawn, then the noise picture by picture.
    """

    def __init__(self, camera: FloorCamera, world: WorldMap, look: Look, rng: np.random.Generator) -> None:
        self._look = look
        self._rng = rng
        self._size = (camera.lens.width_px, camera.lens.height_px)
        self._atlas = draw_floor(
            world, FloorLook(look.tape, look.floor, look.grain_std, look.patches_std), look.texel_m, rng
        )
        self._room = draw_room(look.gloss, rng)
        self._prepare_floor(camera)
        self._prepare_room(camera)
        self._light = self._lit()
        self._noise = self._make_noise()
        self._tints = _tints(look.tape, look.floor)

    def picture(self, pose: tuple[float, float, float]) -> Bytes2D:
        """uint8 (height, width, 3), a new array, blue green red."""
        import cv2

        x_m, y_m, yaw_rad = pose
        grey = np.zeros(self._size[::-1], dtype=np.uint8)
        if self._top < self._size[1]:
            grey[self._top :] = self._floor_seen(x_m, y_m, yaw_rad)
        grey = cv2.add(grey, self._room_seen(yaw_rad))
        grey = cv2.multiply(grey, self._light, scale=self._look.brightness / 255.0)
        if self._look.noise_std > 0.0:
            grey = cv2.addWeighted(grey, 1.0, self._some_noise(), 1.0, -_NOISE_ZERO)
        blue, green = (cv2.LUT(grey, tint) for tint in self._tints)
        return np.asarray(cv2.merge([blue, green, grey]), dtype=np.uint8)

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

    # ------------------------------------------------------------------------------- room, light, noise

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
        seen = cv2.resize(soft, self._size, interpolation=cv2.INTER_LINEAR).astype(np.uint8)
        return np.asarray(cv2.min(seen, self._room_cap), dtype=np.uint8)

    def _lit(self) -> Bytes2D:
        """Loss of light towards the corners, 255 = none."""
        width, height = self._size
        across = (np.arange(width) - (width - 1) / 2.0) / (width / 2.0)
        down = (np.arange(height) - (height - 1) / 2.0) / (height / 2.0)
        loss = self._look.vignette * (across[None, :] ** 2 + down[:, None] ** 2) / 2.0
        return np.asarray(np.round(255.0 * (1.0 - loss)), dtype=np.uint8)

    def _make_noise(self) -> Bytes2D:
        width, height = self._size
        shape = (height + _NOISE_SPARE_PX, width + _NOISE_SPARE_PX)
        noise = self._look.noise_std * self._rng.standard_normal(shape, dtype=np.float32)
        return np.asarray(np.clip(np.round(noise + _NOISE_ZERO), 0, 255), dtype=np.uint8)

    def _some_noise(self) -> Bytes2D:
        """A stretch of one larger noise picture, at a place drawn anew for each frame."""
        down, right = self._rng.integers(0, _NOISE_SPARE_PX + 1, 2).tolist()
        return self._noise[down : down + self._size[1], right : right + self._size[0]]


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
