"""Judges the draft of a map file and makes the route map of it: every mistake is told, not only the first."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections import defaultdict
from collections.abc import Iterator

from robotd.setup.problems import Path
from robotd_plugins.behaviours.jetbot_route.compass import Compass
from robotd_plugins.behaviours.jetbot_route.route_map import NodeKind, RouteEdge, RouteMap, RouteNode
from robotd_plugins.behaviours.jetbot_route.route_map_problems import ERRORS
from robotd_plugins.behaviours.jetbot_route.route_map_shapes import Draft, DraftEdge, DraftNode, Named, Tell

_CLOSE = 1e-9


def check_draft(draft: Draft, tell: Tell, *, sound: bool = True) -> RouteMap | None:
    """The route map of a draft; None where `tell` heard of an error, or the draft is not `sound`: one was told before.

    What an error has spoiled is not judged again.
    """
    return _Check(draft, tell, 0 if sound else 1).map()


class _Check:
    def __init__(self, draft: Draft, tell: Tell, errors: int) -> None:
        self._draft = draft
        self._tell_on = tell
        self._errors = errors
        self._nodes: dict[str, DraftNode] = {}
        """Nodes by id, the first of each."""
        self._drawn: dict[tuple[str, str], DraftEdge] = {}
        """Edges with known ends, the first of each."""

    def map(self) -> RouteMap | None:
        self._check_nodes()
        self._check_ends()
        self._check_course()
        self._check_mirrors()
        self._check_drawing()
        starts = self._mission("start", NodeKind.START, self._draft.starts)
        goals = self._mission("goal", NodeKind.END, self._draft.goals)
        self._check_dimensions()
        if not self._sound():
            return None
        made = self._make(starts, goals)
        self._check_reach(made)
        return made if self._sound() else None

    def _sound(self) -> bool:
        return self._errors == 0

    def _tell(self, code: str, path: Path, message: str) -> None:
        self._errors += code in ERRORS
        self._tell_on(code, path, message)

    # ------------------------------------------------------------------------------------------- nodes

    def _check_nodes(self) -> None:
        points: dict[tuple[float, float], str] = {}
        names: dict[str, str] = {}
        texts = [node.id_is_text for node in self._draft.nodes]
        odd = next((node for node in self._draft.nodes if node.id and node.id_is_text != texts[0]), None)
        if odd is not None:
            self._tell("node_ids_mixed", (*odd.path, "id"), "write all ids as numbers or all as text")
        for node in self._draft.nodes:
            if node.id is None:
                continue
            if node.id in self._nodes:
                self._tell("node_id_duplicate", (*node.path, "id"), f"there is another node with the id {node.id!r}")
                continue
            self._nodes[node.id] = node
            if node.name is not None and names.setdefault(node.name, node.id) != node.id:
                other = names[node.name]
                self._tell("node_name_duplicate", (*node.path, "name"), f"node {other} is called {node.name!r} too")
            if node.x is None or node.y is None:
                continue
            if points.setdefault((node.x, node.y), node.id) != node.id:
                other = points[node.x, node.y]
                self._tell("nodes_overlap", node.path, f"lies on node {other} at ({node.x:g}, {node.y:g})")

    # ------------------------------------------------------------------------------------------- edges

    def _check_ends(self) -> None:
        """Which nodes the edges join; keeps those that join two known ones."""
        # ids that could not be read are missed by the edges that name them: that is one mistake, not many
        all_read = all(node.id is not None for node in self._draft.nodes) and len(self._draft.nodes) > 0
        kinds = {node.id_is_text for node in self._draft.nodes}
        for edge in self._draft.edges:
            known = True
            ends = (edge.source, edge.target)
            for key, end, is_text in zip(("source", "target"), ends, edge.ends_are_text, strict=True):
                if end is None or end not in self._nodes:
                    known = False
                    if end is not None and all_read:
                        self._tell("edge_node_unknown", self._end(edge, key), f"there is no node {end!r}")
                elif self._draft.shape != "D" and kinds == {not is_text}:
                    as_number = f"write {end} without quotes" if is_text else f'write "{end}" in quotes'
                    self._tell("edge_id_type", (*edge.path, key), f"{as_number}, as the nodes do")
            if edge.source is None or edge.target is None or not known:
                continue
            if edge.own_id is not None and edge.own_id != f"{edge.source}-{edge.target}":
                wanted = f"{edge.source}-{edge.target}"
                self._tell("edge_id_wrong", (*edge.path, "id"), f"is {edge.own_id!r} where {wanted!r} is expected")
            if edge.source == edge.target:
                self._tell("edge_self_loop", edge.path, f"begins and ends at node {edge.source}")
            elif (edge.source, edge.target) in self._drawn:
                self._tell("edge_duplicate", edge.path, f"the edge {edge.source} -> {edge.target} is there already")
            else:
                self._drawn[edge.source, edge.target] = edge

    def _end(self, edge: DraftEdge, key: str) -> Path:
        if self._draft.shape != "D":
            return (*edge.path, key)
        return edge.path[:-1] if key == "source" else edge.path

    def _span(self, source: str, target: str) -> tuple[float, float] | None:
        """dx, dy of an edge in the file's units; None where a coordinate is missing or the nodes overlap."""
        a, b = self._nodes[source], self._nodes[target]
        if a.x is None or a.y is None or b.x is None or b.y is None or (a.x, a.y) == (b.x, b.y):
            return None
        return b.x - a.x, b.y - a.y

    def _check_course(self) -> None:
        """Direction, label and length of each edge."""
        labels: dict[tuple[str, Compass], str] = {}
        for (source, target), edge in self._drawn.items():
            path = (*edge.path, "label")
            collides = False
            if edge.label is not None:
                other = labels.setdefault((source, edge.label), target)
                if collides := other != target:
                    told = f"from node {source} another edge goes {edge.label.name} too, to node {other}"
                    self._tell("edge_labels_collide", path, told)
            span = self._span(source, target)
            if edge.length is not None and edge.length <= 0.0:
                self._tell("edge_length_invalid", (*edge.path, "length"), f"{edge.length:g} is no length")
            if span is None:
                continue
            heading = Compass.of_step(*span)
            if heading is None:
                self._tell("edge_off_axis", edge.path, f"{source} -> {target} runs ({span[0]:g}, {span[1]:g})")
                continue
            if edge.label not in (None, heading) and not collides:
                told = f"node {target} lies {heading.name} of node {source}; y grows to the South"
                self._tell("edge_label_mismatch", path, told)
            drawn = abs(span[0]) + abs(span[1])
            if edge.length is not None and 0.0 < edge.length < drawn - _CLOSE:
                told = f"{edge.length:g} is shorter than the {drawn:g} between the nodes"
                self._tell("edge_length_short", (*edge.path, "length"), told)

    def _length(self, source: str, target: str) -> float:
        edge, span = self._drawn[source, target], self._span(source, target)
        drawn = abs(span[0]) + abs(span[1]) if span is not None else math.nan
        return drawn if edge.length is None else edge.length

    def _check_mirrors(self) -> None:
        for (source, target), edge in self._drawn.items():
            back = self._drawn.get((target, source))
            if back is None:
                if not edge.one_way:
                    told = f'add the edge {target} -> {source}, or mark this one "one_way": true'
                    self._tell("edge_mirror_missing", edge.path, told)
            elif edge.one_way:
                # of two that are both marked, the first tells
                if not back.one_way or edge is next(e for e in self._drawn.values() if e is edge or e is back):
                    told = f"there is an edge {target} -> {source}; take one of the two away"
                    self._tell("edge_one_way_mirrored", (*edge.path, "one_way"), told)
            elif source < target and abs(self._length(source, target) - self._length(target, source)) > _CLOSE:
                told = f"the edges between {source} and {target} differ in length"
                self._tell("edge_mirror_length", edge.path, told)

    # ----------------------------------------------------------------------------------------- drawing

    def _straight(self) -> Iterator[tuple[DraftEdge, float, float, float, bool]]:
        """Each drawn road once: edge, the coordinate it keeps, the two it runs between, whether it runs along x."""
        for (source, target), edge in self._drawn.items():
            span = self._span(source, target)
            if span is None or Compass.of_step(*span) is None or ((target, source) in self._drawn and source > target):
                continue
            a, b = self._nodes[source], self._nodes[target]
            assert a.x is not None and a.y is not None and b.x is not None and b.y is not None
            along_x = span[1] == 0.0
            low, high = sorted((a.x, b.x) if along_x else (a.y, b.y))
            yield edge, a.y if along_x else a.x, low, high, along_x

    def _check_drawing(self) -> None:
        """Nodes on the way of an edge, and edges that cross."""
        on_row, on_column = defaultdict[float, list[float]](list), defaultdict[float, list[float]](list)
        for node in self._nodes.values():
            if node.x is not None and node.y is not None:
                on_row[node.y].append(node.x)
                on_column[node.x].append(node.y)
        for line in (*on_row.values(), *on_column.values()):
            line.sort()
        roads = list(self._straight())
        upright = sorted((at, low, high) for _, at, low, high, along_x in roads if not along_x)
        columns = [at for at, *_ in upright]
        for edge, at, low, high, along_x in roads:
            line = (on_row if along_x else on_column)[at]
            if bisect_left(line, high) > bisect_right(line, low):
                through = line[bisect_right(line, low)]
                where = f"({through:g}, {at:g})" if along_x else f"({at:g}, {through:g})"
                self._tell("edge_passes_node", edge.path, f"runs through the node at {where}; end it there")
            if not along_x:
                continue
            for x, top, bottom in upright[bisect_right(columns, low) : bisect_left(columns, high)]:
                if top < at < bottom and x not in line:
                    self._tell("edges_cross", edge.path, f"crosses another edge at ({x:g}, {at:g}) without a node")

    def _check_dimensions(self) -> None:
        told = self._draft.dimensions
        xs = [node.x for node in self._draft.nodes if node.x is not None]
        ys = [node.y for node in self._draft.nodes if node.y is not None]
        if told is None or not xs or not ys:
            return
        for key, values in (("width", xs), ("height", ys)):
            there = max(values) - min(values)
            # servers count either nodes or the gaps between them
            if isinstance(told.get(key), int | float) and told[key] not in (there, there + 1):
                text = f"{key} {told[key]:g} does not fit coordinates from {min(values):g} to {max(values):g}"
                self._tell("dimensions_mismatch", (*self._draft.dimensions_path, key), text)

    # ----------------------------------------------------------------------------------------- mission

    def _mission(self, what: str, kind: NodeKind, named: list[Named]) -> tuple[str, ...]:
        """Starts or goals: the nodes of that type and, by the rule of the shape, those that are named apart."""
        found = {node.id: (*node.path, "type") for node in self._nodes.values() if node.id and node.kind is kind}
        typed, spoiled = bool(found), False
        for place in named if self._draft.named_rule or not typed else ():
            node = place.id if place.id is not None else self._at(place.point)
            if node is not None and node in self._nodes:
                found.setdefault(node, place.path)
            else:
                spoiled = True
                said = repr(place.id) if place.id is not None else f"at {place.point}"
                self._tell(f"{what}_unknown", place.path, f"there is no node {said}")
        ids = tuple(found)
        if not ids and not spoiled and self._nodes:
            self._tell(f"{what}_missing", (), f"no node is the {what}")
        if len(ids) > 1:
            told = f"node {ids[0]} is {'the start' if what == 'start' else 'an end'} already"
            code = (
                "goal_choice"
                if what == "goal"
                else "start_several"
                if typed or self._draft.named_rule
                else "start_choice"
            )
            self._tell(code, found[ids[1]], told)
        return ids

    def _at(self, point: tuple[float, float] | None) -> str | None:
        return next((node.id for node in self._nodes.values() if (node.x, node.y) == point), None)

    def _check_reach(self, made: RouteMap) -> None:
        """From the first start on; only of maps without errors, else every gap would be told as a road that ends."""
        paths = {node.id: node.path for node in self._draft.nodes if node.id is not None}
        for goal in sorted(set(made.goals) & set(made.starts)):
            self._tell("goal_is_start", paths[goal], f"node {goal} is start and end: nothing is to be driven")
        reached = {start: made.reached_from(start) for start in made.starts}
        to_goal = frozenset[str]().union(*(self._leading_to(made, goal) for goal in made.goals))
        for start, nodes in reached.items():
            if not nodes & set(made.goals):
                goals = ", ".join(made.goals)
                self._tell("goal_unreachable", paths[made.goals[0]], f"no road leads from node {start} to {goals}")
        anywhere = frozenset[str]().union(*reached.values())
        for node in made.nodes:
            path, arms = paths[node.id], made.arms(node.id)
            if not arms and node.id not in (*made.starts, *made.goals) and node.kind is not NodeKind.LOAD:
                self._tell("node_isolated", path, f"no edge touches node {node.id}")
            elif node.kind is NodeKind.LOAD and not (node.id in anywhere and node.id in to_goal):
                self._tell("load_unreachable", path, f"node {node.id} cannot be visited between start and end")
            elif node.id not in anywhere and node.id not in made.goals:
                self._tell("node_unreachable", path, f"no road leads from the start to node {node.id}")
            elif node.id in anywhere and node.id not in to_goal and to_goal & anywhere:
                self._tell("node_trap", path, f"from node {node.id} no end can be reached")

    @staticmethod
    def _leading_to(made: RouteMap, goal: str) -> frozenset[str]:
        turned = (RouteEdge(edge.target, edge.source, edge.heading.opposite) for edge in made.edges)
        return made.reached_from(goal, turned)

    def _make(self, starts: tuple[str, ...], goals: tuple[str, ...]) -> RouteMap:
        nodes, edges = [], []
        for node in self._nodes.values():
            assert node.id is not None and node.x is not None and node.y is not None
            # one word for one thing, whichever way the shape said it
            kind = NodeKind.START if node.id in starts else NodeKind.END if node.id in goals else node.kind
            nodes.append(RouteNode(node.id, node.x, node.y, kind, node.name or ""))
        for (source, target), edge in self._drawn.items():
            span = self._span(source, target)
            heading = Compass.of_step(*span) if span is not None else None
            assert heading is not None
            edges.append(RouteEdge(source, target, heading, self._length(source, target), edge.one_way))
        return RouteMap(tuple(nodes), tuple(edges), starts, goals, self._draft.name, self._draft.extras)
