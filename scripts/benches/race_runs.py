"""The jobs of the race bench, each a small function from plain numbers to one row, so that a run can be taken up."""

from __future__ import annotations

import random
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from benches.race_drivers import Behaving
from benches.race_limit import limited_lap_s
from benches.race_plant import Conditions, Ground, Race, Run
from benches.race_reference import PlainFollowTheGap
from benches.race_tracks import EVANS, Track, evans, procedural
from robotd_devices.sim.single_track import F1TENTH, TT02D, RaceCar

Row = dict[str, Any]
Job = tuple[str, Callable[[], Row]]
TOP_MPS = {"f1tenth": 8.0, "tt02d": 5.0}
CARS: dict[str, RaceCar] = {"f1tenth": F1TENTH, "tt02d": TT02D}
PUBLISHED_S = {"esp": 45.78, "gbr": 39.34, "mco": 34.99}
_PATH_EVERY = 2


@lru_cache(maxsize=4)
def ground(name: str, data: Path, back: bool = False) -> Ground:
    """A track by name with its distance transform; the last few are kept."""
    track = evans(name, data) if name in EVANS else procedural(int(name))
    return Ground(track.reverse() if back else track)


def row_of(run: Run, wanted: int) -> Row:
    """What is kept of a run; the path only where it is short enough to draw."""
    return {
        "laps_s": run.laps_s,
        "unfinished": len(run.laps_s) < wanted and not run.crashed and not run.stuck,
        "crashed": run.crashed,
        "stuck": run.stuck,
        "clearance_m": run.clearance_m,
        "over_grip_share": run.over_grip_share,
        "most_grip_share": run.most_grip_share,
        "steer_rate_radps": run.steer_rate_radps,
        "mean_mps": run.mean_mps,
        "top_mps": run.top_mps,
        "progress_m": run.progress_m,
        "seconds": run.seconds,
    }


def path_of(run: Run) -> list[list[float]]:
    """The first two minutes of the path, every second scan."""
    return [[round(value, 2) for value in point] for point in run.path[: 40 * 120 : _PATH_EVERY]]


def conditions_of(car: str, seed: int = 0) -> Conditions:
    """The nominal ones: f1tenth 40 Hz, all beams at once as in the published simulators; TT-02D a lidar that turns."""
    if car == "tt02d":
        return Conditions(
            rate_hz=10.0, beams=1081, fov_rad=2.0 * np.pi * 1080 / 1081, range_max_m=12.0, sweep=True, seed=seed
        )
    return Conditions(seed=seed)


def laps(name: str, car: str, count: int, data: Path, learn: bool = False, what: str = "laps", **keys: Any) -> Row:
    """Consecutive laps from a standstill; learn: with the line from lap 2 on."""
    here = ground(name, data)
    driver = Behaving(CARS[car], learn, **keys)
    run = Race(here, CARS[car], conditions_of(car)).drive(driver, count, limit_s=count * 300.0)
    limit = limited_lap_s(here.track, CARS[car], TOP_MPS[car], CARS[car].mu)
    row = {
        "what": what, "track": name, "car": car, "learn": learn, **row_of(run, count), "limit_s": limit,
        "plan_us": [float(np.percentile(driver.took_us, q)) for q in (50, 99)], "path": path_of(run),
    }  # fmt: skip
    if driver.learning is not None:
        row["line"] = driver.line_told()
    return row


def plain(name: str, data: Path, linear_tyres: bool) -> Row:
    """The plain follow-the-gap for one lap at 25 Hz: the harness measured against published numbers."""
    conditions = Conditions(rate_hz=25.0, linear_tyres=linear_tyres)
    run = Race(ground(name, data), F1TENTH, conditions).drive(PlainFollowTheGap(), 1, limit_s=300.0)
    return {"what": "plain", "track": name, "linear_tyres": linear_tyres, **row_of(run, 1)}


def seed_rules(name: str, data: Path, planner: str) -> Row:
    """The seed's literal rules, or the rule before them, for one lap at 40 Hz."""
    driver = Behaving(F1TENTH, profile="seed_safe", planner=planner, recover=False)
    run = Race(ground(name, data), F1TENTH, Conditions()).drive(driver, 1, limit_s=400.0)
    return {"what": "seed", "planner": planner, "track": name, **row_of(run, 1)}


def random_lap(seed: int, tracks: list[str], data: Path) -> Row:
    """One lap under conditions drawn at random; friction is told to the car, the rest it must find out."""
    rng = random.Random(f"lap {seed}")
    name = rng.choice(tracks)
    back = rng.random() < 0.5
    conditions = random_conditions(rng, seed)
    mu = conditions.mu
    assert mu is not None
    here = ground(name, data, back)
    start = here.track.pose(rng.uniform(0.0, here.track.length_m))
    start = _base_at(start)
    run = Race(here, F1TENTH, conditions).drive(Behaving(F1TENTH, mu=min(mu, 1.0489)), 1, start, limit_s=300.0)
    limit_s = _limit(name, back, mu, data)
    return {
        "what": "random", "seed": seed, "track": name, "back": back, **told(conditions),
        **row_of(run, 1), "limit_s": limit_s,
    }  # fmt: skip


def random_conditions(rng: random.Random, seed: int) -> Conditions:
    """Rate, latency, noise, dropout and friction, drawn in the order in which they always were."""
    mu = rng.choice((0.7, 1.05))
    return Conditions(
        rate_hz=rng.choice((10.0, 25.0, 40.0)), latency_s=rng.choice((0.0, 0.03, 0.06)),
        noise_m=rng.choice((0.01, 0.03, 0.05)), dropout=rng.choice((0.0, 0.1)), mu=mu, seed=seed,
    )  # fmt: skip


def told(conditions: Conditions) -> Row:
    """Of drawn conditions, for a row."""
    return {
        "rate_hz": conditions.rate_hz, "latency_s": conditions.latency_s, "noise_m": conditions.noise_m,
        "dropout": conditions.dropout, "mu": conditions.mu,
    }  # fmt: skip


@lru_cache(maxsize=128)
def _limit(name: str, back: bool, mu: float, data: Path) -> float:
    return limited_lap_s(ground(name, data, back).track, F1TENTH, 8.0, mu)[1]


def _base_at(pose: tuple[float, float, float]) -> tuple[float, float, float]:
    """The middle of the car on the line, not its rear axle."""
    back = F1TENTH.wheelbase_m / 2.0
    return pose[0] - back * float(np.cos(pose[2])), pose[1] - back * float(np.sin(pose[2])), pose[2]


def one_track(name: str, data: Path) -> Track:
    """For drawing."""
    return ground(name, data).track
