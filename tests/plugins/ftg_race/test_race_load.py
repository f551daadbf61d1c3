"""What a race car asks of motor and front wheels in a bend, where speeding up takes load off the wheels that steer."""

from __future__ import annotations

import pytest
from race_cars import F1TENTH

from robotd_plugins.behaviours.ftg_race import FtgRace, FtgRaceConfig
from robotd_plugins.behaviours.ftg_race.commanding import SpeedPolicy
from robotd_plugins.behaviours.ftg_race.planner_ftg import PlannerFTG
from robotd_plugins.behaviours.ftg_race.planning_types import Motion

POLICY = SpeedPolicy(8.0, 0.2, 1.0, 4.0, 1.0, 9.0, 9.0, 10.0, 0.21, 0.053, 0.06)


def planner(**keys: float) -> PlannerFTG:
    found = FtgRace(FtgRaceConfig.model_validate(keys), None, F1TENTH)._planner
    assert isinstance(found, PlannerFTG)
    return found


def steered(yaw_rate_radps: float, wanted_mps: float, curvature_pm: float = 0.2, **keys: float) -> float:
    motion = Motion(speed_mps=5.0, yaw_rate_radps=yaw_rate_radps)
    return planner(**keys).steered_rad(curvature_pm, motion, wanted_mps)


@pytest.mark.parametrize(
    ("speed_mps", "lateral_mps2", "most_mps2"),
    [
        (3.0, 0.0, 9.0),
        (3.0, 8.0, 5.0),  # a circle would leave 0.6 of 9
        (3.0, 12.0, 2.25),
        (7.8, 0.0, 0.2 / 0.21),  # the slack controller is told no more than the top speed
        (8.5, 0.0, 0.0),
    ],
)
def test_it_knows_what_comes_of_a_wanted_speed(speed_mps: float, lateral_mps2: float, most_mps2: float) -> None:
    assert 0.0 <= POLICY.along_mps2(speed_mps + 1.0, speed_mps, lateral_mps2) <= most_mps2 + 1e-9


def test_what_comes_is_what_the_motor_is_told() -> None:
    told = POLICY.ramp(6.0, 4.0, 4.0, 3.0, 0.025)
    assert (told - 4.0) / 0.21 == pytest.approx(POLICY.along_mps2(6.0, 4.0, 3.0))


@pytest.mark.parametrize(
    ("before_mps", "lateral_mps2", "brakes"), [(5.0, 8.0, True), (7.0, 2.0, True), (7.0, 8.0, False)]
)
def test_in_a_bend_it_gets_off_the_motor_before_it_brakes(before_mps: float, lateral_mps2: float, brakes: bool) -> None:
    told = POLICY.ramp(3.0, 5.0, before_mps, lateral_mps2, 0.025)
    assert (told < 5.0) == brakes
    # for one command only: it was told its own speed, and brakes with the next
    assert brakes or POLICY.ramp(3.0, 5.0, told, lateral_mps2, 0.025) < 5.0


def test_speeding_up_in_a_bend_turns_the_front_wheels_farther_than_keeping_the_speed() -> None:
    more = steered(1.0, 8.0) - steered(1.0, 5.0)
    assert more > 0.01
    assert more == pytest.approx(-(steered(-1.0, 8.0, -0.2) - steered(-1.0, 5.0, -0.2)))


@pytest.mark.parametrize("yaw_rate_radps", [0.0, -0.5])
def test_a_car_that_has_not_turned_in_yet_gets_no_more_steering_for_load(yaw_rate_radps: float) -> None:
    assert steered(yaw_rate_radps, 8.0) == steered(yaw_rate_radps, 8.0, load_shift_rad=0.0)


def test_too_much_yaw_is_counted_from_zero_where_the_way_turns_to_the_other_side() -> None:
    """A hair of yaw to the wrong side is a hair too much, not as much as is missing."""
    before, after = steered(1e-3, 5.0), steered(-1e-3, 5.0)
    assert after == pytest.approx(before, abs=1e-3)
    assert steered(2.0, 5.0) < before
