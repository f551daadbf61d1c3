"""Who may move the robot: modes, arming, the e-stop latch, goals and leases, as a pure state machine.

    e-stop from any source -> latched -> reset (does not start motion) -> arm (a third act) -> drive

MANUAL is a mode, not a priority: when its lease ends the robot stops, and autonomy returns only by `resume`.
Disarming, an e-stop and the loss of a needed device end every goal; arming starts anew what the config starts.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TypeAlias

from robotd.authoring.config import Goal
from robotd.world.messages import Command, Mode

MAX_LEASE_NS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Arm:
    by: str


@dataclass(frozen=True, slots=True)
class Disarm:
    by: str
    reason: str = ""


@dataclass(frozen=True, slots=True)
class EStop:
    by: str
    reason: str = ""


@dataclass(frozen=True, slots=True)
class ResetEStop:
    by: str


@dataclass(frozen=True, slots=True)
class Start:
    by: str
    behaviour: str
    goal: Goal | None = None


@dataclass(frozen=True, slots=True)
class Cancel:
    by: str
    behaviour: str


@dataclass(frozen=True, slots=True)
class Pause:
    by: str


@dataclass(frozen=True, slots=True)
class Resume:
    by: str


@dataclass(frozen=True, slots=True)
class Teleop:
    by: str
    drive: Command
    lease_ns: int


Request: TypeAlias = Arm | Disarm | EStop | ResetEStop | Start | Cancel | Pause | Resume | Teleop


@dataclass(frozen=True, slots=True)
class Lease:
    """The hand that drives: until `until_ns` the latest command of `by` stands."""

    by: str
    drive: Command
    until_ns: int


@dataclass(frozen=True, slots=True)
class OperatorState:
    """All that the operator knows, and what follows from it, worked out once.

    mode: who may move the robot. reason: why it stands, as long as the mode lets nothing drive; else empty.
    """

    armed: bool = False
    estop: EStop | None = None
    paused_by: str | None = None
    lease: Lease | None = None
    active: frozenset[str] = frozenset()
    why_disarmed: str = "not armed yet"
    mode: Mode = field(init=False)
    reason: str = field(init=False)

    def __post_init__(self) -> None:
        mode, reason = self._judged()
        object.__setattr__(self, "mode", mode)
        object.__setattr__(self, "reason", reason)

    def _judged(self) -> tuple[Mode, str]:
        if self.estop is not None:
            said = f": {self.estop.reason}" if self.estop.reason else ""
            return Mode.ESTOP, f"e-stop by {self.estop.by}{said}; reset it, then arm"
        if not self.armed:
            return Mode.DISARMED, f"disarmed: {self.why_disarmed}"
        if self.lease is not None:
            return Mode.MANUAL, f"driven by hand by {self.lease.by}"
        if self.paused_by is not None:
            return Mode.PAUSED, f"paused by {self.paused_by}"
        return Mode.AUTO, ""


@dataclass(frozen=True, slots=True)
class Answer:
    """The new state, and what follows. `refused` is empty where the request was accepted.

    start: behaviours to begin; stop: behaviours whose goals end as CANCELLED with `why`.
    """

    state: OperatorState
    refused: str = ""
    start: tuple[Start, ...] = ()
    stop: tuple[str, ...] = ()
    why: str = ""


@dataclass(frozen=True, slots=True)
class Facts:
    """What the operator must know of the robot to decide. `not_ready`: why it cannot be armed, or empty."""

    behaviours: frozenset[str] = frozenset()
    benched: frozenset[str] = frozenset()
    autostart: tuple[Start, ...] = field(default_factory=tuple)
    not_ready: str = ""


def decide(state: OperatorState, request: Request, facts: Facts, now_ns: int) -> Answer:
    """The answer to one request; the state is unchanged wherever it is refused."""
    match request:
        case EStop():
            if state.estop is not None:
                return Answer(state)
            stopped = replace(state, estop=request, armed=False, lease=None, paused_by=None, active=frozenset())
            stopped = replace(stopped, why_disarmed="the e-stop was tripped")
            return Answer(stopped, stop=tuple(sorted(state.active)), why=f"e-stop by {request.by}")
        case ResetEStop():
            if state.estop is None:
                return Answer(state, refused="no e-stop is latched")
            return Answer(replace(state, estop=None, why_disarmed="the e-stop was reset; arm to drive"))
        case Disarm():
            why = request.reason or f"by {request.by}"
            off = replace(state, armed=False, lease=None, paused_by=None, active=frozenset(), why_disarmed=why)
            return Answer(off, stop=tuple(sorted(state.active)), why=f"disarmed {why}")
        case Arm():
            return _arm(state, facts)
        case Start():
            return _start(state, request, facts)
        case Cancel():
            if request.behaviour not in state.active:
                return Answer(state, refused=f"{request.behaviour} is not active")
            rest = replace(state, active=state.active - {request.behaviour})
            return Answer(rest, stop=(request.behaviour,), why=f"cancelled by {request.by}")
        case Pause():
            if not state.armed:
                return Answer(state, refused=state.reason)
            return Answer(replace(state, paused_by=request.by))
        case Resume():
            if not state.armed:
                return Answer(state, refused=state.reason)
            return Answer(replace(state, paused_by=None, lease=None))
        case Teleop():
            return _teleop(state, request, now_ns)


def ended(state: OperatorState, behaviour: str) -> OperatorState:
    """The state after a behaviour ended by itself (done, failed, benched)."""
    return replace(state, active=state.active - {behaviour})


def _arm(state: OperatorState, facts: Facts) -> Answer:
    if state.estop is not None:
        return Answer(state, refused=state.reason)
    if state.armed:
        return Answer(state)
    if facts.not_ready:
        return Answer(state, refused=facts.not_ready)
    begin = tuple(start for start in facts.autostart if start.behaviour not in facts.benched)
    armed = replace(state, armed=True, active=frozenset(start.behaviour for start in begin), why_disarmed="")
    return Answer(armed, start=begin)


def _start(state: OperatorState, request: Start, facts: Facts) -> Answer:
    name = request.behaviour
    if name not in facts.behaviours:
        known = ", ".join(sorted(facts.behaviours)) or "none"
        return Answer(state, refused=f"no behaviour {name!r}; this robot has: {known}")
    if name in facts.benched:
        return Answer(state, refused=f"{name} is benched after an exception; restart robotd once it is mended")
    if not state.armed:
        return Answer(state, refused=state.reason)
    again = (name,) if name in state.active else ()
    return Answer(
        replace(state, active=state.active | {name}), start=(request,), stop=again, why=f"restarted by {request.by}"
    )


def _teleop(state: OperatorState, request: Teleop, now_ns: int) -> Answer:
    if not state.armed:
        return Answer(state, refused=state.reason)
    held = state.lease
    if held is not None and held.by != request.by and now_ns <= held.until_ns:
        return Answer(state, refused=f"{held.by} holds the lease")
    if not 0 < request.lease_ns <= MAX_LEASE_NS:
        return Answer(state, refused=f"a lease lasts up to {MAX_LEASE_NS / 1e9:g} s; renew it with each command")
    return Answer(replace(state, lease=Lease(request.by, request.drive, now_ns + request.lease_ns)))
