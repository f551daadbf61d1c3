"""Driving a mapped route: from node to node by line, lidar and distance, turning at each as the plan says."""

from __future__ import annotations

import logging
import math

from robotd import Done, Drive, LidarScan
from robotd.authoring.behaviour import Failed, StepResult
from robotd.authoring.explain import Drawing, Explanation, Path, Scalar, Text
from robotd_plugins.behaviours.jetbot_route.belief import Belief
from robotd_plugins.behaviours.jetbot_route.compass import Compass, Turn
from robotd_plugins.behaviours.jetbot_route.config import JetBotRouteConfig
from robotd_plugins.behaviours.jetbot_route.course import StraightCourse
from robotd_plugins.behaviours.jetbot_route.drawing import draw_line, draw_place
from robotd_plugins.behaviours.jetbot_route.lidar_ear import LidarEar
from robotd_plugins.behaviours.jetbot_route.mission import Mission
from robotd_plugins.behaviours.jetbot_route.node_cues import Cues, NodeSeen, fuse
from robotd_plugins.behaviours.jetbot_route.route_map import MapScale, NodeForm
from robotd_plugins.behaviours.jetbot_route.route_states import RouteFacts, route_transition
from robotd_plugins.behaviours.jetbot_route.sees import Sees
from robotd_plugins.behaviours.jetbot_route.states import State
from robotd_plugins.behaviours.jetbot_route.steer import LineAhead
from robotd_plugins.behaviours.jetbot_route.tracker import Search, Tracker
from robotd_plugins.behaviours.jetbot_route.turning import Turning, TurnSettings

log = logging.getLogger("robotd.jetbot_route")

_STILL_MPS = 0.01
_STILL_RADPS = 0.05
_CREEP_MPS = 0.04
_DRAWN_NODES = 12
_MOVING = (State.DRIVING_STRAIGHT, State.APPROACHING_INTERSECTION, State.LEAVING_INTERSECTION, State.REACQUIRING_LINE)
_ON_ROAD = (State.DRIVING_STRAIGHT, State.APPROACHING_INTERSECTION, State.LEAVING_INTERSECTION)
_RESTING = (State.HANDLING_EVENT, State.LINE_VALIDATION)


