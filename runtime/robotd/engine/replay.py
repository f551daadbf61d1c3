"""Runs a recording again, turn by turn, and compares what is written to the base bit for bit.

Nothing is opened and no time passes: the turn gets the recorded inputs at the recorded instants. Behaviours and quick
perceptors run for real. What a slow perceptor answered, and what a perceptor made of frames that were not kept, comes
from the recording.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

from robotd.authoring.view import View
from robotd.engine.codec import RecordError, allow, decode, encode
from robotd.engine.core import Core
from robotd.engine.graph import Graph, compile_graph, device_topics
from robotd.engine.guarding import GUARDIAN
from robotd.engine.journal import FORMAT, INPUTS
from robotd.engine.nodes import Node, PerceptorNode
from robotd.engine.parts import Parts, PerceptorPart
from robotd.engine.record_file import platform_header
from robotd.engine.record_reader import DROPPED, Entry, Recording
from robotd.safety.operator import Arm, Cancel, Disarm, EStop, Pause, Request, ResetEStop, Resume, Start, Teleop
from robotd.world.messages import Applied, CameraFrame, Drive, Message, Steer

ARITHMETIC = ("numpy", "cpu", "libc")
"""Keys of a header that decide the last bit of a number."""

_REQUESTS = (Arm, Cancel, Disarm, EStop, Pause, ResetEStop, Resume, Start, Teleop)


@dataclass(frozen=True, slots=True)
class Difference:
    """The first command that did not come out again.

    `turn` and `now_ns` as recorded, `time_s` since the start of the run. `recorded` and `replayed` are None where that
    side wrote nothing. `fault`: what the replay raised instead, or empty. `entered`: the last inputs, its own last.
    """

    turn: int
    now_ns: int
    time_s: float
    recorded: Applied | None
    replayed: Applied | None
    entered: tuple[str, ...]
    fault: str = ""

    def __str__(self) -> str:
        before = f", before that {', '.join(reversed(self.entered[:-1]))}" if self.entered[1:] else ""
        return (
            f"turn {self.turn} at {self.time_s:.6f} s: recorded {_told(self.recorded)}; "
            f"replayed {self.fault or _told(self.replayed)}; the turn of {self.entered[-1]}{before}"
        )


@dataclass(frozen=True, slots=True)
class ReplayReport:
    """What a replay found. `compared`, `uncompared`: commands up to and after the end of what can be compared."""

    compared: int
    first_difference: Difference | None = None
    uncompared: int = 0
    turns: int = 0
    notes: tuple[str, ...] = ()


@dataclass(slots=True)
class Turn:
    """One input as recorded and what came of it. `broken`: why it may lack something, or empty."""

    entry: Entry
    perceived: list[Entry] = field(default_factory=list)
    commands: list[Entry] = field(default_factory=list)
    broken: str = ""


def turns(recording: Recording) -> Iterator[Turn]:
    """The turns of a recording up to the first that is not whole, which comes last. Raises RecordError for no start."""
    turn: Turn | None = None
    for entry in recording:
        if turn is None:
            if entry.kind != "started":
                raise RecordError(f"{recording.path}: begins with {entry.kind!r} of turn {entry.sequence}, not a start")
            turn = Turn(entry)
            continue
        match entry.kind:
            case kind if kind in INPUTS:
                yield turn
                turn = Turn(entry)
            case "perceived":
                turn.perceived.append(entry)
            case "command":
                turn.commands.append(entry)
            case "failed":
                turn.broken = f"the run ended with a fault: {decode(entry.payload, {})}"
            case kind if kind == DROPPED:
                gap = decode(entry.payload, {})
                first = gap["first_sequence"]
                if entry.sequence != turn.entry.sequence:  # the gap begins after this turn, which is whole
                    yield turn
                    turn = Turn(entry)
                turn.broken = f"{gap['count']} entries are missing from turn {first} on ({gap['reason']})"
            case _:
                raise RecordError(f"{recording.path}: turn {entry.sequence} holds a {entry.kind!r}, which is unknown")
        if turn.broken:
            yield turn
            return
    if turn is None:
        raise RecordError(f"{recording.path}: holds no run ({recording.end.reason or 'it is empty'})")
    if not recording.end.is_complete:
        turn.broken = f"the file ends too early ({recording.end.reason})"
    yield turn


def replay(
    recording: Recording,
    parts: Parts,
    tolerance: float = 0.0,
    watch: Callable[[Core, Turn], None] | None = None,
) -> ReplayReport:
    """Run `recording` through the same robot and compare the commands, up to the first difference.

    parts: the robot, as its recorded config makes it. tolerance: the largest difference of a number (m/s, rad/s, rad)
    that counts as equal; 0 means bit for bit, with who drove and what limited it. watch: called after each turn.

    Raises RecordError for a recording that this robot cannot have made, and whatever a plugin's `load` raises.
    """
    if recording.header.get("format") != FORMAT:
        found = recording.header.get("format")
        raise RecordError(f"{recording.path}: a run of format {found}, this robotd replays format {FORMAT}")
    player = Player(parts, frames=bool(recording.header.get("frames")))
    entered: deque[Entry] = deque(maxlen=3)
    compared, count, broken, difference = 0, 0, "", None
    start_ns = end_ns = 0
    for turn in turns(recording):
        now_ns, broken = turn.entry.now_ns, turn.broken
        start_ns = now_ns if count == 0 else start_ns
        if broken:
            end_ns = now_ns
            break
        count += 1
        entered.append(turn.entry)
        fault = ""
        try:
            player.play(turn)
        except RecordError:
            raise
        except Exception as error:
            fault = f"{type(error).__name__}: {error}"
        same, wrong = player.compare(turn.commands, tolerance)
        compared += same
        if fault or wrong is not None:
            recorded, replayed = wrong if wrong is not None else (None, None)
            difference = Difference(
                turn=turn.entry.sequence,
                now_ns=now_ns,
                time_s=(now_ns - start_ns) / 1e9,
                recorded=recorded,
                replayed=replayed,
                entered=tuple(player.tell(entry) for entry in entered),
                fault=fault and f"raised {fault}",
            )
            break
        if watch is not None and player.core is not None:
            watch(player.core, turn)
    notes = [*platform_notes(recording.header), *player.notes]
    uncompared = 0
    if broken:
        uncompared = sum(1 for e in recording if e.kind == "command") - compared
        notes.append(f"compared up to {(end_ns - start_ns) / 1e9:.3f} s: {broken}")
        if uncompared:
            notes.append(f"{uncompared} commands after that were not compared")
    return ReplayReport(compared, difference, uncompared, count, tuple(notes))


def platform_notes(header: Mapping[str, Any]) -> tuple[str, ...]:
    """What of robotd, Python and this computer's arithmetic is other than where the recording was made."""
    here = platform_header()
    return tuple(
        f"recorded with {key} {header[key]}, replayed with {here[key]}"
        for key in here
        if key in header and header[key] != here[key]
    )


