"""The state machine of a mapped route, row by row."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import pytest

from robotd_plugins.behaviours.jetbot_route import JetBotRouteConfig
from robotd_plugins.behaviours.jetbot_route.compass import Turn
from robotd_plugins.behaviours.jetbot_route.route_states import RouteFacts, route_transition
from robotd_plugins.behaviours.jetbot_route.states import State

CONFIG = JetBotRouteConfig()
WAIT, DRIVE, APPROACH = State.WAITING_FOR_LINE, State.DRIVING_STRAIGHT, State.APPROACHING_INTERSECTION
HANDLE, TURN, CHECK = State.HANDLING_EVENT, State.TURNING, State.LINE_VALIDATION
LEAVE, AGAIN, DEAD, GOAL = State.LEAVING_INTERSECTION, State.REACQUIRING_LINE, State.DEAD_END, State.GOAL_REACHED
HERE = RouteFacts(node="2", next_node="6")


@pytest.mark.parametrize(
    ("state", "changed", "expected", "why"),
    [
        (WAIT, {}, WAIT, ""),
        (WAIT, {"refusal": "no way leads there", "line": True}, DEAD, "no way leads there"),
        (WAIT, {"at_goal": True}, GOAL, "node 2 is where the robot stands"),
        (WAIT, {"line": True}, HANDLE, "line in both regions"),
        (WAIT, {"road_ahead": False}, HANDLE, "the map has no road ahead of the start"),
        (WAIT, {"in_state_s": 10.1}, DEAD, "no line in sight for 10 s"),
        (DRIVE, {}, DRIVE, ""),
        (DRIVE, {"node_m": 0.3, "evidence": "bar"}, APPROACH, "node 6 in 0.30 m: bar"),
        (DRIVE, {"node_m": 0.3, "overdue_m": 0.1, "evidence": "bar"}, APPROACH, "node 6 in 0.30 m: bar"),
        (DRIVE, {"overdue_m": 0.01}, DEAD, "node 6 did not come: nothing of it was seen where the map has it"),
        (DRIVE, {"unseen_m": 0.08}, DRIVE, ""),
        (DRIVE, {"unseen_m": 0.09}, AGAIN, "no line for 0.09 m"),
        (APPROACH, {"node_m": 0.1}, APPROACH, ""),
        (APPROACH, {"node_m": 0.1, "unseen_m": 1.0}, APPROACH, ""),
        (APPROACH, {}, DRIVE, "node 6 is not there after all"),
        (APPROACH, {"node_m": 0.0, "evidence": "bar, distance"}, HANDLE, "node 6: bar, distance"),
        (APPROACH, {"node_m": -0.1, "stops": False, "evidence": "distance"}, LEAVE, "node 6: distance"),
        (APPROACH, {"node_m": 0.0, "is_goal": True, "evidence": "end"}, GOAL, "node 6: end"),
        (APPROACH, {"node_m": 0.0, "is_goal": True, "stops": False, "evidence": "end"}, GOAL, "node 6: end"),
        (HANDLE, {"turn": Turn.LEFT, "in_state_s": 1.0}, HANDLE, ""),
        (HANDLE, {"turn": Turn.LEFT, "standing": True, "in_state_s": 0.1}, HANDLE, ""),
        (HANDLE, {"turn": Turn.LEFT, "standing": True, "in_state_s": 0.2}, TURN, "at node 2 left to node 6"),
        (HANDLE, {"turn": Turn.TURN_AROUND, "standing": True, "in_state_s": 0.2}, TURN,
         "at node 2 turn around to node 6"),
        (HANDLE, {"turn": Turn.STRAIGHT, "standing": True, "in_state_s": 0.2}, CHECK,
         "at node 2 straight on to node 6"),
        (HANDLE, {"standing": True, "in_state_s": 0.2}, DEAD, "at node 2 the plan has no way on"),
        (TURN, {"line": True}, TURN, ""),
        (TURN, {"turned": True}, CHECK, "turned onto a line"),
        (TURN, {"turned": False}, DEAD, "at node 2 no line leads to node 6"),
        (TURN, {"in_state_s": 15.1}, DEAD, "at node 2 the turn took longer than 15 s"),
        (CHECK, {}, CHECK, ""),
        (CHECK, {"line": True}, LEAVE, "the line to node 6"),
        (CHECK, {"in_state_s": 1.6, "tries": 1}, TURN, "the line to node 6 is not where it should be: looking about"),
        (CHECK, {"in_state_s": 1.6, "tries": 2}, DEAD, "at node 2 no line leads to node 6"),
        (LEAVE, {"in_state_m": 0.07, "line": True}, LEAVE, ""),
        (LEAVE, {"in_state_m": 0.08}, AGAIN, "clear of node 2"),
        (AGAIN, {}, AGAIN, ""),
        (AGAIN, {"line": True, "searched": True}, DRIVE, "line found"),
        *((AGAIN, lost, DEAD,
           "the line from node 2 to node 6 was lost and is not to be found on either side")
          for lost in ({"searched": True}, {"overdue_m": 0.1}, {"in_state_m": 0.41})),
        (DEAD, {"line": True}, DEAD, ""),
        (GOAL, {"line": True}, GOAL, ""),
    ],
)  # fmt: skip
def test_each_row(state: State, changed: dict[str, object], expected: State, why: str) -> None:
    assert route_transition(state, replace(HERE, **changed), CONFIG) == (expected, why)  # type: ignore[arg-type]


def test_every_change_has_a_reason_and_nothing_else_has() -> None:
    lists = product(
        State, (False, True), (0.0, 0.3, float("nan")), (-1.0, 0.1), (None, *Turn), (None, False, True), (False, True)
    )
    for state, line, node_m, overdue_m, turn, turned, standing in lists:
        facts = replace(
            HERE, line=line, node_m=node_m, overdue_m=overdue_m, turn=turn, turned=turned, standing=standing,
            in_state_s=1.0,
        )  # fmt: skip
        after, why = route_transition(state, facts, CONFIG)
        assert bool(why) is (after is not state)
