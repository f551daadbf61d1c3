"""The state machine of a mapped route, as a pure function: what leads from each state to the next."""

from __future__ import annotations

import math
from dataclasses import dataclass

from robotd_plugins.behaviours.jetbot_route.compass import Turn
from robotd_plugins.behaviours.jetbot_route.config import JetBotRouteConfig
from robotd_plugins.behaviours.jetbot_route.states import State

_LOST_SHARE = 2.0
"""A line that is seen now and then, but never believed, is followed no farther than so many times `reacquire_m`."""


@dataclass(frozen=True, slots=True)
class RouteFacts:
    """All that a transition depends on. Distances in metres of travel.

    refusal: why no route can be driven at all. node, next_node: as in the belief. at_goal: `node` is the last one.
    line: believed (k of n pictures) and in keeping with the course. road_ahead: the map has a road where the robot
    looks. node_m: distance to the next node's centre, nan while no evidence suffices; evidence: what speaks for it.
    overdue_m: how far the next node is behind the last place where it could be (negative: still before it).
    stops: the next node is one at which the robot stops. is_goal: the next node is the last one.
    turn: what is to be done at `node`; None: the plan says nothing. tries: times the turn was begun.
    turned: the turn ended on a line (True), without one (False), is under way (None).
    unseen_m: travel since a line was last seen. searched: both sides were looked at in vain. standing: at rest.
    in_state_m, in_state_s: since this state began.
    """

    node: str = ""
    next_node: str = ""
    refusal: str = ""
    at_goal: bool = False
    line: bool = False
    road_ahead: bool = True
    node_m: float = math.nan
    evidence: str = ""
    overdue_m: float = -math.inf
    stops: bool = True
    is_goal: bool = False
    turn: Turn | None = None
    tries: int = 0
    turned: bool | None = None
    unseen_m: float = 0.0
    searched: bool = False
    standing: bool = False
    in_state_m: float = 0.0
    in_state_s: float = 0.0


def route_transition(state: State, facts: RouteFacts, config: JetBotRouteConfig) -> tuple[State, str]:
    """The next state and why; the same state, with an empty reason, where nothing changes."""
    match state:
        case State.WAITING_FOR_LINE:
            return _waiting(facts, config)
        case State.DRIVING_STRAIGHT:
            return _driving(facts, config)
        case State.APPROACHING_INTERSECTION:
            return _approaching(facts)
        case State.HANDLING_EVENT:
            if facts.standing and facts.in_state_s >= config.settle_s:
                return _decided(facts)
        case State.TURNING:
            return _turning(facts, config)
        case State.LINE_VALIDATION:
            return _validating(facts, config)
        case State.LEAVING_INTERSECTION:
            if facts.in_state_m >= config.clearance_m:
                return State.REACQUIRING_LINE, f"clear of node {facts.node}"
        case State.REACQUIRING_LINE:
            if facts.line:
                return State.DRIVING_STRAIGHT, "line found"
            if facts.searched or facts.overdue_m > 0.0 or facts.in_state_m > _LOST_SHARE * config.reacquire_m:
                return State.DEAD_END, (
                    f"the line from node {facts.node} to node {facts.next_node} was lost and is not to be found on "
                    "either side"
                )
        case State.DEAD_END | State.GOAL_REACHED:
            pass
    return state, ""


def _waiting(facts: RouteFacts, config: JetBotRouteConfig) -> tuple[State, str]:
    if facts.refusal:
        return State.DEAD_END, facts.refusal
    if facts.at_goal:
        return State.GOAL_REACHED, f"node {facts.node} is where the robot stands"
    if facts.line:
        return State.HANDLING_EVENT, "line in both regions"
    if not facts.road_ahead:
        return State.HANDLING_EVENT, "the map has no road ahead of the start"
    if facts.in_state_s > config.wait_for_line_s:
        return State.DEAD_END, f"no line in sight for {config.wait_for_line_s:g} s"
    return State.WAITING_FOR_LINE, ""


def _driving(facts: RouteFacts, config: JetBotRouteConfig) -> tuple[State, str]:
    if not math.isnan(facts.node_m):
        return State.APPROACHING_INTERSECTION, f"node {facts.next_node} in {facts.node_m:.2f} m: {facts.evidence}"
    if facts.overdue_m > 0.0:
        return State.DEAD_END, f"node {facts.next_node} did not come: nothing of it was seen where the map has it"
    if facts.unseen_m > config.lost_m:
        return State.REACQUIRING_LINE, f"no line for {facts.unseen_m:.2f} m"
    return State.DRIVING_STRAIGHT, ""


def _approaching(facts: RouteFacts) -> tuple[State, str]:
    if math.isnan(facts.node_m):
        return State.DRIVING_STRAIGHT, f"node {facts.next_node} is not there after all"
    if facts.node_m > 0.0:
        return State.APPROACHING_INTERSECTION, ""
    reached = f"node {facts.next_node}: {facts.evidence}"
    if facts.is_goal:
        return State.GOAL_REACHED, reached
    return (State.HANDLING_EVENT if facts.stops else State.LEAVING_INTERSECTION), reached


def _decided(facts: RouteFacts) -> tuple[State, str]:
    if facts.turn is None:
        return State.DEAD_END, f"at node {facts.node} the plan has no way on"
    does = facts.turn.value.replace("_", " ")
    if facts.turn is Turn.STRAIGHT:
        return State.LINE_VALIDATION, f"at node {facts.node} {does} on to node {facts.next_node}"
    return State.TURNING, f"at node {facts.node} {does} to node {facts.next_node}"


def _turning(facts: RouteFacts, config: JetBotRouteConfig) -> tuple[State, str]:
    if facts.turned:
        return State.LINE_VALIDATION, "turned onto a line"
    if facts.turned is False:
        return State.DEAD_END, f"at node {facts.node} no line leads to node {facts.next_node}"
    if facts.in_state_s > config.turn_timeout_s:
        return State.DEAD_END, f"at node {facts.node} the turn took longer than {config.turn_timeout_s:g} s"
    return State.TURNING, ""


def _validating(facts: RouteFacts, config: JetBotRouteConfig) -> tuple[State, str]:
    if facts.line:
        return State.LEAVING_INTERSECTION, f"the line to node {facts.next_node}"
    if facts.in_state_s > config.validation_s:
        if facts.tries <= config.turn_retries:
            return State.TURNING, f"the line to node {facts.next_node} is not where it should be: looking about"
        return State.DEAD_END, f"at node {facts.node} no line leads to node {facts.next_node}"
    return State.LINE_VALIDATION, ""
