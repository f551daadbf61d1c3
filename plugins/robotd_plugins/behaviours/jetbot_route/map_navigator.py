"""The seed's `MapNavigator`: one object that reads a map and answers where to go next."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from robotd_plugins.behaviours.jetbot_route.compass import Compass, Turn
from robotd_plugins.behaviours.jetbot_route.route_map import RouteMap
from robotd_plugins.behaviours.jetbot_route.route_map_file import load_route_map
from robotd_plugins.behaviours.jetbot_route.route_plan import Ban, NoRoute, PlanCosts, Route, RoutePlanner


class MapNavigator:
    """Questions about one map; it remembers nothing of the robot. Nodes are named by id, as text or as a number."""

    def __init__(self, route_map: RouteMap, *, pitch_m: float = 1.0, costs: PlanCosts | None = None) -> None:
        self.map = route_map
        self._planner = RoutePlanner(route_map, pitch_m=pitch_m, costs=costs)

    @classmethod
    def load(cls, path: str | Path, *, pitch_m: float = 1.0, costs: PlanCosts | None = None) -> MapNavigator:
        """Read a map file of any shape. Raises RouteMapError listing every error in it."""
        return cls(load_route_map(path), pitch_m=pitch_m, costs=costs)

    @property
    def start_node(self) -> str | None:
        """The map's start; None where it names none, or several."""
        return self.map.starts[0] if len(self.map.starts) == 1 else None

    @property
    def end_node(self) -> str | None:
        """The map's end; None where it names none, or several."""
        return self.map.goals[0] if len(self.map.goals) == 1 else None

    def find_path(
        self,
        start: str | int | None = None,
        end: str | int | None = None,
        heading: Compass = Compass.E,
        banned_edges: Iterable[Ban] = (),
    ) -> Route | NoRoute:
        """The cheapest route, over all load nodes where the map has some; without start or end, the map's own.

        Raises KeyError for an unknown node, ValueError where neither is given nor in the map.
        """
        begin = self.start_node if start is None else str(start)
        if begin is None:
            raise ValueError(f"the map has {len(self.map.starts)} starts; say where the robot stands")
        goals = None if end is None else (str(end),)
        return self._planner.plan_visits(begin, heading, self.map.loads, goals, banned_edges)

    def next_node(self, route: Route, current: str | int) -> str | None:
        """The node after the first visit of a node on a route; None at its end. Raises ValueError for a node off it."""
        if str(current) not in route.nodes:
            raise ValueError(f"node {current} is not on the route {' -> '.join(route.nodes)}")
        at = route.nodes.index(str(current))
        return route.nodes[at + 1] if at + 1 < len(route.nodes) else None

    def neighbour(self, node: str | int, direction: Compass) -> str | None:
        """The node that a road leads to in a direction; None where there is no road, or only one towards here."""
        edge = self.map.edges_from(str(node)).get(direction)
        return None if edge is None else edge.target

    def direction(self, node: str | int, neighbour: str | int) -> Compass | None:
        """The direction of the road between two nodes; None where there is none."""
        edge = self.map.edge(str(node), str(neighbour))
        return None if edge is None else edge.heading

    def relative_turn(self, heading: Compass, direction: Compass) -> Turn:
        """The turn of a robot that looks one way and shall drive another."""
        return heading.turn_to(direction)
