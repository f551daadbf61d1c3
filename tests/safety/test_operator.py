"""The operator's rules as rows, and its laws over random histories."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotd.safety.operator import (
    Arm,
    Cancel,
    Disarm,
    EStop,
    Facts,
    OperatorState,
    Pause,
    Request,
    ResetEStop,
    Resume,
    Start,
    Teleop,
    decide,
    ended,
)
from robotd.world.messages import Drive, Mode

FACTS = Facts(behaviours=frozenset({"a", "b"}), autostart=(Start("config", "a"),))
S = 1_000_000_000


def run(*requests: Request, facts: Facts = FACTS, now_ns: int = 0) -> tuple[OperatorState, str]:
    """The state after a history, and the last refusal."""
    state, refused = OperatorState(), ""
    for request in requests:
        answer = decide(state, request, facts, now_ns)
        state, refused = answer.state, answer.refused
    return state, refused


HAND = Teleop("pad", Drive(0.1), S // 2)


@pytest.mark.parametrize(
    ("history", "mode", "active", "refused"),
    [
        ([], Mode.DISARMED, set(), ""),
        ([Arm("me")], Mode.AUTO, {"a"}, ""),
        ([Arm("me"), Disarm("me")], Mode.DISARMED, set(), ""),
        ([Arm("me"), EStop("button")], Mode.ESTOP, set(), ""),
        ([Arm("me"), EStop("button"), Arm("me")], Mode.ESTOP, set(), "e-stop by button"),
        ([Arm("me"), EStop("button"), ResetEStop("me")], Mode.DISARMED, set(), ""),
        ([Arm("me"), EStop("button"), ResetEStop("me"), Arm("me")], Mode.AUTO, {"a"}, ""),
        ([EStop("button"), EStop("page"), ResetEStop("me")], Mode.DISARMED, set(), ""),
        ([ResetEStop("me")], Mode.DISARMED, set(), "no e-stop"),
        ([Start("me", "b")], Mode.DISARMED, set(), "disarmed"),
        ([Arm("me"), Start("me", "b")], Mode.AUTO, {"a", "b"}, ""),
        ([Arm("me"), Start("me", "c")], Mode.AUTO, {"a"}, "no behaviour 'c'"),
        ([Arm("me"), Cancel("me", "a")], Mode.AUTO, set(), ""),
        ([Arm("me"), Cancel("me", "b")], Mode.AUTO, {"a"}, "b is not active"),
        ([HAND], Mode.DISARMED, set(), "disarmed"),
        ([Arm("me"), HAND], Mode.MANUAL, {"a"}, ""),
        ([Arm("me"), HAND, Teleop("other", Drive(), S // 2)], Mode.MANUAL, {"a"}, "pad holds"),
        ([Arm("me"), HAND, Resume("me")], Mode.AUTO, {"a"}, ""),
        ([Arm("me"), Teleop("pad", Drive(), 2 * S)], Mode.AUTO, {"a"}, "a lease lasts"),
        ([Arm("me"), Pause("me")], Mode.PAUSED, {"a"}, ""),
        ([Arm("me"), Pause("me"), HAND], Mode.MANUAL, {"a"}, ""),
        ([Arm("me"), Pause("me"), Resume("me")], Mode.AUTO, {"a"}, ""),
        ([Arm("me"), HAND, EStop("button"), Resume("me")], Mode.ESTOP, set(), "e-stop"),
    ],
)
def test_histories(history: list[Request], mode: Mode, active: set[str], refused: str) -> None:
    state, last_refusal = run(*history)
    assert state.mode is mode
    assert state.active == active
    assert bool(last_refusal) == bool(refused) and refused in last_refusal
    assert state.reason or mode is Mode.AUTO, "a robot that may not move says why"


def test_a_lease_that_ended_does_not_give_autonomy_back() -> None:
    state, _ = run(Arm("me"), HAND)
    late = decide(state, Teleop("other", Drive(), S // 2), FACTS, 2 * S)
    assert not late.refused, "the lease is over, so another hand may take it"
    assert state.mode is Mode.MANUAL


def test_not_ready_is_the_reason_of_the_refusal() -> None:
    state, refused = run(Arm("me"), facts=Facts(not_ready="waiting for lidar"))
    assert refused == "waiting for lidar"
    assert state.mode is Mode.DISARMED


def test_benched_behaviours_neither_start_nor_autostart() -> None:
    facts = Facts(behaviours=frozenset({"a"}), benched=frozenset({"a"}), autostart=(Start("config", "a"),))
    assert run(Arm("me"), facts=facts)[0].active == set()
    assert "benched" in run(Arm("me"), Start("me", "a"), facts=facts)[1]


def test_an_ended_goal_leaves_the_others() -> None:
    state, _ = run(Arm("me"), Start("me", "b"))
    assert ended(state, "a").active == {"b"}


requests = st.one_of(
    st.builds(Arm, st.just("x")),
    st.builds(Disarm, st.just("x")),
    st.builds(EStop, st.just("x")),
    st.builds(ResetEStop, st.just("x")),
    st.builds(Start, st.just("x"), st.sampled_from(["a", "b", "c"])),
    st.builds(Cancel, st.just("x"), st.sampled_from(["a", "b", "c"])),
    st.builds(Pause, st.just("x")),
    st.builds(Resume, st.just("x")),
    st.builds(Teleop, st.sampled_from(["x", "y"]), st.just(Drive(0.1)), st.integers(-S, 3 * S)),
)


@given(st.lists(st.tuples(requests, st.integers(0, S)), max_size=40))
def test_laws(history: list[tuple[Request, int]]) -> None:
    state, now_ns = OperatorState(), 0
    for request, later_ns in history:
        now_ns += later_ns
        before, answer = state, decide(state, request, FACTS, now_ns)
        state = answer.state
        if answer.refused:
            assert state == before, "a refusal changes nothing"
        if before.estop is not None and not isinstance(request, ResetEStop):
            assert state.estop is not None, "the e-stop is latched"
        if isinstance(request, ResetEStop):
            assert not state.armed or before.armed, "a reset does not arm"
        if state.armed and not before.armed:
            assert isinstance(request, Arm), "only arming arms"
        if before.mode is Mode.MANUAL and state.mode is Mode.AUTO:
            assert isinstance(request, Resume), "only resume gives autonomy back"
        if state.mode in (Mode.ESTOP, Mode.DISARMED):
            assert not state.active and state.lease is None
