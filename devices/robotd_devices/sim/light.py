"""Light that changes: shadows that wander over the floor, lamps that grow stronger and weaker, and white balance."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from robotd.world.messages import Bytes2D, Float32s, Float64s
from robotd_devices.sim.look import Look

_WAVES = (0.37, 1.0, 2.3)
"""Frequencies of the drift, as multiples of one over `light_drift_s`."""
_REACH_M = 2.5
"""Shadows farther off are not worth drawing."""


@dataclass(frozen=True, slots=True, eq=False)
class Drift:
    """A smooth wander between -1 and 1 as a function of time alone."""

    amplitudes: Float64s
    phases_rad: Float64s
    time_s: float

    def at(self, when_s: float) -> float:
        """The value at an instant."""
        turns = np.array(_WAVES) * (math.tau * when_s / self.time_s)
        return float(self.amplitudes @ np.sin(turns + self.phases_rad))


def drawn_drift(time_s: float, rng: np.random.Generator) -> Drift:
    """A wander drawn at random."""
    amplitudes = rng.uniform(0.3, 1.0, len(_WAVES))
    return Drift(amplitudes / amplitudes.sum(), rng.uniform(0.0, math.tau, len(_WAVES)), time_s)


class Shadows:
    """Four-sided shadows at random places of a floor, each wandering to and fro on a line of its own.

    base_m: floor points in base, float32 (h, w, 2); nan where no floor is seen.
    """

    def __init__(
        self, look: Look, bounds_m: tuple[float, float, float, float], base_m: Float32s, rng: np.random.Generator
    ) -> None:
        x0, y0, x1, y1 = bounds_m
        area_m2 = max(x1 - x0, 1.0) * max(y1 - y0, 1.0)
        count = int(rng.poisson(look.shadows_per_m2 * area_m2)) if look.shadows_per_m2 > 0.0 else 0
        self._look = look
        self._places_m = rng.uniform((x0, y0), (max(x1, x0 + 1.0), max(y1, y0 + 1.0)), (count, 2))
        self._corners_m = np.array([_corners_m(rng) for _ in range(count)]).reshape(count, 4, 2)
        self._depths = rng.uniform(0.5, 1.0, count) * look.shadow_depth
        way_rad = rng.uniform(0.0, math.tau, count)
        self._ways = np.stack((np.cos(way_rad), np.sin(way_rad)), axis=1)
        self._sways_m = rng.uniform(0.1, 0.4, count)
        self._phases_rad = rng.uniform(0.0, math.tau, count)
        self._forward = np.ascontiguousarray(np.nan_to_num(base_m[..., 0], nan=1e6))
        self._sideways = np.ascontiguousarray(np.nan_to_num(base_m[..., 1], nan=1e6))

    def light(self, pose: tuple[float, float, float], when_s: float) -> Bytes2D | None:
        """What is left of the light at each point, uint8 (h, w), 255 = all; None where no shadow is near."""
        import cv2

        # the top speed of a swing is its width times its frequency
        swing = np.sin(self._phases_rad + when_s * self._look.shadow_speed_mps / self._sways_m)
        places_m = self._places_m + self._ways * (self._sways_m * swing)[:, None]
        near = np.flatnonzero(np.hypot(places_m[:, 0] - pose[0], places_m[:, 1] - pose[1]) < _REACH_M)
        light: Any = None
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        to_base = np.array([[cos, -sin], [sin, cos]])
        for at in near.tolist():
            corners = (self._corners_m[at] + places_m[at] - pose[:2]) @ to_base
            beyond: Any = None
            for (ax, ay), (bx, by) in zip(corners.tolist(), np.roll(corners, -1, axis=0).tolist(), strict=True):
                length = math.hypot(bx - ax, by - ay) * self._look.shadow_edge_m
                nx, ny = (by - ay) / length, (ax - bx) / length
                side = cv2.addWeighted(self._forward, nx, self._sideways, ny, -(nx * ax + ny * ay))
                beyond = side if beyond is None else cv2.max(beyond, side)
            # from half an edge inside to half an edge outside, in parts of 255
            depth = 255.0 * float(self._depths[at])
            left = np.maximum(cv2.addWeighted(beyond, depth, beyond, 0.0, 255.0 - depth / 2.0), 255.0 - depth)
            light = left if light is None else cv2.min(light, left)
        return None if light is None else np.asarray(cv2.convertScaleAbs(light), dtype=np.uint8)


def _corners_m(rng: np.random.Generator) -> Float64s:
    """A crooked rectangle about zero, counter-clockwise and convex."""
    half = np.array((rng.uniform(0.15, 0.5), rng.uniform(0.05, 0.25)))
    corners = np.array([(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)]) * half * rng.uniform(0.8, 1.2, (4, 1))
    turn = rng.uniform(0.0, math.tau)
    cos, sin = math.cos(turn), math.sin(turn)
    turned: Float64s = corners @ np.array([[cos, sin], [-sin, cos]])
    return turned
