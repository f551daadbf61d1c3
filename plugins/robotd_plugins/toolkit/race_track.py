"""A learned race track: what passes between its survey, the map and line made of it, the place on it, and who races.

Everything is in the frame `track`: its origin is the pose of base (the rear axle's middle) at the survey's first key
frame, x forward, y left, counter-clockwise positive. Positions are of base, but for the line of a `RaceTrack`, which
is of the middle of the car's footprint, with which the planner plans.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from robotd import Message
from robotd.world.messages import Float32s, Float64s, read_only


def _freeze(message: Any, *names: str) -> None:
    for name in names:
        array = getattr(message, name)
        if array.flags.writeable:
            object.__setattr__(message, name, read_only(array))


@dataclass(frozen=True, slots=True, eq=False)
class TrackSurvey(Message):
    """A lap that was driven and has met its own beginning. The stamp is that of the last scan in it.

    path: float64 (n, 3), x_m, y_m, yaw_rad of base at each key frame in driving order, as scan-matched odometry tells
    them: not yet closed, and going on for a few metres after the lap's end, over its own beginning.
    points_m: float32 (m, 2), returns of the key frames, each in base of its own key frame; key: int32 (m,), which one.
    closing: pose of base at key frame `closing_key`, seen in base at key frame `closed_key` (one of the first), as the
    two scans match. residual_m, residual_rad: how far odometry alone has missed that.
    lidar_x_m, lidar_y_m: the lidar in base. number: counts surveys of one run from 1; attempt: those of one goal.
    """

    path: Float64s
    points_m: Float32s
    key: NDArray[np.int32]
    closing_key: int
    closed_key: int
    closing: tuple[float, float, float]
    residual_m: float
    residual_rad: float
    lidar_x_m: float = 0.0
    lidar_y_m: float = 0.0
    number: int = 1
    attempt: int = 1

    def __post_init__(self) -> None:
        n = len(self.path)
        if self.path.shape != (n, 3) or n < 3:
            raise ValueError(f"path must be (n, 3) with n at least 3, not {self.path.shape}")
        if self.points_m.shape != (len(self.key), 2):
            raise ValueError(f"points_m {self.points_m.shape} and key {self.key.shape} must be (m, 2) and (m,)")
        if not 0 <= self.closed_key < self.closing_key < n:
            raise ValueError(f"closed_key {self.closed_key} and closing_key {self.closing_key} must rise below {n}")
        _freeze(self, "path", "points_m", "key")


@dataclass(frozen=True, slots=True, eq=False)
class RaceTrack(Message):
    """A track with its walls and the line to race on; holds until a better one replaces it.

    distance_m: float32 (rows, columns), signed distance to the nearest wall: positive on the track, 0 on the wall,
    negative behind it and where nothing was ever seen. Cell [r, c] is the value at its middle: x = origin_m[0] +
    (c + 0.5) resolution_m, y = origin_m[1] + (r + 0.5) resolution_m. Exact to about a centimetre within half a metre
    of a wall, to half a cell farther away.
    path: float64 (n, 3), x_m, y_m, yaw_rad of base on the surveyed lap, closed: the last joins the first, which is not
    repeated.
    s_m, x_m, y_m, yaw_rad, curvature_pm, speed_mps: float64 (k,), the line of the footprint's middle, closed in the
    same way, s_m from 0 to less than `length_m`. Empty where no line was found; `reason` says why.
    at_ns, at: where base was in `track` at the end of the survey: whoever looks for the car begins there.
    lap_s: time of a flying lap that the line should take; nan without a line. version: counts up from 1.
    """

    distance_m: Float32s
    resolution_m: float
    origin_m: tuple[float, float]
    path: Float64s
    s_m: Float64s
    x_m: Float64s
    y_m: Float64s
    yaw_rad: Float64s
    curvature_pm: Float64s
    speed_mps: Float64s
    length_m: float
    lap_s: float = math.nan
    version: int = 1
    reason: str = ""
    at_ns: int = 0
    at: tuple[float, float, float] = (0.0, 0.0, 0.0)

    is_state: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if self.distance_m.ndim != 2 or self.distance_m.dtype != np.float32:
            raise ValueError(f"distance_m must be float32 (rows, columns), not {self.distance_m.dtype}")
        line = (self.s_m, self.x_m, self.y_m, self.yaw_rad, self.curvature_pm, self.speed_mps)
        if any(array.shape != self.s_m.shape or array.ndim != 1 for array in line):
            raise ValueError(f"the line's arrays must be (k,) each, not {[array.shape for array in line]}")
        _freeze(self, "distance_m", "path", "s_m", "x_m", "y_m", "yaw_rad", "curvature_pm", "speed_mps")

    @property
    def has_line(self) -> bool:
        """Whether there is a line to race on."""
        return len(self.s_m) > 0


@dataclass(frozen=True, slots=True)
class Located(Message):
    """Where base is in `track` at the stamp, which is that of the scan (the end of its sweep).

    residual_m: robust spread (1.4826 times the median size) of the distances between the returns used and the walls.
    explained_share: of the returns used, those within 3 sigma of a wall. is_sure: the pose may be driven by; `reason`
    says why not. version: of the `RaceTrack` in which the pose stands.
    vx_mps, vy_mps, wz_radps: velocity of base in its own frame, as the matches tell it.
    """

    x_m: float
    y_m: float
    yaw_rad: float
    residual_m: float = math.nan
    explained_share: float = 0.0
    is_sure: bool = False
    reason: str = ""
    version: int = 0
    vx_mps: float = 0.0
    vy_mps: float = 0.0
    wz_radps: float = 0.0
