"""A car that is carried round a small procedural track along its middle: true poses, scans, and what wheels tell."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from robotd.world.geometry import compose, inverse
from robotd.world.kinematics import Ackermann
from robotd.world.messages import Float64s, LidarScan, Odometry
from robotd.world.robot import Robot
from robotd_plugins.toolkit.scan_motion import twist_of

S = 1_000_000_000
Pose = tuple[float, float, float]
CAR = Robot(
    kinematics=Ackermann(0.3302, 0.27, 0.4189),
    footprint_m=((0.4551, 0.155), (0.4551, -0.155), (-0.1249, -0.155), (-0.1249, 0.155)),
)


@dataclass(slots=True)
class Lap:
    """Twenty scans a second at 4 m/s, from the start line on. ground: `benches.race_plant.Ground`."""

    ground: Any
    speed_mps: float = 4.0
    rate_hz: float = 20.0
    beams: int = 541
    noise_m: float = 0.01
    dropout: float = 0.0
    sweep: bool = False
    lidar_x_m: float = 0.17
    _ring: Float64s = field(init=False)
    _way: Float64s = field(init=False)
    _angles: Any = field(init=False)
    _scans: dict[float, LidarScan] = field(default_factory=dict)

    def __post_init__(self) -> None:
        middle = self.ground.track.middle_m
        # a gentle weave, so that not all laps are the middle line
        along = np.roll(middle, -2, axis=0) - np.roll(middle, 2, axis=0)
        normal = np.stack((-along[:, 1], along[:, 0]), axis=1) / np.hypot(along[:, 0], along[:, 1])[:, None]
        weave = 0.12 * np.sin(np.arange(len(middle)) * (6.0 * math.tau / len(middle)))
        ring = middle + weave[:, None] * normal
        ring = np.vstack((ring, ring[:1]))
        self._way = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(ring, axis=0).T))))
        step = np.roll(ring[:-1], -3, axis=0) - np.roll(ring[:-1], 3, axis=0)
        yaw = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
        whole = round((yaw[-1] - yaw[0]) / math.tau) * math.tau
        self._ring = np.column_stack((ring, np.append(yaw, yaw[0] + whole)))
        self._angles = np.linspace(-2.36, 2.36, self.beams).astype(np.float32)

    @property
    def lap_s(self) -> float:
        """Once round."""
        return float(self._way[-1]) / self.speed_mps

    def pose(self, at_s: float) -> Pose:
        """Base on the map."""
        laps, way = divmod(max(at_s, 0.0) * self.speed_mps, float(self._way[-1]))
        x, y, yaw = (float(np.interp(way, self._way, self._ring[:, k])) for k in range(3))
        return x, y, yaw + laps * (self._ring[-1, 2] - self._ring[0, 2])

    def odometry(self, at_s: float, jump: Pose = (0.0, 0.0, 0.0)) -> Odometry:
        """What wheels and a gyroscope tell. jump: as for a scan."""
        a, b = (compose(self.pose(at_s + step), jump) for step in (-0.01, 0.01))
        vx, _, wz = twist_of(compose(inverse(a), b), 0.02 if at_s > 0.01 else 0.01)
        return Odometry(round(at_s * S), 0.0, 0.0, 0.0, vx, 0.0, wz)

    def scan(self, at_s: float, jump: Pose = (0.0, 0.0, 0.0), ground: Any = None) -> LidarScan:
        """A scan whose sweep ends then. jump: where the car really is, seen from where it should be."""
        if jump != (0.0, 0.0, 0.0) or ground is not None:
            return self._scan(at_s, jump, ground or self.ground)
        if at_s not in self._scans:
            self._scans[at_s] = self._scan(at_s, jump, self.ground)
        return self._scans[at_s]

    def _scan(self, at_s: float, jump: Pose, ground: Any) -> LidarScan:
        rng = np.random.default_rng(round(at_s * 1e6))
        shares = np.linspace(0.0, 1.0, self.beams) if self.sweep else np.ones(self.beams)
        starts = at_s - 1.0 / self.rate_hz
        grid = [compose(self.pose(starts + share / self.rate_hz), jump) for share in np.linspace(0.0, 1.0, 9)]
        px, py = (np.interp(shares, np.linspace(0.0, 1.0, 9), [pose[k] for pose in grid]) for k in (0, 1))
        yaw = np.interp(shares, np.linspace(0.0, 1.0, 9), np.unwrap([pose[2] for pose in grid]))
        bearing = self._angles.astype(np.float64) + yaw
        lx, ly = px + self.lidar_x_m * np.cos(yaw), py + self.lidar_x_m * np.sin(yaw)
        ranges = ground.ranges_m(lx, ly, bearing, 12.0)
        ranges = np.maximum(ranges + self.noise_m * rng.standard_normal(self.beams), 0.0)
        ranges[rng.random(self.beams) < self.dropout] = math.nan
        stamp_ns = round(at_s * S)
        start_ns = round(starts * S) if self.sweep else stamp_ns
        return LidarScan(stamp_ns, ranges.astype(np.float32), self._angles, start_ns, 0.05, 12.0, self.lidar_x_m)

    def times(self, from_s: float, to_s: float) -> Iterator[float]:
        """Of the scans' ends."""
        first, last = math.ceil(from_s * self.rate_hz), math.floor(to_s * self.rate_hz)
        return (i / self.rate_hz for i in range(max(first, 1), last + 1))

    def seen_from_start(self, at_s: float) -> Pose:
        """The true pose in the frame of the first scan's base."""
        return compose(inverse(self.pose(1.0 / self.rate_hz)), self.pose(at_s))
