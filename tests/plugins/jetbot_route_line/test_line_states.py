"""The state machine row by row, what it takes to believe a picture, and the steering law."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from robotd_plugins.behaviours.jetbot_route import JetBotRouteConfig
from robotd_plugins.behaviours.jetbot_route.evidence import Place, Votes
from robotd_plugins.behaviours.jetbot_route.states import Facts, State, transition
from robotd_plugins.behaviours.jetbot_route.steer import LineAhead, curvature_pm, drive, learned_drift_pm

CONFIG = JetBotRouteConfig()
WAIT, DRIVE, APPROACH = State.WAITING_FOR_LINE, State.DRIVING_STRAIGHT, State.APPROACHING_INTERSECTION
LEAVE, AGAIN, DEAD, GOAL = State.LEAVING_INTERSECTION, State.REACQUIRING_LINE, State.DEAD_END, State.GOAL_REACHED


@pytest.mark.parametrize(
    ("state", "facts", "expected", "why"),
    [
        (WAIT, Facts(), WAIT, ""),
        (WAIT, Facts(line=True), DRIVE, "line in both regions"),
        (WAIT, Facts(in_state_s=10.1), DEAD, "no line in sight for 10 s"),
        (WAIT, Facts(line=True, in_state_s=10.1), DRIVE, "line in both regions"),
        (WAIT, Facts(end_m=0.0), WAIT, ""),
        (DRIVE, Facts(line=True), DRIVE, ""),
        (DRIVE, Facts(unseen_m=0.08), DRIVE, ""),
        (DRIVE, Facts(unseen_m=0.09), AGAIN, "no line for 0.09 m"),
        (DRIVE, Facts(crossing_m=0.3, unseen_m=0.09), APPROACH, "crossing in 0.30 m"),
        (DRIVE, Facts(end_m=0.1), DRIVE, ""),
        (DRIVE, Facts(end_m=0.05, unseen_m=0.09), DRIVE, ""),
        (DRIVE, Facts(end_m=0.03), GOAL, "end of the line"),
        (APPROACH, Facts(crossing_m=0.1), APPROACH, ""),
        (APPROACH, Facts(crossing_m=0.1, unseen_m=1.0), APPROACH, ""),
        (APPROACH, Facts(), DRIVE, "no crossing after all"),
        (APPROACH, Facts(crossing_m=0.0, straight=True), LEAVE, "straight on"),
        (APPROACH, Facts(crossing_m=-0.01), LEAVE, "straight on"),
        (APPROACH, Facts(crossing_m=0.1, straight=False), APPROACH, ""),
        (APPROACH, Facts(crossing_m=0.0, straight=False), DEAD, "the crossing has no way straight on"),
        (LEAVE, Facts(in_state_m=0.07, line=True), LEAVE, ""),
        (LEAVE, Facts(in_state_m=0.08), AGAIN, "clear of the crossing"),
        (LEAVE, Facts(end_m=0.02), GOAL, "end of the line"),
        (AGAIN, Facts(), AGAIN, ""),
        (AGAIN, Facts(line=True, searched=True), DRIVE, "line found"),
        (AGAIN, Facts(searched=True), DEAD, "the line was lost and is not to be found on either side"),
        (DEAD, Facts(line=True, end_m=0.0, crossing_m=0.1), DEAD, ""),
        (GOAL, Facts(line=True, unseen_m=9.0, searched=True), GOAL, ""),
    ],
)
def test_transitions(state: State, facts: Facts, expected: State, why: str) -> None:
    assert transition(state, facts, CONFIG) == (expected, why)


_DISTANCE = st.one_of(st.just(math.nan), st.floats(-1.0, 1.0))


@given(
    st.sampled_from(State),
    st.builds(
        Facts,
        line=st.booleans(),
        crossing_m=_DISTANCE,
        straight=st.sampled_from([None, True, False]),
        end_m=_DISTANCE,
        unseen_m=st.floats(0.0, 1.0),
        in_state_m=st.floats(-0.1, 1.0),
        in_state_s=st.floats(0.0, 20.0),
        searched=st.booleans(),
    ),
)
def test_a_change_has_a_reason_and_the_ends_are_final(state: State, facts: Facts) -> None:
    after, why = transition(state, facts, CONFIG)
    assert bool(why) == (after is not state)
    if state in (DEAD, GOAL):
        assert after is state
    if after is GOAL and state is not GOAL:
        assert facts.end_m <= CONFIG.stop_before_end_m and state is not WAIT


@pytest.mark.parametrize(
    ("votes", "believed"),
    [
        ("", False),
        ("yy", False),
        ("yyy", True),
        ("y-y-y", True),
        ("y--y--y", False),
        # three of five in; it takes four of five against to drop it again
        ("yyy--", True),
        ("yyy---", True),
        ("yyy----", False),
        ("yyy----yy", False),
        ("yyy----yyy", True),
    ],
)
def test_three_of_five_with_hysteresis(votes: str, believed: bool) -> None:
    counted = Votes(3, 5)
    for vote in votes:
        counted.cast(vote == "y")
    assert counted.believed is believed


def _place(*looks: tuple[float, float | None]) -> Place:
    place = Place(3, 5, 0.06, (0.18, 0.30))
    for travelled_m, ahead_m in looks:
        place.look(travelled_m, ahead_m, True)
    return place


@pytest.mark.parametrize(
    ("what", "looks", "at_m"),
    [
        ("two are not enough", [(0.0, 0.3), (0.01, 0.29)], math.nan),
        ("three agree", [(0.0, 0.3), (0.01, 0.29), (0.02, 0.28)], 0.3),
        ("a frame between is missing", [(0.0, 0.3), (0.01, None), (0.02, 0.28), (0.03, 0.27)], 0.3),
        ("three that disagree", [(0.0, 0.3), (0.0, 0.2), (0.0, 0.1)], math.nan),
        ("one odd one does not move it", [(0.0, 0.3), (0.0, 0.3), (0.0, 0.3), (0.0, 0.15)], 0.3),
        ("not seen while it is too near", [(0.0, 0.3), (0.0, 0.3), (0.0, 0.3), *[(0.2, None)] * 9], 0.3),
        ("not seen where it should be", [(0.0, 0.3), (0.0, 0.3), (0.0, 0.3), *[(0.05, None)] * 4], math.nan),
        ("no metres", [(0.0, math.nan)] * 9, math.nan),
    ],
)
def test_a_place_is_believed_when_pictures_agree(
    what: str, looks: list[tuple[float, float | None]], at_m: float
) -> None:
    assert _place(*looks).at_m == pytest.approx(at_m, abs=1e-9, nan_ok=True), what


def test_the_way_straight_on_is_what_most_pictures_say() -> None:
    place = Place(1, 1, 0.06, (0.18, 0.30))
    assert place.straight is None
    for straight, expected in ((False, False), (None, False), (True, None), (True, True)):
        place.look(0.0, 0.3, straight)
        assert place.straight is expected


# ------------------------------------------------------------------------------------------------- steering


@given(st.floats(-0.1, 0.1), st.floats(-0.5, 0.5))
def test_steering_is_odd(left_m: float, heading_rad: float) -> None:
    there = curvature_pm(LineAhead(left_m, heading_rad), CONFIG)
    mirrored = curvature_pm(LineAhead(-left_m, -heading_rad), CONFIG)
    assert mirrored == pytest.approx(-there)


@given(st.floats(-0.1, 0.1), st.floats(1e-6, 1e-3))
def test_steering_has_no_dead_band_and_no_step(left_m: float, step_m: float) -> None:
    low, high = (curvature_pm(LineAhead(at_m, 0.0), CONFIG) for at_m in (left_m, left_m + step_m))
    assert low < high <= low + 101.0 * step_m


@pytest.mark.parametrize("radius_m", [0.3, -0.3, 0.6, 2.0])
def test_on_an_arc_it_steers_that_arc(radius_m: float) -> None:
    """The line's chord from the near region to the far one, prolonged to the axle, is steered to the arc itself."""
    near_m, far_m = 0.128, CONFIG.reach_m
    near, far = (radius_m - math.copysign(math.sqrt(radius_m**2 - at_m**2), radius_m) for at_m in (near_m, far_m))
    heading_rad = math.atan2(far - near, far_m - near_m)
    config = JetBotRouteConfig(safe_zone_m=0.0)
    found = curvature_pm(LineAhead(near - near_m * math.tan(heading_rad), heading_rad), config)
    assert found == pytest.approx(1.0 / radius_m, rel=0.25)


