"""The perceptor: a `TrackSurvey` in, a `RaceTrack` out, solved beside the event loop."""

from __future__ import annotations

import logging

from robotd import Perceptor, View, every
from robotd.authoring.explain import Explanation, Scalar, Text
from robotd.world.robot import Robot
from robotd_plugins.behaviours.ftg_race.body import body_of
from robotd_plugins.perception.race_track.config import RaceTrackConfig
from robotd_plugins.perception.race_track.learn import learn
from robotd_plugins.toolkit.race_track import RaceTrack, TrackSurvey

log = logging.getLogger("robotd.race_track")


class Sees(View):
    """Each survey."""

    survey: TrackSurvey = every(within_s=60.0)


class RaceTrackLearner(Perceptor[RaceTrackConfig, Sees, RaceTrack]):
    """Publishes one track for each goal: of the first of its surveys that gives a map and a line."""

    offload = True
    sim_latency_s = 3.0

    def __init__(self, config: RaceTrackConfig, robot: Robot | None = None) -> None:
        super().__init__(config, robot)
        self._body = body_of(self.robot, config.vehicle_width_m)
        self._track: RaceTrack | None = None
        self._why = "waits for a surveyed lap"

    @classmethod
    def load(cls, config: RaceTrackConfig) -> None:
        import scipy.ndimage
        import scipy.optimize
        import scipy.sparse.linalg
        import scipy.spatial  # noqa: F401  # the import is the work

    def step(self, seen: Sees) -> RaceTrack | None:
        if seen.survey.attempt > 1 and self._track is not None and self._track.has_line:
            return None
        try:
            track = learn(seen.survey, self.config, self._body)
        except ValueError as error:
            self._track, self._why = None, str(error)
            log.warning("no track from survey %d: %s", seen.survey.number, error)
            return None
        self._track, self._why = track, track.reason or f"a line of {track.length_m:.1f} m, {track.lap_s:.2f} s"
        log.info("track %d: %s", track.version, self._why)
        return track

    def explain(self) -> Explanation:
        if self._track is None:
            return (Text("race_track", self._why),)
        return Text("race_track", self._why), Scalar("line length", self._track.length_m, "m")
