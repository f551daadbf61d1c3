"""From a config and a goal to the route that is to be driven, or to a sentence why there is none."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

from robotd_plugins.behaviours.jetbot_route.compass import Compass
from robotd_plugins.behaviours.jetbot_route.config import JetBotRouteConfig, JetBotRouteGoal, map_path
from robotd_plugins.behaviours.jetbot_route.route_map import RouteMap
from robotd_plugins.behaviours.jetbot_route.route_map_file import load_route_map
from robotd_plugins.behaviours.jetbot_route.route_plan import PlanCosts, Route, RoutePlanner


@dataclass(frozen=True, slots=True)
class Mission:
    """What one goal asks for. route: None where there is no way; refusal says why, and is empty otherwise."""

    map: RouteMap
    start: str
    heading: Compass
    route: Route | None
    refusal: str = ""


@lru_cache(maxsize=8)
def planner(file: str, pitch_m: float, costs: PlanCosts) -> RoutePlanner:
    """The planner of a map file, made once. Raises RouteMapError listing every error of the file."""
    return RoutePlanner(load_route_map(map_path(file)), pitch_m=pitch_m, costs=costs)


def plan(config: JetBotRouteConfig, goal: JetBotRouteGoal) -> Mission:
    """The mission of a goal on the config's map, which must name one."""
    assert config.map is not None
    plans = planner(config.map, config.pitch_m, config.costs)
    route_map, heading = plans.map, Compass[goal.heading or config.heading]

    def refused(why: str, start: str = "") -> Mission:
        return Mission(route_map, start, heading, None, why)

    for key, named in (("start_node", goal.start_node), ("end_node", goal.end_node)):
        if named is not None and str(named) not in route_map:
            nodes = ", ".join(node.id for node in route_map.nodes)
            return refused(f"{key}: the map has no node {named}; it has {nodes}")
    if goal.start_node is None and len(route_map.starts) != 1:
        return refused(f"the map has {len(route_map.starts)} starts: the goal's start_node must say where the robot is")
    start = route_map.starts[0] if goal.start_node is None else str(goal.start_node)
    goals = None if goal.end_node is None else (str(goal.end_node),)
    if goals is None and not route_map.goals:
        return refused("the map has no end: the goal's end_node must say where to go", start)
    try:
        found = plans.plan_visits(start, heading, route_map.loads, goals)
    except ValueError as error:
        return refused(str(error), start)
    if isinstance(found, Route):
        return Mission(route_map, start, heading, found)
    return refused(found.reason, start)