class RouteDrive:
    """One goal on a map; the state machine is `route_transition`, everything it depends on is in `RouteFacts`."""

    def __init__(self, config: JetBotRouteConfig, mission: Mission) -> None:
        self.config = config
        self.mission = mission
        self.state = State.WAITING_FOR_LINE
        self.reason = "started"
        self.visited: list[str] = []
        """Nodes that the robot believes to have reached, in order; the start is not among them."""
        self._tracker = Tracker(config, StraightCourse(), mapped=True)
        self._ear = LidarEar(config)
        self._search = Search()
        self._turning: Turning | None = None
        self._tries = 0
        self._belief = Belief(mission.start, scale_std=config.odometry_error_share / 2.0)
        self._heading = mission.heading
        self._done = 0
        self._node: NodeSeen | None = None
        self._told: set[str] = set()
        self._since_m = 0.0
        self._since_ns: int | None = None
        self._rested_ns: int | None = None
        self._looked_ns = -1
        self._aim()

    @property
    def belief(self) -> Belief:
        """Where the robot believes to be."""
        return self._belief

    def step(self, seen: Sees) -> StepResult:
        """One decision."""
        if self._since_ns is None:
            self._since_ns = seen.now_ns
            if self.mission.route is not None:
                log.info("the route: %s", self.mission.route.why)
        self._tracker.travel(seen.odometry)
        self._rest(seen)
        if seen.line.stamp_ns != self._looked_ns:
            self._looked_ns = seen.line.stamp_ns
            self._look(seen)
        self._listen(seen.scan)
        self._node = self._fuse()
        state, reason = route_transition(self.state, self._facts(seen.now_ns), self.config)
        if state is not self.state:
            self._enter(state, reason, seen.now_ns)
        if self.state is State.GOAL_REACHED:
            return Done(f"GOAL_REACHED: {self.reason}")
        if self.state is State.DEAD_END:
            return Failed(self.reason)
        return self._command()

    # ------------------------------------------------------------------------------------------ the plan

    @property
    def _turn(self) -> Turn | None:
        """What is to be done at the node where the robot is."""
        route = self.mission.route
        return route.actions[self._done] if route is not None and self._done < len(route.actions) else None

    def _aim(self) -> None:
        """The edge after the node where the robot is, as the route has it."""
        route = self.mission.route
        if route is not None and self._done < len(route.actions):
            edge = self.mission.map.edge(route.nodes[self._done], route.nodes[self._done + 1])
            assert edge is not None
            self._belief = self._belief.towards(edge.target, edge.length * self.config.pitch_m)

    def _form(self) -> NodeForm | None:
        """How the tape looks at the next node."""
        node = self._belief.next_node
        return None if node is None else self.mission.map.form(node)

    def _is_passed(self) -> bool:
        """Whether nothing is to be seen or done at the next node: tape that goes straight on, and so does the plan."""
        route = self.mission.route
        assert route is not None
        after = route.actions[self._done + 1] if self._done + 1 < len(route.actions) else None
        return self._form() is NodeForm.PASSAGE and after is Turn.STRAIGHT

    # ------------------------------------------------------------------------------------- what it knows

    def _rest(self, seen: Sees) -> None:
        """Since when the robot has been at rest in a state in which it rests."""
        odometry = seen.odometry
        moves = abs(odometry.vx_mps) > _STILL_MPS or abs(odometry.wz_radps) > _STILL_RADPS
        if self.state not in _RESTING or moves:
            self._rested_ns = None
        elif self._rested_ns is None:
            self._rested_ns = odometry.stamp_ns

    def _look(self, seen: Sees) -> None:
        line, tracker = seen.line, self._tracker
        if self.state is State.TURNING:
            if (
                self._turning is not None
                and line.near.is_seen
                and line.far.is_seen
                and not math.isnan(line.heading_rad)
            ):
                age_s = (seen.odometry.stamp_ns - line.stamp_ns) / 1e9
                self._turning.look(tracker.turned_rad - seen.odometry.wz_radps * age_s, line.heading_rad)
            return
        if self.state is State.LINE_VALIDATION:
            settled_ns = None if self._rested_ns is None else self._rested_ns + round(self.config.settle_s * 1e9)
            if settled_ns is None or line.stamp_ns < settled_ns:
                # the picture is older than the turn's end
                return
        tracker.look(
            line,
            self._agrees,
            steady=self.state is State.DRIVING_STRAIGHT,
            crossing_counts=lambda at_m: self._may_be(at_m, "a crossing", self._form() is not NodeForm.PASSAGE),
            end_counts=lambda at_m: self._may_be(at_m, "an end of the line", self._line_ends()),
        )

    def _agrees(self, ahead: LineAhead, course_rad: float) -> bool:
        """Whether this line may be the road: roads are straight, and stay where they are; arms and shadows do not."""
        off_rad = abs(math.remainder(ahead.heading_rad - course_rad, math.tau))
        if self.state in _ON_ROAD:
            moved_m = abs(ahead.left_m - self._tracker.left_m)
            return off_rad <= self.config.road_heading_rad and moved_m <= self.config.road_jump_m
        return off_rad <= self.config.reacquire_heading_rad

    def _line_ends(self) -> bool:
        """Whether the map has no tape straight on at the next node."""
        node, route = self._belief.next_node, self.mission.route
        return node is not None and route is not None and route.headings[self._done] not in self.mission.map.arms(node)

    def _may_be(self, at_m: float, what: str, possible: bool) -> bool:
        """Whether something seen may be the next node; what may not is told once an edge."""
        belief = self._belief
        if belief.next_node is None or self.state not in _MOVING:
            return False
        inside = abs(at_m - belief.expected_m) <= belief.half_window_m(self.config.node_tolerance_m)
        if inside and possible:
            return True
        place = f"{belief.progress_m(at_m):.2f} m after node {belief.node}"
        self._tell(what, f"{what} seen {place}; the map has node {belief.next_node} after {belief.edge_m:.2f} m")
        return False

    def _tell(self, what: str, sentence: str) -> None:
        if what not in self._told:
            self._told.add(what)
            log.info("cues disagree: %s", sentence)

    def _listen(self, scan: LidarScan | None) -> None:
        """What the lidar says of the next node."""
        belief = self._belief
        if scan is None or belief.next_node is None or self.state not in _MOVING:
            return
        at_m = self._ear.listen(scan, self._tracker.travelled_m)
        if not math.isnan(at_m):
            self._may_be(at_m, "a crossing by lidar", True)

    def _fuse(self) -> NodeSeen | None:
        belief, tracker = self._belief, self._tracker
        if belief.next_node is None or self.state not in _MOVING:
            return None
        cues = Cues(
            belief.expected_m,
            belief.half_window_m(self.config.node_tolerance_m),
            bar_m=tracker.crossing.at_m,
            end_m=tracker.end.at_m - self.config.stop_before_end_m,
            lidar_m=self._ear.at_m,
            unmarked=self._form() is NodeForm.PASSAGE,
            sure=belief.unsure_m <= self.config.distance_sure_m,
        )
        return fuse(cues, self.config.cues, self.config.distance_near_m)

    def _facts(self, now_ns: int) -> RouteFacts:
        tracker, belief, route = self._tracker, self._belief, self.mission.route
        going = route is not None and belief.next_node is not None
        stops = going and not self._is_passed()
        node_m = math.nan if self._node is None else self._node.at_m - tracker.travelled_m
        if self._node is not None and not self._node.seen and node_m > self.config.node_tolerance_m:
            # nothing to approach yet
            node_m = math.nan
        return RouteFacts(
            node=belief.node,
            next_node=belief.next_node or "",
            refusal=self.mission.refusal,
            at_goal=route is not None and route.is_there,
            line=tracker.line.believed,
            road_ahead=self._heading in self.mission.map.arms(belief.node) if self.mission.start else True,
            node_m=node_m - (self.config.arrive_m if stops else 0.0),
            evidence="" if self._node is None else self._node.why,
            overdue_m=tracker.travelled_m
            - belief.expected_m
            - (belief.half_window_m(self.config.node_tolerance_m) if going else math.nan),
            stops=stops,
            is_goal=route is not None and self._done + 1 == len(route.actions),
            turn=self._turn,
            tries=self._tries,
            turned=None if self._turning is None else self._turning.turned,
            unseen_m=tracker.unseen_m,
            searched=self._search.ended,
            standing=self._rested_ns is not None,
            in_state_m=tracker.travelled_m - self._since_m,
            in_state_s=(now_ns - (self._since_ns or now_ns)) / 1e9,
        )

    # ------------------------------------------------------------------------------------ what changes

    def _enter(self, state: State, reason: str, now_ns: int) -> None:
        log.info("%s -> %s: %s", self.state.value, state.value, reason)
        tracker = self._tracker
        before, self.state, self.reason = self.state, state, reason
        self._since_m, self._since_ns, self._rested_ns = tracker.travelled_m, now_ns, None
        if before is State.APPROACHING_INTERSECTION and state is not State.DRIVING_STRAIGHT:
            self._reach()
        match state:
            case State.LEAVING_INTERSECTION:
                self._leave(before)
            case State.TURNING:
                self._begin_turn(before)
            case State.LINE_VALIDATION:
                self._validate(before)
            case State.REACQUIRING_LINE:
                tracker.line.clear()
                self._search = Search()
            case _:
                pass

    def _reach(self) -> None:
        """The next node was reached, and only now it is the robot's node."""
        node = self._node
        assert node is not None and self._belief.next_node is not None
        self._belief = self._belief.arrived(node.at_m) if node.seen else self._belief.counted()
        self.visited.append(self._belief.node)
        self._done += 1
        self._tries = 0
        self._tracker.crossing.clear()
        self._tracker.end.clear()
        self._ear.clear()
        self._told.clear()
        self._aim()

    def _begin_turn(self, before: State) -> None:
        """Turn to the planned road; looking about for a line that is not there is a turn by nothing, with its slack."""
        config, tracker = self.config, self._tracker
        assert self._turn is not None and tracker.odometry is not None
        # what the robot is off the road it stands on belongs to the turn
        angle_rad = math.remainder(tracker.course.rad - tracker.odometry.yaw_rad, math.tau)
        if before is State.HANDLING_EVENT:
            by_odometry_rad = self._turn.angle_rad / self._belief.scale
            angle_rad += by_odometry_rad
            tracker.course.begin(tracker.course.rad + by_odometry_rad)
            self._heading = self._heading.after(self._turn)
        self._tries += 1
        settings = TurnSettings(angle_rad, config.turn_slack_rad, config.turn_speed_radps, config.reacquire_heading_rad)
        self._turning = Turning(settings, tracker.turned_rad)

    def _validate(self, before: State) -> None:
        tracker = self._tracker
        tracker.line.clear()
        if before is State.TURNING and self._turning is not None:
            assert tracker.odometry is not None
            tracker.course.begin(tracker.odometry.yaw_rad + self._turning.left_rad)
        tracker.seen_m = tracker.travelled_m

    def _leave(self, before: State) -> None:
        if before is State.LINE_VALIDATION and self._turning is not None:
            self._belief = self._belief.left(self._tracker.travelled_m)
        self._turning = None

    # ------------------------------------------------------------------------------------ what it does

    def _command(self) -> Drive:
        config, tracker = self.config, self._tracker
        if self.state is State.TURNING and self._turning is not None:
            return self._turning.command(tracker.turned_rad)
        if self.state not in _MOVING:
            return Drive()
        looks = self.state is State.REACQUIRING_LINE and (self._search.begun or tracker.unseen_m >= config.reacquire_m)
        if looks and tracker.ahead is None:
            return self._search.command(tracker)
        return tracker.along(self._speed_mps())

    def _speed_mps(self) -> float:
        """As fast as it may be here: softly down to a stop before a node at which it stops."""
        speed_mps = self.config.base_speed_mps
        if self.state is not State.APPROACHING_INTERSECTION or self._node is None or self._is_passed():
            return speed_mps
        left_m = max(self._node.at_m - self._tracker.travelled_m - self.config.arrive_m, 0.0)
        return min(speed_mps, max(math.sqrt(2.0 * self.config.brake_mps2 * left_m), _CREEP_MPS))

    # --------------------------------------------------------------------------------------- explaining

    def explain(self) -> Explanation:
        """State and place on the map, what speaks for the next node, the line, and the way that is left."""
        belief, tracker = self._belief, self._tracker
        drawn: list[Drawing] = [
            Text("state", self.state.value),
            Text("because", self.reason),
            Text("node", belief.node),
            Text("next node", belief.next_node or "none"),
            Text("action", "none" if self._turn is None else self._turn.value.replace("_", " ")),
            Text("evidence", "none" if self._node is None else self._node.why),
            Text("lidar", self._ear.said),
            Scalar("progress", belief.progress_m(tracker.travelled_m), "m"),
            Scalar("odometry scale", belief.scale),
        ]
        if belief.next_node is not None:
            drawn.append(Scalar("edge", belief.edge_m, "m"))
        drawn += draw_line(tracker)
        if self._node is not None:
            drawn += draw_place("node", self._node.at_m - tracker.travelled_m)
        drawn += self._way()
        return tuple(drawn)

    def _way(self) -> list[Drawing]:
        """The rest of the route in base, as the belief has it."""
        route, tracker, belief = self.mission.route, self._tracker, self._belief
        if route is None or tracker.odometry is None or belief.next_node is None:
            return []
        scale = MapScale.at(self.mission.map.node(belief.node), self.config.pitch_m)
        left_m = 0.0 if tracker.ahead is None else tracker.ahead.left_m
        moving = self.state in _MOVING
        progress_m = belief.progress_m(tracker.travelled_m) if moving else 0.0
        # from the map frame into that of the road, then into base
        yaw_rad = math.remainder(tracker.course.rad - tracker.odometry.yaw_rad, math.tau) - self._heading.yaw_rad
        cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
        back = Compass(self._heading).yaw_rad
        x0_m, y0_m = progress_m * math.cos(back), progress_m * math.sin(back)
        points = []
        for node in route.nodes[self._done : self._done + _DRAWN_NODES]:
            x_m, y_m = scale.to_map_m(self.mission.map.node(node).x, self.mission.map.node(node).y)
            x_m, y_m = x_m - x0_m, y_m - y0_m
            points.append((cos * x_m - sin * y_m, sin * x_m + cos * y_m + left_m))
        return [Path("route", tuple(points))]