@given(st.floats(-100.0, 100.0), st.floats(0.01, 0.3))
def test_commands_keep_the_limits(curvature: float, speed_mps: float) -> None:
    command = drive(speed_mps, curvature, CONFIG)
    assert abs(command.wz_radps) <= CONFIG.max_correction_radps + 1e-12
    assert min(CONFIG.slow_speed_mps, speed_mps) - 1e-12 <= command.vx_mps <= speed_mps
    if command.vx_mps > CONFIG.slow_speed_mps + 1e-9:
        # the bend is kept: it slows down before it cuts
        assert command.wz_radps == pytest.approx(command.vx_mps * curvature, abs=1e-9)


def test_a_steady_pull_is_learned_within_bounds_and_not_in_bends() -> None:
    pull = 0.0
    for _ in range(100):
        pull = learned_drift_pm(pull, LineAhead(0.01, 0.0), 0.01, CONFIG)
    assert pull == pytest.approx(0.75)
    assert learned_drift_pm(0.99, LineAhead(0.02, 0.0), 1.0, CONFIG) == CONFIG.drift_max_pm
    assert learned_drift_pm(0.3, LineAhead(0.02, 0.5), 1.0, CONFIG) == 0.3
    assert learned_drift_pm(0.3, LineAhead(0.05, 0.0), 1.0, CONFIG) == 0.3


@pytest.mark.parametrize(
    ("config", "told"),
    [
        ({"confirm_frames": 6}, "can never happen"),
        ({"slow_speed_mps": 0.3}, "must not be above base_speed_mps"),
        ({"lost_m": 0.3}, "must not be above reacquire_m"),
    ],
)
def test_parameters_that_cannot_be_are_refused(config: dict[str, Any], told: str) -> None:
    with pytest.raises(ValidationError, match=told):
        JetBotRouteConfig(**config)
