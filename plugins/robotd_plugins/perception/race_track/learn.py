"""From a survey to a track: key frames registered, walls as a distance field, and the line to race on."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from robotd.world.messages import Float64s
from robotd_plugins.behaviours.ftg_race.body import Body
from robotd_plugins.behaviours.ftg_race.commanding import GRAVITY_MPS2
from robotd_plugins.behaviours.ftg_race.line import LineLimits, WallField, learned_line
from robotd_plugins.perception.race_track.closing import closed_again
from robotd_plugins.perception.race_track.config import RaceTrackConfig
from robotd_plugins.perception.race_track.doubt import contradicted_share
from robotd_plugins.perception.race_track.field import distance_field
from robotd_plugins.perception.race_track.rays import rays_of
from robotd_plugins.perception.race_track.register import register, surface
from robotd_plugins.toolkit.race_track import RaceTrack, TrackSurvey

_BEHIND_M = 0.2
_STEP_M, _SHORT_M = 0.05, 0.3
"""A beam has shown to be free what lies on its way, but for its end: returns beside its own are wall too."""


def learn(survey: TrackSurvey, config: RaceTrackConfig, body: Body) -> RaceTrack:
    """The track of a survey; a few seconds of computing. Without a line where the solver finds none, with its reason.

    Raises ValueError with a sentence where the survey makes no map.
    """
    survey = closed_again(survey)
    poses = register(survey)
    walls, rays = surface(survey, poses), rays_of(survey, poses)
    ray, seen_m = rays.points(_STEP_M, _SHORT_M)
    distance_m, origin_m = distance_field(walls, poses[:, :2], config.resolution_m, config.reach_m, seen_m)
    contradicted = contradicted_share(rays, ray, seen_m, walls, distance_m, config.resolution_m, origin_m)
    if contradicted > config.contradicted_share_max:
        raise ValueError(
            f"the surveyed lap does not fit on itself: {100.0 * contradicted:.0f} % of one key frame's beams would "
            "have passed through its walls"
        )
    path = lap_of(poses, survey.closed_key, survey.closing_key)
    line: dict[str, Any]
    try:
        found = learned_line(
            path, WallField(distance_m, config.resolution_m, origin_m), body, limits_of(config), config.margin_m
        )
        line = {
            "s_m": found.s_m, "x_m": found.x_m, "y_m": found.y_m, "yaw_rad": found.yaw_rad,
            "curvature_pm": found.curvature_pm, "speed_mps": found.speed_mps, "length_m": found.length_m,
            "lap_s": found.lap_s,
        }  # fmt: skip
    except ValueError as error:
        none = np.zeros(0)
        line = dict.fromkeys(("s_m", "x_m", "y_m", "yaw_rad", "curvature_pm", "speed_mps"), none)
        line |= {"length_m": 0.0, "reason": str(error)}
    last = poses[-1].tolist()
    return RaceTrack(
        survey.stamp_ns, distance_m, config.resolution_m, origin_m, path, **line, version=survey.number,
        at_ns=survey.stamp_ns, at=(last[0], last[1], last[2]),
    )  # fmt: skip


def lap_of(poses: Float64s, first: int, about: int) -> Float64s:
    """Of the key frames (n, 3) those of one lap: from `first` to the last before its place is reached again."""
    x, y, yaw = poses[first]
    ahead = math.cos(yaw) * (poses[:, 0] - x) + math.sin(yaw) * (poses[:, 1] - y)
    last = about
    while last + 1 < len(poses) and ahead[last + 1] < -_BEHIND_M:
        last += 1
    while last > first + 2 and ahead[last] >= -_BEHIND_M:
        last -= 1
    lap: Float64s = poses[first : last + 1].copy()
    return lap


def limits_of(config: RaceTrackConfig) -> LineLimits:
    """What the line's shape is planned for."""
    grip = config.mu * GRAVITY_MPS2
    return LineLimits(
        config.v_max_mps, config.lateral_share * grip, config.accel_share * grip, config.brake_share * grip,
        config.grip_share * grip,
    )  # fmt: skip
