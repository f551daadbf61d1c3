"""Maps of all shapes come out equal; directions, forms of nodes, and the way into metres."""

from __future__ import annotations

import itertools
import json
import math
from dataclasses import FrozenInstanceError
from pathlib import Path

import pytest
from route_map_shapes import ROUTE_13, SHAPES, square

from robotd_plugins.behaviours.jetbot_route.compass import Compass, Turn
from robotd_plugins.behaviours.jetbot_route.route_map import (
    MapScale,
    NodeForm,
    NodeKind,
    RouteEdge,
    RouteMap,
    RouteNode,
    natural,
)
from robotd_plugins.behaviours.jetbot_route.route_map_file import load_route_map, read_route_map, read_route_map_file


@pytest.mark.parametrize("shape", SHAPES)
def test_each_shape_is_told_by_its_content_and_loads_to_the_same_graph(shape: str) -> None:
    reading = read_route_map(json.dumps(SHAPES[shape]()))
    assert (reading.shape, reading.problems) == (shape, ())
    assert reading.map == load_route_map(ROUTE_13)
    assert hash(reading.map) == hash(load_route_map(ROUTE_13))


def test_the_order_in_the_file_does_not_matter() -> None:
    data = SHAPES["A"]()
    data["nodes"].reverse()
    data["edges"].reverse()
    assert read_route_map(json.dumps(data)).map == load_route_map(ROUTE_13)


def test_a_difference_of_one_edge_is_a_difference() -> None:
    data = SHAPES["A"]()
    data["edges"] = [edge for edge in data["edges"] if {edge["source"], edge["target"]} != {2, 6}]
    made = read_route_map(json.dumps(data)).map
    assert made is not None
    assert made != load_route_map(ROUTE_13)


def test_names_and_extras_accompany_the_graph() -> None:
    cached = read_route_map(json.dumps(SHAPES["C"]())).map
    assert cached is not None
    assert cached.name == "R13"
    assert cached.node("13").name == "M"
    assert cached.node_named("M") is cached.node_named("13") is cached.node("13")
    assert cached.node_named("Z") is None
    assert cached.extras["mapType"] == "map_a"
    assert cached.extras["metadata"]["source"] == "api"


def test_the_shipped_map_has_every_form_of_node_and_a_stub_as_its_goal() -> None:
    made = load_route_map(ROUTE_13)
    forms = [made.form(node.id) for node in made.nodes]
    assert len(made.nodes) == 13
    assert {form: forms.count(form) for form in set(forms)} == {
        NodeForm.CROSS: 2, NodeForm.TEE: 6, NodeForm.BEND: 3, NodeForm.STUB: 2,
    }  # fmt: skip
    assert (made.starts, made.goals) == (("1",), ("9",))
    assert made.form("9") is NodeForm.STUB
    assert made.node("9").kind is NodeKind.END


@pytest.mark.parametrize(
    ("file", "nodes", "edges", "start", "goal"),
    [("shape_a_starter.json", 13, 36, "2", "11"), ("shape_d_adjacency.json", 6, 14, "A", "F")],
)
def test_real_maps_load(data_dir: Path, file: str, nodes: int, edges: int, start: str, goal: str) -> None:
    reading = read_route_map_file(data_dir / "jetbot" / "maps" / file)
    assert reading.problems == ()
    assert reading.map is not None
    assert (len(reading.map.nodes), len(reading.map.edges)) == (nodes, edges)
    assert (reading.map.starts, reading.map.goals) == ((start,), (goal,))


def test_the_shipped_map_is_not_the_stock_map(data_dir: Path) -> None:
    assert load_route_map(data_dir / "jetbot" / "maps" / "shape_a_starter.json") != load_route_map(ROUTE_13)


def test_positions_of_a_server_count_where_no_node_has_the_type() -> None:
    data = SHAPES["B"]()
    for node in data["nodes"]:
        node["type"] = "NONE"
    data["startingPositions"], data["destinationPositions"] = [{"nodeId": 1}], [{"x": 4, "y": 0}]
    assert read_route_map(json.dumps(data)).map == load_route_map(ROUTE_13)


def test_one_way_and_longer_roads_in_lists_and_by_name() -> None:
    listed = square()
    listed["edges"][0] |= {"one_way": True, "length": 3}
    del listed["edges"][1]
    named = {
        "nodes": {str(node["id"]): {"x": node["x"], "y": node["y"]} for node in listed["nodes"]},
        "edges": {
            "1": [{"target": "2", "one_way": True, "length": 3}, "4"],
            "2": ["3"],
            "3": ["2", "4"],
            "4": ["3", "1"],
        },
        "start_node": "1",
        "end_node": "4",
    }
    made = read_route_map(json.dumps(listed)).map
    assert made is not None
    assert made == read_route_map(json.dumps(named)).map
    assert made.edge("1", "2") == RouteEdge("1", "2", Compass.E, 3.0, one_way=True)
    assert made.edge("2", "1") is None
    # the tape is there all the same
    assert made.arms("2") == {Compass.W, Compass.S}


