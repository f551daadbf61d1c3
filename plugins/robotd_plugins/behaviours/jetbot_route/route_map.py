"""The roads of a route: nodes, directed edges between them, starts and goals, whatever the file looked like."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from types import MappingProxyType
from typing import Any

from robotd_plugins.behaviours.jetbot_route.compass import Compass, Turn


class NodeKind(Enum):
    """What a node is to the mission. LOAD nodes are visited before the goal."""

    NORMAL = "normal"
    START = "start"
    END = "end"
    LOAD = "load"


class NodeForm(Enum):
    """How the tape looks at a node: the number of arms, and for two of them whether they lie in one line."""

    ISLAND = "island"
    STUB = "stub"
    PASSAGE = "passage"
    BEND = "bend"
    TEE = "tee"
    CROSS = "cross"


@dataclass(frozen=True, slots=True)
class RouteNode:
    """A place. `x`, `y`: in the file's units, x to the East and y to the South. `name`: for people, else the id."""

    id: str
    x: float
    y: float
    kind: NodeKind = NodeKind.NORMAL
    name: str = field(default="", compare=False)

    def __post_init__(self) -> None:
        if not self.name:
            object.__setattr__(self, "name", self.id)


@dataclass(frozen=True, slots=True)
class RouteEdge:
    """A road that may be driven from `source` to `target`.

    length: in the file's units, at least the drawn distance. one_way: there is no edge back.
    """

    source: str
    target: str
    heading: Compass
    length: float = 1.0
    one_way: bool = False

    @property
    def key(self) -> tuple[str, str]:
        """What a ban names."""
        return self.source, self.target


@dataclass(frozen=True, slots=True)
class RouteMap:
    """A graph of roads. Two maps are equal when their nodes, edges, starts and goals are; names and extras only
    accompany them.

    Nodes and edges are kept in the natural order of their ids, so that equal maps are planned equally. Whoever builds
    one by hand answers for it; `load_route_map` checks files. Raises ValueError for an unknown end of an edge, or an
    id or a direction that is there twice, because then no question below has one answer.
    """

    nodes: tuple[RouteNode, ...]
    edges: tuple[RouteEdge, ...]
    starts: tuple[str, ...] = ()
    goals: tuple[str, ...] = ()
    name: str = field(default="", compare=False)
    extras: Mapping[str, Any] = field(default_factory=dict, compare=False, hash=False, repr=False)
    _nodes: Mapping[str, RouteNode] = field(init=False, compare=False, repr=False)
    _out: Mapping[str, Mapping[Compass, RouteEdge]] = field(init=False, compare=False, repr=False)
    _arms: Mapping[str, frozenset[Compass]] = field(init=False, compare=False, repr=False)

    def __post_init__(self) -> None:
        nodes = tuple(sorted(self.nodes, key=lambda node: natural(node.id)))
        edges = tuple(sorted(self.edges, key=lambda edge: (natural(edge.source), natural(edge.target))))
        by_id = {node.id: node for node in nodes}
        if len(by_id) < len(nodes):
            raise ValueError("two nodes have one id")
        out: dict[str, dict[Compass, RouteEdge]] = {node.id: {} for node in nodes}
        arms: dict[str, set[Compass]] = {node.id: set() for node in nodes}
        for edge in edges:
            if edge.source not in by_id or edge.target not in by_id:
                raise ValueError(f"edge {edge.source} -> {edge.target}: there is no such node")
            if edge.heading in out[edge.source]:
                raise ValueError(f"node {edge.source} has two edges to the {edge.heading.name}")
            out[edge.source][edge.heading] = edge
            arms[edge.source].add(edge.heading)
            arms[edge.target].add(edge.heading.opposite)
        for name, value in (
            ("nodes", nodes),
            ("edges", edges),
            ("starts", tuple(sorted(self.starts, key=natural))),
            ("goals", tuple(sorted(self.goals, key=natural))),
            ("extras", MappingProxyType(dict(self.extras))),
            ("_nodes", MappingProxyType(by_id)),
            (
                "_out",
                MappingProxyType({key: MappingProxyType(dict(sorted(ways.items()))) for key, ways in out.items()}),
            ),
            ("_arms", MappingProxyType({key: frozenset(ways) for key, ways in arms.items()})),
        ):
            object.__setattr__(self, name, value)

    def __contains__(self, node: object) -> bool:
        return node in self._nodes

    @property
    def loads(self) -> tuple[str, ...]:
        """Nodes that are to be visited before the goal."""
        return tuple(node.id for node in self.nodes if node.kind is NodeKind.LOAD)

    def node(self, node: str) -> RouteNode:
        """A node by id. Raises KeyError naming what there is."""
        try:
            return self._nodes[node]
        except KeyError:
            raise KeyError(f"the map has no node {node!r}; it has {', '.join(self._nodes)}") from None

    def node_named(self, name: str) -> RouteNode | None:
        """A node by id, else by name, as codes on cards and operators write it; None where there is none."""
        return self._nodes.get(name) or next((node for node in self.nodes if node.name == name), None)

    def edges_from(self, node: str) -> Mapping[Compass, RouteEdge]:
        """The roads that may be driven away from a node, by direction."""
        return self._out[self.node(node).id]

    def edge(self, source: str, target: str) -> RouteEdge | None:
        """The road from one node to another; None where none may be driven."""
        return next((edge for edge in self.edges_from(source).values() if edge.target == target), None)

    def exits(self, node: str, heading: Compass) -> Mapping[Turn, RouteEdge]:
        """The roads that may be driven away from a node, by the turn of a robot that stands there and looks so."""
        return {heading.turn_to(way): edge for way, edge in self.edges_from(node).items()}

    def arms(self, node: str) -> frozenset[Compass]:
        """Directions in which tape leads away from a node, also tape that may only be driven towards it."""
        return self._arms[self.node(node).id]

    def form(self, node: str) -> NodeForm:
        """How the tape looks at a node, so that a camera's find can be held against it."""
        arms = self.arms(node)
        if len(arms) == 2:
            first, second = arms
            return NodeForm.PASSAGE if first.opposite is second else NodeForm.BEND
        return (NodeForm.ISLAND, NodeForm.STUB, NodeForm.BEND, NodeForm.TEE, NodeForm.CROSS)[len(arms)]

    def reached_from(self, node: str, edges: Iterable[RouteEdge] | None = None) -> frozenset[str]:
        """Every node that can be driven to from a node, itself included; by the given edges, else by all."""
        out: dict[str, list[str]] = {}
        for edge in self.edges if edges is None else edges:
            out.setdefault(edge.source, []).append(edge.target)
        reached, todo = {node}, [node]
        while todo:
            for target in out.get(todo.pop(), ()):
                if target not in reached:
                    reached.add(target)
                    todo.append(target)
        return frozenset(reached)


