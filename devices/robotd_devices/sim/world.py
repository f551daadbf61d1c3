"""A flat world on a fixed grid of time: one robot's true pose among walls, posts, tape, cards and people."""

from __future__ import annotations

import math
import zlib
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
from robotd_devices.sim.scene import Scene, Things
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

    A step that would put the outline into a wall, post, box or card is not taken: the base stands, `collisions` counts
    the contacts (not the steps), and any motion that leads away is free. People walk on whatever the robot does and are
    no wall to it: `person_contacts` counts how often a base that moves meets the disc of one.
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
        self.person_contacts = 0
        self.blocked = False
        self.contacts_rad: tuple[float, ...] = ()
        """Bearings in base of what the outline touches now, people included; empty where it is free."""
        self.velocity: Drive = STOP
        """The base's true velocity during the last step."""
        self.effort_m = 0.0
        """Way of the base so far, forward, sideways and of its outline in turns: what the motors had to do."""
        self.supply = 1.0
        """Voltage of the battery as a share of the full one; a simulated battery sets it."""
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
        self.scene = Scene(self.map, self.generator("people"))
        self._meets: frozenset[int] = frozenset()
        self._people_free_m = 0.0
        self._look_around(0.0)

    async def open(self) -> None:
        """Reads the map and puts the base at its start. Raises DeviceMisconfigured for a map that cannot be."""
        if self._given is None:
            try:
                self.map = load_map(self.config.map)
            except MapError as error:
                raise DeviceMisconfigured(str(error)) from error
        self.collisions, self.person_contacts, self.blocked, self.contacts_rad = 0, 0, False, ()
        self.velocity, self.effort_m, self.supply, self._body = STOP, 0.0, 1.0, None
        self._begin()
        if self._outline.touches(*self.map.start):
            raise DeviceMisconfigured(f"map {self.map.name}: the robot touches a wall or post at `start`: move it")

    def generator(self, name: str) -> np.random.Generator:
        """Random numbers of one device: they depend on the seed and its name, and on nothing that others draw."""
        return np.random.default_rng([self.config.seed, zlib.crc32(name.encode())])

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

    def second(self, stamp_ns: int) -> float:
        """Seconds of this world at an instant, as people and boxes count them."""
        return (stamp_ns - self._start_ns) / NS_PER_S

    def seen(self, from_ns: int, to_ns: int, height_m: float) -> Things:
        """What a level plane at this height cuts from one instant to another; people move on a straight line in it."""
        return self.scene.seen(self.second(from_ns), self.second(to_ns), height_m)

    def put(
        self, name: str, segments_m: Sequence[Sequence[float]] = (), circles_m: Sequence[Sequence[float]] = ()
    ) -> None:
        """Sets walls and posts there from now on, in place of what had that name (a box that appears in a test)."""
        self.advance()
        segments, circles = np.array(segments_m, dtype=np.float64), np.array(circles_m, dtype=np.float64)
        self.scene.put(name, Things(segments.reshape(-1, 4), circles.reshape(-1, 3)))
        self._look_around(self._steps * self._step_s)

    def take_away(self, name: str) -> None:
        """Removes from now on what was put there. Raises KeyError where there is nothing of that name."""
        self.advance()
        self.scene.take_away(name)
        self._look_around(self._steps * self._step_s)

    def off_line_m(self) -> float:
        """How far the base's origin is from the middle of the nearest tape now; inf where there is none."""
        x_m, y_m, _ = self.pose()
        return float(self.map.line_distance_m(np.array([[x_m, y_m]]))[0])

    def _step(self) -> None:
        if self._steps >= self._change_step:
            self._look_around(self._steps * self._step_s)
        drive = self._body.step() if self._body is not None else STOP
        if drive is not STOP:
            drive = self._move(drive)
        self.velocity = drive
        self._steps += 1
        if self.scene.people:
            self._meet_people(drive)
        self._remember()

    def _look_around(self, when_s: float) -> None:
        """Takes note of what stands there now, until the next box comes or goes."""
        self._outline = Outline(self.context.robot.footprint_m, self.scene.standing(when_s))
        self._free_m = 0.0
        change_s = self.scene.next_change_s(when_s)
        self._change_step = math.ceil(change_s / self._step_s - 1e-9) if math.isfinite(change_s) else math.inf

    def _travel_m(self, drive: Drive) -> float:
        """No point of the outline moves farther than this in one step."""
        return (math.hypot(drive.vx_mps, drive.vy_mps) + abs(drive.wz_radps) * self._outline.radius_m) * self._step_s

    def _move(self, drive: Drive) -> Drive:
        x_m, y_m, yaw_rad = advance(self._x_m, self._y_m, self._yaw_rad, drive, self._step_s)
        travel_m = self._travel_m(drive)
        self.effort_m += travel_m
        if self._free_m <= travel_m:
            self._free_m = self._outline.clearance_m(x_m, y_m)
            if self._free_m <= 0.0:
                self._free_m = 0.0
                touched_rad = self._outline.contacts_rad(x_m, y_m, yaw_rad)
                if touched_rad:
                    self.collisions += not self.blocked
                    self.blocked, self.contacts_rad = True, touched_rad
                    return STOP
        else:
            self._free_m -= travel_m
        if self.blocked:
            self.blocked, self.contacts_rad = False, ()
        self._x_m, self._y_m, self._yaw_rad = x_m, y_m, yaw_rad
        self._turned_rad += drive.wz_radps * self._step_s
        return drive

    def _meet_people(self, drive: Drive) -> None:
        """Counts people that the outline begins to touch while the base moves; their bearings are contacts too."""
        self._people_free_m -= self._travel_m(drive) + self.scene.top_speed_mps * self._step_s
        if self._people_free_m > 0.0:
            return
        circles_m = self.scene.people_circles_m(self._steps * self._step_s)
        met = self._outline.meets(self._x_m, self._y_m, self._yaw_rad, circles_m)
        gaps_m = np.hypot(circles_m[:, 0] - self._x_m, circles_m[:, 1] - self._y_m) - circles_m[:, 2]
        self._people_free_m = max(0.0, float(gaps_m.min()) - self._outline.radius_m)
        if drive is not STOP:
            self.person_contacts += len(met.keys() - self._meets)
        if met or self._meets:
            walls_rad = self.contacts_rad if self.blocked else ()
            self.contacts_rad = (*walls_rad, *met.values())
        self._meets = frozenset(met)

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
