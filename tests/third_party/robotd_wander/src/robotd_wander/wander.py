"""Wander: drive about, turn from what is near, back off from what was touched."""

import math

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from robotd import Behaviour, Config, Drive, LidarScan, View, every, latest
from robotd.authoring.explain import Explanation, Scalar, Text
from robotd.world.messages import Contact


class WanderConfig(Config):
    """Parameters; each can be set in a robot's file, where unknown keys are errors."""

    cruise_mps: float = Field(default=0.25, gt=0.0, le=2.0)
    """Speed ahead while the way is free."""
    back_mps: float = Field(default=0.1, gt=0.0, le=0.5)
    """Speed backwards while the bumper is pressed."""
    turn_radps: float = Field(default=1.0, gt=0.0, le=5.0)
    """Turning speed."""
    near_m: float = Field(default=0.5, gt=0.0, le=5.0)
    """What is nearer than this ahead makes the robot turn."""
    clear_m: float = Field(default=0.7, gt=0.0, le=5.0)
    """A turn ends when nothing ahead is nearer than this."""
    ahead_rad: float = Field(default=0.7, gt=0.0, le=math.pi / 2)
    """Half of the angle that counts as ahead."""


class Sees(View):
    """What one step sees. Without a fresh scan there is no step; without a bumper there is one all the same."""

    scan: LidarScan = every(within_s=0.25)
    bumper: Contact | None = latest(within_s=0.5)


class Wander(Behaviour[WanderConfig, Sees]):
    """Ahead, or a turn away from the nearer side that goes on until the way is free."""

    _turn = 0.0
    """+1 while turning left, -1 while turning right, 0 while driving."""
    _nearest_m = math.inf

    def step(self, seen: Sees) -> Drive | None:
        if seen.bumper is not None and seen.bumper.closed:
            self._turn = self._turn or 1.0
            return Drive(vx_mps=-self.config.back_mps)
        left_m, right_m = sides(seen.scan, self.config.ahead_rad)
        self._nearest_m = min(left_m, right_m)
        if self._turn and self._nearest_m >= self.config.clear_m:
            self._turn = 0.0
        elif not self._turn and self._nearest_m < self.config.near_m:
            self._turn = 1.0 if left_m >= right_m else -1.0
        if self._turn:
            return Drive(wz_radps=self._turn * self.config.turn_radps)
        return Drive(vx_mps=self.config.cruise_mps)

    def explain(self) -> Explanation:
        doing = "turning left" if self._turn > 0 else "turning right" if self._turn < 0 else "driving"
        return Scalar("nearest ahead", self._nearest_m, "m"), Text("doing", doing)


def sides(scan: LidarScan, ahead_rad: float) -> tuple[float, float]:
    """Nearest range in metres ahead to the left and ahead to the right; inf where nothing was seen."""
    bearing_rad = scan.angles_rad + scan.yaw_rad
    forward, leftward = np.cos(bearing_rad), np.sin(bearing_rad)
    ahead = forward >= math.cos(ahead_rad)
    return _nearest(scan, ahead & (leftward >= 0.0)), _nearest(scan, ahead & (leftward <= 0.0))


def _nearest(scan: LidarScan, where: NDArray[np.bool_]) -> float:
    ranges_m = scan.ranges_m[where]
    return float(np.min(ranges_m[~np.isnan(ranges_m)], initial=math.inf))
