"""The behaviour `ftg_race` at the wheel of the race plant: its own steps, called without the runtime."""

from __future__ import annotations

import time
from typing import Any

from benches.race_plant import Driver
from robotd.world.kinematics import Ackermann
from robotd.world.messages import LidarScan, Odometry, Steer
from robotd.world.robot import Robot
from robotd_devices.sim.single_track import F1TENTH, TT02D, RaceCar
from robotd_plugins.behaviours.ftg_race import FtgRace, FtgRaceConfig, Sees

TT02D_KEYS: dict[str, Any] = {
    "v_max_mps": 5.0,
    "mu": 0.85,
    "accel_mps2": 4.0,
    "brake_mps2": 4.5,
    "accel_response_s": 0.167,
    "brake_response_s": 0.1,
    "actuation_s": 0.12,
    "understeer_rad": 0.0275,
    "can_reverse": False,
}
"""Config keys of the TT-02D, as in configs/tt02d.yaml."""


def robot_of(car: RaceCar) -> Robot:
    """The car as a robot's config would describe it."""
    kinematics = Ackermann(car.wheelbase_m, car.width_m, car.max_steering_rad)
    return Robot("car", kinematics, car.footprint_m())


class Behaving:
    """A driver made of the behaviour; keeps how long each step took, in microseconds of this thread's CPU."""

    ticks = True

    def __init__(self, car: RaceCar = F1TENTH, **keys: Any) -> None:
        if car is TT02D:
            keys = {**TT02D_KEYS, **keys}
        self.behaviour = FtgRace(FtgRaceConfig(**keys), None, robot_of(car))
        self.took_us: list[float] = []
        self.failed = ""
        self._scan: LidarScan | None = None

    def __call__(self, scan: LidarScan, odometry: Odometry, now_ns: int) -> Steer | None:
        is_new = scan is not self._scan
        self._scan = scan
        seen = Sees.assemble(now_ns, {"scan": scan, "odometry": odometry})
        begin = time.thread_time_ns()
        result = self.behaviour.step(seen)
        if is_new:
            self.took_us.append((time.thread_time_ns() - begin) / 1e3)
        if isinstance(result, Steer):
            return result
        self.failed = getattr(result, "reason", "")
        return None


_: type[Driver] = Behaving
