"""From where the line is to how to turn: a proportional law on lateral and heading error, with continuous gain."""

from __future__ import annotations

import math
from dataclasses import dataclass

from robotd import Drive
from robotd_plugins.behaviours.jetbot_route.config import JetBotRouteConfig
from robotd_plugins.toolkit.line_seen import LineSeen

_DRIFT_ERROR_M = 0.03
_DRIFT_HEADING_RAD = 0.2


@dataclass(frozen=True, slots=True)
class LineAhead:
    """The line in base: how far to the left of the axle's middle, and in which direction (counter-clockwise)."""

    left_m: float
    heading_rad: float


def line_ahead(line: LineSeen, course_rad: float, half_width_m: float) -> LineAhead | None:
    """The line where it passes the axle, extended straight from what was seen ahead; None where nothing was.

    course_rad: direction of the line in base as last known, for pictures that show it in one region only.
    half_width_m: scale of pictures without known metres.
    """
    near, far = line.near, line.far
    if not near.is_seen and not far.is_seen:
        return None
    if math.isnan(near.left_m) and math.isnan(far.left_m):
        # no mount: an error of place is all that the picture tells
        return LineAhead(-(near.x if near.is_seen else far.x) * half_width_m, 0.0)
    heading_rad = line.heading_rad if not math.isnan(line.heading_rad) else course_rad
    place = near if not math.isnan(near.left_m) else far
    return LineAhead(place.left_m - place.ahead_m * math.tan(heading_rad), heading_rad)


def curvature_pm(ahead: LineAhead, config: JetBotRouteConfig) -> float:
    """Curvature (1/m, left positive) that leads back to the line.

    With both gains 1 it is the arc through the line's point at `reach_m` (pure pursuit; Coulter, CMU-RI-TR-92-01):
    2 (left + reach heading) / reach^2. Inside the safe zone the lateral share fades with the error's square, so that
    there is neither a dead band nor a step.
    """
    soft_m = ahead.left_m
    if config.safe_zone_m > 0.0:
        soft_m *= min(1.0, abs(soft_m) / config.safe_zone_m)
    reach_m = config.reach_m
    return 2.0 * (config.correction_gain * soft_m + config.heading_gain * reach_m * ahead.heading_rad) / reach_m**2


def learned_drift_pm(drift_pm: float, ahead: LineAhead, driven_m: float, config: JetBotRouteConfig) -> float:
    """The pull to one side, as a curvature to steer against, after another stretch along the line.

    Unequal wheels leave a lateral error that never goes; here its integral does away with it. Bounded, and errors that
    a bend or a bad start explain better teach nothing.
    """
    if abs(ahead.left_m) > _DRIFT_ERROR_M or abs(ahead.heading_rad) > _DRIFT_HEADING_RAD:
        return drift_pm
    learned = drift_pm + config.drift_gain_pm * driven_m * 2.0 * ahead.left_m / config.reach_m**2
    return min(max(learned, -config.drift_max_pm), config.drift_max_pm)


def drive(speed_mps: float, curvature: float, config: JetBotRouteConfig) -> Drive:
    """The command for a curvature: slower where it would turn faster than allowed, down to `slow_speed_mps`."""
    if abs(curvature) * speed_mps > config.max_correction_radps:
        speed_mps = max(config.max_correction_radps / abs(curvature), min(config.slow_speed_mps, speed_mps))
    limit = config.max_correction_radps
    return Drive(vx_mps=speed_mps, wz_radps=min(max(speed_mps * curvature, -limit), limit))
