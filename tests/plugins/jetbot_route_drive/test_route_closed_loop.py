"""The shipped JetBot drives maps in the simulator: camera, lidar, perceptor, behaviour, guard and wheels in one loop.

The track: the tape's middle stays between the wheels, so the base's origin is never farther from it than half the
distance between them (59 mm), also on nodes and in turns.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from robotd_devices.sim.route import random_route

TRACK_M = 0.059
NODE_M = 0.05
HARSH = (
    "simulation.devices.motors.wheel_error=0.15",
    "simulation.devices.camera.frame_loss=0.1",
    "simulation.devices.camera.gloss=80",
    "simulation.devices.camera.shadows_per_m2=0.8",
    "simulation.devices.camera.shadow_depth=0.35",
)
NODE = ["APPROACHING_INTERSECTION", "HANDLING_EVENT"]
GO = ["LINE_VALIDATION", "LEAVING_INTERSECTION", "REACQUIRING_LINE", "DRIVING_STRAIGHT"]


def _stays_on_the_track(drove: Any) -> None:
    assert drove.off_max_m <= TRACK_M
    assert drove.collisions == 0


def test_the_shipped_map_is_driven_to_its_goal(run: Callable[..., Any]) -> None:
    drove = run(limit_s=100.0)
    assert drove.outcome is not None, drove.states
    assert (drove.outcome.result, drove.outcome.reason[:20]) == ("SUCCEEDED", "GOAL_REACHED: node 9")
    _stays_on_the_track(drove)
    places = {"2": (0.9, -1.8), "6": (0.9, -0.9), "3": (0.9, 0.0), "4": (1.8, 0.0), "5": (2.7, 0.0)}
    assert [name for name, *_ in drove.nodes] == list(places)
    for name, x_m, y_m in drove.nodes:
        assert math.dist((x_m, y_m), places[name]) <= NODE_M, name
    assert math.dist(drove.final, (3.6, 0.0)) <= NODE_M
    turn, straight = [*NODE, "TURNING", *GO], [*NODE, *GO]
    assert drove.states == [
        "WAITING_FOR_LINE", "HANDLING_EVENT", *GO, *turn, *straight, *turn, *straight, *straight,
        "APPROACHING_INTERSECTION",
    ]  # fmt: skip


def test_a_random_map_with_wheels_that_are_wrong_glare_shadows_and_lost_frames(run: Callable[..., Any]) -> None:
    route = random_route(19, 4, 4)
    drove = run(route, *HARSH, seed=3)
    assert drove.outcome is not None and drove.outcome.result == "SUCCEEDED", drove.reasons
    _stays_on_the_track(drove)
    end = next(node for node in route["nodes"] if node["type"] == "end")
    assert math.dist(drove.final, (0.6 * end["x"], -0.6 * end["y"])) <= NODE_M


def test_it_turns_around_right_and_left_and_counts_what_cannot_be_seen(
    run: Callable[..., Any], make_roads: Callable[..., Any]
) -> None:
    """From 2, looking West: around, over the passage 7, right at the bend 3, left at the T 4, to the stub 5."""
    nodes = {1: (0, 0), 2: (1, 0), 7: (2, 0), 3: (3, 0), 4: (3, 1), 5: (4, 1), 6: (2, 1)}
    route = make_roads(nodes, [(1, 2), (2, 7), (7, 3), (3, 4), (4, 5), (4, 6)], 2, 5)
    drove = run(route, heading="W", seed=4)
    assert drove.outcome is not None and drove.outcome.result == "SUCCEEDED", drove.reasons
    _stays_on_the_track(drove)
    assert [name for name, *_ in drove.nodes] == ["7", "3", "4"]
    does = [reason for reason in drove.reasons if reason.startswith("at node")]
    assert does == [
        "at node 2 turn around to node 7", "at node 3 right to node 4", "at node 4 left to node 5",
    ]  # fmt: skip
    assert math.dist(drove.final, (2.4, -0.6)) <= NODE_M


def test_a_road_that_is_not_there_is_a_dead_end_with_a_reason(
    run: Callable[..., Any], make_roads: Callable[..., Any]
) -> None:
    """The map promises a T with a way to the left; the tape has it to the right only."""
    nodes = {1: (0, 0), 2: (1, 0), 3: (1, -1), 4: (1, 1)}
    route = make_roads(nodes, [(1, 2), (2, 3), (2, 4)], 1, 3)
    tape = [((0.0, 0.0), (0.625, 0.0)), ((0.6, 0.0), (0.6, -0.6))]
    drove = run(route, tape=tape)
    assert drove.outcome is not None
    assert (drove.outcome.result, drove.outcome.reason) == ("FAILED", "at node 2 no line leads to node 3")
    assert math.dist(drove.final, (0.6, 0.0)) <= NODE_M
    assert [name for name, *_ in drove.nodes] == ["2"]


def test_a_node_that_does_not_come_is_a_dead_end_and_none_is_counted(
    run: Callable[..., Any], make_roads: Callable[..., Any]
) -> None:
    """The map has a crossing after 0.6 m; the tape runs on without one."""
    nodes = {1: (0, 0), 2: (1, 0), 3: (1, -1), 4: (2, 0)}
    route = make_roads(nodes, [(1, 2), (2, 3), (2, 4)], 1, 3)
    drove = run(route, tape=[((0.0, 0.0), (2.0, 0.0))])
    assert drove.outcome is not None
    assert drove.outcome.reason.startswith("node 2 did not come")
    assert drove.nodes == []
    assert drove.final[0] < 0.85


def test_where_the_goal_is_the_start_the_motors_never_turn(run: Callable[..., Any]) -> None:
    route = {
        "nodes": {"A": {"x": 0, "y": 0, "type": "intersection"}, "B": {"x": 1, "y": 0, "type": "intersection"}},
        "edges": {"A": ["B"], "B": ["A"]},
        "start_node": "A",
        "end_node": "A",
    }
    drove = run(route, tape=[((0.0, 0.0), (0.6, 0.0))], limit_s=5.0)
    assert drove.outcome is not None
    assert (drove.outcome.result, drove.outcome.reason) == (
        "SUCCEEDED",
        "GOAL_REACHED: node A is where the robot stands",
    )
    assert {row[1:4] for row in drove.way} == {(0.0, 0.0, 0.0)}
