"""A JetBot's route map as a floor: its edges as tape, its start as a pose; and random route maps to drive on.

This reads just what can be seen on a floor (node places, edges, start). Whether a route map makes sense is for the
behaviour that drives it; here a map that cannot be laid is refused.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from robotd.world.messages import Float64s

HEADING_RAD = {"E": 0.0, "N": math.pi / 2.0, "W": math.pi, "S": -math.pi / 2.0}

_STEPS = {"N": (0, -1), "E": (1, 0), "S": (0, 1), "W": (-1, 0)}
_OPPOSITE = {"N": "S", "S": "N", "E": "W", "W": "E"}
_KINDS = ("straight", "bend", "T", "cross", "stub")
_TRIES = 400


@dataclass(frozen=True, slots=True)
class Route:
    """places: node id to (x, y) in steps of the grid, y to the south as in the file. edges: each once, by node ids."""

    places: Mapping[str, tuple[float, float]]
    edges: tuple[tuple[str, str], ...]
    start: str | None = None

    def tape_m(self, pitch_m: float, width_m: float) -> list[Float64s]:
        """The middle of each straight stretch of tape, (2, 2) each, map frame (y to the north).

        Edges that go on straight are one tape; each tape is half its width longer at both ends, so that corners and
        crossings are full.
        """
        # by straight line of the grid: whether it runs east, its y or x, and the stretches of it
        lines: dict[tuple[bool, float], list[tuple[float, float]]] = {}
        for a, b in self.edges:
            (ax, ay), (bx, by) = self.places[a], self.places[b]
            runs_east = ay == by
            ends = sorted((ax, bx) if runs_east else (ay, by))
            lines.setdefault((runs_east, ay if runs_east else ax), []).append((ends[0], ends[1]))
        tapes = []
        for (runs_east, across), stretches in sorted(lines.items()):
            for low, high in _joined(stretches):
                along_m = np.array((low * pitch_m - width_m / 2.0, high * pitch_m + width_m / 2.0))
                across_m = np.full(2, across * pitch_m)
                x_m, y_south_m = (along_m, across_m) if runs_east else (across_m, along_m)
                tapes.append(np.stack((x_m, 0.0 - y_south_m), axis=1))
        return tapes

    def place_m(self, node: str, pitch_m: float) -> tuple[float, float]:
        """A node in the map frame."""
        x, y = self.places[node]
        return x * pitch_m, 0.0 - y * pitch_m

    def crossings(self) -> list[str]:
        """Nodes where one can do something else than go straight on."""
        return [node for node in self.places if self._kind(node) not in ("straight", "stub", "lone")]

    def kinds(self) -> dict[str, str]:
        """Each node as `straight`, `bend`, `T`, `cross`, `stub` or `lone`."""
        return {node: self._kind(node) for node in self.places}

    def exits(self, node: str) -> list[str]:
        """The nodes that tape leads to from here."""
        return [b if a == node else a for a, b in self.edges if node in (a, b)]

    def _kind(self, node: str) -> str:
        exits = self.exits(node)
        if len(exits) == 2:
            (ax, ay), (bx, by) = self.places[exits[0]], self.places[exits[1]]
            return "straight" if ax == bx or ay == by else "bend"
        return {0: "lone", 1: "stub", 3: "T", 4: "cross"}[len(exits)]


def _joined(stretches: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Stretches of one line, those that meet or overlap made one."""
    out: list[tuple[float, float]] = []
    for low, high in sorted(stretches):
        if out and low <= out[-1][1]:
            out[-1] = (out[-1][0], max(out[-1][1], high))
        else:
            out.append((low, high))
    return out


