"""The shipped JetBot on mapped floors in virtual time, with the truth beside what it believes."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robotd.engine.loops import virtual_loop
from robotd.engine.runtime import Runtime
from robotd.setup.load import load_config
from robotd.world.clock import ns
from robotd.world.messages import Outcome

JETBOT = Path(__file__).resolve().parents[3] / "configs" / "jetbot.yaml"

Tape = Sequence[tuple[tuple[float, float], tuple[float, float]]]


@dataclass
class Drove:
    """One run: true way (seconds, x, y, yaw), states with their reasons, nodes announced and where the base was."""

    way: list[tuple[float, float, float, float]] = field(default_factory=list)
    states: list[str] = field(default_factory=list)
    reasons: list[str] = field(default_factory=list)
    nodes: list[tuple[str, float, float]] = field(default_factory=list)
    outcome: Outcome | None = None
    collisions: int = 0
    off_max_m: float = 0.0
    """Farthest that the base's origin was from the middle of the nearest tape."""

    @property
    def final(self) -> tuple[float, float]:
        return self.way[-1][1:3]


def drive(sets: Sequence[str], limit_s: float) -> Drove:
    """Run the shipped robot, without its page, until its goal ends, plus half a second."""
    parts = load_config(JETBOT, sim=True, sets=list(sets)).parts
    runtime = Runtime(replace(parts, bridges=()), virtual=True, arm=True)
    drove = Drove()

    def started(running: Any) -> None:
        loop: Any = asyncio.get_running_loop()
        node = next(node for node in running.core.graph.behaviours if node.name == "jetbot_route")

        def ended(event: Any) -> None:
            if isinstance(event, Outcome) and drove.outcome is None:
                drove.outcome = event
                loop.call_at_ns(loop.now_ns() + ns(0.5), running.stop)

        def watch() -> None:
            pose = running.world.pose()
            drove.way.append((loop.time(), *pose))
            drove.collisions = running.world.collisions
            if node.instance is not None:
                driver = node.instance.driver
                if drove.states[-1:] != [driver.state.value]:
                    drove.states.append(driver.state.value)
                    drove.reasons.append(driver.reason)
                drove.nodes += [(name, *pose[:2]) for name in driver.visited[len(drove.nodes) :]]
            loop.call_at_ns(loop.now_ns() + ns(0.02), watch)

        running.core.on_event.append(ended)
        # after the devices have opened
        loop.call_at_ns(loop.now_ns() + 1, watch)
        loop.call_at_ns(ns(limit_s), running.stop)

    with asyncio.Runner(loop_factory=lambda: virtual_loop(None)) as runner:
        runner.run(runtime.run(started))
    world: Any = runtime.world
    drove.off_max_m = float(world.map.line_distance_m(np.array(drove.way)[:, 1:3]).max())
    return drove


def roads(nodes: Mapping[int, tuple[int, int]], pairs: Sequence[tuple[int, int]], start: int, end: int) -> Any:
    """A route map in the starter kit's form: each pair is driven both ways."""
    letters = {(0, -1): "N", (1, 0): "E", (0, 1): "S", (-1, 0): "W"}

    def label(a: int, b: int) -> str:
        dx, dy = (b - a for a, b in zip(nodes[a], nodes[b], strict=True))
        return letters[dx // max(abs(dx), 1), dy // max(abs(dy), 1)]

    kinds = {end: "end", start: "start"}
    return {
        "nodes": [{"id": n, "x": x, "y": y, "type": kinds.get(n, "normal")} for n, (x, y) in nodes.items()],
        "edges": [{"source": a, "target": b, "label": label(a, b)} for p, q in pairs for a, b in ((p, q), (q, p))],
    }


@pytest.fixture
def run(tmp_path: Path) -> Callable[..., Drove]:
    """Drive a route map that is laid as tape; `tape`: other tape instead. Without a map: the config's own."""

    def run(
        route: Any = None,
        *sets: str,
        pitch_m: float = 0.6,
        heading: str = "E",
        seed: int = 0,
        tape: Tape | None = None,
        limit_s: float = 120.0,
    ) -> Drove:
        named = [f"simulation.seed={seed}"]
        if route is not None:
            (tmp_path / "route.json").write_text(json.dumps(route))
            world: dict[str, Any] = {"name": "roads"}
            if tape is None:
                world["route"] = {"file": "route.json", "pitch_m": pitch_m, "heading": heading}
            else:
                world["lines"] = [{"points_m": pair} for pair in tape]
            (tmp_path / "roads.yaml").write_text(json.dumps(world))
            named += [
                f"simulation.map={tmp_path / 'roads.yaml'}",
                f"behaviours.jetbot_route.map={tmp_path / 'route.json'}",
                f"behaviours.jetbot_route.pitch_m={pitch_m}",
                f"behaviours.jetbot_route.heading={heading}",
            ]
        return drive([*named, *sets], limit_s)

    return run


@pytest.fixture
def make_roads() -> Callable[..., Any]:
    return roads
