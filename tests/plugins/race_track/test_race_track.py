"""`race_track`: key frames registered, a distance field that is true, a lap that closes, a line in it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from race_laps import CAR, Lap

from robotd.testing import check_perceptor
from robotd.world.geometry import compose, inverse
from robotd.world.messages import Float32s, Float64s
from robotd_plugins.behaviours.ftg_race.body import body_of
from robotd_plugins.perception.race_track import RaceTrackConfig, RaceTrackLearner, Sees, learn
from robotd_plugins.perception.race_track.closing import closed_again
from robotd_plugins.perception.race_track.field import distance_field
from robotd_plugins.perception.race_track.learn import lap_of
from robotd_plugins.perception.race_track.rays import Rays
from robotd_plugins.perception.race_track.register import Surface, register
from robotd_plugins.perception.track_position.walls import FieldWalls
from robotd_plugins.toolkit.race_track import RaceTrack, TrackSurvey

BODY = body_of(CAR)


def rigid(poses: Float64s, move: tuple[float, float, float]) -> Float64s:
    return np.array([compose(move, (x, y, yaw)) for x, y, yaw in poses.tolist()])


def steps_of(poses: Float64s, over: int) -> Float64s:
    """Each pose seen from the one `over` before it."""
    listed = [tuple(pose) for pose in poses.tolist()]
    return np.array([compose(inverse(a), b) for a, b in zip(listed, listed[over:], strict=False)])


def bent(survey: TrackSurvey, turn_rad: float, scale: float) -> TrackSurvey:
    """The same survey by an odometry that drifts more."""
    path = survey.path.copy()
    for at in range(1, len(path)):
        x, y, yaw = compose(inverse(tuple(survey.path[at - 1])), tuple(survey.path[at]))
        path[at] = compose(tuple(path[at - 1]), (scale * x, scale * y, yaw + turn_rad))
    return replace(survey, path=path)


def test_registered_key_frames_stand_where_an_odometry_with_more_drift_brings_them(survey: TrackSurvey) -> None:
    poses, again = register(survey), register(bent(survey, 0.001, 1.003))
    # ten key frames apart, whichever odometry was the beginning
    error = steps_of(poses, 10) - steps_of(again, 10)
    assert np.percentile(np.abs(error[:, :2]), 95) < 0.05
    assert np.percentile(np.abs(error[:, 2]), 95) < 0.01


@pytest.mark.parametrize("along_m", [0.0, 1.0, -1.5, 2.5])
def test_a_lap_that_was_closed_a_little_off_is_closed_where_it_meets_itself(
    survey: TrackSurvey, along_m: float
) -> None:
    x, y, yaw = survey.closing
    again = closed_again(replace(survey, closing=(x + along_m, y - 0.1, yaw + 0.05))).closing
    assert math.dist(again[:2], (x, y)) < 0.05 and abs(again[2] - yaw) < 0.01


@pytest.mark.parametrize("along_m", [5.0, -5.0, 8.0])
def test_a_lap_that_was_closed_in_the_wrong_place_makes_no_track(survey: TrackSurvey, along_m: float) -> None:
    x, y, yaw = survey.closing
    with pytest.raises(ValueError, match="does not fit on itself"):
        learn(replace(survey, closing=(x + along_m, y, yaw)), RaceTrackConfig(), BODY)


@pytest.mark.parametrize(("early", "late"), [(0, 30), (3, 40), (8, 45)])
def test_two_key_frames_of_different_places_make_no_track(survey: TrackSurvey, early: int, late: int) -> None:
    wrong = replace(survey, closed_key=early, closing_key=late, closing=(0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="does not fit on itself"):
        learn(wrong, RaceTrackConfig(), BODY)


# ------------------------------------------------------------------------------------------------ field


def ring_walls(inner_m: float, outer_m: float) -> tuple[Surface, Float64s]:
    """Two round walls and a path between them."""
    about = np.linspace(0.0, math.tau, 1200, endpoint=False)
    unit = np.stack((np.cos(about), np.sin(about)), axis=1)
    path = unit * (inner_m + outer_m) / 2.0
    return Surface(np.vstack((unit * inner_m, unit * outer_m)), np.vstack((unit, -unit))), path


@settings(max_examples=5, deadline=None)
@given(st.floats(2.0, 4.0), st.floats(1.2, 2.6))
def test_distances_are_true_and_signed(inner_m: float, width_m: float) -> None:
    surface, path = ring_walls(inner_m, inner_m + width_m)
    field, origin = distance_field(surface, path, 0.05, 2.0)
    rows, columns = field.shape
    x, y = origin[0] + (np.arange(columns) + 0.5) * 0.05, origin[1] + (np.arange(rows) + 0.5) * 0.05
    radius = np.hypot(x[None, :], y[:, None])
    true = np.minimum(radius - inner_m, inner_m + width_m - radius)
    near = np.abs(true) < 0.45
    assert np.abs(field - true)[near].max() < 0.015
    assert np.abs(field - true)[true > 0.0].max() < 0.05
    assert (field[true < -0.03] < 0.0).all()


def test_room_beyond_a_wall_that_nobody_drove_in_is_not_free() -> None:
    surface, path = ring_walls(3.0, 5.0)
    # a wall in the middle that looks outwards
    about = np.linspace(0.0, math.tau, 200, endpoint=False)
    unit = np.stack((np.cos(about), np.sin(about)), axis=1)
    both = Surface(np.vstack((surface.points_m, unit)), np.vstack((surface.normals, unit)))
    field, origin = distance_field(both, path, 0.05, 2.0)
    row, column = (int((2.0 * axis - low) / 0.05) for axis, low in ((0.0, origin[1]), (1.0, origin[0])))
    assert field[row, column] < 0.0


def test_what_was_looked_through_is_free_whatever_a_normal_says() -> None:
    """One return whose normal is wrong, as at a sharp corner, and beams that pass in front of it."""
    surface, path = ring_walls(3.0, 2.0 + 3.0)
    normals = surface.normals.copy()
    wrong = np.hypot(surface.points_m[:, 0] - 3.0, surface.points_m[:, 1]) < 0.1
    normals[wrong] = -normals[wrong]
    bad = Surface(surface.points_m, normals)
    beams = np.stack(np.meshgrid(np.arange(3.2, 4.8, 0.05), np.arange(-0.5, 0.5, 0.05)), axis=-1).reshape(-1, 2)
    x = np.array([3.3, 3.7, 3.9])

    def at(field: Float32s, origin: tuple[float, float]) -> Float32s:
        found: Float32s = field[int(-origin[1] / 0.05), ((x - origin[0]) / 0.05).astype(int)]
        return found

    assert (at(*distance_field(bad, path, 0.05, 2.0)) < 0.0).all()
    assert np.allclose(at(*distance_field(bad, path, 0.05, 2.0, beams)), [0.3, 0.7, 0.9], atol=0.06)


def test_beams_are_looked_along_as_far_as_their_end() -> None:
    rays = Rays(np.array([0, 1, 2]), np.zeros((3, 2)), np.array([[1.05, 0.0], [0.0, 2.05], [0.2, 0.0]]))
    ray, at = rays.points(0.1, 0.3)
    assert np.bincount(ray, minlength=3).tolist() == [7, 17, 0]
    assert np.allclose(at[ray == 0], np.column_stack((np.arange(0.05, 0.7, 0.1), np.zeros(7))))


def test_no_walls_are_refused() -> None:
    with pytest.raises(ValueError, match="no walls"):
        distance_field(Surface(np.zeros((0, 2)), np.zeros((0, 2))), np.zeros((3, 2)), 0.05, 2.0)


def test_walls_to_lay_scans_on_are_the_field(track: RaceTrack) -> None:
    """The slope between cells leads from one value to the other."""
    walls = FieldWalls(track)
    rng = np.random.default_rng(3)
    at = track.path[rng.integers(0, len(track.path), 200), :2] + rng.normal(0.0, 0.5, (200, 2))
    distance, slope_x, slope_y = walls.look(at[:, 0], at[:, 1])
    ahead, _, _ = walls.look(at[:, 0] + 0.01, at[:, 1])
    aside, _, _ = walls.look(at[:, 0], at[:, 1] + 0.01)
    assert np.median(np.abs(ahead - distance - 0.01 * slope_x)) < 0.002
    assert np.median(np.abs(aside - distance - 0.01 * slope_y)) < 0.002
    assert np.median(np.abs(walls.at(at[:, 0], at[:, 1]) - distance)) < 0.03
    assert walls.at(np.array([1e4]), np.array([-1e4])) == -math.inf


# ------------------------------------------------------------------------------------------------ track


def test_walls_stand_where_they_are(track: RaceTrack, lap: Lap, ground: Any) -> None:
    """Clearance along the lap in the learned field, against the true one at the same place."""
    walls = FieldWalls(track)
    errors = []
    for at_s in lap.times(1.0, lap.lap_s):
        pose = lap.seen_from_start(at_s)
        true = ground.distance_m(*lap.pose(at_s)[:2]) + 0.21 * ground.track.resolution_m
        errors.append(float(walls.at(np.array([pose[0]]), np.array([pose[1]]))[0]) - true)
    # both fields have cells of 5 cm, and a map may be bent by a little over its length
    assert np.percentile(np.abs(errors), 90) < 0.12 and abs(np.median(errors)) < 0.05


def test_the_lap_closes_and_is_driven_in_order(track: RaceTrack) -> None:
    ring = np.vstack((track.path, track.path[:1]))
    steps = np.hypot(*np.diff(ring[:, :2], axis=0).T)
    assert steps.max() < 1.6
    turned = np.remainder(np.diff(ring[:, 2]) + math.pi, math.tau) - math.pi
    assert abs(abs(turned.sum()) - math.tau) < 1e-6


def test_the_line_keeps_to_the_track(track: RaceTrack) -> None:
    assert track.has_line and track.reason == ""
    room = FieldWalls(track).at(track.x_m, track.y_m)
    assert room.min() > CAR.footprint_m[0][1]
    assert track.lap_s < 0.9 * track.length_m / 4.0


def test_a_car_that_is_too_wide_gets_walls_but_no_line(survey: TrackSurvey) -> None:
    wide = learn(survey, RaceTrackConfig(margin_m=1.0), BODY)
    assert not wide.has_line and wide.reason
    assert (wide.distance_m > 0.5).any()


def test_where_the_car_was_at_the_end_is_in_the_track(track: RaceTrack, survey: TrackSurvey, lap: Lap) -> None:
    assert track.at_ns == survey.stamp_ns
    true = lap.seen_from_start(survey.stamp_ns / 1e9)
    assert math.dist(track.at[:2], true[:2]) < 0.3


@pytest.mark.parametrize(("beyond", "last"), [(3, 19), (0, 19), (5, 19)])
def test_one_lap_is_cut_out_of_a_longer_one(beyond: int, last: int) -> None:
    about = np.arange(20 + beyond) * (math.tau / 20.0)
    poses = np.stack((3.0 * np.cos(about), 3.0 * np.sin(about), about + math.pi / 2.0), axis=1)
    assert np.array_equal(lap_of(poses, 0, len(poses) - 1), poses[: last + 1])


def test_a_survey_that_makes_no_track_publishes_none(survey: TrackSurvey) -> None:
    learner, (x, y, yaw) = RaceTrackLearner(RaceTrackConfig(), CAR), survey.closing
    wrong = replace(survey, closing=(x + 6.0, y, yaw))
    assert learner.step(Sees(now_ns=survey.stamp_ns, survey=wrong)) is None
    assert "fit on itself" in str(learner.explain())


def test_the_second_survey_of_a_goal_is_for_when_the_first_gave_nothing(survey: TrackSurvey) -> None:
    learner, second = RaceTrackLearner(RaceTrackConfig(), CAR), replace(survey, attempt=2, number=2)
    assert learner.step(Sees(now_ns=survey.stamp_ns, survey=second)) is not None
    assert learner.step(Sees(now_ns=survey.stamp_ns, survey=second)) is None


def test_keeps_the_contract(survey: TrackSurvey) -> None:
    def view(number: int) -> Sees:
        return Sees(now_ns=survey.stamp_ns, survey=survey)

    check_perceptor(RaceTrackLearner, make_view=view, robot=CAR, steps=1)
