"""Who drives: the learned line while everything speaks for it, follow-the-gap otherwise, decided anew in each step."""

from __future__ import annotations

import logging

import numpy as np

from robotd.authoring.explain import Explanation, Scalar, Text
from robotd.world.clock import NS_PER_S
from robotd_plugins.behaviours.ftg_race.body import Body
from robotd_plugins.behaviours.ftg_race.commanding import SpeedPolicy
from robotd_plugins.behaviours.ftg_race.config import FtgRaceConfig
from robotd_plugins.behaviours.ftg_race.line.laps import Laps
from robotd_plugins.behaviours.ftg_race.line.on_line import TrackLine
from robotd_plugins.behaviours.ftg_race.line.planner import LinePlanner, Pose
from robotd_plugins.behaviours.ftg_race.planner_ftg import PlannerFTG
from robotd_plugins.behaviours.ftg_race.planning_types import Command, Scan
from robotd_plugins.toolkit.race_track import Located, RaceTrack

log = logging.getLogger("robotd.ftg_race")

_AGAIN_NS = NS_PER_S // 4
"""After a fallback the line is not tried for so long."""
LINE = "learned line"
"""What `driven_by` says then."""


class LapTwo:
    """Falls back in the step in which a reason appears; comes back a quarter of a second later at the earliest.

    A line on which a lap took longer than follow-the-gap's best is dropped until the track has a newer version.
    """

    def __init__(self, config: FtgRaceConfig, body: Body, policy: SpeedPolicy, planner: PlannerFTG) -> None:
        self._planner = LinePlanner(config, body, policy, planner)
        self._line: TrackLine | None = None
        self._version = 0
        self._dropped = ""
        self._off_ns: int | None = None
        self.laps = Laps()
        self.is_on = False
        self.why = "no line yet"

    def plan(
        self, scan: Scan, now_ns: int, track: RaceTrack | None, located: Located | None, base_track: Pose | None
    ) -> Command | None:
        """The command on the line; None: follow-the-gap drives, `why` says why.

        base_track: base at the sweep's end seen in track, None where nobody knows.
        """
        if self._line is None:
            self.laps.drive(now_ns, scan.motion.speed_mps)
        if track is not None and track.version != self._version:
            self._adopt(track)
        found = self._look(scan, now_ns, located, base_track)
        is_on = isinstance(found, Command)
        if self._line is not None:
            if base_track is None or located is None or not located.is_sure:
                self.laps.again()
            elif self.laps.step(now_ns, self._planner.place.s_m, self._line.length_m, self.is_on and is_on):
                self._dropped = f"a lap took {self.laps.line_s:.2f} s, follow-the-gap {self.laps.best_s:.2f} s"
        self._told(is_on, now_ns, "" if isinstance(found, Command) else found)
        return found if isinstance(found, Command) else None

    def _adopt(self, track: RaceTrack) -> None:
        self._version, self._dropped = track.version, ""
        if not track.has_line:
            self._line, self._dropped = None, track.reason or "the track has no line"
            return
        self._line = TrackLine(track, self._planner.limits)
        steps = np.roll(track.path[:, :2], -1, axis=0) - track.path[:, :2]
        self.laps.first_lap(float(np.hypot(steps[:, 0], steps[:, 1]).sum()))

    def _look(self, scan: Scan, now_ns: int, located: Located | None, base_track: Pose | None) -> Command | str:
        line = self._line
        if line is None:
            return self._dropped or "no line yet"
        if located is None or base_track is None:
            return "nobody knows where the car is"
        if not located.is_sure:
            return f"the place is not sure: {located.reason}"
        if located.version != line.version:
            return f"the place is on version {located.version} of the track, the line on {line.version}"
        found = self._planner.plan(scan, line, base_track, now_ns, not self.is_on)
        if self._dropped:
            return self._dropped
        if not self.is_on and self._off_ns is not None and now_ns - self._off_ns < _AGAIN_NS:
            return self.why
        return found

    def _told(self, is_on: bool, now_ns: int, why: str) -> None:
        if is_on and not self.is_on and self._line is not None:
            log.info("on the learned line, version %d: %.2f s a lap expected", self._version, self._line.lap_s)
        elif self.is_on and not is_on:
            self._off_ns = now_ns
            log.info("off the learned line: %s", why)
        self.is_on, self.why = is_on, why

    @property
    def driven_by(self) -> str:
        """Who drives; for follow-the-gap, why."""
        return LINE if self.is_on else f"follow-the-gap: {self.why}"

    def explain(self) -> Explanation:
        """Who drives and why, and where beside the line the car is."""
        place = self._planner.place
        return (
            Text("driven by", self.driven_by),
            Scalar("off the line", place.aside_m, "m"),
            Scalar("along the line", place.s_m, "m"),
            Scalar("line free", self._planner.free_m, "m"),
        )
