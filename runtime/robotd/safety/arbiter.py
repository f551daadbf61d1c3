"""Picks one proposal, and says why each other one lost: pure, no clock, no I/O.

Order of authority: e-stop, disarmed, MANUAL (a lease), behaviours by priority. Nobody fresh means stop.
Ties cannot happen: equal priorities are refused when the config is loaded.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from typing import NamedTuple

from robotd.world.messages import Command, Mode


class Loss(Enum):
    """Why a proposal did not become the command."""

    STALE = "its inputs are too old"
    OUTRANKED = "a higher priority drives"
    NOT_ALLOWED = "the mode lets no behaviour drive"


class Proposal(NamedTuple):
    """What somebody wants. `fresh_until_ns` and `oldest_ns` come from the inputs, never from the author."""

    by: str
    priority: int
    command: Command
    oldest_ns: int
    fresh_until_ns: int


class Loser(NamedTuple):
    """A proposal that lost, and to whom or to what."""

    by: str
    loss: Loss
    detail: str = ""


class Verdict(NamedTuple):
    """What was decided. `winner` None means stop, and `reason` says why in words for people."""

    winner: Proposal | None
    losers: tuple[Loser, ...] = ()
    reason: str = ""


_AUTO = Mode.AUTO
_NOBODY = "no behaviour has an opinion"


def arbitrate(proposals: Sequence[Proposal], manual: Proposal | None, mode: Mode, why: str, now_ns: int) -> Verdict:
    """The verdict over all standing proposals at `now_ns`.

    proposals: at most one of each behaviour. manual: the operator's own, under its lease. why: the reason for `mode`,
    repeated to people while nothing may drive.
    """
    if mode is _AUTO:
        if len(proposals) == 1 and now_ns <= proposals[0].fresh_until_ns:
            return Verdict(proposals[0])
        return _by_priority(proposals, now_ns)
    losers = tuple(Loser(p.by, Loss.NOT_ALLOWED, mode.value) for p in proposals)
    if mode is not Mode.MANUAL:
        return Verdict(None, losers, why)
    if manual is None or now_ns > manual.fresh_until_ns:
        return Verdict(None, losers, "the manual lease has ended; resume gives the robot back to its behaviours")
    return Verdict(manual, losers)


def _by_priority(proposals: Sequence[Proposal], now_ns: int) -> Verdict:
    winner: Proposal | None = None
    for proposal in proposals:
        if now_ns <= proposal.fresh_until_ns and (winner is None or proposal.priority > winner.priority):
            winner = proposal
    if winner is None:
        if not proposals:
            return Verdict(None, (), _NOBODY)
        stale = tuple(Loser(p.by, Loss.STALE) for p in proposals)
        return Verdict(None, stale, f"the inputs of {stale[0].by} are too old")
    losers = tuple(
        Loser(p.by, Loss.STALE) if now_ns > p.fresh_until_ns else Loser(p.by, Loss.OUTRANKED, winner.by)
        for p in proposals
        if p is not winner
    )
    return Verdict(winner, losers)
