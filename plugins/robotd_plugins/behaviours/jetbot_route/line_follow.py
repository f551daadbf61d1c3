"""The behaviour in its line-following form: along the line, straight on at crossings, to the line's end."""

from __future__ import annotations

import logging
import math
from typing import ClassVar

from robotd import Behaviour, Done, Drive, Odometry, View, every, needed
from robotd.authoring.behaviour import Failed, StepResult
from robotd.authoring.explain import Explanation, Line, Points, Scalar, Text
from robotd.world.robot import Robot
from robotd_plugins.behaviours.jetbot_route.config import JetBotRouteConfig, JetBotRouteGoal
from robotd_plugins.behaviours.jetbot_route.evidence import Place, Votes
from robotd_plugins.behaviours.jetbot_route.states import Facts, State, transition
from robotd_plugins.behaviours.jetbot_route.steer import LineAhead, curvature_pm, drive, learned_drift_pm, line_ahead
from robotd_plugins.toolkit.line_seen import LineSeen

log = logging.getLogger("robotd.jetbot_route")

_SIGHT_M = (0.18, 0.30)
"""Where a crossing or an end is seen in every picture, ahead of the axle."""
_COURSE_KEEPS = 0.5
_JUMP_M = 0.06
_AIMED_RAD = 0.05
_ODOMETRY_JUMP_M = 0.5
_MOVING = (State.DRIVING_STRAIGHT, State.APPROACHING_INTERSECTION, State.LEAVING_INTERSECTION, State.REACQUIRING_LINE)


class Sees(View):
    """Each look at the line, with the odometry of that moment."""

    line: LineSeen = every(within_s=0.25)
    odometry: Odometry = needed(within_s=0.1)


