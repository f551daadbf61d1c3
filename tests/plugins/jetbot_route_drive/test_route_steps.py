"""Single steps on a map with made-up looks: the contract, what it says, and what may not count for a node."""

from __future__ import annotations

import logging
import math
from typing import Any

import pytest

from robotd import Drive, LidarScan, Odometry
from robotd.authoring.explain import Path, Scalar, Text
from robotd.testing import check_behaviour, open_scan
from robotd.world.clock import ns
from robotd_plugins.behaviours.jetbot_route import JetBotRoute, JetBotRouteConfig, Sees
from robotd_plugins.behaviours.jetbot_route.route_drive import RouteDrive
from robotd_plugins.behaviours.jetbot_route.states import State
from robotd_plugins.toolkit.line_seen import CrossingBar, LineSeen, RoiLine

HZ = 20.0
CONFIG = JetBotRouteConfig(map="route_13")
"""From node 1 East to node 2, 0.9 m, where the plan turns left."""


def _looked(t_s: float, bar_m: float | None = None) -> LineSeen:
    near, far = RoiLine(0.85, 1.0, 0.0, 0.15, 1.0, 0.128, 0.0), RoiLine(0.6, 0.75, 0.0, 0.1, 1.0, 0.212, 0.0)
    bar = None if bar_m is None else CrossingBar(0.0, 0.6, True, True, True, 1.0, bar_m)
    return LineSeen(ns(t_s), near, far, 0.0, bar)


class Walk:
    """Feeds looks at 20 Hz to one behaviour whose wheels do what it says."""

    def __init__(self, config: JetBotRouteConfig = CONFIG) -> None:
        self.behaviour = JetBotRoute(config)
        self.number = 0
        self.x_m = self.yaw_rad = 0.0
        self.said: Any = Drive()

    @property
    def driver(self) -> RouteDrive:
        assert isinstance(self.behaviour.driver, RouteDrive)
        return self.behaviour.driver

    def step(self, bar_at_m: float | None = None, scan: LidarScan | None = None) -> Any:
        t_s = self.number / HZ
        self.number += 1
        ahead_m = math.nan if bar_at_m is None else bar_at_m - self.x_m
        line = _looked(t_s, ahead_m if 0.14 <= ahead_m <= 0.38 else None)
        odometry = Odometry(ns(t_s), self.x_m, 0.0, self.yaw_rad, self.said.vx_mps, 0.0, self.said.wz_radps)
        self.said = self.behaviour.step(Sees(line=line, odometry=odometry, scan=scan, now_ns=ns(t_s)))
        if isinstance(self.said, Drive):
            self.x_m += self.said.vx_mps / HZ
            self.yaw_rad += self.said.wz_radps / HZ
        return self.said

    def until(self, state: State, bar_at_m: float | None = None) -> None:
        while self.behaviour.state is not state:
            self.step(bar_at_m)
            assert self.number < 600, self.behaviour.state


@pytest.mark.parametrize("bar_at_m", [0.82, 0.9, 0.98])
def test_it_stops_over_the_node_and_only_then_has_reached_it(bar_at_m: float) -> None:
    walk = Walk()
    walk.until(State.APPROACHING_INTERSECTION, bar_at_m)
    assert (walk.driver.belief.node, walk.driver.visited) == ("1", [])
    walk.until(State.HANDLING_EVENT, bar_at_m)
    assert (walk.driver.belief.node, walk.driver.visited) == ("2", ["2"])
    assert walk.said == Drive()
    assert walk.x_m == pytest.approx(bar_at_m, abs=0.02)


def test_a_bar_long_before_the_node_is_told_and_is_none(caplog: pytest.LogCaptureFixture) -> None:
    walk = Walk()
    with caplog.at_level(logging.INFO, "robotd.jetbot_route"):
        walk.until(State.DRIVING_STRAIGHT)
        while walk.x_m < 0.5:
            walk.step(0.45)
            assert walk.behaviour.state is State.DRIVING_STRAIGHT
    told = [record.message for record in caplog.records if record.message.startswith("cues disagree")]
    assert told == ["cues disagree: a crossing seen 0.45 m after node 1; the map has node 2 after 0.90 m"]


def test_opposite_legs_beside_the_road_do_not_stop_it() -> None:
    """The seed stopped at once when the lidar saw two markers."""
    legs = [(0.212, 0.212, 0.05), (-0.212, -0.212, 0.05)]
    walk = Walk()
    walk.until(State.DRIVING_STRAIGHT)
    while walk.x_m < 0.6:
        walk.step(scan=open_scan(posts=legs, stamp_ns=walk.number))
        assert walk.behaviour.state in (State.DRIVING_STRAIGHT, State.LEAVING_INTERSECTION, State.REACQUIRING_LINE)
        assert walk.said.vx_mps > 0.0


def test_markers_at_the_right_distance_are_enough_where_no_bar_is_seen() -> None:
    markers = [(0.212, 0.212, 0.05), (-0.212, -0.212, 0.05)]
    walk = Walk()
    walk.until(State.DRIVING_STRAIGHT)
    while walk.x_m < 0.88:
        walk.step()
    walk.step(scan=open_scan(posts=markers, stamp_ns=walk.number))
    walk.until(State.HANDLING_EVENT)
    assert walk.driver.visited == ["2"]
    assert "lidar, distance" in walk.driver.reason


def test_it_says_where_it_is_and_draws_the_way_that_is_left() -> None:
    walk = Walk()
    walk.until(State.APPROACHING_INTERSECTION, 0.9)
    drawn = {(type(item), item.name): item for item in walk.behaviour.explain()}
    for name, text in (
        ("state", "APPROACHING_INTERSECTION"),
        ("node", "1"),
        ("next node", "2"),
        ("action", "straight"),
    ):
        assert drawn[Text, name] == Text(name, text)
    progress, way = drawn[Scalar, "progress"], drawn[Path, "route"]
    assert isinstance(progress, Scalar) and isinstance(way, Path)
    assert progress.value == pytest.approx(walk.x_m, abs=0.02)
    # node 1 is behind, node 2 ahead, then up to node 3 and on to 4, 5 and 9
    left_m = 0.9 - progress.value
    expected = [(left_m - 0.9, 0.0), (left_m, 0.0), (left_m, 0.9), (left_m, 1.8)]
    assert [p for point in way.xy_m[:4] for p in point] == pytest.approx([p for q in expected for p in q], abs=0.02)
    assert len(way.xy_m) == 7


def test_keeps_the_contract() -> None:
    def view(number: int) -> Sees:
        t_s, x_m = number / HZ, max(0.0, 0.01 * (number - 20))
        scan = open_scan(posts=[(0.2, 0.2, 0.05)], stamp_ns=ns(t_s)) if number % 2 else None
        line = _looked(t_s, 0.9 - x_m if 0.14 < 0.9 - x_m < 0.38 else None)
        return Sees(line=line, odometry=Odometry(ns(t_s), x_m, 0.0, 0.0, 0.2), scan=scan, now_ns=ns(t_s))

    check_behaviour(JetBotRoute, CONFIG)
    check_behaviour(JetBotRoute, CONFIG, make_view=view, steps=160)
