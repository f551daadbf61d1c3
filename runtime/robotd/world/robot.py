"""The robot's body as every part sees it: kinematics, outline, mounts and limits, from the config's `robot:`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from robotd.world.kinematics import Differential, Kinematics


@dataclass(frozen=True, slots=True)
class Mount:
    """A sensor seen in base: x forward, y left, z up, then roll, pitch (nose down positive), yaw."""

    x_m: float = 0.0
    y_m: float = 0.0
    z_m: float = 0.0
    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    yaw_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class Limits:
    """What the base may do. Accelerations are magnitudes; `decel` is what the brakes hold for sure."""

    vx_mps: float = 0.5
    vy_mps: float = 0.0
    wz_radps: float = 2.0
    accel_mps2: float = 1.0
    decel_mps2: float = 1.0
    angular_accel_radps2: float = 8.0


@dataclass(frozen=True, slots=True)
class Robot:
    """One body. `footprint_m`: corners of the outline in base, any order; the convex hull is used."""

    name: str = "robot"
    kinematics: Kinematics = field(default_factory=lambda: Differential(track_m=0.12))
    footprint_m: tuple[tuple[float, float], ...] = ((0.1, 0.08), (0.1, -0.08), (-0.1, -0.08), (-0.1, 0.08))
    mounts: Mapping[str, Mount] = field(default_factory=lambda: MappingProxyType({}))
    limits: Limits = field(default_factory=Limits)

    def mount(self, device: str) -> Mount:
        """Where a device sits; at the base's origin unless the config says otherwise."""
        return self.mounts.get(device, Mount())

    @property
    def radius_m(self) -> float:
        """Radius about the base's origin that holds the whole outline."""
        return max(math.hypot(x, y) for x, y in self.footprint_m)
