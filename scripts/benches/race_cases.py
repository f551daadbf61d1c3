"""Single situations of the race bench: a nose before a wall, and a box that appears on the way."""

from __future__ import annotations

import math
import random
from dataclasses import replace
from typing import Any

import numpy as np

from benches.race_drivers import Behaving
from benches.race_plant import Conditions, Ground, Race
from benches.race_tracks import Track
from robotd_devices.sim.single_track import GRAVITY_MPS2, RaceCar, RaceTrack

AWAY_M, AWAY_MPS, WITHIN_S = 1.5, 1.0, 8.0
"""Racing again: so far from where it stood, at so much speed, within so long."""
_ROOM_S = 0.1
"""Of a command until servo, motor and tyres have answered."""
BOX_HALF_M = 0.15


def stopping_m(car: RaceCar, conditions: Conditions, speed_mps: float) -> float:
    """How far a car goes until it stands for something that appears: scan, latency and answer, then 0.583 mu g."""
    brake = 0.583 * (conditions.mu if conditions.mu is not None else car.mu) * GRAVITY_MPS2
    wait_s = 1.0 / conditions.rate_hz + conditions.latency_s + _ROOM_S
    return speed_mps * wait_s + speed_mps * speed_mps / (2.0 * brake)


def nose_to_wall(ground: Ground, car: RaceCar, seed: int, **keys: Any) -> dict[str, Any]:
    """One pose with the nose 5 to 30 cm from a wall, at any yaw, from a standstill."""
    rng = random.Random(seed)
    race = Race(ground, car, Conditions(seed=seed))
    middle, width = ground.track.middle_m, ground.track.width_m
    while True:
        at = rng.randrange(len(middle))
        yaw = rng.uniform(-math.pi, math.pi)
        aside, about = rng.uniform(-0.5, 0.5) * width[at], rng.uniform(0.0, math.tau)
        x, y = middle[at, 0] + aside * math.cos(about), middle[at, 1] + aside * math.sin(about)
        if race.clearance_m(x, y, yaw) < 0.03:
            continue
        front = car.footprint_m()[0][0]
        tip = (x + front * math.cos(yaw), y + front * math.sin(yaw))
        gap = float(ground.ranges_m(tip[0], tip[1], np.array([yaw]), 2.0)[0])
        if 0.05 <= gap <= 0.30:
            break
    driver = Behaving(car, **keys)
    start, done = (x, y), [math.inf]

    def watch(now_s: float, pose: tuple[float, float, float], track: RaceTrack) -> None:
        if math.hypot(pose[0] - start[0], pose[1] - start[1]) > AWAY_M and track.vx_mps > AWAY_MPS:
            done[0] = min(done[0], now_s)

    run = race.drive(driver, 99, (x, y, yaw), WITHIN_S, lambda now_s, track: math.isfinite(done[0]), on_step=watch)
    return {"s": done[0] if math.isfinite(done[0]) else None, "crashed": run.crashed, "gap_m": gap, "yaw": yaw}


def straight(length_m: float = 40.0, width_m: float = 2.0) -> Track:
    """A corridor, open to the end; its middle line is no ring, but nobody drives to its end."""
    resolution = 0.05
    rows, columns = round((width_m + 1.0) / resolution), round(length_m / resolution)
    y = (np.arange(rows) + 0.5) * resolution - (width_m + 1.0) / 2.0
    occupied = np.repeat((np.abs(y) > width_m / 2.0)[:, None], columns, axis=1)
    middle = np.stack((np.arange(0.5, length_m, 0.1), np.zeros(len(np.arange(0.5, length_m, 0.1)))), axis=1)
    return Track("straight", middle, np.full(len(middle), width_m), occupied, resolution, (0.0, -(width_m + 1.0) / 2.0))


def appearing_box(car: RaceCar, seed: int, top_mps: float, conditions: Conditions, **keys: Any) -> dict[str, Any]:
    """A box of 30 cm appears before a car at 2 to 8 m/s, farther off than it needs to stop."""
    rng = random.Random(seed)
    ground = Ground(straight())
    speed = rng.uniform(2.0, top_mps)
    conditions = replace(conditions, seed=seed)
    front = car.footprint_m()[0][0]
    appear_m = 6.0
    box_x = appear_m + front + stopping_m(car, conditions, speed) + rng.uniform(0.0, 1.0) + BOX_HALF_M
    box_y = rng.uniform(-0.6, 0.6)
    driver = Behaving(car, v_max_mps=speed, **keys)
    there = [False]

    def watch(now_s: float, pose: tuple[float, float, float], track: RaceTrack) -> None:
        if not there[0] and pose[0] >= appear_m:
            ground.add_box(box_x, box_y, BOX_HALF_M)
            there[0] = True

    start = (1.0, 0.0, 0.0)
    race = Race(ground, car, conditions)
    run = race.drive(
        driver, 99, start, 6.0 + 20.0 / speed, lambda now_s, track: race.at_m > box_x + 2.0, speed, on_step=watch
    )
    return {"crashed": run.crashed, "speed": speed, "box": (box_x, box_y), "clearance_m": run.clearance_m}
