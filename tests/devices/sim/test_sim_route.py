"""Route maps on the floor: tape where the edges are, the start that the file names, random maps that can be driven."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robotd_devices.sim.map_file import RouteLaying
from robotd_devices.sim.maps import MapError, lay_route, load_map
from robotd_devices.sim.route import random_route, route_from

ELL: dict[str, Any] = {
    "nodes": [
        {"id": 1, "x": 0, "y": 0, "type": "start"},
        {"id": 2, "x": 1, "y": 0, "type": "normal"},
        {"id": 3, "x": 2, "y": 0, "type": "normal"},
        {"id": 4, "x": 1, "y": 1, "type": "end"},
    ],
    "edges": [
        {"source": 1, "target": 2, "label": "E"},
        {"source": 2, "target": 1, "label": "W"},
        {"source": 2, "target": 3, "label": "E"},
        {"source": 2, "target": 4, "label": "S"},
    ],
}


def written(folder: Path, text: str, content: Any) -> str:
    (folder / "route.json").write_text(json.dumps(content))
    (folder / "floor.yaml").write_text(text)
    return str(folder / "floor.yaml")


def test_edges_are_tape_of_the_pitch_and_south_is_down(tmp_path: Path) -> None:
    world = load_map(written(tmp_path, "route: {file: route.json, pitch_m: 0.8, tape_width_m: 0.04}", ELL))
    tapes = sorted(line.points_m.round(9).tolist() for line in world.lines)
    assert tapes == [[[-0.02, 0.0], [1.62, 0.0]], [[0.8, 0.02], [0.8, -0.82]]]
    assert {line.width_m for line in world.lines} == {0.04}
    assert world.start == (0.0, 0.0, 0.0)


def test_a_start_of_the_map_overrules_that_of_the_route(tmp_path: Path) -> None:
    world = load_map(written(tmp_path, "start: {x_m: 0.4}\nroute: {file: route.json, heading: S}", ELL))
    assert world.start == (0.4, 0.0, 0.0)
    assert load_map(written(tmp_path, "route: {file: route.json, heading: S}", ELL)).start[2] == -math.pi / 2.0


@pytest.mark.parametrize(("markers", "nodes"), [("none", 0), ("crossings", 1), ("all", 4)])
def test_markers_stand_north_east_and_south_west_of_nodes(tmp_path: Path, markers: str, nodes: int) -> None:
    world = load_map(written(tmp_path, f"route: {{file: route.json, markers: {markers}}}", ELL))
    assert len(world.circles_m) == 2 * nodes
    if markers == "crossings":
        gaps = world.circles_m[:, :2] - (0.9, 0.0)
        assert np.hypot(*gaps.T) == pytest.approx([0.3, 0.3])
        assert np.degrees(np.arctan2(gaps[:, 1], gaps[:, 0])) == pytest.approx([45.0, -135.0])


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ([], "expected a list `nodes` and a list `edges`"),
        ({"nodes": [{"id": 1, "x": 0}], "edges": []}, r"nodes\[0\]: expected id, x and y"),
        ({"nodes": [ELL["nodes"][0]] * 2, "edges": []}, r"nodes\[1\]: a second node 1"),
        ({**ELL, "edges": [{"source": 1, "target": 9}]}, r"edges\[0\]: expected source and target among the nodes"),
        ({**ELL, "edges": [{"source": 1, "target": 4}]}, r"edges\[0\]: 1 to 4 runs neither"),
        ({**ELL, "edges": [{"source": 1, "target": 1}]}, r"edges\[0\]: 1 to 1 runs neither"),
    ],
)
def test_a_route_that_cannot_be_laid_is_refused_naming_the_entry(tmp_path: Path, content: Any, words: str) -> None:
    with pytest.raises(MapError, match=rf"floor\.yaml: route\.json: {words}"):
        load_map(written(tmp_path, "route: {file: route.json}", content))


def test_a_route_that_is_not_there_is_refused(tmp_path: Path) -> None:
    (tmp_path / "floor.yaml").write_text("route: {file: no.json}")
    with pytest.raises(MapError, match=r"route\.file: no\.json: there is no such file"):
        load_map(str(tmp_path / "floor.yaml"))


def test_the_stock_map_of_the_starter_kit_lies_on_the_floor(data_dir: Path) -> None:
    route = route_from(json.loads((data_dir / "jetbot" / "maps" / "shape_a_starter.json").read_text()))
    assert (len(route.places), len(route.edges), route.start) == (13, 18, "2")
    world = lay_route(route, RouteLaying())
    assert world.start == (0.0, -1.8, 0.0)
    nodes_m = np.array([route.place_m(node, 0.9) for node in route.places])
    assert world.line_distance_m(nodes_m).max() < 1e-9
    length_m = sum(float(np.hypot(*(line.points_m[1] - line.points_m[0]))) - 0.05 for line in world.lines)
    assert length_m == pytest.approx(18 * 0.9)


@pytest.mark.parametrize("size", [(3, 3), (3, 8), (5, 4), (8, 8)])
@pytest.mark.parametrize("seed", range(4))
def test_random_routes_are_whole_various_and_the_same_for_a_seed(size: tuple[int, int], seed: int) -> None:
    content = random_route(seed, *size)
    assert content == random_route(seed, *size)
    assert content != random_route(seed + 100, *size)
    route = route_from(content)
    kinds = set(route.kinds().values())
    assert kinds <= {"straight", "bend", "T", "cross", "stub"}
    assert len(kinds) >= (4 if size == (3, 3) else 5)
    assert route.start is not None
    seen, todo = {route.start}, [route.start]
    while todo:
        new = set(route.exits(todo.pop())) - seen
        seen |= new
        todo += new
    assert seen == set(route.places), "every node can be reached"
    x, y = route.places[route.start]
    assert (x + 1, y) in [route.places[node] for node in route.exits(route.start)], "an exit to the east"
    assert [node["type"] for node in content["nodes"]].count("end") == 1
    for edge in content["edges"]:
        (ax, ay), (bx, by) = route.places[str(edge["source"])], route.places[str(edge["target"])]
        assert edge["label"] == {(1, 0): "E", (-1, 0): "W", (0, 1): "S", (0, -1): "N"}[(bx - ax, by - ay)]


def test_a_grid_too_small_for_a_random_route_is_refused() -> None:
    with pytest.raises(ValueError, match="2 x 5 is too small"):
        random_route(0, 2, 5)
