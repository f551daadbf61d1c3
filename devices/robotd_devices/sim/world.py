"""A flat world on a fixed grid of time: one robot's true pose among walls, posts and tape."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from robotd.authoring.config import Config, FileKey
from robotd.authoring.device import DeviceContext, DeviceMisconfigured, World
from robotd.world.clock import NS_PER_S, ns
from robotd.world.kinematics import advance
from robotd.world.messages import STOP, Drive, Float64s
from robotd_devices.sim.maps import FloorLine, MapError, WorldMap, load_map, map_from_segments
from robotd_devices.sim.ticks import generator
from robotd_devices.sim.touch import Outline

_PAST_S = 1.0
"""How far back a pose can be asked for."""


class FlatWorldConfig(Config):
    """The world of `simulation:`."""

    map: Annotated[str, FileKey("maps")] = "line_track"
    """A map file, by path or by the name of a shipped map."""
    seed: int = Field(default=0, ge=0)
    """Everything random in this world follows from it and from the names of the devices."""
    step_s: float = Field(default=0.005, ge=0.0005, le=0.02)
    """The grid of physics."""


class Body(Protocol):
    """What moves the base: asked once in each grid step."""

    def step(self) -> Drive:
        """The body's velocity during the next step, in its own frame."""
        ...


class FlatWorld(World[FlatWorldConfig]):
    """Integrates the base's true pose, exactly on SE(2), in whole steps since the world was opened.

    The world is brought up to date by whoever asks (a sensor before it looks, the base before it takes a command), so
    that devices that fall on one instant see the same world whatever their order, and an instant at which nobody
    looks costs no timer. No step is left out. A command given inside a step counts for that whole step.

    A step that would put the outline into a wall or a post is not taken: the base stands, `collisions` counts the
    contacts (not the steps), and any motion that leads away is free.
    """

    def __init__(
        self,
        config: FlatWorldConfig | None = None,
        context: DeviceContext | None = None,
        world_map: WorldMap | None = None,
    ) -> None:
        super().__init__(config if config is not None else FlatWorldConfig(), context)
        self._given = world_map
        self.map: WorldMap = world_map if world_map is not None else map_from_segments()
        self.collisions = 0
        self.blocked = False
        self.velocity: Drive = STOP
        """The base's true velocity during the last step."""
        self._step_ns = ns(self.config.step_s)
        self._step_s = self._step_ns / NS_PER_S
        self._body: Body | None = None
        self._begin()

    def _begin(self) -> None:
        self._start_ns = self.context.clock.now_ns()
        self._steps = 0
        self._x_m, self._y_m, self._yaw_rad = self.map.start
        self._turned_rad = self._yaw_rad
        self._rows = round(_PAST_S / self._step_s) + 1
        self._past = np.empty((4 * self._rows, 4))
        self._past[0] = (0.0, *self.map.start)
        self._filled = 1
        self._outline = Outline(self.context.robot.footprint_m, self.map)
        self._free_m = 0.0

    async def open(self) -> None:
        """Reads the map and puts the base at its start. Raises DeviceMisconfigured for a map that cannot be."""
        if self._given is None:
            try:
                self.map = load_map(self.config.map)
            except MapError as error:
                raise DeviceMisconfigured(str(error)) from error
        self.collisions, self.blocked, self.velocity, self._body = 0, False, STOP, None
        self._begin()
        if self._outline.touches(*self.map.start):
            raise DeviceMisconfigured(f"map {self.map.name}: the robot touches a wall or post at `start`: move it")

    def generator(self, name: str) -> np.random.Generator:
        """The random numbers of one device of this world."""
        return generator(self.config.seed, name)

    @property
    def step_ns(self) -> int:
        """One grid step in nanoseconds."""
        return self._step_ns

    def attach(self, body: Body) -> None:
        """`body` moves the base from now on. Raises DeviceMisconfigured where another one does already."""
        if self._body is not None and self._body is not body:
            raise DeviceMisconfigured("one simulated world moves one base: remove the second simulated base")
        self.advance()
        self._body = body

    def detach(self, body: Body) -> None:
        """The base stands from now on."""
        if self._body is body:
            self.advance()
            self._body, self.velocity = None, STOP

    def advance(self) -> None:
        """Takes every whole step up to the clock's now."""
        wanted = (self.context.clock.now_ns() - self._start_ns) // self._step_ns
        while self._steps < wanted:
            self._step()

    def pose(self) -> tuple[float, float, float]:
        """True base in map now: x, y, yaw."""
        x_m, y_m, yaw_rad = self.poses(np.array([self.context.clock.now_ns()]))[0]
        return float(x_m), float(y_m), math.remainder(float(yaw_rad), math.tau)

    def poses(self, stamps_ns: NDArray[np.int64]) -> Float64s:
        """True poses at instants of the last second up to now, float64 (n, 3): x, y, and yaw counted on without wrap.

        Between two grid steps the pose is interpolated, after the last one it goes on at the present velocity.
        """
        self.advance()
        now_ns = self.context.clock.now_ns() - self._start_ns
        over_s = (now_ns - self._steps * self._step_ns) / NS_PER_S
        end = self._filled
        if over_s > 0.0:
            x_m, y_m, _ = advance(self._x_m, self._y_m, self._yaw_rad, self.velocity, over_s)
            self._past[end] = (float(now_ns), x_m, y_m, self._turned_rad + self.velocity.wz_radps * over_s)
            end += 1
        when = (stamps_ns - self._start_ns).astype(np.float64)
        past = self._past[max(0, end - self._rows) : end]
        return np.stack([np.interp(when, past[:, 0], past[:, column]) for column in (1, 2, 3)], axis=1)

    def off_line_m(self) -> float:
        """How far the base's origin is from the middle of the nearest tape now; inf where there is none."""
        x_m, y_m, _ = self.pose()
        return float(self.map.line_distance_m(np.array([[x_m, y_m]]))[0])

    def _step(self) -> None:
        drive = self._body.step() if self._body is not None else STOP
        if drive is not STOP:
            drive = self._move(drive)
        self.velocity = drive
        self._steps += 1
        self._remember()

    def _move(self, drive: Drive) -> Drive:
        x_m, y_m, yaw_rad = advance(self._x_m, self._y_m, self._yaw_rad, drive, self._step_s)
        # no point of the outline moves farther than this
        travel_m = (
            math.hypot(drive.vx_mps, drive.vy_mps) + abs(drive.wz_radps) * self._outline.radius_m
        ) * self._step_s
        if self._free_m <= travel_m:
            self._free_m = self._outline.clearance_m(x_m, y_m)
            if self._free_m <= 0.0 and self._outline.touches(x_m, y_m, yaw_rad):
                self._free_m = 0.0
                self.collisions += not self.blocked
                self.blocked = True
                return STOP
        else:
            self._free_m -= travel_m
        self.blocked = False
        self._x_m, self._y_m, self._yaw_rad = x_m, y_m, yaw_rad
        self._turned_rad += drive.wz_radps * self._step_s
        return drive

    def _remember(self) -> None:
        if self._filled >= len(self._past) - 1:
            # one row stays free for the pose between two steps
            self._past[: self._rows] = self._past[self._filled - self._rows : self._filled]
            self._filled = self._rows
        self._past[self._filled] = (float(self._steps * self._step_ns), self._x_m, self._y_m, self._turned_rad)
        self._filled += 1


def flat_world(context: DeviceContext) -> FlatWorld:
    """The world that a simulated device lives in. Raises DeviceMisconfigured where it has none, or another kind."""
    world = context.world
    if isinstance(world, FlatWorld):
        return world
    found = "no simulated world" if world is None else f"a world of class {type(world).__name__}"
    raise DeviceMisconfigured(
        f"{context.name}: this simulated device needs the world `flat_world`, but found {found}; "
        "start with --sim and a config whose `simulation:` names the world flat_world"
    )


def world_from_segments(
    segments_m: Sequence[Sequence[float]] | Float64s = (),
    *,
    circles_m: Sequence[Sequence[float]] | Float64s = (),
    lines: Sequence[FloorLine] = (),
    start: tuple[float, float, float] = (0.0, 0.0, 0.0),
    seed: int = 0,
    context: DeviceContext | None = None,
) -> FlatWorld:
    """A world from plain numbers, without a file; open it like any other. See `map_from_segments`."""
    world_map = map_from_segments(segments_m, circles_m=circles_m, lines=lines, start=start)
    return FlatWorld(FlatWorldConfig(seed=seed), context, world_map)
