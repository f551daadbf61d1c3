"""The arbiter's rules as rows: who wins, who loses and why."""

from __future__ import annotations

import pytest

from robotd.safety.arbiter import Loss, Proposal, arbitrate
from robotd.world.messages import Drive, Mode

GO = Drive(0.3)


def proposal(by: str, priority: int, fresh_until_ns: int = 100) -> Proposal:
    return Proposal(by, priority, GO, 0, fresh_until_ns)


LOW, HIGH = proposal("low", 10), proposal("high", 20)
OLD = proposal("old", 30, fresh_until_ns=10)
HAND = proposal("hand", 0, fresh_until_ns=60)


@pytest.mark.parametrize(
    ("mode", "proposals", "manual", "winner", "losers"),
    [
        (Mode.AUTO, [], None, None, {}),
        (Mode.AUTO, [LOW], None, "low", {}),
        (Mode.AUTO, [LOW, HIGH], None, "high", {"low": Loss.OUTRANKED}),
        (Mode.AUTO, [HIGH, LOW], None, "high", {"low": Loss.OUTRANKED}),
        (Mode.AUTO, [OLD], None, None, {"old": Loss.STALE}),
        (Mode.AUTO, [OLD, LOW], None, "low", {"old": Loss.STALE}),
        (Mode.AUTO, [OLD, LOW, HIGH], None, "high", {"old": Loss.STALE, "low": Loss.OUTRANKED}),
        (Mode.MANUAL, [HIGH], HAND, "hand", {"high": Loss.NOT_ALLOWED}),
        (Mode.MANUAL, [HIGH], None, None, {"high": Loss.NOT_ALLOWED}),
        (Mode.PAUSED, [HIGH], HAND, None, {"high": Loss.NOT_ALLOWED}),
        (Mode.DISARMED, [HIGH], HAND, None, {"high": Loss.NOT_ALLOWED}),
        (Mode.ESTOP, [HIGH], HAND, None, {"high": Loss.NOT_ALLOWED}),
    ],
)
def test_who_wins(
    mode: Mode, proposals: list[Proposal], manual: Proposal | None, winner: str | None, losers: dict[str, Loss]
) -> None:
    verdict = arbitrate(proposals, manual, mode, "because", 50)
    assert (verdict.winner.by if verdict.winner else None) == winner
    assert {loser.by: loser.loss for loser in verdict.losers} == losers
    assert verdict.reason or verdict.winner is not None, "a stop without a reason"


def test_a_lease_that_ended_stops_and_says_how_to_go_on() -> None:
    verdict = arbitrate([HIGH], HAND, Mode.MANUAL, "", 61)
    assert verdict.winner is None
    assert "resume" in verdict.reason


@pytest.mark.parametrize(("now_ns", "fresh"), [(100, True), (101, False)])
def test_freshness_ends_after_its_last_nanosecond(now_ns: int, fresh: bool) -> None:
    assert (arbitrate([LOW], None, Mode.AUTO, "", now_ns).winner is LOW) is fresh