def read_route(path: Path) -> Route:
    """The route of a JSON file. Raises ValueError naming what cannot be laid on a floor."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ValueError(f"{path.name}: {error}") from error
    try:
        return route_from(content)
    except ValueError as error:
        raise ValueError(f"{path.name}: {error}") from error


def route_from(content: Any) -> Route:
    """From the starter kit's form: `nodes` of id, x, y, type and `edges` of source and target; also inside `map_data`.

    Raises ValueError naming the entry.
    """
    if isinstance(content, dict) and isinstance(content.get("map_data"), dict):
        content = content["map_data"]
    if not isinstance(content, dict) or not all(isinstance(content.get(key), list) for key in ("nodes", "edges")):
        raise ValueError("expected a list `nodes` and a list `edges`")
    places: dict[str, tuple[float, float]] = {}
    start: str | None = None
    for at, node in enumerate(content["nodes"]):
        try:
            name, place = str(node["id"]), (float(node["x"]), float(node["y"]))
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"nodes[{at}]: expected id, x and y ({error!r})") from error
        if not all(map(math.isfinite, place)) or name in places:
            raise ValueError(f"nodes[{at}]: {'a second node ' + name if name in places else 'x and y must be finite'}")
        places[name] = place
        if start is None and str(node.get("type", "")).lower() == "start":
            start = name
    edges: dict[frozenset[str], tuple[str, str]] = {}
    for at, edge in enumerate(content["edges"]):
        try:
            a, b = str(edge["source"]), str(edge["target"])
            (ax, ay), (bx, by) = places[a], places[b]
        except (KeyError, TypeError) as error:
            raise ValueError(f"edges[{at}]: expected source and target among the nodes ({error!r})") from error
        if (ax == bx) == (ay == by):
            raise ValueError(f"edges[{at}]: {a} to {b} runs neither north-south nor east-west")
        edges.setdefault(frozenset((a, b)), (a, b))
    return Route(places, tuple(edges.values()), start)


def random_route(seed: int, columns: int, rows: int, density: float = 0.35) -> dict[str, Any]:
    """A connected route map on a grid of `columns` x `rows` in the starter kit's form, the same for the same numbers.

    It holds each kind of node (straight, bend, T, cross, stub; 3 x 3 has room for only four of them), leaves some
    places of the grid empty, starts on a node with an exit to the east and ends elsewhere, not next to it. `density`:
    share of edges beyond a tree that are laid. Raises ValueError below 3 x 3.
    """
    if columns < 3 or rows < 3:
        raise ValueError(f"a grid of {columns} x {rows} is too small for a random route: at least 3 x 3")
    rng = np.random.default_rng([seed, columns, rows])
    for _ in range(_TRIES):
        cells = _some_cells(rng, columns, rows)
        joined = _some_edges(rng, cells, density)
        # numbered row by row, as on the stock map
        number = {cell: at + 1 for at, cell in enumerate(sorted(cells, key=lambda cell: (cell[1], cell[0])))}
        edges = [
            {"source": number[a], "target": number[b], "label": label}
            for cell, way in joined
            for a, b, label in (
                (cell, _next(cell, way), way),
                (_next(cell, way), cell, _OPPOSITE[way]),
            )
        ]
        starts = sorted(cell for cell, way in joined if way == "E")
        start = starts[int(rng.integers(len(starts)))]
        others = sorted(cells - {start})
        end = others[int(rng.integers(len(others)))]
        kind = {start: "start", end: "end"}
        nodes = [
            {"id": number[cell], "x": cell[0], "y": cell[1], "type": kind.get(cell, "normal")}
            for cell in sorted(cells, key=lambda cell: number[cell])
        ]
        content = {"nodes": nodes, "edges": edges}
        found = set(route_from(content).kinds().values())
        enough = len(_KINDS) if columns * rows > 9 else len(_KINDS) - 1
        if len(found) >= enough and end not in (_next(start, way) for way in _STEPS):
            return content
    raise RuntimeError(f"no route map with every kind of node in {_TRIES} tries (seed {seed}, density {density})")


def _next(cell: tuple[int, int], way: str) -> tuple[int, int]:
    return cell[0] + _STEPS[way][0], cell[1] + _STEPS[way][1]


def _some_cells(rng: np.random.Generator, columns: int, rows: int) -> set[tuple[int, int]]:
    """The grid without a few of its places."""
    cells = {(x, y) for x in range(columns) for y in range(rows)}
    for _ in range(int(rng.integers(0, max(1, columns * rows // 8) + 1))):
        x, y = int(rng.integers(columns)), int(rng.integers(rows))
        rest = cells - {(x, y)}
        if _is_one_piece(rest):
            cells = rest
    return cells


def _is_one_piece(cells: set[tuple[int, int]]) -> bool:
    todo, seen = [min(cells)], {min(cells)}
    while todo:
        cell = todo.pop()
        for way in _STEPS:
            there = _next(cell, way)
            if there in cells and there not in seen:
                seen.add(there)
                todo.append(there)
    return len(seen) == len(cells)


def _some_edges(
    rng: np.random.Generator, cells: set[tuple[int, int]], density: float
) -> list[tuple[tuple[int, int], str]]:
    """Edges to the east and the south: a random tree over all cells (Kruskal), and some more."""
    every = [(cell, way) for cell in sorted(cells) for way in ("E", "S") if _next(cell, way) in cells]
    root = {cell: cell for cell in cells}

    def find(cell: tuple[int, int]) -> tuple[int, int]:
        while root[cell] != cell:
            cell = root[cell]
        return cell

    kept = []
    for at in rng.permutation(len(every)).tolist():
        cell, way = every[at]
        a, b = find(cell), find(_next(cell, way))
        if a != b:
            root[a] = b
            kept.append((cell, way))
        elif rng.random() < density:
            kept.append((cell, way))
    return sorted(kept)
