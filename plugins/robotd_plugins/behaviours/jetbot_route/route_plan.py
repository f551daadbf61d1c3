"""The cheapest way over a route map, with turns counted: A* over (node, heading), bans, nodes to visit."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from pydantic import Field

from robotd import Config
from robotd_plugins.behaviours.jetbot_route.compass import Compass, Turn
from robotd_plugins.behaviours.jetbot_route.route_map import RouteMap

Ban: TypeAlias = tuple[str, str]
"""A road that may not be driven, as (source, target); the way back is another road."""

_SINK = 4
_STATES = 5
"""A node has a state for each heading, and one for `there, whatever the heading`."""


class PlanCosts(Config):
    """What a turn costs, in metres that could be driven instead. Going straight on costs nothing but its length."""

    left_m: float = Field(default=0.25, ge=0.0)
    """A quarter to the left."""
    right_m: float = Field(default=0.25, ge=0.0)
    """A quarter to the right."""
    turn_around_m: float | None = Field(default=1.5, ge=0.0)
    """Turning around on a node; null forbids it."""

    def of(self, turn: Turn) -> float:
        """Cost of a turn; inf where it is forbidden."""
        if turn is Turn.TURN_AROUND:
            return math.inf if self.turn_around_m is None else self.turn_around_m
        return {Turn.STRAIGHT: 0.0, Turn.LEFT: self.left_m, Turn.RIGHT: self.right_m}[turn]


@dataclass(frozen=True, slots=True)
class Route:
    """A way to drive. `actions[i]` is done at `nodes[i]` and leads along `headings[i]` to `nodes[i + 1]`.

    cost_m: length_m and the costs of turns. bans: what was forbidden when it was planned. visits: the nodes that were
    to be visited, in the order in which the route visits them.
    """

    nodes: tuple[str, ...]
    headings: tuple[Compass, ...]
    actions: tuple[Turn, ...]
    cost_m: float
    length_m: float
    bans: frozenset[Ban] = frozenset()
    visits: tuple[str, ...] = ()

    @property
    def goal(self) -> str:
        """Where it ends."""
        return self.nodes[-1]

    @property
    def is_there(self) -> bool:
        """Whether nothing is to be driven: the robot stands on the goal."""
        return len(self.nodes) == 1

    @property
    def why(self) -> str:
        """What makes its cost, as a sentence for people."""
        if self.is_there:
            return f"node {self.goal} is where the robot stands"
        counts = [(self.actions.count(turn), turn) for turn in (Turn.LEFT, Turn.RIGHT, Turn.TURN_AROUND)]
        turns = ", ".join(f"{n} x {turn.value.replace('_', ' ')}" for n, turn in counts if n) or "no turn"
        text = f"{' -> '.join(self.nodes)}: {self.length_m:.4g} m and {turns}, together {self.cost_m:.4g} m"
        text += f"; visits {', '.join(self.visits)}" if self.visits else ""
        return text + (f"; avoids {_roads(self.bans)}" if self.bans else "")


@dataclass(frozen=True, slots=True)
class NoRoute:
    """There is no way, and what would make one.

    without_bans: the route if nothing were banned. by_turning_around: the route, bans kept, if turning around were
    allowed (None where it is, or where that does not help).
    """

    reason: str
    bans: frozenset[Ban] = frozenset()
    without_bans: Route | None = None
    by_turning_around: Route | None = None

    @property
    def bans_in_the_way(self) -> tuple[Ban, ...]:
        """The bans that `without_bans` would break, in driving order."""
        return () if self.without_bans is None else broken(self.without_bans, self.bans)


def broken(route: Route, bans: Iterable[Ban]) -> tuple[Ban, ...]:
    """The bans that a route breaks, in driving order."""
    forbidden = frozenset(bans)
    return tuple(road for road in itertools.pairwise(route.nodes) if road in forbidden)


class RoutePlanner:
    """Plans on one map. Building it imports networkx and lays out the state graph once; it never changes afterwards.

    pitch_m: metres of one unit of the map's lengths.

    The heuristic is what is left in a world without obstacles: the Manhattan distance, and the least cost of turns that
    let the robot go each way that it still must. Each part is the exact cost of a relaxed problem (roads are never
    shorter than drawn, and every way must be faced once), so their sum is consistent and A* finds the least cost.
    """

    def __init__(self, route_map: RouteMap, *, pitch_m: float = 1.0, costs: PlanCosts | None = None) -> None:
        import networkx

        if not 0.0 < pitch_m < math.inf:
            raise ValueError(f"pitch_m must be a positive number of metres, not {pitch_m}")
        self.map, self.pitch_m, self.costs = route_map, pitch_m, costs or PlanCosts()
        self._nx = networkx
        self._at = {node.id: index for index, node in enumerate(route_map.nodes)}
        self._xy_m = [(node.x * pitch_m, node.y * pitch_m) for node in route_map.nodes]
        self._turns_left = _least_turns(self.costs)
        self._graph = networkx.DiGraph()
        for index, node in enumerate(route_map.nodes):
            for heading in Compass:
                state = index * _STATES + heading
                self._graph.add_edge(state, index * _STATES + _SINK, m=0.0, road=None)
                for way, edge in route_map.edges_from(node.id).items():
                    cost_m = edge.length * pitch_m + self.costs.of(heading.turn_to(way))
                    if cost_m < math.inf:
                        after = self._at[edge.target] * _STATES + way
                        self._graph.add_edge(state, after, m=cost_m, road=edge.key)

    def plan(
        self, start: str, heading: Compass, goals: str | Iterable[str] | None = None, bans: Iterable[Ban] = ()
    ) -> Route | NoRoute:
        """The cheapest route from a node, looking a way, to the nearest of the goals (the map's own unless given).

        Raises KeyError for an unknown node, ValueError where there is no goal.
        """
        wanted = self._goals(goals)
        forbidden = frozenset(bans)
        best: Route | None = None
        for goal in wanted:
            states = self._search(self._state(start, heading), self._at[goal] * _STATES + _SINK, forbidden)
            if states is not None:
                route = self._route(states[:-1], forbidden)
                best = route if best is None or route.cost_m < best.cost_m else best
        if best is not None:
            return best
        named = " or ".join(wanted)
        told = f"no way leads from node {start}, heading {heading.name}, to {named}"
        return self._explained(told, forbidden, lambda planner, bans: planner.plan(start, heading, wanted, bans))

    def plan_visits(
        self,
        start: str,
        heading: Compass,
        visits: Sequence[str],
        goals: str | Iterable[str] | None = None,
        bans: Iterable[Ban] = (),
        *,
        in_order: bool = False,
    ) -> Route | NoRoute:
        """The cheapest route that visits nodes on its way, in the best order (exact) or, `in_order`, in theirs.

        Raises KeyError for an unknown node, ValueError where there is no goal or there are too many nodes to visit.
        """
        from robotd_plugins.behaviours.jetbot_route.route_visits import MAX_VISITS, cheapest_order

        forbidden, wanted = frozenset(bans), self._goals(goals)
        stops = [node for node in dict.fromkeys(visits) if self.map.node(node).id != start]
        if not stops:
            return self.plan(start, heading, wanted, forbidden)
        if len(stops) > MAX_VISITS:
            raise ValueError(f"{len(stops)} nodes to visit are too many for an exact plan; at most {MAX_VISITS}")
        ends = [self._at[goal] * _STATES + _SINK for goal in wanted]
        arrivals = [[self._at[stop] * _STATES + way for way in Compass] for stop in stops]
        order = cheapest_order(
            self._state(start, heading), arrivals, ends, lambda state: self._costs_from(state, forbidden), in_order
        )
        if order is not None:
            states = [order[0]]
            for leg in itertools.pairwise(order):
                found = self._search(*leg, forbidden)
                assert found is not None
                states += found[1:]
            # the last state is the goal's sink
            visited = tuple(self.map.nodes[state // _STATES].id for state in order[1:-1])
            return self._route(states[:-1], forbidden, visited)
        told = (
            f"no way leads from node {start}, heading {heading.name}, over {', '.join(stops)} to {' or '.join(wanted)}"
        )
        return self._explained(
            told,
            forbidden,
            lambda planner, bans: planner.plan_visits(start, heading, stops, wanted, bans, in_order=in_order),
        )

    # ------------------------------------------------------------------------------------------ inside

    def _goals(self, goals: str | Iterable[str] | None) -> tuple[str, ...]:
        wanted = self.map.goals if goals is None else (goals,) if isinstance(goals, str) else tuple(goals)
        if not wanted:
            raise ValueError("there is no goal: the map has none and none was given")
        return tuple(self.map.node(goal).id for goal in wanted)

    def _state(self, node: str, heading: Compass) -> int:
        return self._at[self.map.node(node).id] * _STATES + heading

    def _search(self, source: int, target: int, bans: frozenset[Ban]) -> list[int] | None:
        """The cheapest states from one to another, both included; None where there are none."""
        goal_x_m, goal_y_m = self._xy_m[target // _STATES]
        xy_m, turns_left = self._xy_m, self._turns_left

        def left_m(state: int, _: int) -> float:
            index, heading = divmod(state, _STATES)
            dx_m, dy_m = goal_x_m - xy_m[index][0], goal_y_m - xy_m[index][1]
            turns: float = turns_left[heading, (dx_m > 0.0) - (dx_m < 0.0), (dy_m > 0.0) - (dy_m < 0.0)]
            return abs(dx_m) + abs(dy_m) + turns

        def cost_m(_: int, after: int, road: dict[str, Any]) -> float | None:
            if road["road"] is None:
                return 0.0 if after == target else None
            return None if road["road"] in bans else road["m"]

        try:
            found: list[int] = self._nx.astar_path(self._graph, source, target, heuristic=left_m, weight=cost_m)
        except self._nx.NetworkXNoPath:
            return None
        return found

    def _costs_from(self, source: int, bans: frozenset[Ban]) -> dict[int, float]:
        """Cost to every state that can be reached from one."""
        costs: dict[int, float] = self._nx.single_source_dijkstra_path_length(
            self._graph, source, weight=lambda _, __, road: None if road["road"] in bans else road["m"]
        )
        return costs

    def _route(self, states: Sequence[int], bans: frozenset[Ban], visits: tuple[str, ...] = ()) -> Route:
        nodes = tuple(self.map.nodes[state // _STATES].id for state in states)
        ways = [Compass(state % _STATES) for state in states]
        actions = tuple(before.turn_to(after) for before, after in itertools.pairwise(ways))
        edges = [self.map.edges_from(node)[way] for node, way in zip(nodes, ways[1:], strict=False)]
        length_m = math.fsum(edge.length * self.pitch_m for edge in edges)
        cost_m = math.fsum((length_m, *(self.costs.of(turn) for turn in actions)))
        return Route(nodes, tuple(ways[1:]), actions, cost_m, length_m, bans, visits)

    def _explained(
        self, told: str, bans: frozenset[Ban], again: Callable[[RoutePlanner, frozenset[Ban]], Route | NoRoute]
    ) -> NoRoute:
        """Why there is no route, by trying what could be given up."""
        without_bans: Route | None = None
        turning: Route | None = None
        if bans:
            answer = again(self, frozenset())
            without_bans = answer if isinstance(answer, Route) else None
        if self.costs.turn_around_m is None:
            freer = PlanCosts(left_m=self.costs.left_m, right_m=self.costs.right_m)
            answer = again(RoutePlanner(self.map, pitch_m=self.pitch_m, costs=freer), bans)
            turning = answer if isinstance(answer, Route) else None
        reasons = []
        if without_bans is not None:
            reasons.append(f"banned: {_roads(broken(without_bans, bans))}")
        if turning is not None:
            reasons.append("turning around is forbidden")
        if not reasons:
            reasons.append("the map has no such road" + (", with or without the bans" if bans else ""))
        return NoRoute(f"{told}: {'; '.join(reasons)}", bans, without_bans, turning)


def _least_turns(costs: PlanCosts) -> dict[tuple[int, int, int], float]:
    """Least cost of turns by heading and the signs of what is left to go (dx, dy); for a sink, 0."""
    between = {(a, b): costs.of(a.turn_to(b)) for a in Compass for b in Compass}
    for via, a, b in itertools.product(Compass, repeat=3):
        between[a, b] = min(between[a, b], between[a, via] + between[via, b])
    least: dict[tuple[int, int, int], float] = {}
    for dx, dy in itertools.product((-1, 0, 1), repeat=2):
        ways = [way for way in (Compass.of_step(dx, 0), Compass.of_step(0, dy)) if way is not None]
        for heading in Compass:
            orders = ([heading, *order] for order in itertools.permutations(ways))
            least[heading, dx, dy] = min(sum(between[pair] for pair in itertools.pairwise(order)) for order in orders)
        least[_SINK, dx, dy] = 0.0
    return least


def _roads(bans: Iterable[Ban]) -> str:
    return ", ".join(f"{source} -> {target}" for source, target in sorted(bans))
