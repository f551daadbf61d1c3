"""The states of `jetbot_route`, and the pure function that leads from one to the next where there is no map."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from robotd_plugins.behaviours.jetbot_route.config import JetBotRouteConfig


class State(Enum):
    """Named as in the seed."""

    WAITING_FOR_LINE = "WAITING_FOR_LINE"
    """Standing, until both regions show a line."""
    DRIVING_STRAIGHT = "DRIVING_STRAIGHT"
    """Following the line."""
    APPROACHING_INTERSECTION = "APPROACHING_INTERSECTION"
    """A crossing, with a map the next node, is believed to be ahead, at a known place."""
    HANDLING_EVENT = "HANDLING_EVENT"
    """Standing on a node: deciding what to do there."""
    TURNING = "TURNING"
    """Turning on the spot, until the new line lies ahead."""
    LINE_VALIDATION = "LINE_VALIDATION"
    """Standing: is there a line, and does it lead where the chosen road should?"""
    LEAVING_INTERSECTION = "LEAVING_INTERSECTION"
    """Leaving the crossing's middle, on the chosen course."""
    REACQUIRING_LINE = "REACQUIRING_LINE"
    """Looking for the line, after a crossing or after losing it."""
    DEAD_END = "DEAD_END"
    """No way on: the goal has failed."""
    GOAL_REACHED = "GOAL_REACHED"
    """At the end: the goal is done."""


@dataclass(frozen=True, slots=True)
class Facts:
    """All that a transition depends on. Distances in metres of travel; nan: there is none.

    line: believed (k of n pictures) and in keeping with the course. crossing_m, end_m: ahead of the axle, negative
    behind it. straight: whether the crossing has a way straight on, None unknown. unseen_m: travel since a line was
    last seen. in_state_m, in_state_s: since this state began. searched: both sides were looked at in vain.
    """

    line: bool = False
    crossing_m: float = math.nan
    straight: bool | None = None
    end_m: float = math.nan
    unseen_m: float = 0.0
    in_state_m: float = 0.0
    in_state_s: float = 0.0
    searched: bool = False


def transition(state: State, facts: Facts, config: JetBotRouteConfig) -> tuple[State, str]:
    """The next state and why; the same state, with an empty reason, where nothing changes."""
    moving = state not in (State.WAITING_FOR_LINE, State.DEAD_END, State.GOAL_REACHED)
    if moving and facts.end_m <= config.stop_before_end_m:
        return State.GOAL_REACHED, "end of the line"
    match state:
        case State.WAITING_FOR_LINE:
            if facts.line:
                return State.DRIVING_STRAIGHT, "line in both regions"
            if facts.in_state_s > config.wait_for_line_s:
                return State.DEAD_END, f"no line in sight for {config.wait_for_line_s:g} s"
        case State.DRIVING_STRAIGHT:
            if not math.isnan(facts.crossing_m):
                return State.APPROACHING_INTERSECTION, f"crossing in {facts.crossing_m:.2f} m"
            if facts.unseen_m > config.lost_m and math.isnan(facts.end_m):
                return State.REACQUIRING_LINE, f"no line for {facts.unseen_m:.2f} m"
        case State.APPROACHING_INTERSECTION:
            if math.isnan(facts.crossing_m):
                return State.DRIVING_STRAIGHT, "no crossing after all"
            if facts.crossing_m <= 0.0 and facts.straight is False:
                return State.DEAD_END, "the crossing has no way straight on"
            if facts.crossing_m <= 0.0:
                return State.LEAVING_INTERSECTION, "straight on"
        case State.LEAVING_INTERSECTION:
            if facts.in_state_m >= config.clearance_m:
                return State.REACQUIRING_LINE, "clear of the crossing"
        case State.REACQUIRING_LINE:
            if facts.line:
                return State.DRIVING_STRAIGHT, "line found"
            if facts.searched:
                return State.DEAD_END, "the line was lost and is not to be found on either side"
        case _:
            # the others belong to mapped routes, or are final
            pass
    return state, ""
