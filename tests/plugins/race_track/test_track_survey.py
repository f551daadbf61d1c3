"""`track_survey`: a lap closes on itself, once; what makes it begin anew."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from race_laps import CAR, Lap, S

from robotd.testing import check_perceptor
from robotd.world.geometry import compose, inverse
from robotd.world.messages import ActiveGoal, Applied, Steer
from robotd_plugins.perception.track_survey import Sees, TrackSurveyConfig, TrackSurveyor
from robotd_plugins.toolkit.race_track import TrackSurvey

from .conftest import surveyed


def seen(lap: Lap, at_s: float, goal: ActiveGoal | None = None) -> Sees:
    return Sees(now_ns=round(at_s * S), scan=lap.scan(at_s), odometry=lap.odometry(at_s), applied=None, goal=goal)


def closing_error(lap: Lap, survey: TrackSurvey, stamps: list[int]) -> tuple[float, float, float]:
    """Of the closing, against the true poses at its two key frames."""
    early, late = (lap.pose(stamps[key] / S) for key in (survey.closed_key, survey.closing_key))
    return compose(inverse(compose(inverse(early), late)), survey.closing)


@pytest.mark.parametrize(
    ("what", "change"),
    [
        ("as it is", {}),
        ("noise and dropout", {"noise_m": 0.05, "dropout": 0.1}),
        ("a turning lidar", {"sweep": True, "rate_hz": 10.0, "speed_mps": 3.0}),
    ],
)
def test_a_lap_closes_on_itself(lap: Lap, what: str, change: dict[str, float]) -> None:
    driven = Lap(lap.ground, **change)  # type: ignore[arg-type]
    surveyor = TrackSurveyor(TrackSurveyConfig(), CAR)
    found, at_s, stamps = None, 0.0, list[int]()
    for at_s in driven.times(0.0, 1.4 * driven.lap_s):
        found = surveyor.step(seen(driven, at_s))
        if found is not None:
            break
        stamps = [key.stamp_ns for key in surveyor._survey.keys]
    assert found is not None, what
    # soon after the start line was passed again, and not long before
    assert 1.0 < at_s / driven.lap_s < 1.3
    along, across, turn = closing_error(driven, found, stamps)
    assert abs(along) < 0.15 and abs(across) < 0.05 and abs(turn) < math.radians(1.5)
    true = driven.seen_from_start(stamps[len(stamps) // 2] / S)
    assert math.dist(found.path[len(stamps) // 2, :2], true[:2]) < 0.6


def test_it_rests_after_its_survey_until_there_is_a_new_goal(lap: Lap) -> None:
    surveyor = TrackSurveyor(TrackSurveyConfig(attempts=1), CAR)
    first, second = ActiveGoal(1, "ftg_race"), ActiveGoal(2, "ftg_race")
    said = [s for at in lap.times(0.0, 1.4 * lap.lap_s) if (s := surveyor.step(seen(lap, at, first))) is not None]
    assert [survey.number for survey in said] == [1]
    again = (surveyor.step(seen(lap, at, second)) for at in lap.times(1.4 * lap.lap_s, 2.8 * lap.lap_s))
    assert [survey.number for survey in again if survey is not None] == [2]


def test_without_odometry_the_commands_do(lap: Lap) -> None:
    surveyor = TrackSurveyor(TrackSurveyConfig(), CAR)
    found = None
    for at_s in lap.times(0.0, 1.4 * lap.lap_s):
        told = lap.odometry(at_s)
        command = Steer(told.vx_mps, math.atan(0.3302 * told.wz_radps / told.vx_mps))
        applied = Applied(told.stamp_ns, command)
        found = surveyor.step(replace_view(seen(lap, at_s), applied))
        if found is not None:
            break
    assert found is not None and found.residual_m < 2.0


def replace_view(view: Sees, applied: Applied) -> Sees:
    return Sees(now_ns=view.now_ns, scan=view.scan, odometry=None, applied=applied, goal=None)


def test_a_car_that_goes_back_begins_anew(lap: Lap) -> None:
    surveyor = TrackSurveyor(TrackSurveyConfig(), CAR)
    for i in range(1, 60):
        # two seconds forwards, then back the same way
        at_s = 2.0 - abs(2.0 - i / 20.0)
        told = lap.odometry(at_s)
        told = replace(told, stamp_ns=i * S // 20)
        if i > 40:
            told = replace(told, vx_mps=-told.vx_mps, wz_radps=-told.wz_radps)
        scan = replace(lap.scan(at_s), stamp_ns=i * S // 20, start_ns=i * S // 20)
        surveyor.step(Sees(now_ns=scan.stamp_ns, scan=scan, odometry=told, applied=None, goal=None))
        if i == 40:
            assert len(surveyor._survey.keys) > 6
    assert len(surveyor._survey.keys) < 6
    assert surveyor._survey.odometry.key is not None


def test_a_scan_of_another_place_begins_anew(lap: Lap) -> None:
    surveyor = TrackSurveyor(TrackSurveyConfig(), CAR)
    for at_s in lap.times(0.0, 4.0):
        surveyor.step(seen(lap, at_s))
    before = len(surveyor._survey.keys)
    there = lap.scan(4.05)
    scan = replace(there, ranges_m=np.linspace(0.5, 3.0, lap.beams).astype(np.float32))
    surveyor.step(Sees(now_ns=scan.stamp_ns, scan=scan, odometry=lap.odometry(4.05), applied=None, goal=None))
    assert before > 10 and len(surveyor._survey.keys) <= 1


def test_the_path_and_the_points_agree(survey: TrackSurvey) -> None:
    assert survey.key.max() == len(survey.path) - 1 and (np.diff(survey.key) >= 0).all()
    assert not survey.points_m.flags.writeable and not survey.path.flags.writeable
    steps = np.hypot(*np.diff(survey.path[:, :2], axis=0).T)
    assert steps.max() < 1.6
    assert tuple(survey.path[0]) == (0.0, 0.0, 0.0)


def test_the_beginning_is_not_looked_for_before_a_whole_turn(lap: Lap) -> None:
    assert surveyed(lap, 0.8) is None


@pytest.mark.parametrize(
    "wrong",
    [
        {"path": np.zeros((5, 2))},
        {"path": np.zeros((2, 3))},
        {"points_m": np.zeros((3, 2), np.float32)},
        {"closing_key": 99},
        {"closed_key": 60},
    ],
)
def test_a_survey_that_makes_no_sense_is_refused(survey: TrackSurvey, wrong: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="must"):
        replace(survey, **wrong)  # type: ignore[arg-type]


def test_keeps_the_contract(lap: Lap) -> None:
    check_perceptor(TrackSurveyor)
    check_perceptor(TrackSurveyor, make_view=lambda number: seen(lap, (number + 1) / 20.0), robot=CAR)