def test_a_map_is_frozen() -> None:
    made = load_route_map(ROUTE_13)
    with pytest.raises(FrozenInstanceError):
        made.nodes = ()  # type: ignore[misc]
    with pytest.raises(TypeError):
        made.edges_from("1")[Compass.N] = made.edges[0]  # type: ignore[index]


def test_questions_of_a_map() -> None:
    made = load_route_map(ROUTE_13)
    assert "7" in made
    assert "77" not in made
    assert {turn: edge.target for turn, edge in made.exits("6", Compass.N).items()} == {
        Turn.STRAIGHT: "3", Turn.RIGHT: "7", Turn.TURN_AROUND: "2",
    }  # fmt: skip
    assert made.edge("8", "13") == RouteEdge("8", "13", Compass.S, 2.0)
    with pytest.raises(KeyError, match="it has 1, 2, 3"):
        made.node("77")


@pytest.mark.parametrize(
    ("nodes", "edges", "told"),
    [
        ([("a", 0, 0), ("a", 1, 0)], [], "one id"),
        ([("a", 0, 0)], [("a", "b", Compass.E)], "no such node"),
        ([("a", 0, 0), ("b", 1, 0), ("c", 2, 0)], [("a", "b", Compass.E), ("a", "c", Compass.E)], "two edges to the E"),
    ],
)
def test_a_map_by_hand_that_has_two_answers_is_refused(
    nodes: list[tuple[str, float, float]], edges: list[tuple[str, str, Compass]], told: str
) -> None:
    with pytest.raises(ValueError, match=told):
        RouteMap(tuple(RouteNode(*node) for node in nodes), tuple(RouteEdge(*edge) for edge in edges))


def test_ids_in_natural_order() -> None:
    assert sorted(["10", "2", "B", "A12", "A2", "1", "²"], key=natural) == ["1", "2", "10", "A2", "A12", "B", "²"]


# ---------------------------------------------------------------------------------------------- directions


@pytest.mark.parametrize(
    ("heading", "way", "turn"),
    [
        (Compass.E, Compass.E, Turn.STRAIGHT),
        (Compass.E, Compass.N, Turn.LEFT),
        (Compass.E, Compass.S, Turn.RIGHT),
        (Compass.E, Compass.W, Turn.TURN_AROUND),
        (Compass.N, Compass.W, Turn.LEFT),
        (Compass.W, Compass.N, Turn.RIGHT),
        (Compass.S, Compass.E, Turn.LEFT),
    ],
)
def test_turns(heading: Compass, way: Compass, turn: Turn) -> None:
    assert heading.turn_to(way) is turn


def test_turns_agree_with_angles_in_the_map_frame() -> None:
    for heading, way in itertools.product(Compass, repeat=2):
        turn = heading.turn_to(way)
        assert heading.after(turn) is way
        assert math.remainder(heading.yaw_rad + turn.angle_rad - way.yaw_rad, math.tau) == pytest.approx(0.0, abs=1e-12)


def test_a_way_and_its_yaw_agree_with_the_conversion_of_points() -> None:
    scale = MapScale(0.9, origin_x=2.0, origin_y=3.0)
    for way in Compass:
        x_m, y_m = scale.to_map_m(2.0 + way.step[0], 3.0 + way.step[1])
        assert (x_m, y_m) == pytest.approx((0.9 * math.cos(way.yaw_rad), 0.9 * math.sin(way.yaw_rad)), abs=1e-12)
        assert Compass.of_step(*way.step) is way


@pytest.mark.parametrize(
    ("yaw_deg", "way", "off_deg"), [(10, "E", 10), (-100, "S", -10), (179, "W", -1), (-170, "W", 10)]
)
def test_the_nearest_way_to_a_yaw(yaw_deg: float, way: str, off_deg: float) -> None:
    nearest, off_rad = Compass.of_yaw(math.radians(yaw_deg))
    assert nearest.name == way
    assert math.degrees(off_rad) == pytest.approx(off_deg)


def test_steps_that_are_none() -> None:
    assert [Compass.of_step(*step) for step in ((0, 0), (1, 1), (-1, 2))] == [None, None, None]


def test_metres() -> None:
    made = load_route_map(ROUTE_13)
    scale = MapScale.at(made.node("1"), 0.9)
    assert scale.pose(made.node("9"), Compass.N) == pytest.approx((3.6, 1.8, math.pi / 2))
    assert scale.to_file(*scale.to_map_m(1.25, 7.5)) == pytest.approx((1.25, 7.5))
    tape = scale.tape_m(made)
    assert len(tape) == len(made.edges) // 2
    assert tape[0] == ((0.0, 0.0), pytest.approx((0.9, 0.0)))


@pytest.mark.parametrize("pitch_m", [0.0, -1.0, math.nan, math.inf])
def test_a_pitch_must_be_positive(pitch_m: float) -> None:
    with pytest.raises(ValueError, match="pitch_m"):
        MapScale(pitch_m)
