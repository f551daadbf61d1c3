"""The behaviour: perception, planning and commanding in a row, once a scan."""

from __future__ import annotations

import math
from dataclasses import replace

from robotd import Behaviour, Failed, LidarScan, Odometry, Steer, View, every, latest
from robotd.authoring.behaviour import StepResult
from robotd.authoring.explain import Explanation, Scalar, Text
from robotd.world.clock import NS_PER_S
from robotd.world.geometry import compose
from robotd.world.robot import Robot
from robotd_plugins.behaviours.ftg_race.body import body_of
from robotd_plugins.behaviours.ftg_race.commanding import (
    GRAVITY_MPS2,
    SpeedPolicy,
    SteeringSmoother,
    iir_time_constant_s,
)
from robotd_plugins.behaviours.ftg_race.config import FtgRaceConfig, RaceGoal
from robotd_plugins.behaviours.ftg_race.line.lap_two import LapTwo
from robotd_plugins.behaviours.ftg_race.perception import ScanPreprocessor
from robotd_plugins.behaviours.ftg_race.planner_baseline import PlannerBaseline
from robotd_plugins.behaviours.ftg_race.planner_ftg import PlannerFTG, planner_of
from robotd_plugins.behaviours.ftg_race.planning_types import Command, Motion, Planner, Scan
from robotd_plugins.behaviours.ftg_race.recovery import Recovery, State
from robotd_plugins.behaviours.ftg_race.way_since import WaySince
from robotd_plugins.toolkit.race_track import Located, RaceTrack

_CYCLE_S = 0.1
"""The seed's loop, to which its filter's beta belongs."""
_ALL_ROUND_RAD = math.pi
_TICKS_HZ = 50
_LEAST_NS = NS_PER_S // 100
_FAST_S = 0.03
"""Scans that come as fast as this are planned once each; between slower ones the car's own motion is followed."""


class Sees(View, hz=_TICKS_HZ):
    """Each scan wakes a step, and between slow scans time does. Without odometry the car is taken to do as told."""

    scan: LidarScan = every(within_s=0.25)
    odometry: Odometry | None = latest(within_s=0.25)
    track: RaceTrack | None = latest()
    located: Located | None = latest(within_s=0.25)


