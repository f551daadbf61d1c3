"""The picture of a robot's state: what it must always say, and how it fits any terminal."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotd.engine.status import BehaviourStatus, DeviceStatus, Status, StreamStatus
from robotd.engine.status_view import (
    MOST_ROWS,
    Scale,
    bar,
    changes,
    fit,
    is_moving,
    render,
    scale_of,
    standing,
    width_of,
)
from robotd.world.kinematics import Ackermann
from robotd.world.messages import Drive, Mode, Steer
from robotd.world.robot import Limits, Robot

ROUTE = BehaviourStatus("jetbot_route", True, "following the line", 80, "drives")
DOCK = BehaviourStatus("dock_approach", False, "", 50, "")
LIDAR = StreamStatus("lidar_scan", "lidar", 10.03, 0.04, 0, 2)
CAMERA = StreamStatus("camera_frame", "camera", 0.0, math.inf, 1234, 0)
OPEN = DeviceStatus("lidar", "open", "")
LOST = DeviceStatus("camera", "lost", "no /dev/video0")


def state(**changed: Any) -> Status:
    whole = Status(
        now_ns=75_000_000_000,
        mode=Mode.AUTO,
        reason="",
        behaviours=(DOCK, ROUTE),
        streams=(LIDAR, CAMERA),
        devices=(OPEN, LOST),
        command=Drive(0.25, -1.0),
        by="jetbot_route",
        limited_by=(),
        tick_late_ms=0.31,
        turns=12,
        virtual=True,
    )
    return dataclasses.replace(whole, **changed)


GOLDEN_DRIVING = """\
robotd  AUTO      simulated 0:01:15  tick 0.3 ms late
driving: jetbot_route
command  vx +0.25 m/s [.......|====...]  turn -1.00 rad/s [...====|.......]
devices  1 of 2 open: lidar
  camera  lost: no /dev/video0
behaviours
> jetbot_route    80  following the line  drives
  dock_approach   50  inactive
streams             rate      age  unseen  faults  from
  lidar_scan     10.0 Hz   0.04 s       0       2  lidar
  camera_frame    0.0 Hz    never    1234       0  camera"""

GOLDEN_STANDING = """\
robotd  DISARMED  0:01:10  tick 0.3 ms late
standing still: disarmed: not armed yet
command  vx +0.00 m/s [.......|.......]  turn +0.00 rad/s [.......|.......]
devices  1 of 1 open: lidar"""

GOLDEN_LOW = """\
robotd  AUTO      simulated 0:01:15  tick 0~
driving: jetbot_route
command  vx +0.25 m/s  turn -1.00 rad/s
devices  1 of 2 open: lidar
  camera  lost: no /dev/video0
behaviours  (+2 more)
streams             rate      age  unseen  ~"""

GOLDEN_HIGHER = """\
robotd  AUTO      simulated 0:01:15  tick 0~
driving: jetbot_route
command  vx +0.25 m/s  turn -1.00 rad/s
devices  1 of 2 open: lidar
  camera  lost: no /dev/video0
