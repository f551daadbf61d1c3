"""The car's body as the planners see it, and how far its outline may go along an arc before it touches a return."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from robotd.world.kinematics import Ackermann
from robotd.world.messages import Float64s
from robotd.world.robot import Robot

_STRAIGHT_PM = 1e-3


@dataclass(frozen=True, slots=True)
class Body:
    """Distances from base (the rear axle's middle), all in metres; the outline is taken as a rectangle about y = 0."""

    wheelbase_m: float
    max_steering_rad: float
    front_m: float
    rear_m: float
    """Of the rear end; negative."""
    half_width_m: float

    @property
    def middle_m(self) -> float:
        """Of the outline's middle, ahead of base."""
        return (self.front_m + self.rear_m) / 2.0

    @property
    def least_radius_m(self) -> float:
        """Turning circle of the middle."""
        return math.hypot(self.wheelbase_m / math.tan(self.max_steering_rad), self.middle_m)

    def wider(self, margin_m: float) -> Body:
        """The same body with a margin all round."""
        return Body(
            self.wheelbase_m, self.max_steering_rad, self.front_m + margin_m, self.rear_m - margin_m,
            self.half_width_m + margin_m,
        )  # fmt: skip


def body_of(robot: Robot, width_m: float | None = None) -> Body:
    """The body of a robot; width_m in place of the footprint's. A robot that is no car gets a small one of its size."""
    car = robot.kinematics
    xs, ys = zip(*robot.footprint_m, strict=True)
    half_m = max(max(ys), -min(ys)) if width_m is None else width_m / 2.0
    if isinstance(car, Ackermann):
        return Body(car.wheelbase_m, car.max_steering_rad, max(xs), min(xs), half_m)
    return Body(max(xs) - min(xs), 0.4, max(xs), min(xs), half_m)


def swept_free_m(
    x_m: Float64s, y_m: Float64s, curvature_pm: float, body: Body, most_m: float, back: bool = False
) -> float:
    """How far base may go along an arc before the outline touches one of the points (n,) in base; at most `most_m`.

    On an arc every point of the outline moves on a circle about the turning centre, so a return is met where its own
    circle cuts the outline: the front, or the inner side, whichever comes first. Exact for a rectangle that turns less
    than half round. back: drive backwards. Points inside the outline count as 0.
    """
    sign = -1.0 if back else 1.0
    # backwards is forwards for the car seen in a mirror behind it
    x, front, rear = (
        sign * x_m,
        (body.front_m if not back else -body.rear_m),
        (body.rear_m if not back else -body.front_m),
    )
    y, half = y_m, body.half_width_m
    if abs(curvature_pm) < _STRAIGHT_PM:
        ahead = x[(np.abs(y) < half) & (x > rear)]
        return float(min(max(ahead.min() - front, 0.0), most_m)) if len(ahead) else most_m
    radius = 1.0 / abs(curvature_pm)
    # turned so that the centre lies to the left, at (0, radius)
    lateral = radius - (y if curvature_pm > 0.0 else -y)
    away2 = x * x + lateral * lateral
    inner, outer2 = radius - half, (radius + half) ** 2 + max(front, -rear) ** 2
    met = (away2 < outer2) & (away2 > max(inner, 0.0) ** 2)
    if not met.any():
        return most_m
    x, lateral, away2 = x[met], lateral[met], away2[met]
    at = np.arctan2(x, lateral)
    # where the point's circle cuts the front edge, and the inner side; angles from the centre, forwards positive
    front_lateral = np.sqrt(np.maximum(away2 - front * front, 0.0))
    on_front = (away2 >= front * front) & (front_lateral >= inner) & (front_lateral <= radius + half)
    turn = np.where(on_front, at - np.arctan2(front, front_lateral), np.inf)
    side_x = np.sqrt(np.maximum(away2 - inner * inner, 0.0))
    for edge_x in (side_x, -side_x):
        on_side = (away2 >= inner * inner) & (edge_x <= front) & (edge_x >= rear) & (inner > 0.0)
        turn = np.minimum(turn, np.where(on_side, _ahead(at - np.arctan2(edge_x, inner)), np.inf))
    outer_x = np.sqrt(np.maximum(away2 - (radius + half) ** 2, 0.0))
    # the rear outer corner swings out only where the axle is ahead of it
    on_outer = (away2 >= (radius + half) ** 2) & (-outer_x >= rear)
    turn = np.minimum(turn, np.where(on_outer, _ahead(at - np.arctan2(-outer_x, radius + half)), np.inf))
    inside = (x > rear) & (x < front) & (np.abs(lateral - radius) < half)
    way = np.where(inside, 0.0, _ahead(turn) * radius)
    return float(min(way.min(), most_m))


def _ahead(turn: Float64s) -> Float64s:
    """What lies behind is met after almost a whole turn: never, for our purposes."""
    return np.where(turn < -1e-9, np.inf, np.maximum(turn, 0.0))