class FtgRace(Behaviour[FtgRaceConfig, Sees, RaceGoal]):
    """Races without a map, and from lap 2 on along the line that it has learned. FAILED where it is stuck for good."""

    emits = Steer

    def __init__(self, config: FtgRaceConfig, goal: RaceGoal | None = None, robot: Robot | None = None) -> None:
        super().__init__(config, goal, robot)
        self._body = body_of(self.robot, config.vehicle_width_m)
        grip = config.mu * GRAVITY_MPS2
        self._policy = SpeedPolicy(
            top_mps=config.v_max_mps,
            stop_distance_m=config.stop_distance_m,
            front_gain_ps=config.front_gain_ps,
            steer_slowdown_mps_per_rad=config.steer_slowdown_mps_per_rad,
            target_gain_ps=config.target_gain_ps,
            accel_mps2=min(config.accel_mps2, 0.95 * grip),
            brake_mps2=min(config.brake_mps2, 0.95 * grip),
            grip_mps2=0.972 * grip,
            accel_response_s=config.accel_response_s,
            brake_response_s=config.brake_response_s,
            settle_s=0.06,
        )
        smoother = SteeringSmoother(
            self._body, iir_time_constant_s(config.steer_iir_beta, _CYCLE_S), config.steer_rate_radps
        )
        self._planner: Planner = (
            PlannerBaseline(config, self._body, self._policy)
            if config.planner == "baseline"
            else planner_of(config, self._body, self._policy, smoother)
        )
        self._lap_two = (
            LapTwo(config, self._body, self._policy, self._planner)
            if config.learn and isinstance(self._planner, PlannerFTG)
            else None
        )
        is_seed = config.planner == "baseline" or config.method == "patches"
        self._preprocessor = ScanPreprocessor(
            config.angle_step_rad, config.fov_rad if is_seed else _ALL_ROUND_RAD, config.range_min_m,
            config.range_max_m, config.median_bins, config.confirm_single,
        )  # fmt: skip
        self._recovery = Recovery(config, self._body)
        self._way = WaySince(config.rear_slip_rad / grip)
        self._period_s = _CYCLE_S
        self._scan: Scan | None = None
        self._stamp_ns: int | None = None
        self._planned_ns = 0
        self._told = Command(0.0, 0.0)

    def step(self, seen: Sees) -> StepResult:
        is_new = seen.scan.stamp_ns != self._stamp_ns
        told = self._told
        if seen.odometry is not None:
            v, w = seen.odometry.vx_mps, seen.odometry.wz_radps
        else:
            v, w = told.speed_mps, told.speed_mps * told.curvature_pm
        self._way.add(seen.now_ns, v, w)
        if not is_new and (self._period_s <= _FAST_S or seen.now_ns - self._planned_ns < _LEAST_NS):
            return Steer(told.speed_mps, told.steering_rad)
        motion = self._motion(seen, v, w, is_new)
        if is_new or self._scan is None:
            self._scan = self._preprocessor.process(seen.scan, motion)
        else:
            self._scan = replace(self._scan, motion=motion)
        self._planned_ns = seen.now_ns
        return self._act(self._scan, self._on_line(self._scan, seen))

    @property
    def driven_by(self) -> str:
        """The learned line, or follow-the-gap and why."""
        return self._lap_two.driven_by if self._lap_two is not None else "follow-the-gap"

    def _on_line(self, scan: Scan, seen: Sees) -> Command | None:
        """What the learned line asks for, if it may."""
        if self._lap_two is None or self._recovery.state is not State.RACE:
            return None
        at = seen.located
        base_track = None
        if at is not None:
            base_track = compose((at.x_m, at.y_m, at.yaw_rad), self._way.since(at.stamp_ns, seen.scan.stamp_ns))
        return self._lap_two.plan(scan, seen.now_ns, seen.track, at, base_track)

    def _act(self, scan: Scan, on_line: Command | None) -> StepResult:
        motion = scan.motion
        command = self._recovery.step(scan, self._planner.plan(scan) if on_line is None else on_line)
        if self._recovery.state is State.FAILED:
            return Failed(f"stuck: tried {self.config.retries} times to back off from a wall in one place")
        speed = command.speed_mps
        if speed > 0.0:
            v = motion.speed_mps
            lateral = max(abs(v * motion.yaw_rate_radps), abs(command.curvature_pm) * v * v)
            speed = self._policy.ramp(speed, v, self._told.speed_mps, lateral, motion.period_s)
        self._told = replace(command, speed_mps=speed)
        return Steer(speed, command.steering_rad)

    def _motion(self, seen: Sees, v: float, w: float, is_new: bool) -> Motion:
        """The car's motion now; the period adapts to the scans as they come."""
        scan = seen.scan
        if is_new:
            if self._stamp_ns is not None and scan.stamp_ns > self._stamp_ns:
                passed = min((scan.stamp_ns - self._stamp_ns) / NS_PER_S, 0.3)
                # at once where they come slower, gently where they come faster
                self._period_s = max(passed, self._period_s + 0.2 * (passed - self._period_s))
            self._stamp_ns = scan.stamp_ns
        age = max(0.0, (seen.now_ns - scan.stamp_ns) / NS_PER_S)
        sweep = max(0.0, (scan.stamp_ns - scan.start_ns) / NS_PER_S) if scan.start_ns else 0.0
        hold = self._period_s if self._period_s <= _FAST_S else 1.0 / _TICKS_HZ
        moved = self._way.since(scan.stamp_ns, seen.now_ns)
        return Motion(v, w, age, hold, moved, min(sweep, 0.3), self._told.curvature_pm)

    def explain(self) -> Explanation:
        return (
            *self._planner.explain(),
            *(self._lap_two.explain() if self._lap_two is not None else ()),
            Text("state", self._recovery.state.value),
            Scalar("speed told", self._told.speed_mps, "m/s"),
            Scalar("steering told", self._told.steering_rad, "rad"),
        )
