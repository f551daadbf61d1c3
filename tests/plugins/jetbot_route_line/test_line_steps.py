"""Single steps on made-up looks: what one odd picture may not do, and what the behaviour does meanwhile."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

import pytest

from robotd import Done, Drive, Odometry
from robotd.authoring.behaviour import Failed, StepResult
from robotd.authoring.explain import Line, Points, Scalar, Text
from robotd.testing import check_behaviour
from robotd.world.clock import ns
from robotd_plugins.behaviours.jetbot_route import JetBotRoute, JetBotRouteConfig, Sees
from robotd_plugins.behaviours.jetbot_route.states import State

HZ = 20.0
SPEED_MPS = 0.2


class Walk:
    """Feeds looks at 20 Hz to one behaviour that drives straight along x at what it was told."""

    def __init__(self, look: Callable[..., Any], **config: Any) -> None:
        self.look = look
        self.behaviour = JetBotRoute(JetBotRouteConfig(**config))
        self.number = 0
        self.x_m = self.yaw_rad = 0.0
        self.said: StepResult = None

    def step(self, *args: Any, **how: Any) -> StepResult:
        t_s = self.number / HZ
        self.number += 1
        line = self.look(t_s, *args, **how)
        self.said = self.behaviour.step(
            Sees(line=line, odometry=Odometry(ns(t_s), self.x_m, 0.0, self.yaw_rad), scan=None, now_ns=ns(t_s))
        )
        if isinstance(self.said, Drive):
            self.x_m += self.said.vx_mps / HZ
            self.yaw_rad += self.said.wz_radps / HZ
        return self.said

    def steps(self, count: int, *args: Any, **how: Any) -> list[StepResult]:
        return [self.step(*args, **how) for _ in range(count)]

    @property
    def state(self) -> State:
        return self.behaviour.state


@pytest.fixture
def walk(look: Callable[..., Any]) -> Callable[..., Walk]:
    def make(**config: Any) -> Walk:
        walking = Walk(look, **config)
        walking.steps(5)
        assert walking.state is State.DRIVING_STRAIGHT
        return walking

    return make


def _speeds(said: Iterable[StepResult]) -> list[float]:
    return [command.vx_mps for command in said if isinstance(command, Drive)]


def test_it_stands_until_both_regions_show_a_line(look: Callable[..., Any]) -> None:
    walking = Walk(look)
    assert _speeds(walking.steps(6, far=False)) == [0.0] * 6
    assert _speeds(walking.steps(3)) == [0.0, 0.0, SPEED_MPS]


@pytest.mark.parametrize(("left_m", "sign"), [(0.02, 1.0), (-0.02, -1.0)])
def test_it_turns_towards_the_line(walk: Callable[..., Walk], left_m: float, sign: float) -> None:
    said = walk().step(left_m)
    assert isinstance(said, Drive) and said.wz_radps * sign > 0.1


def test_one_odd_picture_is_no_crossing_and_no_end(walk: Callable[..., Walk]) -> None:
    walking = walk()
    for _ in range(10):
        walking.step(bar_m=0.3)
        walking.steps(4)
        walking.step(end_m=0.25)
        walking.steps(4)
        assert walking.state is State.DRIVING_STRAIGHT


def test_a_crossing_is_passed_straight_and_counted_once(walk: Callable[..., Walk]) -> None:
    walking = walk()
    at_m, states = walking.x_m + 0.4, []
    while walking.x_m < at_m + 0.4:
        ahead_m = at_m - walking.x_m
        seen = 0.14 <= ahead_m <= 0.38
        near_hidden = -0.02 < ahead_m - 0.128 < 0.02
        walking.step(None if near_hidden else 0.0, bar_m=ahead_m if seen else None)
        if states[-1:] != [walking.state]:
            states.append(walking.state)
    assert states == [
        State.DRIVING_STRAIGHT,
        State.APPROACHING_INTERSECTION,
        State.LEAVING_INTERSECTION,
        State.REACQUIRING_LINE,
        State.DRIVING_STRAIGHT,
    ]


def test_on_a_crossing_its_bar_is_not_taken_for_the_line(walk: Callable[..., Walk]) -> None:
    walking = walk()
    walking.steps(4, bar_m=0.3)
    assert walking.state is State.APPROACHING_INTERSECTION
    straight = walking.step()
    # a line that leads off to the side is the bar's arm
    assert isinstance(straight, Drive)
    aside = walking.step(0.2, 0.9)
    assert isinstance(aside, Drive) and abs(aside.wz_radps - straight.wz_radps) < 0.05


def test_a_short_loss_slows_down_and_keeps_the_direction(walk: Callable[..., Walk]) -> None:
    walking = walk()
    said = walking.step(None)
    assert isinstance(said, Drive)
    assert (said.vx_mps, said.wz_radps) == (0.08, pytest.approx(0.0, abs=1e-6))
    assert _speeds(walking.steps(1)) == [SPEED_MPS]
    assert walking.state is State.DRIVING_STRAIGHT


def test_a_long_loss_is_bounded_looks_to_both_sides_and_fails(walk: Callable[..., Walk]) -> None:
    walking = walk()
    walking.steps(3, 0.01)
    lost_at_m, turned = walking.x_m, []
    while isinstance(walking.said, Drive):
        walking.step(None)
        turned.append(walking.yaw_rad)
        assert walking.number < 400
    assert walking.said == Failed("the line was lost and is not to be found on either side")
    assert walking.x_m - lost_at_m <= 0.20 + 0.02
    # first to the side where the line was
    assert max(turned) > 0.6 and min(turned) < -0.6
    assert turned.index(max(turned)) < turned.index(min(turned))


def test_a_line_found_again_is_followed(walk: Callable[..., Walk]) -> None:
    walking = walk()
    while walking.state is State.DRIVING_STRAIGHT:
        walking.step(None)
    assert walking.state is State.REACQUIRING_LINE
    walking.steps(3, 0.02, -0.1)
    assert walking.state is State.DRIVING_STRAIGHT


def test_it_stops_at_the_end_by_odometry(walk: Callable[..., Walk]) -> None:
    walking = walk()
    end_m = walking.x_m + 0.35
    while isinstance(walking.said, Drive):
        ahead_m = end_m - walking.x_m
        # from 0.14 m on nothing of the line is in the picture any more
        walking.step(
            0.0 if ahead_m > 0.14 else None, far=ahead_m > 0.24, end_m=ahead_m if 0.14 < ahead_m < 0.3 else None
        )
        assert walking.number < 400
    assert walking.said == Done("end of the line")
    assert end_m - walking.x_m == pytest.approx(0.03, abs=0.012)


def test_odometry_that_begins_anew_is_no_way_driven(walk: Callable[..., Walk]) -> None:
    walking = walk()
    walking.steps(4, bar_m=0.3)
    walking.x_m -= 5.0
    walking.step(bar_m=0.27)
    assert walking.state is State.APPROACHING_INTERSECTION


def test_it_says_what_it_thinks(walk: Callable[..., Walk]) -> None:
    walking = walk()
    walking.steps(4, 0.01, bar_m=0.3)
    drawn = walking.behaviour.explain()
    assert drawn[0] == Text("state", "APPROACHING_INTERSECTION")
    kinds = {(type(item), item.name) for item in drawn}
    assert {(Line, "line"), (Points, "crossing"), (Scalar, "crossing ahead"), (Scalar, "lateral error")} <= kinds


def test_without_metres_it_steers_by_the_picture(walk: Callable[..., Walk], look: Callable[..., Any]) -> None:
    from dataclasses import replace

    walking = walk()
    seen = look(1.0, 0.0)
    bare = replace(
        seen,
        near=replace(seen.near, x=-0.2, ahead_m=math.nan, left_m=math.nan),
        far=replace(seen.far, x=-0.2, ahead_m=math.nan, left_m=math.nan),
        heading_rad=math.nan,
    )
    said = walking.behaviour.step(Sees(line=bare, odometry=Odometry(ns(1.0), 0.0, 0.0, 0.0), scan=None, now_ns=ns(1.0)))
    assert isinstance(said, Drive) and said.wz_radps > 0.1


def test_keeps_the_contract(look: Callable[..., Any]) -> None:
    def view(number: int) -> Sees:
        t_s = number / HZ
        odometry = Odometry(ns(t_s), 0.01 * number, 0.0, 0.0)
        return Sees(
            line=look(t_s, 0.01 * math.sin(number), bar_m=0.3 if number > 20 else None),
            odometry=odometry,
            scan=None,
            now_ns=ns(t_s),
        )

    check_behaviour(JetBotRoute)
    check_behaviour(JetBotRoute, make_view=view)