class JetBotRoute(Behaviour[JetBotRouteConfig, Sees, JetBotRouteGoal]):
    """Follows the line; the state machine is `transition`, everything it depends on is in `Facts`."""

    blind_after_s: ClassVar[float | None] = 2.0

    def __init__(
        self, config: JetBotRouteConfig, goal: JetBotRouteGoal | None = None, robot: Robot | None = None
    ) -> None:
        super().__init__(config, goal, robot)
        k, n = config.confirm_frames, config.of_frames
        self.state = State.WAITING_FOR_LINE
        self.reason = "started"
        self._line_votes = Votes(k, n)
        self._crossing = Place(k, n, config.place_tolerance_m, _SIGHT_M)
        self._end = Place(k, n, config.place_tolerance_m, _SIGHT_M)
        self._passed_m = -math.inf
        self._travelled_m = 0.0
        self._odometry: Odometry | None = None
        self._seen_m = 0.0
        self._since_m = 0.0
        self._since_ns: int | None = None
        self._course_rad = 0.0
        self._accept_rad = math.pi / 2.0
        self._ahead: LineAhead | None = None
        self._last_left_m = 0.0
        self._drift_pm = 0.0
        self._driven_m = 0.0
        self._search: list[float] = []
        self._searched = False

    def step(self, seen: Sees) -> StepResult:
        if self._since_ns is None:
            self._since_ns, self._course_rad = seen.now_ns, seen.odometry.yaw_rad
        self._travel(seen.odometry)
        self._perceive(seen)
        state, reason = transition(self.state, self._facts(seen.now_ns), self.config)
        if state is not self.state:
            self._enter(state, reason, seen.now_ns)
        if self.state is State.GOAL_REACHED:
            return Done(self.reason)
        if self.state is State.DEAD_END:
            return Failed(self.reason)
        return self._command(seen.odometry)

    def explain(self) -> Explanation:
        facts = self._facts(self._since_ns or 0)
        drawn: list[Text | Scalar | Line | Points] = [Text("state", self.state.value), Text("because", self.reason)]
        if self._ahead is not None:
            left_m, slope = self._ahead.left_m, math.tan(self._ahead.heading_rad)
            reach_m = self.config.reach_m
            drawn.append(Line("line", (0.0, left_m), (reach_m, left_m + reach_m * slope)))
            drawn.append(Scalar("lateral error", left_m, "m"))
            drawn.append(Scalar("heading error", self._ahead.heading_rad, "rad"))
        for name, distance_m in (("crossing", facts.crossing_m), ("end", facts.end_m)):
            if not math.isnan(distance_m):
                drawn += [Points(name, ((distance_m, 0.0),)), Scalar(f"{name} ahead", distance_m, "m")]
        drawn.append(Scalar("travelled", self._travelled_m, "m"))
        return tuple(drawn)

    # ------------------------------------------------------------------------------------ what it knows

    def _travel(self, odometry: Odometry) -> None:
        before, self._odometry, self._driven_m = self._odometry, odometry, 0.0
        if before is None:
            return
        x_m, y_m = odometry.x_m - before.x_m, odometry.y_m - before.y_m
        step_m = x_m * math.cos(odometry.yaw_rad) + y_m * math.sin(odometry.yaw_rad)
        if abs(step_m) < _ODOMETRY_JUMP_M:
            # a larger step is a base that began to count anew
            self._travelled_m += step_m
            self._driven_m = step_m

    def _perceive(self, seen: Sees) -> None:
        line, odometry, config = seen.line, seen.odometry, self.config
        age_s = (odometry.stamp_ns - line.stamp_ns) / 1e9
        yaw_rad = odometry.yaw_rad - odometry.wz_radps * age_s
        at_m = self._travelled_m - odometry.vx_mps * age_s
        course_rad = math.remainder(self._course_rad - yaw_rad, math.tau)
        ahead = line_ahead(line, course_rad, config.picture_half_width_m)
        if ahead is not None and not self._agrees(ahead, course_rad):
            ahead = None
        self._ahead = ahead
        both = ahead is not None and line.near.is_seen and line.far.is_seen
        self._line_votes.cast(both)
        if ahead is not None:
            self._seen_m = self._travelled_m
            self._last_left_m = ahead.left_m
        if both and ahead is not None:
            # the course is the line's direction in the frame of odometry
            off_rad = math.remainder(yaw_rad + ahead.heading_rad - self._course_rad, math.tau)
            self._course_rad += (1.0 - _COURSE_KEEPS) * off_rad
            if self.state is State.DRIVING_STRAIGHT:
                self._drift_pm = learned_drift_pm(self._drift_pm, ahead, self._driven_m, self.config)
        bar = line.bar
        if bar is not None and at_m + bar.ahead_m - self._passed_m < config.crossing_distance_m:
            bar = None
        self._crossing.look(at_m, bar.ahead_m if bar is not None else None, bar.straight if bar is not None else None)
        self._end.look(at_m, line.end.ahead_m if line.end is not None else None)

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
        return Facts(
            line=self._line_votes.believed,
            crossing_m=self._crossing.at_m - self._travelled_m,
            straight=self._crossing.straight,
            end_m=self._end.at_m - self._travelled_m,
            unseen_m=self._travelled_m - self._seen_m,
            in_state_m=self._travelled_m - self._since_m,
            in_state_s=(now_ns - (self._since_ns or now_ns)) / 1e9,
            searched=self._searched,
        )

    def _enter(self, state: State, reason: str, now_ns: int) -> None:
        log.info("%s -> %s: %s", self.state.value, state.value, reason)
        before, self.state, self.reason = self.state, state, reason
        self._since_m, self._since_ns = self._travelled_m, now_ns
        if state is State.LEAVING_INTERSECTION:
            self._passed_m = self._crossing.at_m
            self._crossing.clear()
        if state is State.REACQUIRING_LINE:
            after_crossing = before is State.LEAVING_INTERSECTION
            self._accept_rad = self.config.reacquire_heading_rad if after_crossing else math.pi / 2.0
            self._line_votes.clear()
            self._search, self._searched = [], False

    # ------------------------------------------------------------------------------------ what it does

    def _command(self, odometry: Odometry) -> Drive:
        if self.state not in _MOVING:
            return Drive()
        config = self.config
        unseen_m = self._travelled_m - self._seen_m
        looks = self.state is State.REACQUIRING_LINE and (self._search or unseen_m >= config.reacquire_m)
        if looks and self._ahead is None:
            return self._look_about(odometry)
        ahead, speed_mps = self._ahead, config.base_speed_mps
        if ahead is None:
            # keep the direction, without a word about the place
            off_rad = math.remainder(self._course_rad - odometry.yaw_rad, math.tau)
            ahead, speed_mps = LineAhead(0.0, off_rad), config.slow_speed_mps
        end_m = self._end.at_m - self._travelled_m - config.stop_before_end_m
        if not math.isnan(end_m):
            speed_mps = min(speed_mps, config.slow_speed_mps + max(end_m, 0.0))
        return drive(speed_mps, curvature_pm(ahead, config) + self._drift_pm, config)

    def _look_about(self, odometry: Odometry) -> Drive:
        """Turn on the spot: first to the side where the line was last, then to the other, then back."""
        if not self._search:
            first = math.copysign(self.config.search_rad, self._last_left_m)
            self._search = [first, -first, 0.0]
        off_rad = math.remainder(self._course_rad + self._search[0] - odometry.yaw_rad, math.tau)
        if abs(off_rad) < _AIMED_RAD:
            self._search.pop(0)
            if not self._search:
                self._searched = True
                return Drive()
            off_rad = math.remainder(self._course_rad + self._search[0] - odometry.yaw_rad, math.tau)
        return Drive(wz_radps=math.copysign(self.config.turn_speed_radps, off_rad))
