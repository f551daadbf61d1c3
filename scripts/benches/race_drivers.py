"""The behaviour `ftg_race` at the wheel of the race plant: its own steps, called without the runtime."""

from __future__ import annotations

import re
import time
from collections import Counter
from typing import Any

import numpy as np

from benches.race_plant import NS, Driver
from robotd.world.kinematics import Ackermann
from robotd.world.messages import LidarScan, Message, Odometry, Steer
from robotd.world.robot import Robot
from robotd_devices.sim.single_track import F1TENTH, TT02D, RaceCar
from robotd_plugins.behaviours.ftg_race import FtgRace, FtgRaceConfig, Sees
from robotd_plugins.behaviours.ftg_race.line.lap_two import LINE
from robotd_plugins.perception import race_track, track_position, track_survey
from robotd_plugins.toolkit.race_track import Located, RaceTrack

_NUMBER = re.compile(r"-?\d+(\.\d+)?")
SOLVE_S = 3.0
"""The survey is a track and a line so much later, as the perceptor declares for virtual time."""

_SHARED = ("v_max_mps", "mu")

TT02D_KEYS: dict[str, Any] = {
    "v_max_mps": 5.0,
    "mu": 0.85,
    "accel_mps2": 4.0,
    "brake_mps2": 4.5,
    "accel_response_s": 0.167,
    "brake_response_s": 0.1,
    "actuation_s": 0.12,
    "understeer_rad": 0.0275,
    "can_reverse": False,
}
"""Config keys of the TT-02D, as in configs/tt02d.yaml."""


def robot_of(car: RaceCar) -> Robot:
    """The car as a robot's config would describe it."""
    kinematics = Ackermann(car.wheelbase_m, car.width_m, car.max_steering_rad)
    return Robot("car", kinematics, car.footprint_m())


class Learning:
    """The three perceptors of lap 2, called in the runtime's order; what is solved appears `late_s` later.

    keys: of the perceptor `race_track`.
    """

    def __init__(self, robot: Robot, late_s: float = SOLVE_S, **keys: Any) -> None:
        self._survey = track_survey.TrackSurveyor(track_survey.TrackSurveyConfig(), robot)
        self._learn = race_track.RaceTrackLearner(race_track.RaceTrackConfig(**keys), robot)
        self._position = track_position.TrackPosition(track_position.TrackPositionConfig(), robot)
        self._late_ns = round(late_s * NS)
        self._waiting: list[tuple[int, RaceTrack]] = []
        self.track: RaceTrack | None = None
        self.located: Located | None = None
        self.took_us: list[float] = []
        self.solve_s: list[float] = []

    def step(self, scan: LidarScan, odometry: Odometry, now_ns: int, is_new: bool) -> None:
        while self._waiting and self._waiting[0][0] <= now_ns:
            self.track = self._waiting.pop(0)[1]
        told = {"scan": scan, "odometry": odometry, "applied": None}
        begin = time.thread_time_ns()
        survey = self._survey.step(track_survey.Sees.assemble(now_ns, {**told, "goal": None}))
        located = self._position.step(track_position.Sees.assemble(now_ns, {**told, "track": self.track}))
        if is_new:
            self.took_us.append((time.thread_time_ns() - begin) / 1e3)
        self.located = located or self.located
        if survey is not None:
            begin = time.thread_time_ns()
            track = self._learn.step(race_track.Sees.assemble(now_ns, {"survey": survey}))
            self.solve_s.append((time.thread_time_ns() - begin) / 1e9)
            if track is not None:
                self._waiting.append((now_ns + self._late_ns, track))


class Behaving:
    """A driver made of the behaviour; keeps how long each step took, in microseconds of this thread's CPU.

    learn: with the perceptors of lap 2; without, the car races by follow-the-gap for ever. What `keys` say of the top
    speed and the floor is said to the line's perceptor too, as in the shipped configs.
    """

    ticks = True

    def __init__(self, car: RaceCar = F1TENTH, learn: bool = False, **keys: Any) -> None:
        if car is TT02D:
            keys = {**TT02D_KEYS, **keys}
        self.behaviour = FtgRace(FtgRaceConfig(**keys), None, robot_of(car))
        shared = {key: value for key, value in keys.items() if key in _SHARED}
        self.learning = Learning(robot_of(car), **shared) if learn else None
        self.views: list[Sees] | None = None
        """Where a list is put here, each view is kept in it."""
        self.took_us: list[float] = []
        self.failed = ""
        self._scan: LidarScan | None = None
        self._by: Counter[str] = Counter()

    @property
    def is_on_line(self) -> bool:
        """Whether the last command was one on the learned line."""
        return self.behaviour.driven_by == LINE

    def line_told(self) -> dict[str, Any]:
        """Since there is a line: the share of steps driven on it, why the others were not, and what the rest costs."""
        steps = max(self._by.total(), 1)
        why = {reason: count / steps for reason, count in self._by.most_common(6) if reason != LINE}
        learning = self.learning
        assert learning is not None
        return {
            "share": self._by[LINE] / steps, "why_not": why, "solve_s": learning.solve_s,
            "perceptors_us": [float(np.percentile(learning.took_us, q)) for q in (50, 99)],
        }  # fmt: skip

    def __call__(self, scan: LidarScan, odometry: Odometry, now_ns: int) -> Steer | None:
        is_new = scan is not self._scan
        self._scan = scan
        learned: dict[str, Message | None] = {"track": None, "located": None}
        if self.learning is not None:
            self.learning.step(scan, odometry, now_ns, is_new)
            learned = {"track": self.learning.track, "located": self.learning.located}
        seen = Sees.assemble(now_ns, {"scan": scan, "odometry": odometry, **learned})
        if self.views is not None:
            self.views.append(seen)
        begin = time.thread_time_ns()
        result = self.behaviour.step(seen)
        if is_new:
            self.took_us.append((time.thread_time_ns() - begin) / 1e3)
        if self.learning is not None and self.learning.track is not None:
            self._by[_NUMBER.sub("#", self.behaviour.driven_by)] += 1
        if isinstance(result, Steer):
            return result
        self.failed = getattr(result, "reason", "")
        return None


_: type[Driver] = Behaving
