"""The way down of every turn: one arbitration, the guard, one write to the base; and why the robot stands still."""

from __future__ import annotations

from collections.abc import Sequence

from robotd.authoring.device import Actuator
from robotd.engine.bus import Slot
from robotd.engine.contracts import Base, Journal
from robotd.engine.graph import Graph, base_of
from robotd.engine.parts import Parts
from robotd.safety.arbiter import Proposal, Verdict, arbitrate
from robotd.safety.guard import Guard, Sensed
from robotd.safety.operator import OperatorState
from robotd.world.clock import ns
from robotd.world.kinematics import Ackermann, steer_to_drive
from robotd.world.messages import STOP, Applied, Command, Drive, LidarScan, Steer

HALT_EVERY_TICKS = 10
"""While nothing drives, the stop is written again every so many ticks, in case the first was lost on the way."""


class _Halted:
    """A base on the way out: it takes no command any more, however long the loop still turns."""

    def __init__(self, base: Base) -> None:
        self._base = base

    def apply(self, command: object) -> None:
        pass

    def halt(self) -> None:
        self._base.halt()

    def estop(self) -> None:
        self._base.estop()


class WayDown:
    """From standing proposals to the one write. It remembers what was written last, and nothing of the plugins."""

    def __init__(self, parts: Parts, graph: Graph, base: Base, journal: Journal | None, why: str, now_ns: int) -> None:
        self.guard = Guard(parts.robot, parts.guard)
        self.command: Command = STOP
        self.limited_by: tuple[str, ...] = ()
        self.verdict = Verdict(None, (), why)
        self.guard_reason = ""
        """Why the guard lets nothing through; empty where it does, and where nobody wants to drive."""
        base_part = base_of(parts)
        accepts = base_part.cls.accepts if base_part is not None and issubclass(base_part.cls, Actuator) else Drive
        self.takes: type[Command] = accepts
        self._base = base
        self._journal = journal
        self._applied = graph.slots["applied"]
        self._scans: tuple[Slot, ...] = tuple(graph.slots[name] for name in self.guard.sources)
        self._sensed: dict[Slot, tuple[int, Sensed]] = {}
        self._scan_within_ns = ns(parts.guard.scan_within_s)
        kinematics = parts.robot.kinematics
        self._wheelbase_m = kinematics.wheelbase_m if isinstance(kinematics, Ackermann) else None
        self._driving = True  # so that the first turn writes a stop
        self._written_ns = now_ns
        self._settled: tuple[int, Command, str] | None = None
        self._ticks_halted = 0

    @property
    def moves(self) -> bool:
        """Whether the last command was one to move."""
        command = self.command
        return command != STOP and not (isinstance(command, Steer) and command.speed_mps == 0.0)

    def decide(
        self,
        proposals: Sequence[Proposal],
        manual: Proposal | None,
        operator: OperatorState,
        now_ns: int,
        *,
        tick: bool,
    ) -> bool:
        """One arbitration and at most one write; True where the reason for standing still may have changed.

        tick: repeat what stands, for the base's own watchdog.
        """
        verdict = arbitrate(proposals, manual, operator.mode, operator.reason, now_ns)
        self.verdict = verdict
        winner = verdict.winner
        if winner is None:
            return self._stand(now_ns, tick=tick)
        stale, scans = "", 0
        for slot in self._scans:
            scans += slot.sequence  # grows with each scan of any source
            if slot.message is None or now_ns - slot.oldest_ns > self._scan_within_ns:
                stale = stale or slot.topic.name
        settled = (scans, winner.command, winner.by)
        if settled == self._settled and not stale:
            if tick:  # nothing changed: the heartbeat repeats what was decided
                self._base.apply(self.command)
                self._written_ns = now_ns
            return False
        command = winner.command
        if command.__class__ is not self.takes:
            command = self._converted(command)
        guarded = self.guard.limit(
            command,
            by=winner.by,
            previous=self.command,
            dt_s=(now_ns - self._written_ns) / 1e9,
            sensed=self._sense() if self._scans and not stale else (),
            stale=stale,
        )
        # a ramp goes on by itself; anything else stays until the wish or a scan changes
        self._settled = settled if "acceleration" not in guarded.limited_by else None
        self._driving = True
        self._write(guarded.command, winner.by, guarded.limited_by, now_ns)
        changed, self.guard_reason = guarded.reason != self.guard_reason, guarded.reason
        return changed

    def estop(self) -> None:
        """Somebody pulled the e-stop: the base does what it has for that, before anything else."""
        self._base.estop()

    def halt(self) -> None:
        """The way out: stop, whatever state the rest is in. From here on nothing drives or is written down."""
        if not isinstance(self._base, _Halted):
            self._base = _Halted(self._base)
            self._journal = None
        self._base.halt()

    def _stand(self, now_ns: int, *, tick: bool) -> bool:
        self._settled = None
        self.guard_reason = ""
        if self._driving:
            self._driving = False
            self._ticks_halted = 0
            self._write(None, "", (), now_ns)
            return True
        if tick:
            self._ticks_halted += 1
            if self._ticks_halted % HALT_EVERY_TICKS == 0:
                self._base.halt()
        return False

    def _converted(self, command: Command) -> Command:
        """A car's command for a base that takes velocities."""
        return steer_to_drive(command, self._wheelbase_m or 1.0) if isinstance(command, Steer) else command

    def _sense(self) -> list[Sensed]:
        """What the zones need of their sources, each of which has a scan; worked out once a scan."""
        sensed = []
        for slot in self._scans:
            sequence, known = self._sensed.get(slot, (-1, None))
            if known is None or sequence != slot.sequence:
                assert isinstance(slot.message, LidarScan)
                known = self.guard.sense(slot.topic.name, slot.message)
                self._sensed[slot] = slot.sequence, known
            sensed.append(known)
        return sensed

    def _write(self, command: Command | None, by: str, limited_by: tuple[str, ...], now_ns: int) -> None:
        if command is None:
            self._base.halt()
            command = STOP
        else:
            self._base.apply(command)
        self.command = command
        self.limited_by = limited_by
        self._written_ns = now_ns
        applied = Applied(now_ns, command, by, limited_by)
        if self._journal is not None:
            self._journal.note("command", by, now_ns, applied)
        self._applied.put(applied, now_ns)
