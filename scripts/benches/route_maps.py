"""Route maps: the planner's costs against a plain Dijkstra on random maps, and how long a plan takes."""

from __future__ import annotations

import heapq
import math
import random
import time
from collections.abc import Iterator
from statistics import median, quantiles

from benches.harness import Bench, Context, Figure
from robotd_plugins.behaviours.jetbot_route.compass import Compass
from robotd_plugins.behaviours.jetbot_route.route_map import RouteEdge, RouteMap, RouteNode
from robotd_plugins.behaviours.jetbot_route.route_plan import Ban, NoRoute, PlanCosts, Route, RoutePlanner

_CLOSE = 1e-9


def random_map(
    rng: random.Random, width: int, height: int, *, keep: float = 0.8, one_way: float = 0.1, longer: float = 0.2
) -> RouteMap:
    """A grid map of uneven pitch from which roads were taken away; some roads are one-way, some longer than drawn."""
    xs, ys = ([0.0], [0.0])
    for line, count in ((xs, width), (ys, height)):
        for _ in range(count - 1):
            line.append(line[-1] + rng.choice((1.0, 1.0, 1.0, 0.5, 2.0)))
    nodes = [
        RouteNode(str(row * width + column), xs[column], ys[row]) for row in range(height) for column in range(width)
    ]
    edges = []
    for row in range(height):
        for column in range(width):
            for way, there in ((Compass.E, column + 1 < width), (Compass.S, row + 1 < height)):
                if not there or rng.random() > keep:
                    continue
                a = nodes[row * width + column]
                b = nodes[(row + way.step[1]) * width + column + way.step[0]]
                drawn = abs(b.x - a.x) + abs(b.y - a.y)
                length = drawn * (rng.uniform(1.0, 3.0) if rng.random() < longer else 1.0)
                both = [RouteEdge(a.id, b.id, way, length), RouteEdge(b.id, a.id, way.opposite, length)]
                if rng.random() < one_way:
                    only = rng.choice(both)
                    both = [RouteEdge(only.source, only.target, only.heading, length, one_way=True)]
                edges += both
    return RouteMap(tuple(nodes), tuple(edges))


def plain_cost_m(
    route_map: RouteMap, start: str, heading: Compass, goal: str, bans: frozenset[Ban], costs: PlanCosts, pitch_m: float
) -> float:
    """Least cost by Dijkstra's algorithm, written without regard to the planner; inf where there is no way."""
    roads: dict[str, list[RouteEdge]] = {}
    for edge in route_map.edges:
        if (edge.source, edge.target) not in bans:
            roads.setdefault(edge.source, []).append(edge)
    around_m = math.inf if costs.turn_around_m is None else costs.turn_around_m
    # a quarter clockwise is a turn to the right
    turn_m = {0: 0.0, 1: costs.right_m, 2: around_m, 3: costs.left_m}
    queue, done = [(0.0, start, int(heading))], set()
    while queue:
        cost_m, node, facing = heapq.heappop(queue)
        if node == goal:
            return cost_m
        if (node, facing) in done:
            continue
        done.add((node, facing))
        for edge in roads.get(node, ()):
            way = int(edge.heading)
            after_m = cost_m + turn_m[(way - facing) % 4] + edge.length * pitch_m
            if after_m < math.inf:
                heapq.heappush(queue, (after_m, edge.target, way))
    return math.inf


def cost_differences(seeds: range) -> Iterator[tuple[int, str]]:
    """For each seed one random map, start, goal and bans: what is wrong with the plan, empty where nothing."""
    for seed in seeds:
        rng = random.Random(seed)
        made = random_map(rng, rng.randint(2, 8), rng.randint(2, 8), keep=rng.uniform(0.5, 1.0))
        costs = PlanCosts(
            left_m=rng.choice((0.0, 0.25, rng.random())),
            right_m=rng.choice((0.0, 0.25, rng.random())),
            turn_around_m=rng.choice((None, 0.0, 1.5, rng.random())),
        )
        pitch_m = rng.uniform(0.3, 2.0)
        roads = [edge.key for edge in made.edges]
        bans = frozenset(rng.sample(roads, min(len(roads), rng.choice((0, 0, 1, 3, 8)))))
        start, goal = rng.choice(made.nodes).id, rng.choice(made.nodes).id
        heading = rng.choice(list(Compass))
        route = RoutePlanner(made, pitch_m=pitch_m, costs=costs).plan(start, heading, goal, bans)
        yield seed, _difference(made, route, (start, heading, goal), bans, costs, pitch_m)


