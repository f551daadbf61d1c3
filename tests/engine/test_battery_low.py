"""A low battery is an event once, and a reason in the status for as long as it lasts."""

from __future__ import annotations

import asyncio
from typing import Any

from small_robot import robot, run

from robotd.authoring.config import Config
from robotd.authoring.device import DeviceContext, Sensor
from robotd.engine.parts import DevicePart, Parts
from robotd.engine.runtime import Runtime
from robotd.engine.status import Status
from robotd.engine.status_view import render
from robotd.world.messages import Battery, BatteryLow, Event


class PackConfig(Config):
    """volts: a reading a second; below 10 V it is low; 0: the gauge is lost."""

    volts: tuple[float, ...] = ()


class Pack(Sensor[PackConfig, Battery]):
    def __init__(self, config: PackConfig, context: DeviceContext | None = None) -> None:
        super().__init__(config, context)
        self._left = list(config.volts)

    async def open(self) -> None:
        self._timer = asyncio.get_running_loop().call_later(1.0, self._speak)

    def _speak(self) -> None:
        if not self._left:
            return
        volts = self._left.pop(0)
        if not volts:
            self.lost("unplugged")
            return
        self.publish(Battery(self.context.clock.now_ns(), volts, charge=volts / 20.0, low=volts < 10.0))
        self._timer = asyncio.get_running_loop().call_later(1.0, self._speak)

    async def close(self) -> None:
        self._timer.cancel()


def story(*volts: float) -> tuple[list[Event], list[Status]]:
    """The events, and the status half a second behind each reading."""
    small = robot()
    parts = Parts(
        small.robot,
        (*small.devices, DevicePart("pack", Pack, PackConfig(volts=volts))),
        guard=small.guard,
        arm_at_start=True,
    )
    events: list[Event] = []
    states: list[Status] = []

    def listen(runtime: Runtime) -> None:
        runtime.core.on_event.append(events.append)

    looks: list[Any] = [(1.5 + i, lambda runtime: states.append(runtime.handle.snapshot())) for i in range(len(volts))]
    run(parts, 1.0 + len(volts), (0.5, listen), *looks)
    return events, states


def of_pack(state: Status) -> str:
    return next(device.detail for device in state.devices if device.name == "pack")


def test_it_is_an_event_when_it_begins_and_a_reason_as_long_as_it_lasts() -> None:
    events, states = story(12.0, 9.9, 9.8, 12.0, 9.0)
    assert [(event.device, event.voltage_v, event.charge) for event in events if isinstance(event, BatteryLow)] == [
        ("pack", 9.9, 0.495),
        ("pack", 9.0, 0.45),
    ]
    assert len(events) == 2
    words = ["", "battery low: 9.9 V, 50%", "battery low: 9.8 V, 49%", "", "battery low: 9.0 V, 45%"]
    assert [of_pack(state) for state in states] == words
    assert all(device.state == "open" for device in states[1].devices)
    assert any("pack  open: battery low: 9.9 V" in line for line in render(states[1], 100, 20))


def test_of_a_gauge_that_is_lost_nothing_is_known() -> None:
    _, states = story(9.0, 0.0)
    assert of_pack(states[0]) == "battery low: 9.0 V, 45%"
    assert of_pack(states[1]) != of_pack(states[0])
