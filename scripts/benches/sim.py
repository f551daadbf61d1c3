"""What the simulator costs: one scan, one picture of either renderer, and the whole JetBot against real time."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable
from statistics import median
from typing import Any

import numpy as np

from benches.harness import Bench, Context, Figure
from robotd.authoring.device import Device, DeviceContext, DeviceError
from robotd.engine.loops import running_loop, virtual_loop
from robotd.world.messages import Drive, Message
from robotd.world.robot import Mount, Robot
from robotd_devices.sim import (
    Card,
    FlatWorld,
    FlatWorldConfig,
    FloorLine,
    Person,
    SimBase,
    SimBaseConfig,
    SimCamera,
    SimCameraConfig,
    SimLidar,
    SimLidarConfig,
    WorldMap,
    walk_along,
)
from robotd_devices.sim.maps import map_from_segments
from robotd_devices.sim.mujoco_devices import MujocoCamera, MujocoCameraConfig

MOUNTS = {"camera": Mount(x_m=0.06, z_m=0.11, pitch_rad=0.35), "lidar": Mount(x_m=-0.03, z_m=0.14)}
DRIVE_S = 20.0


class _Silent:
    """Takes what a device publishes and forgets it."""

    def publish(self, message: Message) -> None:
        pass

    def lost(self, error: DeviceError) -> None:
        raise error

    def fault(self, name: str, detail: str = "") -> None:
        raise RuntimeError(f"{name} {detail}")


def full_map(segments: int) -> WorldMap:
    """Tape with a crossing, `segments` walls all around, four cards and somebody who walks."""
    rng = np.random.default_rng(1)
    turn = rng.uniform(0.0, math.tau, segments)
    reach_m = rng.uniform(2.0, 10.0, segments)
    ends_m = np.stack((reach_m * np.cos(turn), reach_m * np.sin(turn)), axis=1)
    tape = (np.array([(-1.0, 0.0), (9.0, 0.0)]), np.array([(0.9, -0.5), (0.9, 0.5)]))
    return map_from_segments(
        np.hstack((ends_m, ends_m + rng.normal(0.0, 1.0, (segments, 2)))),
        lines=[FloorLine(points_m) for points_m in tape],
        cards=[Card(0.8 + 0.4 * at, (-1) ** at * 0.3, math.pi, text="LRSN"[at]) for at in range(4)],
        people=[Person(walk_along([(2.5, -1.0), (2.5, 1.0)], 1.2))],
    )


def live(
    world_map: WorldMap | None, devices: dict[str, tuple[type[Device[Any]], Any]], seconds: float,
    act: Callable[[dict[str, Any], FlatWorld, float], None],
) -> None:  # fmt: skip
    """Opens the devices in a world on virtual time and calls `act` twenty times a second."""

    async def run() -> None:
        clock, robot = running_loop(), Robot(mounts=MOUNTS)
        world = FlatWorld(FlatWorldConfig(map="route_13"), DeviceContext("world", clock, robot, _Silent()), world_map)
        await world.open()
        opened: dict[str, Any] = {}
        for name, (cls, config) in devices.items():
            cls.load(config)
            opened[name] = cls(config, DeviceContext(name, clock, robot, _Silent(), world))
            await opened[name].open()
        while clock.time() < seconds:
            act(opened, world, clock.time())
            await asyncio.sleep(0.05)
        for device in opened.values():
            await device.close()

    with asyncio.Runner(loop_factory=virtual_loop) as runner:
        runner.run(run())


def scan_ms(scans: int) -> list[float]:
    """Exact ranges of 1081 beams over 270 degrees among 200 walls, each beam from its own pose of a turning robot."""
    taken: list[float] = []

    def act(opened: dict[str, Any], world: FlatWorld, now_s: float) -> None:
        opened["base"].apply(Drive(0.3, 0.5))
        before = time.perf_counter()
        opened["lidar"].true_ranges_m(world, world.context.clock.now_ns())
        taken.append((time.perf_counter() - before) * 1e3)

    lidar = SimLidarConfig(beams=1081, fov_rad=math.radians(270.0), rate_hz=40.0)
    live(full_map(200), {"base": (SimBase, SimBaseConfig()), "lidar": (SimLidar, lidar)}, scans * 0.05, act)
    return taken[5:]


def frame_ms(cls: type[Device[Any]], config: Any, frames: int) -> list[float]:
    """Pictures of 320 x 240 with everything on, rendered as the camera does while the robot drives and turns."""
    taken: list[float] = []

    def act(opened: dict[str, Any], world: FlatWorld, now_s: float) -> None:
        opened["base"].apply(Drive(0.2, 0.4 * math.sin(now_s)))
        shutter = opened["camera"]._shutter
        if now_s > 0.2:
            before = time.perf_counter()
            shutter._show()
            taken.append((time.perf_counter() - before) * 1e3)

    quiet = config.model_copy(update={"rate_hz": 0.01})
    live(full_map(12), {"base": (SimBase, SimBaseConfig()), "camera": (cls, quiet)}, frames * 0.05 + 0.25, act)
    return taken


def jetbot_times_real() -> float:
    """Camera at 20 Hz, lidar at 10 Hz and base on the shipped route, with opening."""
    devices: dict[str, tuple[type[Device[Any]], Any]] = {
        "base": (SimBase, SimBaseConfig()),
        "lidar": (SimLidar, SimLidarConfig()),
        "camera": (SimCamera, SimCameraConfig()),
    }

    def act(opened: dict[str, Any], world: FlatWorld, now_s: float) -> None:
        opened["base"].apply(Drive(0.15, 0.2 * math.sin(now_s)))

    before = time.perf_counter()
    live(None, devices, DRIVE_S, act)
    return DRIVE_S / (time.perf_counter() - before)


class SimBench(Bench):
    """Times the simulator on this machine."""

    name = "sim"
    about = "cost of the simulated lidar, cameras and JetBot"
    figures = (
        Figure("scan_ms_p50", "ms", "<= 1", "1081 beams among 200 walls, a person and cards"),
        Figure("frame_ms_p50", "ms", "<= 3", "320 x 240 with everything on"),
        Figure("mujoco_frame_ms_p50", "ms", "", "the same by MuJoCo"),
        Figure("jetbot_times_real", "x", ">= 10", "camera, lidar and base, opening included"),
    )

    def run(self, ctx: Context) -> None:
        few = 40 if ctx.quick else 300
        scans = scan_ms(few)
        ctx.figure("scan_ms_p50", median(scans), runs=len(scans))
        frames = frame_ms(SimCamera, SimCameraConfig(), few)
        ctx.figure("frame_ms_p50", median(frames), runs=len(frames))
        frames = frame_ms(MujocoCamera, MujocoCameraConfig(), few // 4)
        ctx.figure("mujoco_frame_ms_p50", median(frames), runs=len(frames))
        runs = [jetbot_times_real() for _ in range(1 if ctx.quick else 3)]
        ctx.figure("jetbot_times_real", median(runs), runs=len(runs))


BENCH = SimBench()
