"""The perceptor: scans and what the wheels tell in, one `TrackSurvey` out when a lap has met its beginning."""

from __future__ import annotations

import math

from robotd import LidarScan, Odometry, Perceptor, View, every, latest
from robotd.authoring.explain import Explanation, Path, Scalar, Text
from robotd.world.geometry import compose, inverse
from robotd.world.kinematics import Ackermann
from robotd.world.messages import ActiveGoal, Applied
from robotd.world.robot import Robot
from robotd_plugins.perception.track_survey.config import TrackSurveyConfig
from robotd_plugins.perception.track_survey.survey import Survey
from robotd_plugins.toolkit.race_track import TrackSurvey
from robotd_plugins.toolkit.scan_motion import CarMotion

_HZ = 50
_DRAWN = 60


class Sees(View, hz=_HZ):
    """Each scan; between scans, what wheels tell or, without odometry, what they were commanded."""

    scan: LidarScan = every(within_s=0.25)
    odometry: Odometry | None = latest(within_s=0.25)
    applied: Applied | None = latest(within_s=1.0)
    goal: ActiveGoal | None = latest()


class TrackSurveyor(Perceptor[TrackSurveyConfig, Sees, TrackSurvey]):
    """Surveys the first laps of each goal, publishes each once, and rests."""

    def __init__(self, config: TrackSurveyConfig, robot: Robot | None = None) -> None:
        super().__init__(config, robot)
        kinematics = self.robot.kinematics
        wheelbase_m = kinematics.wheelbase_m if isinstance(kinematics, Ackermann) else math.inf
        self._survey = Survey(config)
        self._motion = CarMotion(wheelbase_m, config.command_lag_s)
        self._stamp_ns: int | None = None
        self._goal_ns: int | None = None

    def step(self, seen: Sees) -> TrackSurvey | None:
        goal_ns = seen.goal.stamp_ns if seen.goal is not None else None
        if goal_ns != self._goal_ns:
            self._goal_ns, self._survey.attempt = goal_ns, 0
            self._survey.begin("a new goal")
        if self._survey.attempt >= self.config.attempts:
            return None
        self._motion.hear(seen.now_ns, seen.odometry, seen.applied.command if seen.applied is not None else None)
        if seen.scan.stamp_ns == self._stamp_ns:
            return None
        self._stamp_ns = seen.scan.stamp_ns
        found = self._survey.step(seen.scan, self._motion)
        if found is not None:
            self._survey.begin("rests" if found.attempt == self.config.attempts else "once more")
        return found

    def explain(self) -> Explanation:
        survey = self._survey
        here = inverse(survey.odometry.pose)
        driven = tuple(compose(here, key.pose)[:2] for key in survey.keys[-_DRAWN:])
        match = survey.odometry.match
        share = match.explained_share if match is not None else math.nan
        return (
            Text("track_survey", survey.why),
            Path("surveyed", driven),
            Scalar("survey explained", share),
            Scalar("survey sigma", survey.odometry.sigma_m, "m"),
        )
