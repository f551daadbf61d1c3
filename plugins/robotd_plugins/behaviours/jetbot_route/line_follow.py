"""Driving without a map: along the line, straight on at crossings, to the line's end."""

from __future__ import annotations

import logging
import math

from robotd import Done, Drive
from robotd.authoring.behaviour import Failed, StepResult
from robotd.authoring.explain import Drawing, Explanation, Text
from robotd_plugins.behaviours.jetbot_route.config import JetBotRouteConfig
from robotd_plugins.behaviours.jetbot_route.course import Course
from robotd_plugins.behaviours.jetbot_route.drawing import draw_line, draw_place
from robotd_plugins.behaviours.jetbot_route.sees import Sees
from robotd_plugins.behaviours.jetbot_route.states import Facts, State, transition
from robotd_plugins.behaviours.jetbot_route.steer import LineAhead
from robotd_plugins.behaviours.jetbot_route.tracker import Search, Tracker

log = logging.getLogger("robotd.jetbot_route")

_JUMP_M = 0.06
_MOVING = (State.DRIVING_STRAIGHT, State.APPROACHING_INTERSECTION, State.LEAVING_INTERSECTION, State.REACQUIRING_LINE)


class LineFollow:
    """Follows the line; the state machine is `transition`, everything it depends on is in `Facts`."""

    def __init__(self, config: JetBotRouteConfig) -> None:
        self.config = config
        self.state = State.WAITING_FOR_LINE
        self.reason = "started"
        self._tracker = Tracker(config, Course())
        self._search = Search()
        self._passed_m = -math.inf
        self._since_m = 0.0
        self._since_ns: int | None = None
        self._looked_ns = -1
        self._accept_rad = math.pi / 2.0

    def step(self, seen: Sees) -> StepResult:
        """One decision."""
        if self._since_ns is None:
            self._since_ns = seen.now_ns
        tracker = self._tracker
        tracker.travel(seen.odometry)
        if seen.line.stamp_ns != self._looked_ns:
            self._looked_ns = seen.line.stamp_ns
            tracker.look(
                seen.line,
                self._agrees,
                steady=self.state is State.DRIVING_STRAIGHT,
                crossing_counts=lambda at_m: at_m - self._passed_m >= self.config.crossing_distance_m,
            )
        state, reason = transition(self.state, self._facts(seen.now_ns), self.config)
        if state is not self.state:
            self._enter(state, reason, seen.now_ns)
        if self.state is State.GOAL_REACHED:
            return Done(self.reason)
        if self.state is State.DEAD_END:
            return Failed(self.reason)
        return self._command()

    def explain(self) -> Explanation:
        """State, line, crossing and end."""
        tracker, reading_m = self._tracker, self._tracker.travelled_m
        drawn: list[Drawing] = [Text("state", self.state.value), Text("because", self.reason)]
        drawn += draw_line(tracker)
        drawn += draw_place("crossing", tracker.crossing.at_m - reading_m)
        drawn += draw_place("end", tracker.end.at_m - reading_m)
        return tuple(drawn)

    def _agrees(self, ahead: LineAhead, course_rad: float) -> bool:
        """Whether this line may be the one that is followed."""
        off_rad = abs(math.remainder(ahead.heading_rad - course_rad, math.tau))
        if self.state is State.REACQUIRING_LINE:
            return off_rad <= self._accept_rad
        if self.state in (State.APPROACHING_INTERSECTION, State.LEAVING_INTERSECTION):
            # on a crossing its bars look like lines that lead elsewhere
            return off_rad <= self.config.reacquire_heading_rad and abs(ahead.left_m) <= _JUMP_M
        return True

    def _facts(self, now_ns: int) -> Facts:
        tracker = self._tracker
        return Facts(
            line=tracker.line.believed,
            crossing_m=tracker.crossing.at_m - tracker.travelled_m,
            straight=tracker.crossing.straight,
            end_m=tracker.end.at_m - tracker.travelled_m,
            unseen_m=tracker.unseen_m,
            in_state_m=tracker.travelled_m - self._since_m,
            in_state_s=(now_ns - (self._since_ns or now_ns)) / 1e9,
            searched=self._search.ended,
        )

    def _enter(self, state: State, reason: str, now_ns: int) -> None:
        log.info("%s -> %s: %s", self.state.value, state.value, reason)
        tracker = self._tracker
        before, self.state, self.reason = self.state, state, reason
        self._since_m, self._since_ns = tracker.travelled_m, now_ns
        if state is State.LEAVING_INTERSECTION:
            self._passed_m = tracker.crossing.at_m
            tracker.crossing.clear()
        if state is State.REACQUIRING_LINE:
            after_crossing = before is State.LEAVING_INTERSECTION
            self._accept_rad = self.config.reacquire_heading_rad if after_crossing else math.pi / 2.0
            tracker.line.clear()
            self._search = Search()

    def _command(self) -> Drive:
        if self.state not in _MOVING:
            return Drive()
        config, tracker = self.config, self._tracker
        looks = self.state is State.REACQUIRING_LINE and (self._search.begun or tracker.unseen_m >= config.reacquire_m)
        if looks and tracker.ahead is None:
            return self._search.command(tracker)
        speed_mps = config.base_speed_mps
        end_m = tracker.end.at_m - tracker.travelled_m - config.stop_before_end_m
        if not math.isnan(end_m):
            speed_mps = min(speed_mps, config.slow_speed_mps + max(end_m, 0.0))
        return tracker.along(speed_mps)
