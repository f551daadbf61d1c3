"""Plans: turns counted, bans, nodes to visit, why there is none; and the cost of a plain Dijkstra on random maps."""

from __future__ import annotations

import itertools
import json
import random
import sys
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from route_map_shapes import ROUTE_13, square

from robotd_plugins.behaviours.jetbot_route.compass import Compass, Turn
from robotd_plugins.behaviours.jetbot_route.map_navigator import MapNavigator
from robotd_plugins.behaviours.jetbot_route.route_map import NodeKind, RouteEdge, RouteMap, RouteNode
from robotd_plugins.behaviours.jetbot_route.route_map_file import load_route_map, read_route_map
from robotd_plugins.behaviours.jetbot_route.route_plan import Ban, NoRoute, PlanCosts, Route, RoutePlanner, broken
from robotd_plugins.behaviours.jetbot_route.route_visits import MAX_VISITS

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "scripts"))

from benches.route_maps import cost_differences, plain_cost_m, random_map

E, N, S, W = Compass.E, Compass.N, Compass.S, Compass.W
ON, LEFT, RIGHT, AROUND = Turn.STRAIGHT, Turn.LEFT, Turn.RIGHT, Turn.TURN_AROUND


@pytest.fixture(scope="module")
def thirteen() -> RoutePlanner:
    return RoutePlanner(load_route_map(ROUTE_13))


def planned(answer: Route | NoRoute) -> Route:
    assert isinstance(answer, Route), answer
    return answer


ROUTES: list[tuple[str, str, Compass, str, list[Ban], list[str], list[Turn], float]] = [
    ("straight on", "1", E, "10", [], ["1", "2", "10"], [ON, ON], 2.0),
    ("one turn", "1", E, "6", [], ["1", "2", "6"], [ON, LEFT], 2.25),
    ("a turn at once", "1", N, "2", [], ["1", "2"], [RIGHT], 1.25),
    ("already there", "7", W, "7", [], ["7"], [], 0.0),
    ("around a ban", "2", E, "7", [("2", "10")], ["2", "6", "7"], [LEFT, RIGHT], 2.5),
    ("a ban is for one direction", "10", W, "2", [("2", "10")], ["10", "2"], [ON], 1.0),
    ("back from a stub", "9", E, "5", [], ["9", "5"], [AROUND], 2.5),
    ("round the block is dearer than turning around", "2", E, "1", [], ["2", "1"], [AROUND], 2.5),
    ("a road of two units", "5", S, "13", [], ["5", "8", "13"], [ON, ON], 3.0),
]


@pytest.mark.parametrize(
    ("what", "start", "heading", "goal", "bans", "nodes", "actions", "cost_m"), ROUTES, ids=[row[0] for row in ROUTES]
)
def test_routes(
    thirteen: RoutePlanner,
    what: str,
    start: str,
    heading: Compass,
    goal: str,
    bans: list[Ban],
    nodes: list[str],
    actions: list[Turn],
    cost_m: float,
) -> None:
    route = planned(thirteen.plan(start, heading, goal, bans))
    assert (list(route.nodes), list(route.actions)) == (nodes, actions)
    assert route.cost_m == pytest.approx(cost_m)
    assert route.goal == goal
    assert route.is_there == (start == goal)
    facing = heading
    for action, way in zip(route.actions, route.headings, strict=True):
        facing = facing.after(action)
        assert facing is way
    assert broken(route, bans) == ()


def test_the_whole_mission_of_the_shipped_map(thirteen: RoutePlanner) -> None:
    route = planned(thirteen.plan("1", E))
    assert (route.nodes[0], route.goal, route.length_m, route.cost_m) == ("1", "9", 6.0, 6.5)
    assert route.why.endswith(": 6 m and 1 x left, 1 x right, together 6.5 m")


def test_heading_decides_where_a_replan_leads(thirteen: RoutePlanner) -> None:
    """The seed planned from the node alone, and then had to turn around where it never could."""
    strict = RoutePlanner(thirteen.map, costs=PlanCosts(turn_around_m=None))
    # driven to the West, away from the goal
    route = planned(strict.plan("10", W, "12"))
    assert route.nodes == ("10", "12")
    assert planned(strict.plan("2", W, "6")).actions == (RIGHT,)
    assert AROUND not in planned(strict.plan("2", S, "6")).actions


def test_costs_scale_with_the_pitch() -> None:
    route = planned(RoutePlanner(load_route_map(ROUTE_13), pitch_m=0.5).plan("1", E, "6"))
    assert (route.length_m, route.cost_m) == (1.0, 1.25)


