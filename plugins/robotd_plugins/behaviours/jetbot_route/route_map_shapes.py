"""From the four shapes of map files to one draft: what the file says, with the place of each node and edge.

The shapes are told apart by content. A: the starter kit, lists of nodes and labelled edges. B: a server's answer, A
with names, mission fields and an id for each edge. C: a cached answer, `map_data` holding B beside `metadata`. D: nodes
by name and an adjacency object, with `start_node` and `end_node`. Missing is None; nothing is judged here beyond types.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from robotd.setup.problems import Path
from robotd_plugins.behaviours.jetbot_route.compass import Compass
from robotd_plugins.behaviours.jetbot_route.route_map import NodeKind

Tell = Callable[[str, Path, str], None]
"""Told of each mistake: its code, its path and what is wrong."""

KINDS = {
    **dict.fromkeys(("", "none", "normal", "intersection"), NodeKind.NORMAL),
    **{kind.value: kind for kind in (NodeKind.START, NodeKind.END, NodeKind.LOAD)},
}
_NODE_KEYS = ("id", "x", "y", "type", "name")
_EDGE_KEYS = ("id", "source", "target", "label", "length", "one_way")
_SERVER_KEYS = ("id", "name", "mapType", "orderIndex", "dimensions", "startingPositions", "destinationPositions")
_POSITION_KEYS = ("node", "nodeId", "node_id", "id")


@dataclass(frozen=True, slots=True)
class DraftNode:
    """A node as the file has it. `id_is_text`: the id was written as text."""

    path: Path
    id: str | None
    id_is_text: bool
    x: float | None
    y: float | None
    kind: NodeKind
    name: str | None


@dataclass(frozen=True, slots=True)
class DraftEdge:
    """An edge as the file has it. `ends_are_text`: for source and target, whether it was written as text."""

    path: Path
    source: str | None
    target: str | None
    ends_are_text: tuple[bool, bool]
    label: Compass | None = None
    length: float | None = None
    one_way: bool = False
    own_id: str | None = None


@dataclass(frozen=True, slots=True)
class Named:
    """A place that the mission names: by id, or by coordinates."""

    path: Path
    id: str | None = None
    point: tuple[float, float] | None = None


@dataclass(slots=True)
class Draft:
    """All that a file says. `starts`, `goals`: named apart from the nodes' own types; `named_rule`: they count beside
    the types (shape D), else only where no node has the type."""

    shape: str
    name: str = ""
    nodes: list[DraftNode] = field(default_factory=list)
    edges: list[DraftEdge] = field(default_factory=list)
    starts: list[Named] = field(default_factory=list)
    goals: list[Named] = field(default_factory=list)
    named_rule: bool = False
    dimensions: Mapping[str, Any] | None = None
    dimensions_path: Path = ()
    extras: dict[str, Any] = field(default_factory=dict)


def read_shape(data: Any, tell: Tell) -> Draft | None:
    """The draft of one file's data; None where it has no known shape. Mistakes of type go to `tell`."""
    return _Shapes(tell).read(data)


