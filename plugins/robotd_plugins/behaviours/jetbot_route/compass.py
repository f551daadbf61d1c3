"""The four directions of a route map, and the four turns from one to another."""

from __future__ import annotations

import math
from enum import Enum, IntEnum

from robotd.world.geometry import wrap_rad


class Turn(Enum):
    """What a robot does at a node before it drives on, seen from its own heading. In degrees: 0, 90, -90, 180."""

    STRAIGHT = "straight"
    LEFT = "left"
    RIGHT = "right"
    TURN_AROUND = "turn_around"

    @property
    def angle_rad(self) -> float:
        """The turn about the robot's vertical axis, counter-clockwise positive; pi for TURN_AROUND."""
        return _ANGLES_RAD[self]


class Compass(IntEnum):
    """A direction on the map, numbered clockwise as the seed does. Map files let y grow to the South, x to the East."""

    N = 0
    E = 1
    S = 2
    W = 3

    @property
    def step(self) -> tuple[int, int]:
        """One step this way in the file's own units, (dx, dy) with y to the South."""
        return _STEPS[self]

    @property
    def yaw_rad(self) -> float:
        """The same direction in the map frame (REP-103): East 0, North pi/2, West pi, South -pi/2."""
        return _YAWS_RAD[self]

    @property
    def opposite(self) -> Compass:
        """The way back."""
        return _ALL[(self + 2) % 4]

    def turn_to(self, other: Compass) -> Turn:
        """The turn of a robot that looks this way and shall look the other way."""
        return _TURNS[(other - self) % 4]

    def after(self, turn: Turn) -> Compass:
        """Where a robot looks that looked this way and then turned."""
        return _ALL[(self + _QUARTERS[turn]) % 4]

    @classmethod
    def of_step(cls, dx: float, dy: float) -> Compass | None:
        """The direction of a step in file units; None where it is no step or not along an axis."""
        if (dx == 0.0) == (dy == 0.0):
            return None
        if dx:
            return cls.E if dx > 0.0 else cls.W
        return cls.S if dy > 0.0 else cls.N

    @classmethod
    def of_yaw(cls, yaw_rad: float) -> tuple[Compass, float]:
        """The nearest direction to a yaw in the map frame, and by how much the yaw is off it, in (-pi/4, pi/4]."""
        nearest = min(cls, key=lambda way: abs(wrap_rad(yaw_rad - way.yaw_rad)))
        return nearest, wrap_rad(yaw_rad - nearest.yaw_rad)


_ALL = tuple(Compass)
_STEPS = {Compass.N: (0, -1), Compass.E: (1, 0), Compass.S: (0, 1), Compass.W: (-1, 0)}
_YAWS_RAD = {Compass.N: math.pi / 2, Compass.E: 0.0, Compass.S: -math.pi / 2, Compass.W: math.pi}
_TURNS = (Turn.STRAIGHT, Turn.RIGHT, Turn.TURN_AROUND, Turn.LEFT)
_QUARTERS = {turn: quarters for quarters, turn in enumerate(_TURNS)}
_ANGLES_RAD = {Turn.STRAIGHT: 0.0, Turn.LEFT: math.pi / 2, Turn.RIGHT: -math.pi / 2, Turn.TURN_AROUND: math.pi}