def test_dear_turns_buy_a_longer_way() -> None:
    nodes = tuple(RouteNode(str(i), x, y) for i, (x, y) in enumerate([(0, 0), (1, 0), (1, 1), (2, 1), (2, 0)]))
    roads = [("0", "1", E, 1.0), ("1", "4", E, 3.5), ("1", "2", S, 1.0), ("2", "3", E, 1.0), ("3", "4", N, 1.0)]
    made = RouteMap(nodes, tuple(RouteEdge(a, b, way, length, one_way=True) for a, b, way, length in roads))
    assert planned(RoutePlanner(made).plan("0", E, "4")).nodes == ("0", "1", "4")
    free = PlanCosts(left_m=0.0, right_m=0.0)
    assert planned(RoutePlanner(made, costs=free).plan("0", E, "4")).nodes == ("0", "1", "2", "3", "4")


def test_the_nearest_of_several_goals(thirteen: RoutePlanner) -> None:
    assert planned(thirteen.plan("1", E, ["9", "13", "11"])).goal == "11"


def test_no_route_says_what_would_make_one(thirteen: RoutePlanner) -> None:
    banned = thirteen.plan("1", E, "9", [("5", "9"), ("3", "4")])
    assert isinstance(banned, NoRoute)
    assert banned.bans_in_the_way == (("5", "9"),)
    assert planned(banned.without_bans or banned).goal == "9"
    assert banned.by_turning_around is None
    assert "banned: 5 -> 9" in banned.reason

    strict = RoutePlanner(thirteen.map, costs=PlanCosts(turn_around_m=None))
    stuck = strict.plan("9", E, "5")
    assert isinstance(stuck, NoRoute)
    assert stuck.without_bans is None
    assert stuck.by_turning_around is not None
    assert stuck.by_turning_around.actions == (AROUND,)
    assert "turning around is forbidden" in stuck.reason

    island = RouteMap((RouteNode("a", 0, 0), RouteNode("b", 1, 0)), ())
    nothing = RoutePlanner(island).plan("a", E, "b")
    assert nothing == NoRoute("no way leads from node a, heading E, to b: the map has no such road")


def test_wrong_questions_are_refused(thirteen: RoutePlanner) -> None:
    with pytest.raises(KeyError, match="'99'"):
        thirteen.plan("99", E)
    with pytest.raises(KeyError, match="'99'"):
        thirteen.plan("1", E, "99")
    with pytest.raises(ValueError, match="no goal"):
        thirteen.plan("1", E, [])
    with pytest.raises(ValueError, match="pitch_m"):
        RoutePlanner(thirteen.map, pitch_m=0.0)
    grid = RoutePlanner(random_map(random.Random(1), 4, 4))
    with pytest.raises(ValueError, match="too many"):
        grid.plan_visits("0", E, [str(i) for i in range(1, MAX_VISITS + 2)], "15")


def test_a_plan_repeats_itself(thirteen: RoutePlanner) -> None:
    again = RoutePlanner(load_route_map(ROUTE_13))
    for start, goal in itertools.permutations([node.id for node in thirteen.map.nodes], 2):
        assert thirteen.plan(start, E, goal) == again.plan(start, E, goal)


def test_costs_are_those_of_dijkstra_on_random_maps() -> None:
    """A sample; `scripts/bench route_maps` does ten thousand."""
    assert [what for _, what in cost_differences(range(300)) if what] == []


def test_the_comparison_can_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    """A heuristic that is too large is found out."""
    import robotd_plugins.behaviours.jetbot_route.route_plan as module

    honest = module._least_turns
    monkeypatch.setattr(module, "_least_turns", lambda costs: {k: 9.0 * (v + 1.0) for k, v in honest(costs).items()})
    assert any(what for _, what in cost_differences(range(300)))


# --------------------------------------------------------------------------------------- nodes to visit


def cheapest_by_trying(planner: RoutePlanner, start: str, heading: Compass, stops: list[str], goal: str) -> float:
    """Every order, every heading of arrival: layered Dijkstra by hand over (stop, heading)."""
    best = float("inf")
    for order in itertools.permutations(stops):
        costs = {(start, heading): 0.0}
        for stop in (*order, goal):
            after: dict[tuple[str, Compass], float] = {}
            for (node, facing), cost_m in costs.items():
                reached = planner._costs_from(planner._state(node, facing), frozenset())
                for way in Compass:
                    leg_m = reached.get(planner._state(stop, way), float("inf"))
                    after[stop, way] = min(after.get((stop, way), float("inf")), cost_m + leg_m)
            costs = after
        best = min(best, *costs.values())
    return best


