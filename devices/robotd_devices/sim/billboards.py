"""Cards and people in a picture: each a flat picture in space, seen through the same lens as the floor.

A point of a plane is P + u U + v V, and a camera at C sees it along a ray of the direction P - C + u U + v V; so that
(u, v, 1) is, but for its length, the inverse of the matrix [U V P-C] applied to the ray (a homography of rays rather
than of pixels, which any central lens obeys; Hartley and Zisserman, Multiple View Geometry, 2003, chapter 8).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from robotd.world.messages import Bytes2D, Float32s, Float64s
from robotd_devices.sim.faces import GAIT_STEPS, blank, figure_width_m, figures, front_of
from robotd_devices.sim.lens import FloorCamera, floor_to_base
from robotd_devices.sim.maps import Card
from robotd_devices.sim.people import Person
from robotd_devices.sim.structures import Hidden

_FARTHEST_M = 15.0
_NEAREST_M = 0.05
_NO_MAP: Any = None
"""The other map of a lookup that has both coordinates in one."""

_ALONG = np.linspace(0.0, 1.0, 5)
_RIM = np.array([(u, v) for u in _ALONG for v in _ALONG if u in (0.0, 1.0) or v in (0.0, 1.0)])
"""Points (n, 2) all around a board, in parts of its width and its height."""


@dataclass(frozen=True, slots=True, eq=False)
class Boards:
    """n flat pictures as the camera sees them: lower left corner, lower edge and left edge, (n, 3) each, camera frame.

    levels: of each board premultiplied uint8 (h, w, 4), each half as fine as the one before, with a clear rim.
    """

    corners_m: Float64s
    across_m: Float64s
    up_m: Float64s
    levels: list[list[Bytes2D]]


class Billboards:
    """All cards of a map and all people, drawn from far to near.

    rays_base: unit rays (h, w, 3) of the picture. What is more than 90 degrees off the axis is not drawn. Raises
    ValueError for a picture file that cannot be read.
    """

    def __init__(
        self, camera: FloorCamera, rays_base: Float64s, cards: tuple[Card, ...], people: tuple[Person, ...]
    ) -> None:
        self._lens = camera.lens
        self._base_camera = camera.camera_base
        self._eye_m = np.array((camera.mount.x_m, camera.mount.y_m, camera.mount.z_m))
        self._slopes = _slopes(rays_base @ camera.camera_base)
        self._people = people
        self._card_levels = [(_levels(front_of(card)), _levels(blank(card))) for card in cards]
        self._card_ends_m = np.array([card.segment_m for card in cards]).reshape(-1, 4)
        self._card_heights_m = np.array([(card.bottom_m, card.height_m) for card in cards]).reshape(-1, 2)
        looks = [figures(person) for person in people]
        self._person_levels = [[_levels(figure) for figure in steps] for steps in looks]
        self._person_sizes_m = np.array(
            [(figure_width_m(person, steps[0]), person.height_m) for person, steps in zip(people, looks, strict=True)]
        ).reshape(-1, 2)

    def draw(self, bgr: Bytes2D, pose: tuple[float, float, float], when_s: float, hidden: Hidden | None) -> None:
        """Draws them into a picture in place, behind what hides them."""
        if not self._card_levels and not self._people:
            return
        boards = self._seen(pose, when_s)
        away_m = np.linalg.norm(boards.corners_m + (boards.across_m + boards.up_m) / 2.0, axis=1)
        u, v = _RIM[None, :, :1], _RIM[None, :, 1:]
        rims_m = boards.corners_m[:, None] + u * boards.across_m[:, None] + v * boards.up_m[:, None]
        rims_px = self._lens.pixels(rims_m.reshape(-1, 3)).reshape(len(away_m), -1, 2)
        # what is partly behind the lens, and so nan, compares as out of sight
        low, high = np.floor(rims_px.min(axis=1)) - 1.0, np.ceil(rims_px.max(axis=1)) + 2.0
        size = np.array(bgr.shape[1::-1], dtype=np.float64)
        in_sight = (low < size).all(axis=1) & (high > 0.0).all(axis=1) & (rims_m[..., 2] > 0.0).all(axis=1)
        in_sight &= (away_m > _NEAREST_M) & (away_m < _FARTHEST_M)
        for at in np.argsort(-away_m, kind="stable").tolist():
            if in_sight[at]:
                x0, y0 = np.maximum(low[at], 0.0).astype(int).tolist()
                x1, y1 = np.minimum(high[at], size).astype(int).tolist()
                tall_px = float(high[at, 1] - low[at, 1])
                self._draw_one(bgr, boards, at, (x0, x1, y0, y1), tall_px, hidden, float(away_m[at]))

    def _seen(self, pose: tuple[float, float, float], when_s: float) -> Boards:
        """All of them from a pose: cards by the side that faces the camera, people always turned to it."""
        eye = self._eye_m[:2]
        ends_m = floor_to_base(self._card_ends_m.reshape(-1, 2), pose).reshape(-1, 4)
        along, to_eye = ends_m[:, 2:] - ends_m[:, :2], eye - ends_m[:, :2]
        is_front = to_eye[:, 0] * along[:, 1] - to_eye[:, 1] * along[:, 0] > 0.0
        left_m = np.where(is_front[:, None], ends_m[:, :2], ends_m[:, 2:])
        along = np.where(is_front[:, None], along, -along)
        levels = [pair[0] if front else pair[1] for pair, front in zip(self._card_levels, is_front, strict=True)]
        bottoms_m, heights_m = self._card_heights_m.T
        if self._people:
            when = np.array([when_s])
            places_m = floor_to_base(np.vstack([person.walk.places_m(when) for person in self._people]), pose)
            to_eye = eye - places_m
            sideways = np.stack((-to_eye[:, 1], to_eye[:, 0]), axis=1) / np.maximum(np.hypot(*to_eye.T), 1e-6)[:, None]
            widths = sideways * self._person_sizes_m[:, :1]
            left_m, along = np.vstack((left_m, places_m - widths / 2.0)), np.vstack((along, widths))
            bottoms_m = np.append(bottoms_m, np.zeros(len(widths)))
            heights_m = np.append(heights_m, self._person_sizes_m[:, 1])
            for person, steps in zip(self._people, self._person_levels, strict=True):
                step = round(float(person.gait_rad(when)[0]) / math.tau * GAIT_STEPS)
                levels.append(steps[step % len(steps)])
        nothing = np.zeros(len(left_m))
        corners_m = np.column_stack((left_m, bottoms_m)) - self._eye_m
        return Boards(
            corners_m @ self._base_camera,
            np.column_stack((along, nothing)) @ self._base_camera,
            np.column_stack((nothing, nothing, heights_m)) @ self._base_camera,
            levels,
        )

    def _draw_one(
        self,
        bgr: Bytes2D,
        boards: Boards,
        at: int,
        where: tuple[int, int, int, int],
        tall_px: float,
        hidden: Hidden | None,
        away_m: float,
    ) -> None:
        import cv2

        x0, x1, y0, y1 = where
        levels = boards.levels[at]
        shrink = math.log2(max(1.0, (levels[0].shape[0] - 2) / tall_px))
        face = levels[min(round(shrink), len(levels) - 1)]
        rows, columns = face.shape[0] - 2, face.shape[1] - 2
        # the clear rim is texel 0, and a texel's centre has whole coordinates
        to_texel = np.array([(columns, 0.0, 0.5), (0.0, -rows, rows + 0.5), (0.0, 0.0, 1.0)])
        plane = np.linalg.inv(np.stack((boards.across_m[at], boards.up_m[at], boards.corners_m[at]), axis=1))
        texels = cv2.perspectiveTransform(np.ascontiguousarray(self._slopes[y0:y1, x0:x1]), to_texel @ plane)
        seen = cv2.remap(face, texels, _NO_MAP, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
        if hidden is not None:
            nearer = hidden.reach_m[y0:y1, x0:x1] < away_m
            seen[nearer & (hidden.shown[y0:y1, x0:x1] > 0)] = 0
        clear = cv2.cvtColor(cv2.bitwise_not(cv2.extractChannel(seen, 3)), cv2.COLOR_GRAY2BGR)
        part = bgr[y0:y1, x0:x1]
        part[:] = cv2.add(cv2.multiply(part, clear, scale=1.0 / 255.0), cv2.cvtColor(seen, cv2.COLOR_BGRA2BGR))


def _slopes(rays: Float64s) -> Float32s:
    """Rays (h, w, 3) of the camera frame by where they pierce the plane one metre ahead, float32 (h, w, 2)."""
    ahead = np.nan_to_num(rays[..., 2:]) > 0.02
    with np.errstate(divide="ignore", invalid="ignore"):
        slopes = np.where(ahead, rays[..., :2] / rays[..., 2:], 1e6)
    return np.ascontiguousarray(slopes, dtype=np.float32)


def _levels(face: Bytes2D) -> list[Bytes2D]:
    """A picture premultiplied with its opacity, and copies of half, a quarter... its size, each with a clear rim."""
    import cv2

    mixed = face.copy()
    mixed[..., :3] = (face[..., :3].astype(np.uint16) * face[..., 3:] + 127) // 255
    copies = [mixed]
    while min(copies[-1].shape[:2]) >= 8:
        copies.append(np.asarray(cv2.resize(copies[-1], None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)))
    return [np.pad(copy, ((1, 1), (1, 1), (0, 0))) for copy in copies]
