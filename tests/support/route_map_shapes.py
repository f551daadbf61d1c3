"""One map in the four shapes, written from their description; and a small sound map that tests spoil."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

ROUTE_13 = Path(__file__).resolve().parents[2] / "maps" / "route_13.json"


def shape_a() -> dict[str, Any]:
    """The shipped map as the starter kit would write it."""
    data: dict[str, Any] = json.loads(ROUTE_13.read_text())
    return data


def shape_b() -> dict[str, Any]:
    """The same as a server answers: names, capital types, an id for each edge, mission fields."""
    data = shape_a()
    kinds = {"normal": "None", "start": "Start", "end": "End"}
    nodes = [
        {**node, "name": chr(ord("A") + index), "type": kinds[node["type"]]} for index, node in enumerate(data["nodes"])
    ]
    edges = [{"id": f"{edge['source']}-{edge['target']}", **edge} for edge in data["edges"]]
    return {
        "id": "7b0f7a3e-5a55-4d7a-9d4b-0d6d1c1f2b11",
        "name": "R13",
        "mapType": "map_a",
        "orderIndex": 3,
        "dimensions": {"width": 4, "height": 4},
        "nodes": nodes,
        "edges": edges,
        "startingPositions": [],
        "destinationPositions": [],
        "barriersOpen": False,
        "startTime": None,
        "isPublic": True,
    }


def shape_c() -> dict[str, Any]:
    """The same as a cache keeps a server's answer."""
    inner = shape_b()
    counts = {"nodes_count": len(inner["nodes"]), "edges_count": len(inner["edges"])}
    metadata = {"source": "api", "map_type": "map_a", "timestamp": "2025-11-02T09:30:00", **counts}
    return {"metadata": metadata, "map_data": inner}


def shape_d() -> dict[str, Any]:
    """The same by name, with neighbours instead of labelled edges."""
    data = shape_a()
    edges: dict[str, list[str]] = {}
    for edge in data["edges"]:
        edges.setdefault(str(edge["source"]), []).append(str(edge["target"]))
    ends = {node["type"]: str(node["id"]) for node in data["nodes"]}
    nodes = {str(node["id"]): {"x": node["x"], "y": node["y"], "type": "intersection"} for node in data["nodes"]}
    return {"nodes": nodes, "edges": edges, "start_node": ends["start"], "end_node": ends["end"]}


SHAPES = {"A": shape_a, "B": shape_b, "C": shape_c, "D": shape_d}

_SQUARE: dict[str, Any] = {
    "nodes": [
        {"id": 1, "x": 0, "y": 0, "type": "start"},
        {"id": 2, "x": 1, "y": 0, "type": "normal"},
        {"id": 3, "x": 1, "y": 1, "type": "normal"},
        {"id": 4, "x": 0, "y": 1, "type": "end"},
    ],
    "edges": [
        {"source": 1, "target": 2, "label": "E"},
        {"source": 2, "target": 1, "label": "W"},
        {"source": 2, "target": 3, "label": "S"},
        {"source": 3, "target": 2, "label": "N"},
        {"source": 3, "target": 4, "label": "W"},
        {"source": 4, "target": 3, "label": "E"},
        {"source": 1, "target": 4, "label": "S"},
        {"source": 4, "target": 1, "label": "N"},
    ],
}


def square() -> dict[str, Any]:
    """Four nodes around a square: 1 start, 2 East of it, 3 South of that, 4 end, South of 1."""
    return copy.deepcopy(_SQUARE)