def same_arithmetic(header: Mapping[str, Any]) -> bool:
    """Whether equal inputs must give equal bits here: the same numpy, processor class and C library."""
    here = platform_header()
    return all(header.get(key) == here[key] for key in ARITHMETIC)


def known_classes(parts: Parts) -> dict[str, type]:
    """Every class that an entry of this robot's recordings may name; the table for `codec.decode`."""
    roots: list[type] = [Applied, Drive, Steer, CameraFrame, *_REQUESTS]
    for device in parts.devices:
        roots += device_topics(device)
    for perceptor in parts.perceptors:
        roots += _family(perceptor.cls.produces)
    roots += [behaviour.cls.goal_type for behaviour in parts.behaviours]
    return allow(*roots)


def _family(cls: type) -> list[type]:
    """A class and all that derive from it: a perceptor may return a message of a narrower type than it declares."""
    found = [cls]
    heirs: list[type] = cls.__subclasses__()
    for heir in heirs:
        found += _family(heir)
    return found


class Player:
    """One robot without devices: gives recorded turns to a `Core` and keeps what it writes.

    `core` is None until the turn `started`. `written`: commands of the last turn.
    """

    def __init__(self, parts: Parts, *, frames: bool) -> None:
        self._classes = known_classes(parts)
        played = [part for part in parts.perceptors if part.cls.offload or (not frames and _sees_frames(part))]
        kept = tuple(_stand_in(part) if part in played else part for part in parts.perceptors)
        self.parts = replace(parts, perceptors=kept)
        self.notes: list[str] = []
        if played:
            self.notes.append(f"played back, not run: {', '.join(part.name for part in played)}")
        for perceptor in self.parts.perceptors:
            perceptor.cls.load(perceptor.config)
        for behaviour in self.parts.behaviours:
            behaviour.cls.load(behaviour.config)
        self._graph: Graph = compile_graph(self.parts)
        self._perceptors = {node.name: node for node in self._graph.perceptors}
        self._played: dict[str, _Played] = {}
        for node in self._graph.perceptors:
            if node.sees_frames and not node.offload and not frames:
                node.played = self._played[node.name] = _Played(node.name)
        self.written: list[Applied] = []
        self.core: Core | None = None

    # the turn's journal, base, timers and offloader: only the first listens

    def note(self, kind: str, ref: str, now_ns: int, payload: Any) -> None:
        if kind == "command":
            self.written.append(payload)

    def apply(self, command: Any) -> None:
        pass

    def halt(self) -> None:
        pass

    def estop(self) -> None:
        pass

    def now_ns(self) -> int:
        raise RuntimeError("nobody asks a replay for the time: it comes with each input")

    def call_at_ns(self, when_ns: int, callback: Callable[..., object], *args: object) -> object:
        return None

    def submit(self, node: PerceptorNode, view: View, oldest_ns: int, now_ns: int) -> None:
        pass

    # ------------------------------------------------------------------------------------------ playing

    def play(self, turn: Turn) -> None:
        """One turn. Raises RecordError where this robot cannot take it, and what the turn itself raises."""
        entry = turn.entry
        self.written = []
        for made in turn.perceived:
            if made.topic in self._played:
                self._played[made.topic].append(self.value(made))
        now_ns = entry.now_ns
        if entry.kind == "started":
            self.core = Core(self.parts, self._graph, self, timers=self, offloader=self, journal=self, now_ns=now_ns)
            return
        core = self.core
        assert core is not None
        match entry.kind:
            case "tick":
                core.tick(now_ns)
            case "message":
                core.receive(self._find(self._graph.slots, entry, "topic"), self.value(entry), now_ns)
            case "timer":
                core.timer(self._node(entry), now_ns)
            case "expiry":
                core.expire(self._node(entry), now_ns)
            case "offloaded":
                result, oldest_ns = self.value(entry)
                core.offloaded(self._find(self._perceptors, entry, "perceptor"), result, oldest_ns, now_ns)
            case "request":
                request: Request = self.value(entry)
                core.request(request, now_ns)
            case "opened":
                core.device_opened(self._device(entry), now_ns)
            case "lost":
                core.device_lost(self._device(entry), self.value(entry), now_ns)
        for name, left in self._played.items():
            if left:
                left.clear()
                raise RuntimeError(f"perceptor {name} was stepped less often than recorded")

    def tell(self, entry: Entry) -> str:
        """An input in words: `message lidar_scan`, `request EStop by button`."""
        words = f"{entry.kind} {entry.topic}".strip()
        if entry.kind == "message":
            stamp_ns = self.value(entry).stamp_ns
            return f"{words} ({(entry.now_ns - stamp_ns) / 1e6:.3g} ms old)"
        return f"{words} by {self.value(entry).by}" if entry.kind == "request" else words

    def compare(
        self, recorded: list[Entry], tolerance: float
    ) -> tuple[int, tuple[Applied | None, Applied | None] | None]:
        """How many commands of the last turn are the recorded ones, and the first pair that is not."""
        written = self.written
        for i in range(max(len(recorded), len(written))):
            entry = recorded[i] if i < len(recorded) else None
            made = written[i] if i < len(written) else None
            if entry is not None and made is not None and entry.payload == encode(made):
                continue
            meant = self.value(entry) if entry is not None else None
            if not (tolerance and meant is not None and made is not None and _near(meant, made, tolerance)):
                return i, (meant, made)
        return len(recorded), None

    def value(self, entry: Entry) -> Any:
        """What an entry holds; None where it holds nothing. Raises RecordError naming the turn."""
        if not entry.payload:
            return None
        try:
            return decode(entry.payload, self._classes)
        except RecordError as error:
            raise RecordError(f"turn {entry.sequence}, {entry.kind} {entry.topic}: {error}") from error

    def _node(self, entry: Entry) -> Node:
        index = self.value(entry)
        nodes = self._graph.nodes
        if not isinstance(index, int) or not 0 <= index < len(nodes) or nodes[index].name != entry.topic:
            raise RecordError(f"turn {entry.sequence}: this robot has no {entry.topic!r} at {index}")
        return nodes[index]

    def _device(self, entry: Entry) -> str:
        if entry.topic != GUARDIAN:
            self._find({part.name: part for part in self.parts.devices}, entry, "device")
        return entry.topic

    def _find(self, table: Mapping[str, Any], entry: Entry, what: str) -> Any:
        try:
            return table[entry.topic]
        except KeyError:
            raise RecordError(f"turn {entry.sequence}: this robot has no {what} {entry.topic!r}") from None


