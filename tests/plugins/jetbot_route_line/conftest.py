"""The shipped JetBot in its simulator on virtual time, and made-up looks at a line for single steps."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pytest

from robotd.engine.loops import virtual_loop
from robotd.engine.runtime import Runtime
from robotd.setup.load import load_config
from robotd.world.clock import ns
from robotd.world.messages import Outcome
from robotd_devices.sim import SimCamera
from robotd_plugins.toolkit.line_seen import CrossingBar, LineEnd, LineSeen, RoiLine

JETBOT = Path(__file__).resolve().parents[3] / "configs" / "jetbot.yaml"


@dataclass
class Drove:
    """One closed-loop run: the true way (t, x, y, yaw, metres off the tape), the states, and how it ended."""

    way: list[tuple[float, float, float, float, float]] = field(default_factory=list)
    states: list[str] = field(default_factory=list)
    outcome: Outcome | None = None
    ended_s: float = math.inf
    runtime: Any = None

    @property
    def off_max_m(self) -> float:
        return max(row[4] for row in self.way)

    @property
    def off_rms_m(self) -> float:
        return math.sqrt(sum(row[4] ** 2 for row in self.way) / len(self.way))

    @property
    def final(self) -> tuple[float, float, float]:
        return self.way[-1][1:4]


def drive(world_map: str, seed: int, limit_s: float, *sets: str, camera: type[SimCamera] = SimCamera) -> Drove:
    """Run until the goal ends (plus half a second) or `limit_s`, without the page."""
    line = ("behaviours.jetbot_route.map=null", f"simulation.map={world_map}", f"simulation.seed={seed}")
    parts = load_config(JETBOT, sim=True, sets=(*line, *sets)).parts
    devices = tuple(replace(part, cls=camera) if part.cls is SimCamera else part for part in parts.devices)
    runtime = Runtime(replace(parts, devices=devices, bridges=()), virtual=True, arm=True)
    drove = Drove(runtime=runtime)

    def started(running: Any) -> None:
        loop: Any = asyncio.get_running_loop()

        def ended(event: Any) -> None:
            if isinstance(event, Outcome) and drove.outcome is None:
                drove.outcome, drove.ended_s = event, loop.time()
                loop.call_at_ns(loop.now_ns() + ns(0.5), running.stop)

        def watch() -> None:
            world = running.world
            drove.way.append((loop.time(), *world.pose(), world.off_line_m()))
            node = next(node for node in running.core.graph.behaviours if node.name == "jetbot_route")
            if node.instance is not None and drove.states[-1:] != [node.instance.state.value]:
                drove.states.append(node.instance.state.value)
            loop.call_at_ns(loop.now_ns() + ns(0.02), watch)

        running.core.on_event.append(ended)
        # after the devices have opened
        loop.call_at_ns(loop.now_ns() + 1, watch)
        loop.call_at_ns(ns(limit_s), running.stop)

    with asyncio.Runner(loop_factory=lambda: virtual_loop(None)) as runner:
        runner.run(runtime.run(started))
    return drove


def looked(
    t_s: float,
    left_m: float | None = 0.0,
    heading_rad: float = 0.0,
    *,
    far: bool = True,
    bar_m: float | None = None,
    straight: bool | None = True,
    end_m: float | None = None,
) -> LineSeen:
    """A look at a straight line that passes the axle `left_m` to the left; None: nothing seen."""

    def roi(top: float, height: float, ahead_m: float, seen: bool) -> RoiLine:
        if left_m is None or not seen:
            return RoiLine(top, top + height)
        place_m = left_m + ahead_m * math.tan(heading_rad)
        return RoiLine(top, top + height, -place_m / 0.13, 0.15, 1.0, ahead_m, place_m)

    near, beyond = roi(0.85, 0.15, 0.128, True), roi(0.60, 0.15, 0.212, far)
    bar = None if bar_m is None else CrossingBar(0.0, 0.6, True, True, straight, 1.0, bar_m)
    end = None if end_m is None else LineEnd(0.0, 0.6, end_m)
    known = near.is_seen and beyond.is_seen
    return LineSeen(ns(t_s), near, beyond, heading_rad if known else math.nan, bar, end)


@pytest.fixture
def run() -> Callable[..., Drove]:
    return drive


@pytest.fixture
def look() -> Callable[..., LineSeen]:
    return looked
