"""Each kind of wrong map gives exactly its codes, each at its place."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from route_map_shapes import shape_b, shape_c, shape_d, square

from robotd_plugins.behaviours.jetbot_route.route_map_file import (
    MAX_BYTES,
    load_route_map,
    read_route_map,
    read_route_map_file,
)
from robotd_plugins.behaviours.jetbot_route.route_map_problems import ERRORS, WARNINGS, RouteMapError

Spoil = Callable[[dict[str, Any]], object]
PAGE = Path(__file__).resolve().parents[3] / "docs" / "behaviours" / "route_maps.md"


def edge(source: object, target: object, label: str = "E", **more: object) -> dict[str, Any]:
    return {"source": source, "target": target, "label": label, **more}


def node(name: object, x: object, y: object, **more: object) -> dict[str, Any]:
    return {"id": name, "x": x, "y": y, "type": "normal", **more}


def one_way_square(m: dict[str, Any], *kept: int) -> None:
    """Only some edges are left, each of them one-way."""
    m["edges"] = [{**m["edges"][index], "one_way": True} for index in kept]


def goal_is_start(m: dict[str, Any]) -> None:
    m["end_node"] = m["start_node"]


# what is done to the sound square: codes and paths that come of it
SPOILED: list[tuple[str, Spoil, dict[str, str]]] = [
    ("no nodes", lambda m: m.pop("nodes"), {"nodes_missing": ""}),
    ("no edges", lambda m: m.pop("edges"), {"edges_missing": ""}),
    ("neither", lambda m: m.clear(), {"shape_unknown": ""}),
    ("nodes empty", lambda m: m.update(nodes=[], edges=[edge(1, 2)]), {"nodes_empty": "nodes"}),
    ("edges empty", lambda m: m.update(edges=[]), {"edges_empty": "edges"}),
    ("nodes a number", lambda m: m.update(nodes=4), {"type_wrong": "nodes"}),
    ("edges of another shape", lambda m: m.update(edges={}), {"type_wrong": "edges"}),
    ("a node is a list", lambda m: m["nodes"].append([5, 2, 0]), {"type_wrong": "nodes[4]"}),
    ("an edge is text", lambda m: m["edges"].append("1-2"), {"type_wrong": "edges[8]"}),
    ("x is text", lambda m: m["nodes"][1].update(x="1"), {"type_wrong": "nodes[1].x"}),
    ("y is true", lambda m: m["nodes"][1].update(y=True), {"type_wrong": "nodes[1].y"}),
    ("y is null", lambda m: m["nodes"][1].update(y=None), {"type_wrong": "nodes[1].y"}),
    ("a type is a number", lambda m: m["nodes"][1].update(type=1), {"type_wrong": "nodes[1].type"}),
    ("a name is a number", lambda m: m["nodes"][1].update(name=1), {"type_wrong": "nodes[1].name"}),
    ("a label is a number", lambda m: m["edges"][0].update(label=1), {"type_wrong": "edges[0].label"}),
    ("one_way is text", lambda m: m["edges"][0].update(one_way="no"), {"type_wrong": "edges[0].one_way"}),
    ("a target is null", lambda m: m["edges"].append(edge(1, None)), {"type_wrong": "edges[8].target"}),
    ("no id", lambda m: m["nodes"][1].pop("id"), {"key_missing": "nodes[1]"}),
    ("no x", lambda m: m["nodes"][1].pop("x"), {"key_missing": "nodes[1]"}),
    ("no source", lambda m: m["edges"].append({"target": 1, "label": "N"}), {"key_missing": "edges[8]"}),
    ("no label", lambda m: m["edges"][0].pop("label"), {"key_missing": "edges[0]"}),
    ("an id with a fraction", lambda m: m["nodes"][1].update(id=2.5), {"node_id_type": "nodes[1].id"}),
    ("an id is true", lambda m: m["nodes"][1].update(id=True), {"node_id_type": "nodes[1].id"}),
    ("an id is empty", lambda m: m["nodes"][1].update(id=""), {"node_id_empty": "nodes[1].id"}),
    ("one id is text", lambda m: m["nodes"][1].update(id="2"), {"node_ids_mixed": "nodes[1].id"}),
    ("an id twice", lambda m: m["nodes"].append(node(2, 5, 5)), {"node_id_duplicate": "nodes[4].id"}),
    (
        "a name twice",
        lambda m: [m["nodes"][index].update(name="A") for index in (0, 2)],
        {"node_name_duplicate": "nodes[2].name"},
    ),
    ("an unknown type", lambda m: m["nodes"][1].update(type="gate"), {"node_type_unknown": "nodes[1].type"}),
    ("two nodes on one point", lambda m: m["nodes"].append(node(5, 1, 1)), {"nodes_overlap": "nodes[4]"}),
    ("an edge to nowhere", lambda m: m["edges"].append(edge(2, 9)), {"edge_node_unknown": "edges[8].target"}),
    ("an edge from nowhere", lambda m: m["edges"].append(edge(9, 2)), {"edge_node_unknown": "edges[8].source"}),
    ("an edge's id as text", lambda m: m["edges"][0].update(target="2"), {"edge_id_type": "edges[0].target"}),
    ("a loop", lambda m: m["edges"].append(edge(2, 2)), {"edge_self_loop": "edges[8]"}),
    ("an edge twice", lambda m: m["edges"].append(m["edges"][0]), {"edge_duplicate": "edges[8]"}),
    (
        "a diagonal",
        lambda m: m["edges"].extend([edge(1, 3, "N"), edge(3, 1, "S")]),
        {"edge_off_axis": "edges[8]", "edge_off_axis ": "edges[9]"},
    ),
    ("an unknown label", lambda m: m["edges"][0].update(label="Q"), {"edge_label_unknown": "edges[0].label"}),
    ("a label twice", lambda m: m["edges"][6].update(label="E"), {"edge_labels_collide": "edges[6].label"}),
    ("a wrong label", lambda m: m["edges"][2].update(label="N"), {"edge_label_mismatch": "edges[2].label"}),
    (
        "y to the North",
        lambda m: [m["edges"][index].update(label=label) for index, label in zip((6, 7), "NS", strict=True)],
        {"edge_label_mismatch": "edges[6].label", "edge_label_mismatch ": "edges[7].label"},
    ),
    (
        "an edge through a node",
        lambda m: (
            m["nodes"].append(node(5, 2, 0)),
            m["edges"].extend([edge(1, 5, "E", length=2), edge(5, 1, "W", length=2)]),
        ),
        {"edge_passes_node": "edges[8]", "edge_labels_collide": "edges[8].label"},
    ),
    ("no way back", lambda m: m["edges"].pop(1), {"edge_mirror_missing": "edges[0]"}),
    (
        "one-way with a way back",
        lambda m: m["edges"][0].update(one_way=True),
        {"edge_one_way_mirrored": "edges[0].one_way"},
    ),
    (
        "one-way both ways",
        lambda m: [m["edges"][index].update(one_way=True) for index in (0, 1)],
        {"edge_one_way_mirrored": "edges[0].one_way"},
    ),
    ("longer one way", lambda m: m["edges"][0].update(length=2), {"edge_mirror_length": "edges[0]"}),
    (
        "no length",
        lambda m: [m["edges"][index].update(length=0) for index in (0, 1)],
        {"edge_length_invalid": "edges[0].length", "edge_length_invalid ": "edges[1].length"},
    ),
    (
        "shorter than drawn",
        lambda m: [m["edges"][index].update(length=0.5) for index in (0, 1)],
        {"edge_length_short": "edges[0].length", "edge_length_short ": "edges[1].length"},
    ),
    ("no start", lambda m: m["nodes"][0].update(type="normal"), {"start_missing": ""}),
    ("several starts", lambda m: m["nodes"][1].update(type="Start"), {"start_several": "nodes[1].type"}),
    ("no end", lambda m: m["nodes"][3].update(type="normal"), {"goal_missing": ""}),
    ("an end beyond one-way roads", lambda m: one_way_square(m, 0, 2, 5, 7), {"goal_unreachable": "nodes[3]"}),
    (
        "an end on an island",
        lambda m: m.update(edges=m["edges"][:4]),
        {"goal_unreachable": "nodes[3]"},
    ),
    (
        "a load node in a blind one-way",
        lambda m: (m["nodes"].append(node(5, 2, 0, type="Load")), m["edges"].append(edge(2, 5, one_way=True))),
        {"load_unreachable": "nodes[4]"},
    ),
    (
        "several mistakes at once",
        lambda m: (m["nodes"][1].update(type="gate"), m["edges"][0].update(label="Q"), m["edges"].append(edge(7, 7))),
        {
            "node_type_unknown": "nodes[1].type",
            "edge_label_unknown": "edges[0].label",
            "edge_node_unknown": "edges[8].source",
            "edge_node_unknown ": "edges[8].target",
        },
    ),
]


def codes_and_paths(text: str | bytes) -> list[tuple[str, str]]:
    return sorted((problem.code, problem.path) for problem in read_route_map(text).errors)


def expected(rows: dict[str, str]) -> list[tuple[str, str]]:
    return sorted((code.strip(), path) for code, path in rows.items())


@pytest.mark.parametrize(("what", "spoil", "codes"), SPOILED, ids=[row[0] for row in SPOILED])
def test_a_spoiled_map_gives_exactly_its_codes(what: str, spoil: Spoil, codes: dict[str, str]) -> None:
    data = square()
    spoil(data)
    reading = read_route_map(json.dumps(data))
    assert codes_and_paths(json.dumps(data)) == expected(codes)
    assert reading.map is None


OTHER_SHAPES: list[tuple[str, Callable[[], dict[str, Any]], Spoil, dict[str, str]]] = [
    ("C: counts", shape_c, lambda m: m["metadata"].update(nodes_count=12), {"count_mismatch": "metadata.nodes_count"}),
    ("C: no map inside", shape_c, lambda m: m.update(map_data=[]), {"type_wrong": "map_data"}),
    ("C: metadata", shape_c, lambda m: m.update(metadata=1), {"type_wrong": "metadata"}),
    ("C: a path goes through map_data", shape_c, lambda m: m["map_data"]["nodes"][0].update(x="0"),
     {"type_wrong": "map_data.nodes[0].x"}),
    ("D: unknown start", shape_d, lambda m: m.update(start_node="Q"), {"start_unknown": "start_node"}),
    ("D: unknown end", shape_d, lambda m: m.update(end_node="Q"), {"goal_unknown": "end_node"}),
    ("D: no start", shape_d, lambda m: m.pop("start_node"), {"start_missing": ""}),
    ("D: start beside a typed one", shape_d, lambda m: m["nodes"]["5"].update(type="start"),
     {"start_several": "start_node"}),
    ("D: start a list", shape_d, lambda m: m.update(start_node=["1"]),
     {"type_wrong": "start_node", "start_missing": ""}),
    ("D: unknown neighbour", shape_d, lambda m: m["edges"]["1"].append("Q"), {"edge_node_unknown": "edges.1[1]"}),
    ("D: unknown source", shape_d, lambda m: m["edges"].update(Q=["1"]), {"edge_node_unknown": "edges.Q"}),
    ("D: no way back", shape_d, lambda m: m["edges"]["2"].remove("1"), {"edge_mirror_missing": "edges.1[0]"}),
    ("D: neighbours as text", shape_d, lambda m: m["edges"].update({"1": "2"}),
     {"type_wrong": "edges.1", "edge_mirror_missing": "edges.2[0]"}),
    ("D: an empty name", shape_d, lambda m: m["nodes"].update({"": {"x": 9, "y": 9}}), {"node_id_empty": "nodes."}),
    ("B: unknown position", shape_b, lambda m: (m["nodes"][0].update(type="None"), m.update(startingPositions=[99])),
     {"start_unknown": "startingPositions[0]"}),
    ("B: a position of nothing", shape_b, lambda m: m.update(startingPositions=[None]),
     {"type_wrong": "startingPositions[0]"}),
    ("B: positions as text", shape_b, lambda m: m.update(destinationPositions="9"),
     {"type_wrong": "destinationPositions"}),
]  # fmt: skip


@pytest.mark.parametrize(("what", "make", "spoil", "codes"), OTHER_SHAPES, ids=[row[0] for row in OTHER_SHAPES])
def test_the_other_shapes_have_their_own_mistakes(
    what: str, make: Callable[[], dict[str, Any]], spoil: Spoil, codes: dict[str, str]
) -> None:
    data = make()
    spoil(data)
    assert codes_and_paths(json.dumps(data)) == expected(codes)


TEXTS: list[tuple[str, str | bytes, str, int, int]] = [
    ("not closed", '{"nodes": [\n  {"id": 1', "json_malformed", 2, 11),
    ("a comma too many", '{"nodes": [1,\n]}', "json_malformed", 2, 1),
    ("a comma too few", '{"nodes": []\n"edges": []}', "json_malformed", 2, 1),
    ("a key without quotes", '{\n  nodes: []}', "json_malformed", 2, 3),
    ("no colon", '{\n  "nodes" []}', "json_malformed", 2, 11),
    ("text after the end", "{}\n{}", "json_malformed", 2, 1),
    ("a text not closed", '{"nodes": "a\n"}', "json_malformed", 1, 11),
    ("a comment", '{\n // nodes\n}', "json_malformed", 2, 2),
    ("a leading zero", '{"nodes": 01}', "json_malformed", 1, 12),
    ("too deep", "[" * 30, "json_too_deep", 1, 26),
    ("a list at the top", "[1]", "shape_unknown", 1, 1),
    ("blank", " \n\t", "file_empty", 0, 0),
    ("not UTF-8", b'{"nodes": "\xff"}', "file_not_utf8", 0, 0),
    ("too large", b" " * (MAX_BYTES + 1), "file_too_large", 0, 0),
]  # fmt: skip


@pytest.mark.parametrize(("what", "text", "code", "line", "column"), TEXTS, ids=[row[0] for row in TEXTS])
def test_text_that_is_no_map(what: str, text: str | bytes, code: str, line: int, column: int) -> None:
    (problem,) = read_route_map(text).problems
    assert (problem.code, problem.line or 0, problem.column or 0) == (code, line, column)


@pytest.mark.parametrize("number", ["NaN", "-Infinity", "Infinity", "1e999", "1" * 50])
def test_numbers_that_no_map_needs(number: str) -> None:
    text = json.dumps(square(), indent=1).replace('"x": 1', f'"x": {number}', 1)
    (problem,) = read_route_map(text, "my.json").problems
    assert (problem.code, problem.path) == ("number_not_finite", "nodes[1].x")
    at = text[: text.index(number)]
    assert (problem.line, problem.column) == (at.count("\n") + 1, len(at) - at.rfind("\n"))


def test_a_key_twice() -> None:
    text = json.dumps(square()).replace('"x": 1', '"x": 0, "x": 1', 1)
    assert codes_and_paths(text) == [("json_duplicate_key", "nodes[1].x")]


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    (problem,) = read_route_map_file(tmp_path / "none.json").problems
    assert problem.code == "file_unreadable"
    with pytest.raises(RouteMapError, match=r"none\.json"):
        load_route_map(tmp_path / "none.json")


def test_the_error_lists_all_with_file_line_column_path_and_code(tmp_path: Path) -> None:
    data = square()
    data["nodes"][1]["type"] = "gate"
    data["edges"][0]["target"] = 9
    file = tmp_path / "wrong.json"
    file.write_text(json.dumps(data, indent=1))
    with pytest.raises(RouteMapError) as caught:
        load_route_map(file)
    lines = str(caught.value).splitlines()
    assert caught.value.codes == ("node_type_unknown", "edge_node_unknown", "edge_mirror_missing")
    assert re.fullmatch(
        r".*wrong\.json:13:\d+: nodes\[1\]\.type: there is no type 'gate'.* \[node_type_unknown\]", lines[0]
    )


WARNED: list[tuple[str, Callable[[], dict[str, Any]], Spoil, dict[str, str]]] = [
    ("start and end are one", shape_d, goal_is_start, {"goal_is_start": "nodes.1"}),
    ("several starting positions", shape_b,
     lambda m: (m["nodes"][0].update(type="None"), m.update(startingPositions=[2, {"x": 2, "y": 3}])),
     {"start_choice": "startingPositions[1]"}),
    ("several ends", square, lambda m: m["nodes"][2].update(type="end"), {"goal_choice": "nodes[3].type"}),
    ("an isolated node", square, lambda m: m["nodes"].append(node(5, 7, 7)), {"node_isolated": "nodes[4]"}),
    ("an unreachable node", square,
     lambda m: (m["nodes"].append(node(5, 2, 0)), m["edges"].append(edge(5, 2, "W", one_way=True))),
     {"node_unreachable": "nodes[4]"}),
    ("a trap", square,
     lambda m: (m["nodes"].append(node(5, 2, 0)), m["edges"].append(edge(2, 5, one_way=True))),
     {"node_trap": "nodes[4]"}),
    ("edges that cross", square,
     lambda m: (m["nodes"].extend([node(5, 0.5, -1), node(6, 0.5, 2)]),
                m["edges"].extend([edge(5, 6, "S"), edge(6, 5, "N")])),
     {"edges_cross": "edges[0]", "edges_cross ": "edges[4]", "node_unreachable": "nodes[4]",
      "node_unreachable ": "nodes[5]"}),
    ("an edge's own id", shape_b, lambda m: m["edges"][0].update(id="1-9"), {"edge_id_wrong": "edges[0].id"}),
    ("dimensions", shape_b, lambda m: m["dimensions"].update(width=9), {"dimensions_mismatch": "dimensions.width"}),
    ("a key that nothing reads", square, lambda m: m["edges"][0].update(oneWay=True),
     {"key_unknown": "edges[0].oneWay"}),
]  # fmt: skip


@pytest.mark.parametrize(("what", "make", "spoil", "codes"), WARNED, ids=[row[0] for row in WARNED])
def test_warnings_keep_nobody_from_driving(
    what: str, make: Callable[[], dict[str, Any]], spoil: Spoil, codes: dict[str, str]
) -> None:
    data = make()
    spoil(data)
    reading = read_route_map(json.dumps(data))
    assert sorted((problem.code, problem.path) for problem in reading.warnings) == expected(codes)
    assert reading.errors == ()
    assert reading.map is not None


def test_every_code_has_its_row_here_and_in_the_docs() -> None:
    here = {code.strip() for *_, codes in (*SPOILED, *OTHER_SHAPES, *WARNED) for code in codes}
    here |= {code for _, _, code, _, _ in TEXTS} | {"number_not_finite", "json_duplicate_key", "file_unreadable"}
    assert here == {*ERRORS, *WARNINGS}
    section = PAGE.read_text(encoding="utf-8").split("\n## Mistakes\n", 1)[1].split("\n## ", 1)[0]
    told = dict(re.findall(r"^\| `(\w+)` \| (.+?) \|$", section, re.MULTILINE))
    assert told == {**ERRORS, **WARNINGS}
    assert len(ERRORS) >= 30


@settings(deadline=None)
@given(st.recursive(
    st.none() | st.booleans() | st.integers(-3, 20) | st.floats() | st.text(max_size=3),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(
        st.sampled_from(["nodes", "edges", "id", "x", "y", "type", "source", "target", "label", "length", "one_way",
                         "map_data", "metadata", "start_node", "end_node", "startingPositions"]), inner, max_size=5),
    max_leaves=25,
))  # fmt: skip
def test_nothing_is_raised_whatever_the_file_holds(data: object) -> None:
    reading = read_route_map(json.dumps(data))
    assert (reading.map is None) == bool(reading.errors)
    assert {problem.code for problem in reading.problems} <= {*ERRORS, *WARNINGS}


@settings(deadline=None)
@given(at=st.integers(0, 2000), insert=st.sampled_from(list('{}[]",:0-eN \n\\x')), cut=st.integers(0, 3))
def test_nothing_is_raised_whatever_the_text(at: int, insert: str, cut: int) -> None:
    text = json.dumps(square())
    at %= len(text)
    spoiled = text[:at] + insert + text[at + cut :]
    reading = read_route_map(spoiled)
    try:
        json.loads(spoiled)
    except ValueError:
        # whatever the standard library refuses is refused here too
        assert reading.map is None