def _difference(
    made: RouteMap,
    route: Route | NoRoute,
    ends: tuple[str, Compass, str],
    bans: frozenset[Ban],
    costs: PlanCosts,
    pitch_m: float,
) -> str:
    """Drives the route on the map, and holds its cost against the least."""
    start, heading, goal = ends
    least_m = plain_cost_m(made, start, heading, goal, bans, costs, pitch_m)
    if isinstance(route, NoRoute):
        return "" if least_m == math.inf else f"no route where one costs {least_m}"
    driven_m, facing, node = 0.0, heading, start
    for action, target in zip(route.actions, route.nodes[1:], strict=True):
        facing = facing.after(action)
        edge = made.edges_from(node).get(facing)
        if edge is None or edge.target != target or edge.key in bans:
            return f"at node {node} the route drives where it may not"
        driven_m += costs.of(action) + edge.length * pitch_m
        node = target
    if node != goal:
        return f"the route ends at node {node}, not {goal}"
    if abs(driven_m - route.cost_m) > _CLOSE:
        return f"the route says {route.cost_m} and costs {driven_m}"
    return "" if abs(route.cost_m - least_m) <= _CLOSE else f"costs {route.cost_m} where {least_m} is possible"


class RouteMaps(Bench):
    name = "route_maps"
    about = "plans over (node, heading) against Dijkstra, and their time"
    figures = (
        Figure("cost_differences", "maps", "= 0", "random maps on which the plan is not the cheapest"),
        Figure("replan_200_ms_p50", "ms", "<= 1", "from anywhere to anywhere on 200 nodes, three bans"),
        Figure("replan_200_ms_p99", "ms", "", "the same"),
        Figure("no_route_200_ms_p50", "ms", "", "the same, the goal banned from all sides: no route, and why"),
        Figure("visits_8_ms", "ms", "", "eight nodes to visit in the best order, on 64 nodes"),
    )

    def run(self, ctx: Context) -> None:
        count = 300 if ctx.quick else 10_000
        wrong = 0
        for done, (seed, what) in enumerate(cost_differences(range(count))):
            ctx.progress(done, count, "random maps")
            if what:
                wrong += 1
                ctx.row({"seed": seed, "what": what})
        ctx.figure("cost_differences", wrong, runs=count)

        rng = random.Random(7)
        took_ms: list[float] = []
        shut_ms: list[float] = []
        for _ in range(3 if ctx.quick else 20):
            made = random_map(rng, 20, 10, keep=0.85)
            planner = RoutePlanner(made)
            roads = [edge.key for edge in made.edges]
            for _ in range(50):
                start, goal = rng.sample(made.nodes, 2)
                bans = rng.sample(roads, 3)
                begin = time.perf_counter()
                planner.plan(start.id, Compass.E, goal.id, bans)
                took_ms.append((time.perf_counter() - begin) * 1e3)
            shut = [edge.key for edge in made.edges if edge.target == goal.id]
            begin = time.perf_counter()
            planner.plan(start.id, Compass.E, goal.id, shut)
            shut_ms.append((time.perf_counter() - begin) * 1e3)
        ctx.figure("replan_200_ms_p50", median(took_ms), runs=len(took_ms))
        ctx.figure("replan_200_ms_p99", quantiles(took_ms, n=100)[98], runs=len(took_ms))

        ctx.figure("no_route_200_ms_p50", median(shut_ms), runs=len(shut_ms))

        made = random_map(rng, 8, 8, keep=1.0, one_way=0.0)
        planner = RoutePlanner(made)
        stops = [node.id for node in rng.sample(made.nodes, 9)]
        begin = time.perf_counter()
        planner.plan_visits("0", Compass.E, stops[:8], stops[8])
        ctx.figure("visits_8_ms", (time.perf_counter() - begin) * 1e3)


BENCH = RouteMaps()
