"""What can be wrong with a map file: a code for each kind of mistake, and a mistake with its place."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

#: What makes a map unusable, by code: what it means. The table of docs/behaviours/route_maps.md is this one.
ERRORS: Mapping[str, str] = MappingProxyType(
    {
        # the text
        "file_unreadable": "the file is not there or may not be read",
        "file_too_large": "the file is larger than 1 MB",
        "file_not_utf8": "the bytes are not UTF-8 text",
        "file_empty": "there is nothing in the file",
        "json_malformed": "the text is not JSON; the place is where reading stopped",
        "json_too_deep": "values are nested deeper than 24 levels",
        "json_duplicate_key": "one object has a key twice",
        "number_not_finite": "NaN, an infinity, or a number that no map needs",
        # the shape
        "shape_unknown": "the file is none of the shapes A to D",
        "nodes_missing": "there is no key `nodes`",
        "edges_missing": "there is no key `edges`",
        "nodes_empty": "the map has no node",
        "edges_empty": "the map has no edge",
        "key_missing": "a node or an edge lacks a key that it needs",
        "type_wrong": "a value has the wrong type: text where a number belongs, a list where an object belongs",
        "count_mismatch": "shape C counts other numbers of nodes or edges than it holds: it was cut off or edited",
        # nodes
        "node_id_type": "an id is neither a whole number nor text",
        "node_id_empty": "an id is an empty text",
        "node_ids_mixed": "some ids are numbers and some are text",
        "node_id_duplicate": "two nodes have one id",
        "node_name_duplicate": "two nodes have one name, so that a code on a card does not tell where it hangs",
        "node_type_unknown": "a type is none of normal, intersection, none, start, end, load",
        "nodes_overlap": "two nodes lie on one point",
        # edges
        "edge_node_unknown": "an edge begins or ends at a node that is not there",
        "edge_id_type": 'an edge writes an id as text and the nodes as numbers ("1" and 1), or the other way round',
        "edge_self_loop": "an edge ends where it begins",
        "edge_duplicate": "one edge is there twice",
        "edge_off_axis": "an edge runs neither North, East, South nor West",
        "edge_label_unknown": "a label is none of N, E, S, W",
        "edge_labels_collide": "two edges leave one node with one label",
        "edge_label_mismatch": "a label disagrees with the coordinates (y grows to the South)",
        "edge_passes_node": "an edge runs through a third node",
        "edge_mirror_missing": "the edge back is missing and the edge is not marked `one_way`",
        "edge_one_way_mirrored": "an edge is marked `one_way` and the edge back is there",
        "edge_mirror_length": "an edge and the edge back differ in `length`",
        "edge_length_invalid": "a `length` is not positive",
        "edge_length_short": "a `length` is shorter than the distance between its nodes",
        # the mission
        "start_missing": "no node is the start",
        "start_several": "more than one node is the start",
        "start_unknown": "the start names a node that is not there",
        "goal_missing": "no node is the end",
        "goal_unknown": "the end names a node that is not there",
        "goal_unreachable": "no road leads from the start to the end",
        "load_unreachable": "a load node cannot be visited between start and end",
    }
)

#: What deserves a look but keeps nobody from driving, by code.
WARNINGS: Mapping[str, str] = MappingProxyType(
    {
        "goal_is_start": "start and end are one node: the goal is reached at once, without moving",
        "start_choice": "`startingPositions` names several starts: whoever starts the robot must say which",
        "goal_choice": "several nodes are the end: the nearest is driven to unless the goal names one",
        "node_isolated": "no edge touches a node",
        "node_unreachable": "no road leads from the start to a node",
        "node_trap": "one-way roads lead to a node from which no end can be reached",
        "edges_cross": "two edges cross where there is no node: the camera will see a crossing that the map denies",
        "edge_id_wrong": 'an edge\'s own id is not "source-target"; the id is not used',
        "dimensions_mismatch": "`dimensions` disagrees with the coordinates; it is not used",
        "key_unknown": "a node or an edge has a key that nothing reads",
    }
)


@dataclass(frozen=True, slots=True)
class MapProblem:
    """One mistake. `path`: where in the data, as `nodes[3].x`; line and column from 1, None where there is no text."""

    code: str
    file: str
    line: int | None
    column: int | None
    path: str
    message: str

    @property
    def is_error(self) -> bool:
        """Whether it makes the map unusable; else it is a warning."""
        return self.code in ERRORS

    def __str__(self) -> str:
        place = self.file if self.line is None else f"{self.file}:{self.line}:{self.column}"
        return f"{place}: {self.path + ': ' if self.path else ''}{self.message} [{self.code}]"


class RouteMapError(ValueError):
    """A map file that cannot be used. Its text has one line for each error, in the order of the file."""

    def __init__(self, problems: Iterable[MapProblem]) -> None:
        self.problems: tuple[MapProblem, ...] = tuple(problems)
        super().__init__("\n".join(str(problem) for problem in self.problems if problem.is_error))

    @property
    def codes(self) -> tuple[str, ...]:
        """The codes of the errors, in the order of the file."""
        return tuple(problem.code for problem in self.problems if problem.is_error)
