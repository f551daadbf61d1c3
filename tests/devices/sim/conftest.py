"""A tiny rig: a flat world, its devices on a loop of virtual time, and a link that keeps what they publish."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import pytest

from robotd.authoring.device import Device, DeviceContext, DeviceError
from robotd.engine.loops import running_loop, virtual_loop
from robotd.world.messages import Message
from robotd.world.robot import Robot
from robotd_devices.sim import FlatWorld, FlatWorldConfig, WorldMap


class Link:
    """Keeps messages; a loss is an error here."""

    def __init__(self) -> None:
        self.messages: list[Any] = []

    def publish(self, message: Message) -> None:
        self.messages.append(message)

    def lost(self, error: DeviceError) -> None:
        raise error

    def fault(self, name: str, detail: str = "") -> None:
        raise AssertionError(f"{name} {detail}")


@dataclass
class Rig:
    """`devices`: name to (class, config), opened in this order. After `run`, messages by device name."""

    devices: dict[str, tuple[type[Device[Any]], Any]] = field(default_factory=dict)
    robot: Robot = field(default_factory=Robot)
    world_map: WorldMap | None = None
    map: str = "line_track"
    seed: int = 0
    step_s: float = 0.005
    open: dict[str, Any] = field(default_factory=dict)
    messages: dict[str, list[Any]] = field(default_factory=dict)

    world: FlatWorld = field(init=False)

    def run(self, duration_s: float, script: Sequence[tuple[float, Callable[[Rig], object]]] = ()) -> Rig:
        """From opening to closing; each entry of `script` acts at its second of virtual time."""
        with asyncio.Runner(loop_factory=virtual_loop) as runner:
            runner.run(self._live(duration_s, script))
        return self

    async def _live(self, duration_s: float, script: Sequence[tuple[float, Callable[[Rig], object]]]) -> None:
        clock = running_loop()
        config = FlatWorldConfig(map=self.map, seed=self.seed, step_s=self.step_s)
        self.world = FlatWorld(config, DeviceContext("world", clock, self.robot, Link()), self.world_map)
        await self.world.open()
        for name, (cls, device_config) in self.devices.items():
            link = Link()
            self.messages[name] = link.messages
            self.open[name] = cls(device_config, DeviceContext(name, clock, self.robot, link, self.world))
            await self.open[name].open()
        for at_s, act in [*script, (duration_s, lambda rig: rig.world.advance())]:
            await asyncio.sleep(at_s - clock.time())
            act(self)
        for device in self.open.values():
            await device.close()


@pytest.fixture
def rig() -> type[Rig]:
    return Rig
