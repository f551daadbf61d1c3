"""Cars and scans of small places for the tests of `ftg_race`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from robotd.testing import corridor_scan
from robotd.world.kinematics import Ackermann
from robotd.world.messages import LidarScan, Odometry, Steer
from robotd.world.robot import Robot
from robotd_plugins.behaviours.ftg_race import FtgRace, FtgRaceConfig, Sees

F1TENTH = Robot(
    kinematics=Ackermann(0.3302, 0.27, 0.4189),
    footprint_m=((0.4551, 0.155), (0.4551, -0.155), (-0.1249, -0.155), (-0.1249, 0.155)),
)
TT02D = Robot(
    kinematics=Ackermann(0.257, 0.16, math.radians(25.0)),
    footprint_m=((0.3285, 0.095), (0.3285, -0.095), (-0.0715, -0.095), (-0.0715, 0.095)),
)
S = 1_000_000_000
TICK_NS = 25_000_000


def corridor(**where: Any) -> LidarScan:
    """A corridor 1.8 m wide seen by 1080 beams over the middle of the car."""
    return corridor_scan(**{"width_m": 1.8, "beams": 1080, "range_max_m": 12.0, "x_m": 0.165, **where})


def mirrored(scan: LidarScan) -> LidarScan:
    """Left for right."""
    return LidarScan(
        scan.stamp_ns, scan.ranges_m[::-1].copy(), -scan.angles_rad[::-1], scan.start_ns, scan.range_min_m,
        scan.range_max_m, scan.x_m, -scan.y_m, -scan.yaw_rad,
    )  # fmt: skip


def seen(scan: LidarScan, speed_mps: float = 0.0, yaw_rate_radps: float = 0.0, now_ns: int | None = None) -> Sees:
    """A view of one scan at its own stamp."""
    now = scan.stamp_ns if now_ns is None else now_ns
    odometry = Odometry(now, 0.0, 0.0, 0.0, speed_mps, 0.0, yaw_rate_radps)
    return Sees(now_ns=now, scan=scan, odometry=odometry, track=None, located=None)


def settled(scan_at: Any, speed_mps: float = 0.0, robot: Robot = F1TENTH, steps: int = 4, **keys: Any) -> Steer:
    """The command after a few scans 25 ms apart; scan_at: from a stamp to a scan."""
    race = FtgRace(FtgRaceConfig(**keys), None, robot)
    result: Any = None
    for step in range(steps):
        result = race.step(seen(scan_at(step * TICK_NS + TICK_NS), speed_mps))
    assert isinstance(result, Steer)
    return result


def noisy(scan: LidarScan, rng: np.random.Generator) -> LidarScan:
    """The same with every range a little different, so that no two bins are alike."""
    ranges = (scan.ranges_m * (1.0 + 0.01 * rng.standard_normal(len(scan.ranges_m)))).astype(np.float32)
    return LidarScan(
        scan.stamp_ns, ranges, scan.angles_rad, scan.start_ns, scan.range_min_m, scan.range_max_m, scan.x_m, scan.y_m,
        scan.yaw_rad,
    )  # fmt: skip