behaviours  (+1 more)
> jetbot_route    80  followi~  drives
streams             rate      age  unseen  ~
  lidar_scan     10.0 Hz   0.04 s       0  ~"""


@pytest.mark.parametrize(
    ("status", "width", "height", "since_ns", "golden"),
    [
        (state(), 100, 30, 0, GOLDEN_DRIVING),
        (
            state(
                mode=Mode.DISARMED,
                reason="disarmed: not armed yet",
                command=Drive(),
                by="",
                behaviours=(),
                streams=(),
                devices=(OPEN,),
                virtual=False,
            ),
            100,
            30,
            5_000_000_000,
            GOLDEN_STANDING,
        ),
        (state(), 44, 7, 0, GOLDEN_LOW),
        (state(), 44, 9, 0, GOLDEN_HIGHER),
        (
            state(mode=Mode.ESTOP, reason="e-stop by page", command=Drive()),
            60,
            1,
            0,
            "ESTOP  standing still: e-stop by page",
        ),
    ],
    ids=["driving", "standing", "low and narrow", "narrow", "one line"],
)
def test_golden(status: Status, width: int, height: int, since_ns: int, golden: str) -> None:
    assert "\n".join(render(status, width, height, since_ns=since_ns)) == golden


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"reason": "the lidar is too old", "command": Drive()}, "standing still: the lidar is too old"),
        ({"reason": "", "command": Drive()}, "standing still: jetbot_route asks to stand still"),
        ({"reason": "", "command": Drive(), "by": ""}, "standing still: not open: camera"),
        (
            {"reason": "", "command": Drive(), "by": "", "devices": (OPEN,)},
            "standing still: no behaviour has an opinion",
        ),
        ({"reason": "", "command": Steer(0.0, 0.3), "by": ""}, "standing still: not open: camera"),
        ({"reason": "e-stop by page", "command": Drive(0.1)}, "stopping: e-stop by page"),
        ({"reason": "", "command": Drive(0.0, 0.2)}, "driving: jetbot_route"),
        ({"reason": "", "command": Drive(0.0, 0.0, 0.1), "by": ""}, "driving"),
        ({"reason": "", "command": Steer(0.5, 0.0), "by": "race"}, "driving: race"),
    ],
)
def test_second_line_says_why(changed: dict[str, Any], said: str) -> None:
    assert render(state(**changed), 100, 30)[1] == said


@pytest.mark.parametrize(
    ("changed", "line"),
    [
        ({"limited_by": ("range", "stop zone")}, "limited: range, stop zone"),
        ({"command": Drive(0.1, 0.0, -0.2)}, "vy -0.20 m/s [....===|.......]"),
        ({"command": Steer(0.5, 1.0)}, "speed +0.50 m/s [.......|=======]  steer +1.00 rad [.......|====...]"),
    ],
)
def test_command_line(changed: dict[str, Any], line: str) -> None:
    assert line in render(state(**changed), 120, 30)[2]


@pytest.mark.parametrize(
    ("value", "full", "drawn"),
    [
        (0.0, 1.0, "[....|....]"),
        (1.0, 1.0, "[....|====]"),
        (-0.5, 1.0, "[..==|....]"),
        (0.001, 1.0, "[....|=...]"),
        (2.0, 1.0, "[....|===>]"),
        (-2.0, 1.0, "[<===|....]"),
        (math.nan, 1.0, "[????|????]"),
    ],
)
def test_bar(value: float, full: float, drawn: str) -> None:
    assert bar(value, full, cells=4) == drawn


@pytest.mark.parametrize(
    ("text", "width", "pad", "fitted"),
    [
        ("word", 4, False, "word"),
        ("words", 4, False, "wor~"),
        ("wo", 4, True, "wo  "),
        ("東京駅", 4, False, "東~"),
        ("東京", 4, False, "東京"),
        ("e\u0301te\u0301", 3, False, "e\u0301te\u0301"),
        ("word", 0, True, ""),
    ],
)
def test_fit(text: str, width: int, pad: bool, fitted: str) -> None:
    assert fit(text, width, pad=pad) == fitted


@pytest.mark.parametrize(
    ("robot", "scale"),
    [
        (Robot(limits=Limits(vx_mps=0.4, wz_radps=1.5)), Scale(0.4, 1.5)),
        (Robot(kinematics=Ackermann(0.26, 0.2, 0.42), limits=Limits(vx_mps=3.0)), Scale(3.0, 0.42)),
        (Robot(limits=Limits(vx_mps=0.0, wz_radps=0.0)), Scale(1e-3, 1e-3)),
    ],
)
def test_scale_of(robot: Robot, scale: Scale) -> None:
    assert scale_of(robot) == scale


WORDS = st.text(max_size=60)
NUMBERS = st.floats(-10.0, 10.0)
COMMANDS = st.one_of(st.builds(Drive, NUMBERS, NUMBERS, NUMBERS), st.builds(Steer, NUMBERS, NUMBERS))
STATES = st.builds(
    Status,
    now_ns=st.integers(0, 10**15),
    mode=st.sampled_from(Mode),
    reason=WORDS,
    behaviours=st.lists(
        st.builds(BehaviourStatus, WORDS, st.booleans(), WORDS, st.integers(0, 999), WORDS), max_size=9
    ).map(tuple),
    streams=st.lists(
        st.builds(StreamStatus, WORDS, WORDS, st.floats(0, 1e4), st.floats(0), st.integers(0), st.integers(0)),
        max_size=12,
    ).map(tuple),
    devices=st.lists(
        st.builds(DeviceStatus, WORDS, st.sampled_from(["opening", "open", "lost", "closed"]), WORDS), max_size=9
    ).map(tuple),
    command=COMMANDS,
    by=WORDS,
    limited_by=st.lists(WORDS, max_size=3).map(tuple),
    tick_late_ms=st.floats(0, 1e5),
    turns=st.integers(0),
    virtual=st.booleans(),
)


@given(STATES, st.integers(-1, 200), st.integers(-1, 60))
def test_any_state_fits_any_terminal(status: Status, width: int, height: int) -> None:
    lines = render(status, width, height)
    assert 1 <= len(lines) <= max(1, min(height, MOST_ROWS))
    assert all(width_of(line) <= max(1, width) for line in lines)
    assert not any(char in line for line in lines for char in "\n\x1b")


@given(STATES)
def test_a_robot_that_stands_always_has_a_reason(status: Status) -> None:
    assert is_moving(status) or standing(status)
    assert render(status, 400, 20)[1].startswith(("standing still: ", "stopping: ", "driving"))


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        (None, state(), ["lidar is open", "jetbot_route is active: following the line", "driving: jetbot_route"]),
        (
            None,
            state(zones_off="a bench robot on blocks"),
            [
                "the guard has no zones: a bench robot on blocks",
                "lidar is open",
                "jetbot_route is active: following the line",
                "driving: jetbot_route",
            ],
        ),
        (state(), state(), []),
        (state(), state(now_ns=76_000_000_000, command=Drive(0.3), turns=13), []),
        (state(command=Drive()), state(), ["driving: jetbot_route"]),
        (state(), state(by="dock_approach"), ["driving: dock_approach"]),
        (state(), state(behaviours=(dataclasses.replace(ROUTE, state="crossing"),)), []),
        (
            state(behaviours=()),
            state(behaviours=(dataclasses.replace(ROUTE, state="active"),)),
            ["jetbot_route is active"],
        ),
        (state(), state(devices=(OPEN, dataclasses.replace(LOST, state="open"))), []),
        (
            state(devices=(dataclasses.replace(OPEN, state="opening"),)),
            state(devices=(OPEN,)),
            ["lidar is open"],
        ),
    ],
)
def test_changes(before: Status | None, after: Status, said: list[str]) -> None:
    assert changes(before, after) == said


def test_a_robot_without_zones_always_says_why() -> None:
    lines = render(state(zones_off="on blocks"), 80, 24, scale=Scale())
    assert "no zones: on blocks" in lines
    assert not [line for line in render(state(), 80, 24, scale=Scale()) if "no zones" in line]
