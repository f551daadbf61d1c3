"""Driving by hand: what the sticks ask for, the dead-man's button, leases, buttons, a whole robot in virtual time."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest
from small_robot import QUICK, FakeBase, S, robot, run

from robotd import Drive, Sensor, Steer
from robotd.authoring.config import NoConfig
from robotd.engine.parts import BridgePart, DevicePart
from robotd.engine.runtime import Runtime
from robotd.world.kinematics import Ackermann, Mecanum
from robotd.world.messages import Command, Gamepad, Mode
from robotd.world.robot import Limits, Robot
from robotd_plugins.bridges.gamepad import GamepadTeleop, GamepadTeleopConfig
from robotd_plugins.bridges.gamepad.hand import command, pressed

LIMITS = Limits(vx_mps=1.0, vy_mps=0.6, wz_radps=2.0)
TWO_WHEELS = Robot(limits=LIMITS)
MECANUM = Robot(kinematics=Mecanum(0.2, 0.2, 0.05), limits=LIMITS)
CAR = Robot(kinematics=Ackermann(0.26, 0.16, 0.4), limits=LIMITS)


@pytest.mark.parametrize(
    ("axes", "config", "body", "wanted"),
    [
        ({"y": -1.0}, {}, TWO_WHEELS, Drive(0.5, 0.0, 0.0)),  # away from the person: forward
        ({"y": 1.0}, {"speed_share": 1.0}, TWO_WHEELS, Drive(-1.0, 0.0, 0.0)),
        ({"rx": -1.0}, {}, TWO_WHEELS, Drive(0.0, 1.0, 0.0)),  # to the left: counter-clockwise
        ({"rx": 0.5}, {"turn_share": 0.2}, TWO_WHEELS, Drive(0.0, -0.2, 0.0)),
        ({"x": -1.0}, {}, TWO_WHEELS, Drive(0.0, 0.0, 0.0)),
        ({"x": -1.0}, {}, MECANUM, Drive(0.0, 0.0, 0.3)),
        ({"y": -1.0, "rx": -1.0}, {}, CAR, Steer(0.5, 0.4)),
        ({"rx": 1.0}, {}, CAR, Steer(0.0, -0.4)),
        ({"hat0y": -1.0}, {"forward_axis": "hat0y"}, TWO_WHEELS, Drive(0.5, 0.0, 0.0)),
        ({}, {}, TWO_WHEELS, Drive(0.0, 0.0, 0.0)),
    ],
)
def test_sticks(axes: dict[str, float], config: dict[str, Any], body: Robot, wanted: Command) -> None:
    found = command(Gamepad(0, tuple(axes.items())), GamepadTeleopConfig(**config), body)
    assert type(found) is type(wanted)
    assert [getattr(found, name) for name in found.__slots__] == pytest.approx(
        [getattr(wanted, name) for name in wanted.__slots__]
    )


def test_presses_are_differences_of_counts() -> None:
    now = Gamepad(0, presses=(("east", 3), ("south", 1), ("tl", 2)))
    assert pressed({"east": 2, "tl": 2}, now) == {"east", "south"}


# --------------------------------------------------------------------- a whole robot in virtual time

HELD = Gamepad(0, axes=(("y", -1.0),), buttons=("tl",), deadman=True)
FREE = Gamepad(0, axes=(("y", -1.0),))
SCRIPT: list[tuple[float, Gamepad | None]] = []
"""What the pad is from each instant (s) on; None: unplugged."""


class ScriptedPad(Sensor[NoConfig, Gamepad]):
    """Says every 50 ms what `SCRIPT` holds for now."""

    async def open(self) -> None:
        self._say()

    def _say(self) -> None:
        loop: Any = asyncio.get_running_loop()
        now_ns = loop.now_ns()
        self._timer = loop.call_at_ns(now_ns + S // 20, self._say)
        state = [state for at_s, state in SCRIPT if at_s * S <= now_ns][-1]
        if state is None:
            self.lost("unplugged")
        else:
            self.publish(replace(state, stamp_ns=now_ns))

    async def close(self) -> None:
        self._timer.cancel()


def drive(
    script: Sequence[tuple[float, Gamepad | None]], duration_s: float, *events: Any, body: Robot = QUICK, **config: Any
) -> tuple[Runtime, FakeBase]:
    SCRIPT[:] = [(0.0, FREE), *script]
    parts = robot(body=body)
    parts = replace(
        parts,
        devices=(*parts.devices, DevicePart("gamepad", ScriptedPad, NoConfig())),
        bridges=(BridgePart("gamepad_teleop", GamepadTeleop, GamepadTeleopConfig(**config)),),
    )
    return run(parts, duration_s, *events)


def moves(what: Command | str) -> bool:
    return isinstance(what, Drive) and what != Drive()


def last_motion_s(base: FakeBase) -> float:
    return max((at_ns for at_ns, what in base.log if moves(what)), default=0) / S


@pytest.mark.parametrize(
    ("then", "within_s"),
    [
        (FREE, 0.1),  # let go: one beat of the pad, one look of the bridge
        (None, 0.05),  # unplugged
    ],
)
def test_holding_drives_and_the_end_of_it_stops_well_within_one_lease(then: Gamepad | None, within_s: float) -> None:
    runtime, base = drive([(1.0, HELD), (2.0, then)], 4.0)
    assert not moves(base.at(0.99))
    assert base.at(1.2) == base.at(1.9) == Drive(0.5, 0.0, 0.0)
    assert 1.95 <= last_motion_s(base) <= 2.0 + within_s
    assert within_s < GamepadTeleopConfig().lease_s
    assert not moves(base.at(4.0))
    if then is not None:
        assert runtime.core.operator.mode is Mode.MANUAL  # autonomy returns only by `resume`


def test_a_bridge_that_dies_stops_the_robot_when_its_lease_ends() -> None:
    def break_bridge(runtime: Runtime) -> None:
        for task in asyncio.all_tasks():
            if task.get_name() == "bridge gamepad_teleop":
                task.cancel()

    _, base = drive([(1.0, HELD)], 3.0, (2.0, break_bridge))
    assert 1.95 <= last_motion_s(base) <= 2.0 + GamepadTeleopConfig().lease_s + 0.05


def presses(**counts: int) -> tuple[tuple[str, int], ...]:
    return tuple(sorted(counts.items()))


def test_the_estop_button_needs_no_dead_mans_button_and_arming_none_that_is_held() -> None:
    _, base = drive(
        [
            (1.0, HELD),
            (2.0, replace(HELD, presses=presses(east=1))),  # e-stop while driving
            (2.5, replace(HELD, presses=presses(east=1, select=1))),  # reset
            (3.0, replace(HELD, presses=presses(east=1, select=1, start=1))),  # armed, with the thumb still down
            (3.5, replace(FREE, presses=presses(east=1, select=1, start=1))),
            (4.0, replace(HELD, presses=presses(east=1, select=1, start=1))),
        ],
        5.0,
    )
    assert moves(base.at(1.9))
    assert not any(moves(what) for at_ns, what in base.log if 2.1 * S < at_ns < 4.0 * S)
    assert moves(base.at(4.9))


def test_what_was_pressed_before_the_bridge_came_is_history() -> None:
    runtime, _ = drive([(0.0, replace(FREE, presses=presses(east=4, start=2)))], 1.0)
    assert runtime.core.operator.mode is Mode.AUTO


def test_start_disarms_what_is_armed_and_mode_gives_the_robot_back() -> None:
    runtime, _ = drive([(1.0, HELD), (2.0, FREE), (2.5, replace(FREE, presses=presses(mode=1)))], 3.0)
    assert runtime.core.operator.mode is Mode.AUTO
    runtime, _ = drive([(1.0, replace(FREE, presses=presses(start=1)))], 2.0)
    assert runtime.core.operator.mode is Mode.DISARMED


@pytest.mark.parametrize(("key", "button"), [("estop_button", "east"), ("arm_button", "start")])
@pytest.mark.parametrize("mapped", [True, False])
def test_a_button_that_is_null_does_nothing(key: str, button: str, mapped: bool) -> None:
    runtime, _ = drive([(1.0, replace(FREE, presses=presses(**{button: 1})))], 2.0, **({} if mapped else {key: None}))
    assert (runtime.core.operator.mode is Mode.AUTO) is not mapped


def test_without_a_pad_it_says_what_to_add(caplog: pytest.LogCaptureFixture) -> None:
    parts = replace(robot(), bridges=(BridgePart("gamepad_teleop", GamepadTeleop, GamepadTeleopConfig()),))
    run(parts, 0.5)
    assert "no device publishes 'gamepad': add `gamepad: {}` to `devices`" in caplog.text


def test_defaults_are_within_the_operators_lease() -> None:
    assert math.isclose(GamepadTeleopConfig().lease_s, 0.3)