@settings(deadline=None, max_examples=25)
@given(seed=st.integers(0, 10_000), count=st.integers(1, 3))
def test_the_order_of_visits_is_the_best(seed: int, count: int) -> None:
    rng = random.Random(seed)
    made = random_map(rng, 3, 3, keep=0.95)
    planner = RoutePlanner(made, costs=PlanCosts(turn_around_m=rng.choice((None, 0.7))))
    start, goal, *stops = [node.id for node in rng.sample(made.nodes, 2 + count)]
    answer = planner.plan_visits(start, E, stops, goal)
    least_m = cheapest_by_trying(planner, start, E, stops, goal)
    if isinstance(answer, NoRoute):
        assert least_m == float("inf")
        return
    assert answer.cost_m == pytest.approx(least_m)
    assert sorted(answer.visits) == sorted(stops)
    at = [answer.nodes.index(stop) for stop in answer.visits]
    assert all(node in answer.nodes for node in stops)
    assert len(at) == count
    assert (answer.nodes[0], answer.goal) == (start, goal)


def test_visits_in_their_own_order(thirteen: RoutePlanner) -> None:
    free = planned(thirteen.plan_visits("1", E, ["13", "11"], "9"))
    assert free.visits == ("11", "13")
    kept = planned(thirteen.plan_visits("1", E, ["13", "11"], "9", in_order=True))
    assert kept.visits == ("13", "11")
    assert kept.nodes.index("13") < len(kept.nodes) - 1 - kept.nodes[::-1].index("11")
    assert kept.cost_m > free.cost_m
    assert free.why.count("visits 11, 13") == 1


def test_visits_that_are_no_detour(thirteen: RoutePlanner) -> None:
    plain = planned(thirteen.plan("1", E, "9"))
    assert planned(thirteen.plan_visits("1", E, [], "9")) == plain
    assert planned(thirteen.plan_visits("1", E, ["1"], "9")) == plain
    assert planned(thirteen.plan_visits("1", E, ["2", "9", "2"], "9")).cost_m == plain.cost_m


def test_visits_keep_to_the_bans(thirteen: RoutePlanner) -> None:
    bans = [("2", "11"), ("12", "11")]
    shut = thirteen.plan_visits("1", E, ["11"], "9", bans)
    assert isinstance(shut, NoRoute)
    assert shut.bans_in_the_way == (("2", "11"),)
    assert "over 11 to 9" in shut.reason
    assert broken(planned(thirteen.plan_visits("1", E, ["11"], "9", bans[:1])), bans[:1]) == ()


def test_eight_visits_cost_no_more_than_any_order_drawn() -> None:
    rng = random.Random(3)
    made = random_map(rng, 6, 6, keep=1.0, one_way=0.0)
    planner = RoutePlanner(made)
    start, goal, *stops = [node.id for node in rng.sample(made.nodes, 10)]
    best = planned(planner.plan_visits(start, E, stops, goal))
    for _ in range(5):
        rng.shuffle(stops)
        drawn = planned(planner.plan_visits(start, E, stops, goal, in_order=True))
        assert drawn.visits == tuple(stops)
        assert drawn.cost_m >= best.cost_m - 1e-9


# ------------------------------------------------------------------------------------------- MapNavigator


def test_navigator_answers_as_the_seed_asks() -> None:
    navigator = MapNavigator.load(ROUTE_13)
    assert (navigator.start_node, navigator.end_node) == ("1", "9")
    route = planned(navigator.find_path())
    assert navigator.next_node(route, 1) == "2"
    assert navigator.next_node(route, "9") is None
    with pytest.raises(ValueError, match="node 13 is not on the route 1 -> 2"):
        navigator.next_node(route, 13)
    assert navigator.neighbour(2, N) == "6"
    assert navigator.neighbour(2, E) == "10"
    assert navigator.neighbour(1, N) is None
    assert navigator.direction(2, 11) is S
    assert navigator.direction(2, 13) is None
    assert navigator.relative_turn(E, N) is LEFT
    assert planned(navigator.find_path(2, 7, heading=E, banned_edges=[("2", "10")])).nodes == ("2", "6", "7")


def test_navigator_visits_load_nodes_before_the_end() -> None:
    data = square()
    data["nodes"][1]["type"] = "Load"
    made = read_route_map(json.dumps(data)).map
    assert made is not None
    assert made.node("2").kind is NodeKind.LOAD
    navigator = MapNavigator(made)
    assert planned(navigator.find_path()).nodes == ("1", "2", "3", "4")
    with pytest.raises(ValueError, match="2 starts"):
        MapNavigator(RouteMap(made.nodes, made.edges, ("1", "2"), ("4",))).find_path()


def test_dijkstra_for_comparison_knows_a_way_by_hand() -> None:
    made = load_route_map(ROUTE_13)
    assert plain_cost_m(made, "1", E, "9", frozenset(), PlanCosts(), 1.0) == pytest.approx(6.5)