class _Shapes:
    def __init__(self, tell: Tell) -> None:
        self._tell = tell

    def read(self, data: Any) -> Draft | None:
        if not isinstance(data, dict):
            self._tell("shape_unknown", (), f"a map is an object with nodes and edges, not {_kind(data)}")
            return None
        if "map_data" in data:
            return self._cached(data)
        return self._map(data, (), "B" if any(key in data for key in _SERVER_KEYS) else "A")

    def _cached(self, data: dict[str, Any]) -> Draft | None:
        path: Path = ("map_data",)
        inner = self._typed(data, (), "map_data", dict)
        draft = None if inner is None else self._map(inner, path, "C")
        if draft is None:
            return None
        metadata = self._typed(data, (), "metadata", dict) if "metadata" in data else None
        for key, there in (("nodes_count", len(draft.nodes)), ("edges_count", len(draft.edges))):
            told = (metadata or {}).get(key, there)
            if told != there or isinstance(told, bool):
                self._tell("count_mismatch", ("metadata", key), f"says {told!r}, and the map has {there}")
        draft.extras |= {key: value for key, value in data.items() if key != "map_data"}
        return draft

    def _map(self, data: dict[str, Any], path: Path, shape: str) -> Draft | None:
        missing = [key for key in ("nodes", "edges") if key not in data]
        if len(missing) == 2:
            self._tell("shape_unknown", path, "has neither nodes nor edges: it is none of the shapes A to D")
            return None
        for key in missing:
            self._tell(f"{key}_missing", path, f"has no {key!r}")
        if missing:
            return None
        nodes, edges = data["nodes"], data["edges"]
        draft = Draft("D" if isinstance(nodes, dict) else shape)
        wanted = dict if draft.shape == "D" else list
        for key, value in (("nodes", nodes), ("edges", edges)):
            if not isinstance(value, wanted):
                as_nodes = ", like the nodes" if key == "edges" else ""
                self._tell("type_wrong", (*path, key), f"must be {_NAMES[wanted]}{as_nodes}, not {_kind(value)}")
                return None
            if not value:
                self._tell(f"{key}_empty", (*path, key), f"the map has no {key}")
        if draft.shape == "D":
            self._by_name(draft, data, path)
        else:
            draft.nodes = [n for i, v in enumerate(nodes) if (n := self._node(v, (*path, "nodes", i))) is not None]
            draft.edges = [e for i, v in enumerate(edges) if (e := self._edge(v, (*path, "edges", i))) is not None]
            draft.starts = self._positions(data, path, "startingPositions")
            draft.goals = self._positions(data, path, "destinationPositions")
        name = data.get("name")
        draft.name = name if isinstance(name, str) else ""
        if isinstance(data.get("dimensions"), dict):
            draft.dimensions, draft.dimensions_path = data["dimensions"], (*path, "dimensions")
        draft.extras = {key: value for key, value in data.items() if key not in ("nodes", "edges")}
        return draft

    # ------------------------------------------------------------------------------------ lists (A, B, C)

    def _node(self, value: Any, path: Path, key: str | None = None) -> DraftNode | None:
        if not isinstance(value, dict):
            self._tell("type_wrong", path, f"a node is an object, not {_kind(value)}")
            return None
        self._unknown(value, path, _NODE_KEYS, "node")
        node = self._id(value, path, "id", "node_id_type") if key is None else key
        if node == "":
            self._tell(
                "node_id_empty", path if key is not None else (*path, "id"), "an id needs at least one character"
            )
        kind = value.get("type")
        if kind is not None and not isinstance(kind, str):
            self._tell("type_wrong", (*path, "type"), f"a type is text, not {_kind(kind)}")
        elif (kind or "").lower() not in KINDS:
            known = ", ".join(filter(None, KINDS))
            self._tell("node_type_unknown", (*path, "type"), f"there is no type {kind!r}; there is {known}")
        name = value.get("name")
        if name is not None and not isinstance(name, str):
            self._tell("type_wrong", (*path, "name"), f"a name is text, not {_kind(name)}")
            name = None
        return DraftNode(
            path,
            node or None,
            key is not None or isinstance(value.get("id"), str),
            self._number(value, path, "x"),
            self._number(value, path, "y"),
            KINDS.get(kind.lower(), NodeKind.NORMAL) if isinstance(kind, str) else NodeKind.NORMAL,
            name or None,
        )

    def _edge(self, value: Any, path: Path, source: str | None = None) -> DraftEdge | None:
        """An edge; one of shape D has its source from outside."""
        if not isinstance(value, dict):
            self._tell("type_wrong", path, f"an edge is an object, not {_kind(value)}")
            return None
        self._unknown(value, path, _EDGE_KEYS, "edge")
        begin = self._id(value, path, "source", "type_wrong") if source is None else source
        end = self._id(value, path, "target", "type_wrong")
        label, one_way, own_id = value.get("label"), value.get("one_way", False), value.get("id")
        if label is None and source is None:
            self._tell("key_missing", path, "has no 'label': one of N, E, S, W")
        elif label is not None and not isinstance(label, str):
            self._tell("type_wrong", (*path, "label"), f"a label is text, not {_kind(label)}")
        elif label is not None and label.upper() not in Compass.__members__:
            self._tell("edge_label_unknown", (*path, "label"), f"there is no label {label!r}; there is N, E, S, W")
        if not isinstance(one_way, bool):
            self._tell("type_wrong", (*path, "one_way"), f"must be true or false, not {_kind(one_way)}")
        return DraftEdge(
            path,
            begin or None,
            end or None,
            (source is not None or isinstance(value.get("source"), str), isinstance(value.get("target"), str)),
            Compass.__members__.get(label.upper()) if isinstance(label, str) else None,
            self._number(value, path, "length") if "length" in value else None,
            one_way is True,
            own_id if isinstance(own_id, str) else None,
        )

    def _positions(self, data: dict[str, Any], path: Path, key: str) -> list[Named]:
        """Places by id, by an object that holds an id, or by an object with x and y."""
        values = data.get(key)
        if values is None:
            return []
        if not isinstance(values, list):
            self._tell("type_wrong", (*path, key), f"must be a list, not {_kind(values)}")
            return []
        named = []
        for index, value in enumerate(values):
            inner = (*path, key, index)
            if isinstance(value, dict) and (held := next((k for k in _POSITION_KEYS if k in value), None)):
                inner, value = (*inner, held), value[held]
            if isinstance(value, dict) and "x" in value and "y" in value:
                x, y = self._number(value, inner, "x"), self._number(value, inner, "y")
                if x is not None and y is not None:
                    named.append(Named(inner, point=(x, y)))
            elif _is_id(value):
                named.append(Named(inner, str(value)))
            else:
                self._tell("type_wrong", inner, f"must be a node's id or its x and y, not {_kind(value)}")
        return named

    # --------------------------------------------------------------------------------------- by name (D)

    def _by_name(self, draft: Draft, data: dict[str, Any], path: Path) -> None:
        draft.named_rule = True
        for key, value in data["nodes"].items():
            node = self._node(value, (*path, "nodes", key), key)
            if node is not None:
                draft.nodes.append(node)
        for source, targets in data["edges"].items():
            inner = (*path, "edges", source)
            if not isinstance(targets, list):
                self._tell("type_wrong", inner, f"must be a list of nodes, not {_kind(targets)}")
                continue
            for index, target in enumerate(targets):
                # beside the bare name, an object can say more of a road than that it is there
                told = target if isinstance(target, dict) else {"target": target}
                edge = self._edge(told, (*inner, index), source)
                if edge is not None:
                    draft.edges.append(edge)
        for key, named in (("start_node", draft.starts), ("end_node", draft.goals)):
            value = data.get(key)
            if _is_id(value):
                named.append(Named((*path, key), str(value)))
            elif value is not None:
                self._tell("type_wrong", (*path, key), f"must be the name of a node, not {_kind(value)}")

    # ------------------------------------------------------------------------------------------- values

    def _id(self, value: dict[str, Any], path: Path, key: str, code: str) -> str | None:
        if key not in value:
            self._tell("key_missing", path, f"has no {key!r}")
        elif _is_id(value[key]):
            return str(value[key])
        else:
            self._tell(code, (*path, key), f"an id is a whole number or text, not {_kind(value[key])}")
        return None

    def _number(self, value: dict[str, Any], path: Path, key: str) -> float | None:
        if key not in value:
            self._tell("key_missing", path, f"has no {key!r}")
            return None
        number = value[key]
        if isinstance(number, bool) or not isinstance(number, int | float):
            self._tell("type_wrong", (*path, key), f"must be a number, not {_kind(number)}")
            return None
        return float(number)

    def _typed(self, value: dict[str, Any], path: Path, key: str, wanted: type) -> Any:
        if isinstance(value[key], wanted):
            return value[key]
        self._tell("type_wrong", (*path, key), f"must be {_NAMES[wanted]}, not {_kind(value[key])}")
        return None

    def _unknown(self, value: dict[str, Any], path: Path, known: Sequence[str], what: str) -> None:
        for key in value:
            if key not in known:
                self._tell(
                    "key_unknown", (*path, key), f"nothing reads {key!r} of {what}s; they have {', '.join(known)}"
                )


_NAMES: dict[type, str] = {
    dict: "an object", list: "a list", str: "text", bool: "true or false", int: "a number", float: "a number",
    type(None): "null",
}  # fmt: skip


def _kind(value: Any) -> str:
    return _NAMES.get(type(value), type(value).__name__)


def _is_id(value: Any) -> bool:
    return isinstance(value, str | int) and not isinstance(value, bool)
