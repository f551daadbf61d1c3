"""What passes between the three rooms: a binned scan with the car's motion goes in, a command comes out."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from robotd.authoring.explain import Explanation
from robotd.world.messages import Float64s

HIT: Final = 0
"""Something is there at `ranges_m`."""
FREE: Final = 1
"""Nothing within the lidar's range: free up to `ranges_m`, which is the range then."""
MISSING: Final = 2
"""Not measured, and too wide a hole to be filled from its neighbours: an obstacle."""


@dataclass(frozen=True, slots=True)
class Motion:
    """How the car moves while the scan is looked at."""

    speed_mps: float = 0.0
    yaw_rate_radps: float = 0.0
    age_s: float = 0.0
    """From the end of the sweep to now."""
    period_s: float = 0.1
    """So long a command holds until the next plan."""
    moved: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Base now, seen in base at the sweep's end: x, y, yaw."""
    sweep_s: float = 0.0
    """How long the sweep took; 0: all beams at once."""
    curvature_pm: float = 0.0
    """That was commanded last."""

    def mirrored(self) -> Motion:
        """Left for right."""
        x, y, yaw = self.moved
        return replace(self, yaw_rate_radps=-self.yaw_rate_radps, curvature_pm=-self.curvature_pm, moved=(x, -y, -yaw))


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """One scan in bins of equal angle, in the lidar's place but turned as base is; from right to left.

    bearing_rad, ranges_m: float64 (n,); state: int8 (n,), HIT, FREE or MISSING; `ranges_m` is always finite: the range
    of the nearest hit in the bin, what a narrow hole's neighbours say, `range_max_m` where free, a guess where missing.
    unit: cos and sin of the bearings, (2, n). share: when in the sweep each was measured, 0 to 1, (n,).
    x_m, y_m: the lidar in base.
    """

    bearing_rad: Float64s
    ranges_m: Float64s
    state: NDArray[np.int8]
    unit: Float64s
    share: Float64s
    step_rad: float
    range_max_m: float
    x_m: float = 0.0
    y_m: float = 0.0
    motion: Motion = field(default_factory=Motion)
    noise_m: float = 0.0
    """By how much the ranges err, one sigma, as far as the scans show it."""

    def mirrored(self) -> Scan:
        """Left for right, so that a planner that prefers a side can be made to prefer none."""
        return Scan(
            -self.bearing_rad[::-1], self.ranges_m[::-1], self.state[::-1], self.unit[:, ::-1] * _FLIP,
            self.share[::-1], self.step_rad, self.range_max_m, self.x_m, -self.y_m, self.motion.mirrored(),
            self.noise_m,
        )  # fmt: skip


_FLIP: Final = np.array([[1.0], [-1.0]])


@dataclass(frozen=True, slots=True)
class Command:
    """What a planner wants. curvature_pm: of the way ahead, left positive; free_m: how far it is free."""

    speed_mps: float
    steering_rad: float
    curvature_pm: float = 0.0
    free_m: float = 0.0
    is_blocked: bool = False
    """There is no way ahead; the speed is 0 and no limiter stands between it and the motor."""

    def mirrored(self) -> Command:
        """Left for right."""
        return Command(self.speed_mps, -self.steering_rad, -self.curvature_pm, self.free_m, self.is_blocked)


class Planner(Protocol):
    """From a scan to a command; keeps the memory of one run."""

    def plan(self, scan: Scan) -> Command:
        """One decision; called once a scan."""
        ...

    def explain(self) -> Explanation:
        """What the last plan thought."""
        ...
