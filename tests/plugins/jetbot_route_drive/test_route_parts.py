"""What the mapped route rests on: belief, cues, course, turns, missions; each pure, by tables and laws."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from robotd.authoring.device import DeviceMisconfigured
from robotd.setup.load import load_config
from robotd.setup.problems import ConfigError
from robotd.testing import open_scan
from robotd_plugins.behaviours.jetbot_route import JetBotRoute, JetBotRouteConfig, JetBotRouteGoal
from robotd_plugins.behaviours.jetbot_route.belief import Belief
from robotd_plugins.behaviours.jetbot_route.course import StraightCourse
from robotd_plugins.behaviours.jetbot_route.lidar_ear import LidarEar
from robotd_plugins.behaviours.jetbot_route.mission import plan
from robotd_plugins.behaviours.jetbot_route.node_cues import Cues, CueWeights, NodeSeen, fuse
from robotd_plugins.behaviours.jetbot_route.turning import Turning, TurnSettings

NAN = math.nan
NEAR_M = 0.1

# ------------------------------------------------------------------------------------------------ belief


def test_a_belief_learns_the_scale_and_narrows_its_window() -> None:
    """Wheels 15 % larger than told: 0.9 m of the map are 0.783 m of the odometer."""
    belief = Belief("1").towards("2", 0.9)
    assert belief.expected_m == 0.9
    first = belief.half_window_m(0.08)
    assert abs(0.9 - 0.783) < first
    belief = belief.arrived(0.783).towards("3", 0.9)
    assert (belief.node, belief.from_m, belief.counted_m) == ("2", 0.783, 0.0)
    assert belief.scale == pytest.approx(1.15, abs=0.03)
    assert belief.expected_m == pytest.approx(2 * 0.783, abs=0.02)
    assert belief.half_window_m(0.08) < 0.6 * first


def test_nodes_that_are_only_counted_leave_the_place_where_it_was_last_seen() -> None:
    belief = Belief("1").towards("2", 0.9).counted().towards("3", 0.9)
    assert (belief.node, belief.from_m, belief.counted_m, belief.expected_m) == ("2", 0.0, 0.9, 1.8)
    assert belief.progress_m(1.0) == pytest.approx(0.1)
    seen = belief.arrived(1.6)
    assert seen.scale == pytest.approx(1.8 / 1.6, abs=0.01)
    assert seen.counted_m == 0.0


@given(st.floats(0.3, 3.0), st.floats(0.0, 5.0), st.floats(0.8, 1.2), st.floats(0.02, 0.2))
def test_a_window_never_reaches_a_neighbouring_node(edge_m: float, counted_m: float, scale: float, std: float) -> None:
    belief = Belief("1", "2", edge_m, 0.0, counted_m, scale, std)
    assert 0.0 < belief.half_window_m(0.08) * scale < max(edge_m / 2.0, 0.09)


# -------------------------------------------------------------------------------------------------- cues


@pytest.mark.parametrize(
    ("cues", "expected"),
    [
        (Cues(0.9, 0.2), None),
        (Cues(0.9, 0.2, bar_m=0.95), NodeSeen(0.95, "bar, distance")),
        (Cues(0.9, 0.2, bar_m=1.05), NodeSeen(1.05, "bar")),
        (Cues(0.9, 0.2, bar_m=1.15), None),
        (Cues(0.9, 0.2, bar_m=0.5), None),
        (Cues(0.9, 0.2, end_m=0.9), NodeSeen(0.9, "end of the line, distance")),
        # the lidar alone never is enough: people's legs are opposite markers
        (Cues(0.9, 0.2, lidar_m=1.05), None),
        (Cues(0.9, 0.2, lidar_m=0.92), NodeSeen(0.92, "lidar, distance")),
        (Cues(0.9, 0.2, bar_m=0.95, lidar_m=0.92), NodeSeen(0.95, "bar, lidar, distance")),
        (Cues(0.9, 0.2, bar_m=0.5, lidar_m=0.92), NodeSeen(0.92, "lidar, distance")),
        # the distance alone is enough where it is well known, or where nothing can be seen
        (Cues(0.9, 0.2, sure=True), NodeSeen(0.9, "distance; nothing of it was seen", seen=False)),
        (Cues(0.9, 0.2, lidar_m=1.05, sure=True), None),
        (Cues(0.9, 0.2, unmarked=True), NodeSeen(0.9, "by distance; the map has nothing to see there", seen=False)),
    ],
)  # fmt: skip
def test_cues_are_weighed(cues: Cues, expected: NodeSeen | None) -> None:
    assert fuse(cues, CueWeights(), NEAR_M) == expected


@pytest.mark.parametrize("key", ["lidar", "distance"])
def test_no_weak_cue_can_be_made_enough_alone(key: str) -> None:
    with pytest.raises(ValidationError):
        CueWeights(**{key: 1.0})


# ------------------------------------------------------------------------------------------------ course


@pytest.mark.parametrize("bend_pm", [-2.5, 0.0, 1.2])
def test_a_straight_road_tells_how_odometry_bends(bend_pm: float) -> None:
    """Wheels unequal by 15 % make odometry turn by 2.5 rad/m; after half a metre that is known to a tenth."""
    rng = np.random.default_rng(1)
    course = StraightCourse()
    course.begin(0.3)
    for step in range(1, 51):
        course.travel(0.01)
        course.see(0.3 + bend_pm * 0.01 * step + float(rng.normal(0.0, 0.02)))
    assert course.bend_pm == pytest.approx(bend_pm, abs=0.25)
    before = course.rad
    course.travel(0.1)
    assert course.rad - before == pytest.approx(0.1 * bend_pm, abs=0.03)
    course.begin(1.0)
    assert course.bend_pm == pytest.approx(bend_pm, abs=0.25), "wheels stay what they are in a turn"


def test_one_odd_look_hardly_moves_the_course() -> None:
    course = StraightCourse()
    course.begin(0.0)
    for _ in range(30):
        course.travel(0.01)
        course.see(0.0)
    course.see(1.5)
    assert abs(course.rad) < 0.1


# ----------------------------------------------------------------------------------------------- turning


def _turn(
    angle_rad: float, line_rad: float | None, wheels: float = 1.0, blind_until: float = 0.7
) -> tuple[bool, float]:
    """Turn until it ends, 20 times a second; the line is in sight within 0.7 rad. Its result and the true angle."""
    turning = Turning(TurnSettings(angle_rad, 0.5, 1.2, 0.52), 5.0)
    true_rad = told_rad = 0.0
    for _ in range(400):
        if line_rad is not None and abs(line_rad - true_rad) <= blind_until:
            turning.look(5.0 + told_rad, line_rad - true_rad)
        command = turning.command(5.0 + told_rad)
        assert command.vx_mps == 0.0 and abs(command.wz_radps) <= 1.2
        if turning.turned is not None:
            return turning.turned, true_rad
        told_rad += command.wz_radps / 20.0
        true_rad += command.wz_radps / 20.0 * wheels
    raise AssertionError("it never ended")


@pytest.mark.parametrize("angle_rad", [math.pi / 2.0, -math.pi / 2.0, math.pi, 0.0])
@pytest.mark.parametrize("wheels", [0.87, 1.0, 1.15])
def test_a_turn_ends_on_the_line_whatever_the_wheels_do(angle_rad: float, wheels: float) -> None:
    turned, true_rad = _turn(angle_rad, angle_rad, wheels)
    assert turned
    assert true_rad == pytest.approx(angle_rad, abs=0.06)


def test_without_a_line_it_looks_beyond_and_before_and_gives_up() -> None:
    turned, true_rad = _turn(math.pi / 2.0, None)
    assert not turned
    assert true_rad == pytest.approx(math.pi / 2.0 - 0.5, abs=0.06)


def test_another_road_is_not_the_new_line() -> None:
    """The old road lies a quarter away from the new one."""
    turned, _ = _turn(math.pi / 2.0, 0.0)
    assert not turned


# -------------------------------------------------------------------------------------- config and goals


def _route(folder: Path, **changed: Any) -> str:
    content: dict[str, Any] = {
        "nodes": {name: {"x": at, "y": 0, "type": "intersection"} for at, name in enumerate("ABC")},
        "edges": {"A": ["B"], "B": ["A", "C"], "C": ["B"]},
        "start_node": "A",
        "end_node": "C",
        **changed,
    }
    file = folder / "route.json"
    file.write_text(json.dumps(content, indent=1))
    return str(file)


def test_a_wrong_map_is_refused_with_its_place(tmp_path: Path) -> None:
    file = _route(tmp_path, end_node="Z")
    with pytest.raises(ValidationError, match=r"route\.json:\d+:\d+: end_node: .*\[goal_unknown\]"):
        JetBotRouteConfig(map=file)


def test_a_map_that_is_not_there_is_told_once_with_what_there_is() -> None:
    with pytest.raises(ConfigError) as refused:
        load_config("jetbot", sim=True, sets=("behaviours.jetbot_route.map=route_14",))
    (problem,) = refused.value.problems
    assert (problem.path, problem.hint) == ("behaviours.jetbot_route.map", "did you mean 'route_13'?")


def test_a_map_that_went_bad_after_the_check_is_refused_at_load(tmp_path: Path) -> None:
    config = JetBotRouteConfig(map=_route(tmp_path))
    _route(tmp_path, end_node="Z")
    with pytest.raises(DeviceMisconfigured, match=r"jetbot_route\.map: .*goal_unknown"):
        JetBotRoute.load(config)


@pytest.mark.parametrize(
    ("goal", "nodes", "refusal"),
    [
        ({}, ("A", "B", "C"), ""),
        ({"start_node": "C", "end_node": "A"}, ("C", "B", "A"), ""),
        ({"start_node": "C"}, ("C",), ""),
        ({"end_node": "Z"}, None, "end_node: the map has no node Z; it has A, B, C"),
        ({"start_node": 7}, None, "start_node: the map has no node 7; it has A, B, C"),
    ],
)
def test_a_goal_says_from_where_to_where(
    tmp_path: Path, goal: dict[str, Any], nodes: tuple[str, ...] | None, refusal: str
) -> None:
    mission = plan(JetBotRouteConfig(map=_route(tmp_path)), JetBotRouteGoal(**goal))
    assert (None if mission.route is None else mission.route.nodes) == nodes
    assert mission.refusal == refusal


def test_shipped_maps_are_found_by_name() -> None:
    mission = plan(JetBotRouteConfig(map="route_13"), JetBotRouteGoal())
    assert mission.route is not None
    assert mission.route.nodes == ("1", "2", "6", "3", "4", "5", "9")


def test_a_robot_without_a_lidar_has_no_word_from_it() -> None:
    corner_m = 0.3 * math.sqrt(0.5)
    scan = open_scan(posts=[(corner_m + 0.02, corner_m, 0.04), (-corner_m + 0.02, -corner_m, 0.04)], stamp_ns=1)
    assert math.isnan(LidarEar(JetBotRouteConfig(lidar=None)).listen(scan, 1.0))
    heard = LidarEar(JetBotRouteConfig())
    assert heard.listen(scan, 1.0) == pytest.approx(1.02, abs=0.01)
    assert math.isnan(heard.listen(scan, 2.0)), "a scan is heard once"
