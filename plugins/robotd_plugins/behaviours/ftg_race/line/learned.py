"""From a driven lap and its walls to the line that is raced on: the one door into the solver."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robotd.world.messages import Float64s
from robotd_plugins.behaviours.ftg_race.body import Body
from robotd_plugins.behaviours.ftg_race.line.corridor import WallField
from robotd_plugins.behaviours.ftg_race.line.profile import LineLimits, lap_s, speeds_mps
from robotd_plugins.behaviours.ftg_race.line.solver import quickest

_STEERING_SHARE = 0.9
"""Of the tightest turning circle: the rest is for keeping to the line."""


@dataclass(frozen=True, slots=True, eq=False)
class LearnedLine:
    """A closed line of the footprint's middle, each array float64 (k,); the last point joins the first.

    s_m from 0 to less than length_m, at equal steps; speed_mps: as the limits given allow it; lap_s: of a flying lap.
    """

    s_m: Float64s
    x_m: Float64s
    y_m: Float64s
    yaw_rad: Float64s
    curvature_pm: Float64s
    speed_mps: Float64s
    length_m: float
    lap_s: float


def learned_line(path: Float64s, field: WallField, body: Body, limits: LineLimits, margin_m: float) -> LearnedLine:
    """The line about a driven path (n, 3), poses of base in driving order round one closed lap.

    margin_m: between the body's side and a wall, of the line itself. A second or so of computing: not for the event
    loop. Raises ValueError with a sentence where the corridor is closed or a bend too tight for the car.
    """
    x = path[:, 0] + body.middle_m * np.cos(path[:, 2])
    y = path[:, 1] + body.middle_m * np.sin(path[:, 2])
    ring = quickest(x, y, field, body.half_width_m + margin_m, limits)
    tightest = int(np.abs(ring.curvature_pm).argmax())
    most = _STEERING_SHARE / body.least_radius_m
    if abs(ring.curvature_pm[tightest]) > most:
        raise ValueError(
            f"a bend of {1.0 / abs(ring.curvature_pm[tightest]):.2f} m radius at {ring.x_m[tightest]:.2f}, "
            f"{ring.y_m[tightest]:.2f} is tighter than the car's {1.0 / most:.2f} m"
        )
    speed = speeds_mps(ring.curvature_pm, ring.step_m, limits)
    s: Float64s = np.arange(len(ring.x_m), dtype=np.float64) * ring.step_m
    return LearnedLine(
        s, ring.x_m, ring.y_m, ring.yaw_rad, ring.curvature_pm, speed, len(s) * ring.step_m, lap_s(speed, ring.step_m)
    )
