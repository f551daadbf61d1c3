"""One run of `scripts/bench route`: a random mapped floor, the shipped JetBot on it, and what the truth says of it."""

from __future__ import annotations

import asyncio
import json
import math
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import SequenceMatcher
from pathlib import Path
from typing import Any

import numpy as np

from benches.harness import ROOT
from robotd.engine.loops import virtual_loop
from robotd.engine.runtime import Runtime
from robotd.setup.load import load_config
from robotd.world.clock import ns
from robotd.world.messages import Outcome
from robotd_devices.sim.route import random_route

JETBOT = ROOT / "configs" / "jetbot.yaml"
LIMIT_S = 900.0
NODE_M = 0.15
"""The base was at a node when its origin came so near; a goal is reached no farther from it."""
WHEEL_ERROR = 0.15
_WATCH_S = 0.02
_KEPT = 10


@dataclass(frozen=True, slots=True)
class Scene:
    """One run's world, drawn from its number alone. renderer: `own` or `mujoco`."""

    name: str
    renderer: str
    seed: int
    route: Mapping[str, Any]
    pitch_m: float
    markers: str
    start_off: tuple[float, float, float]
    devices: Mapping[str, float]

    def sets(self) -> list[str]:
        """The world as assignments for the config."""
        told = [f"simulation.seed={self.seed}", f"behaviours.jetbot_route.pitch_m={self.pitch_m}"]
        if self.renderer == "mujoco":
            told.append("devices.camera.use=mujoco_camera")
        return told + [f"simulation.devices.{key}={value}" for key, value in self.devices.items()]

    def places_m(self) -> dict[str, tuple[float, float]]:
        """Each node in the map frame."""
        return {str(n["id"]): (n["x"] * self.pitch_m, -n["y"] * self.pitch_m) for n in self.route["nodes"]}


def scene(renderer: str, number: int, first: int) -> Scene:
    """The world of a run: everything follows from the numbers. `first` sets one family of worlds apart from another."""
    rng = np.random.default_rng([first, number, len(renderer)])
    columns, rows = (int(n) for n in rng.integers(3, 9, 2))
    seed = int(rng.integers(1 << 30))

    def between(low: float, high: float) -> float:
        return round(float(rng.uniform(low, high)), 4)

    devices = {
        "motors.wheel_error": WHEEL_ERROR,
        "camera.frame_loss": 0.1,
        "camera.brightness": between(0.6, 1.1),
        "camera.light_drift": between(0.04, 0.15),
        "camera.noise_std": between(3.0, 6.0),
    }
    if renderer == "own":
        devices |= {
            "camera.gloss": between(40.0, 90.0),
            "camera.shadows_per_m2": between(0.1, 1.0),
            "camera.shadow_depth": between(0.12, 0.4),
            "camera.shadow_edge_m": between(0.01, 0.04),
        }
    else:
        devices |= {"camera.reflectance": between(0.1, 0.3), "camera.specular": between(0.2, 0.5)}
    return Scene(
        f"{renderer} {number}",
        renderer,
        seed,
        random_route(seed, columns, rows),
        between(0.6, 0.9),
        ("none", "crossings", "all")[int(rng.integers(3))],
        (between(-0.015, 0.015), between(-0.015, 0.015), between(-0.05, 0.05)),
        devices,
    )


def drive(scene: Scene) -> dict[str, Any]:
    """Drive one scene to its end and judge it. The row of the bench."""
    import cv2

    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory() as folder:
        sets = _write(scene, Path(folder))
        parts = load_config(JETBOT, sim=True, sets=[*sets, *scene.sets()]).parts
        ride = _Ride()
        began, cpu = time.perf_counter(), time.process_time()
        runtime = Runtime(replace(parts, bridges=()), virtual=True, arm=True)
        with asyncio.Runner(loop_factory=lambda: virtual_loop(None)) as runner:
            runner.run(runtime.run(ride.begin))
        world: Any = runtime.world
        wall_s, cpu_s = time.perf_counter() - began, time.process_time() - cpu
    return {
        "run": scene.name,
        "renderer": scene.renderer,
        **judge(scene, ride),
        "off_max_m": round(float(world.map.line_distance_m(np.array(ride.way)[:, 1:]).max()), 4),
        "sim_s": round(ride.way[-1][0], 2),
        "wall_s": round(wall_s, 3),
        "cpu_s": round(cpu_s, 3),
        "way_m": [[round(x, 3), round(y, 3)] for _, x, y in ride.way[::_KEPT]],
    }