class _Played(deque["Message | str | None"]):
    """What a perceptor made of frames, as recorded; asking for more than that is a difference."""

    def __init__(self, name: str) -> None:
        super().__init__()
        self.name = name

    def popleft(self) -> Message | str | None:
        if not self:
            raise RuntimeError(f"perceptor {self.name} was stepped more often than recorded")
        return super().popleft()


def _sees_frames(part: PerceptorPart) -> bool:
    return any(issubclass(spec.topic.type, CameraFrame) for spec in part.cls.sees.specs)


def _stand_in(part: PerceptorPart) -> PerceptorPart:
    """The same part for the graph, without its models: a perceptor that is played back is never asked."""
    silent = {
        "__init__": lambda self, config, robot=None: None,
        "load": classmethod(lambda cls, config: None),
        "explain": lambda self: (),
    }
    return replace(part, cls=type(part.cls.__name__, (part.cls,), silent))


def _near(recorded: Applied, replayed: Applied, tolerance: float) -> bool:
    one, other = recorded.command, replayed.command
    if type(one) is not type(other) or recorded.by != replayed.by:
        return False
    pairs: Iterable[tuple[float, float]] = ((getattr(one, f.name), getattr(other, f.name)) for f in fields(one))
    return all(math.isclose(a, b, rel_tol=0.0, abs_tol=tolerance) for a, b in pairs)


def _told(applied: Applied | None) -> str:
    if applied is None:
        return "no command"
    limits = f" (limited: {', '.join(applied.limited_by)})" if applied.limited_by else ""
    return f"{applied.command!r} by {applied.by or 'nobody'}{limits}"
