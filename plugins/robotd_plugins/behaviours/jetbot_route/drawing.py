"""What both ways of driving draw of the line."""

from __future__ import annotations

import math

from robotd.authoring.explain import Drawing, Line, Points, Scalar
from robotd_plugins.behaviours.jetbot_route.tracker import Tracker


def draw_line(tracker: Tracker) -> list[Drawing]:
    """The line ahead with its errors, and the odometer."""
    drawn: list[Drawing] = []
    if tracker.ahead is not None:
        left_m, slope = tracker.ahead.left_m, math.tan(tracker.ahead.heading_rad)
        reach_m = tracker.config.reach_m
        drawn.append(Line("line", (0.0, left_m), (reach_m, left_m + reach_m * slope)))
        drawn.append(Scalar("lateral error", left_m, "m"))
        drawn.append(Scalar("heading error", tracker.ahead.heading_rad, "rad"))
    drawn.append(Scalar("travelled", tracker.travelled_m, "m"))
    return drawn


def draw_place(name: str, distance_m: float) -> list[Drawing]:
    """Something on the line that far ahead of the axle; nan: nothing."""
    if math.isnan(distance_m):
        return []
    return [Points(name, ((distance_m, 0.0),)), Scalar(f"{name} ahead", distance_m, "m")]