def _write(scene: Scene, folder: Path) -> list[str]:
    """The files of a scene; the assignments that name them."""
    (folder / "route.json").write_text(json.dumps(scene.route))
    places = scene.places_m()
    start = next(str(node["id"]) for node in scene.route["nodes"] if node["type"] == "start")
    x_m, y_m = (place + off for place, off in zip(places[start], scene.start_off, strict=False))
    xs, ys = zip(*places.values(), strict=True)
    low, high = (min(xs) - 1.0, min(ys) - 1.0), (max(xs) + 1.0, max(ys) + 1.0)
    corners = [[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]]
    world = {
        "name": "bench",
        "start": {"x_m": x_m, "y_m": y_m, "yaw_rad": scene.start_off[2]},
        "route": {"file": "route.json", "pitch_m": scene.pitch_m, "markers": scene.markers},
        "walls": [{"points_m": corners, "closed": True}],
    }
    # JSON is YAML too
    (folder / "world.yaml").write_text(json.dumps(world))
    return [f"simulation.map={folder / 'world.yaml'}", f"behaviours.jetbot_route.map={folder / 'route.json'}"]


class _Ride:
    """What happened: the true way (seconds, x, y), the nodes that the behaviour announced and where it was then."""

    def __init__(self) -> None:
        self.way: list[tuple[float, float, float]] = []
        self.events: list[tuple[str, float, float]] = []
        self.outcome: Outcome | None = None
        self.collisions = 0

    def begin(self, running: Any) -> None:
        loop: Any = asyncio.get_running_loop()
        node = next(node for node in running.core.graph.behaviours if node.name == "jetbot_route")

        def look() -> None:
            x_m, y_m, _ = running.world.pose()
            self.way.append((loop.time(), x_m, y_m))
            self.collisions = running.world.collisions
            if node.instance is not None:
                for name in node.instance.driver.visited[len(self.events) :]:
                    self.events.append((name, x_m, y_m))

        def ended(event: Any) -> None:
            if isinstance(event, Outcome) and self.outcome is None:
                self.outcome = event
                loop.call_at_ns(loop.now_ns() + ns(0.5), running.stop)

        def watch() -> None:
            look()
            loop.call_at_ns(loop.now_ns() + ns(_WATCH_S), watch)

        running.core.on_event.append(ended)
        loop.call_at_ns(loop.now_ns() + 1, watch)
        loop.call_at_ns(ns(LIMIT_S), running.stop)


def judge(scene: Scene, ride: _Ride) -> dict[str, Any]:
    """What the truth says: reached or not, and nodes announced against nodes passed.

    A node event is wrong where another node is nearer than the one announced, or where the sequence of events differs
    from the sequence of nodes that the base's origin truly passed (within `NODE_M`).
    """
    places = scene.places_m()
    goal = next(str(node["id"]) for node in scene.route["nodes"] if node["type"] == "end")
    names, spots = list(places), np.array(list(places.values()))
    passed: list[str] = []
    for _, x_m, y_m in ride.way:
        apart = np.hypot(spots[:, 0] - x_m, spots[:, 1] - y_m)
        nearest = int(apart.argmin())
        if apart[nearest] <= NODE_M and passed[-1:] != [names[nearest]]:
            passed.append(names[nearest])
    told = _last_node(scene, ride)
    true = passed[1:]
    matched = sum(block.size for block in SequenceMatcher(None, told, true, autojunk=False).get_matching_blocks())
    misplaced = 0
    for name, x_m, y_m in ride.events:
        apart = np.hypot(spots[:, 0] - x_m, spots[:, 1] - y_m)
        misplaced += names[int(apart.argmin())] != name
    outcome = ride.outcome
    off_goal_m = math.dist(ride.way[-1][1:3], places[goal])
    return {
        "complete": outcome is not None and outcome.result == "SUCCEEDED" and off_goal_m <= NODE_M,
        "outcome": "no outcome" if outcome is None else f"{outcome.result}: {outcome.reason}",
        "off_goal_m": round(off_goal_m, 4),
        "collisions": ride.collisions,
        "edges": len(true),
        "phantom": len(told) - matched + misplaced,
        "missed": len(true) - matched,
        "nodes": told,
    }


def _last_node(scene: Scene, ride: _Ride) -> list[str]:
    """The nodes announced; the goal is announced by the outcome, in the turn in which the behaviour ends."""
    told = [name for name, _, _ in ride.events]
    if ride.outcome is not None and ride.outcome.result == "SUCCEEDED":
        goal = next(str(node["id"]) for node in scene.route["nodes"] if node["type"] == "end")
        if told[-1:] != [goal]:
            told.append(goal)
    return told


def run_one(renderer: str, number: int, first: int) -> dict[str, Any]:
    """For a worker process: a run by its numbers."""
    return drive(scene(renderer, number, first))


def names_of(rows: Sequence[Mapping[str, Any]]) -> str:
    """The runs of rows, for people."""
    return ", ".join(str(row["run"]) for row in rows)