@dataclass(frozen=True, slots=True)
class MapScale:
    """Where a route map lies in robotd's map frame (REP-103: x to the East, y to the North, metres).

    pitch_m: metres of one unit of the file. origin_x, origin_y: the point of the file, in its own units, at which the
    map frame has its origin. Raises ValueError for a pitch that is not positive.
    """

    pitch_m: float
    origin_x: float = 0.0
    origin_y: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 < self.pitch_m < float("inf"):
            raise ValueError(f"pitch_m must be a positive number of metres, not {self.pitch_m}")

    @classmethod
    def at(cls, node: RouteNode, pitch_m: float) -> MapScale:
        """The map frame with its origin at a node, the start for example."""
        return cls(pitch_m, node.x, node.y)

    def to_map_m(self, x: float, y: float) -> tuple[float, float]:
        """A point of the file in the map frame."""
        return (x - self.origin_x) * self.pitch_m, (self.origin_y - y) * self.pitch_m

    def to_file(self, x_m: float, y_m: float) -> tuple[float, float]:
        """A point of the map frame in the file's units."""
        return self.origin_x + x_m / self.pitch_m, self.origin_y - y_m / self.pitch_m

    def pose(self, node: RouteNode, heading: Compass) -> tuple[float, float, float]:
        """x_m, y_m, yaw_rad in the map frame of a base that stands on a node and looks a way."""
        return *self.to_map_m(node.x, node.y), heading.yaw_rad

    def tape_m(self, route_map: RouteMap) -> list[tuple[tuple[float, float], tuple[float, float]]]:
        """The roads as straight pieces of tape in the map frame, each once, whichever ways it may be driven."""
        roads = {tuple(sorted(edge.key, key=natural)) for edge in route_map.edges}
        ends = [(route_map.node(a), route_map.node(b)) for a, b in sorted(roads, key=lambda r: tuple(map(natural, r)))]
        return [(self.to_map_m(a.x, a.y), self.to_map_m(b.x, b.y)) for a, b in ends]


def natural(text: str) -> tuple[tuple[int, int | str], ...]:
    """A key that sorts texts as people do: node 2 before node 10."""
    parts = re.split(r"([0-9]+)", text)
    return tuple((0, int(part)) if part.isdecimal() and part.isascii() else (1, part) for part in parts if part)
