"""Draws a recorded run as one picture: the path, the speeds, the distances, and who did what when."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from robotd.authoring.explain import Text
from robotd.engine.bus import Slot
from robotd.engine.core import Core
from robotd.engine.parts import Parts
from robotd.engine.record_reader import Recording
from robotd.engine.replay import Player, turns
from robotd.setup.exit_codes import MissingExtra
from robotd.setup.recording import recorded_parts
from robotd.setup.registry import Registry
from robotd.world.kinematics import Ackermann, steer_to_drive
from robotd.world.messages import Applied, Command, Event, LidarScan, Odometry, Outcome, Pose2D, Steer, Target

SUFFIXES = (".png", ".svg", ".pdf")
"""Kinds of pictures that can be written."""

_LISTEN_NS = 1 << 62
_LETTER = 0.009
"""Width of a letter in the states, as a share of the whole time."""
_MODE_COLOURS = {"auto": "#4c9f70", "manual": "#3b7dd8", "paused": "#d8a03b", "disarmed": "#b0b0b0", "estop": "#d0413c"}


@dataclass(slots=True)
class Series:
    """One line over time. `times_s` since the start of the run; a value is nan where there is none."""

    times_s: list[float] = field(default_factory=list)
    values: list[float] = field(default_factory=list)

    def add(self, time_s: float, value: float) -> None:
        self.times_s.append(time_s)
        self.values.append(value)


@dataclass(slots=True)
class Span:
    """Something that held from `start_s` to `end_s`: a mode, who drives, the state that a behaviour names."""

    label: str
    start_s: float
    end_s: float


@dataclass(slots=True)
class Run:
    """Everything that is drawn.

    path_m: (x, y) of the base, and `path_from` says in which topic, or that it was reckoned from the commands.
    speeds, distances: name with unit to line. states: row to its spans, in time. events: (seconds, words).
    """

    title: str
    path_from: str = ""
    path_m: list[tuple[float, float]] = field(default_factory=list)
    speeds: dict[str, Series] = field(default_factory=dict)
    distances: dict[str, Series] = field(default_factory=dict)
    states: dict[str, list[Span]] = field(default_factory=dict)
    events: list[tuple[float, str]] = field(default_factory=list)
    end_s: float = 0.0


def plot_file(path: Path | str, out: Path, *, registry: Registry | None = None) -> Run:
    """Draw the recording at `path` into `out`, whose suffix is one of `SUFFIXES`, and return what was drawn.

    Raises MissingExtra without matplotlib; RecordError and ConfigError as `recorded_parts` does; OSError.
    """
    _figure_class()
    recording = Recording(path)
    run = gather(recording, recorded_parts(recording, registry))
    draw(run, out)
    return run


# ------------------------------------------------------------------------------------------ what is drawn


def gather(recording: Recording, parts: Parts) -> Run:
    """What a recorded run has to show, up to its first gap.

    Commands and sensors are drawn as recorded; states and outcomes as the behaviours give them in a replay.
    """
    player = Player(parts, frames=bool(recording.header.get("frames")))
    reader = _Reader(Run(f"{parts.robot.name}: {recording.path.name}"), parts)
    for turn in turns(recording):
        if turn.broken:
            reader.run.title += f" (drawn up to the first gap: {turn.broken})"
            break
        fresh = player.core is None
        player.play(turn)
        core = player.core
        assert core is not None
        if fresh:
            core.stepping.explain_until_ns = _LISTEN_NS
            core.on_event.append(reader.event)
            reader.start_ns = turn.entry.now_ns
        reader.look(core, turn.entry.now_ns, [player.value(entry) for entry in turn.commands])
    return reader.end()


class _Reader:
    """Takes from each turn what is new in it."""

    def __init__(self, run: Run, parts: Parts) -> None:
        self.run = run
        self.start_ns = 0
        self._kinematics = parts.robot.kinematics
        self._seen: dict[str, int] = {}
        self._poses: dict[str, list[tuple[float, float]]] = {}
        self._reckoned = [(0.0, 0.0)]
        self._yaw_rad = 0.0
        self._command: tuple[int, Command] | None = None

    def event(self, event: Event) -> None:
        """What must not be lost: outcomes and the e-stop."""
        words = f"{event.behaviour} {event.result}" if isinstance(event, Outcome) else type(event).__name__
        self.run.events.append((self._time(event.stamp_ns), words))

    def look(self, core: Core, now_ns: int, commands: list[Applied]) -> None:
        """One turn, after it was played; `commands` as recorded in it."""
        self.run.end_s = self._time(now_ns)
        for slot in core.graph.slots.values():
            if slot.sequence != self._seen.get(slot.topic.name, 0):
                self._seen[slot.topic.name] = slot.sequence
                self._message(slot)
        for applied in commands:
            self._written(applied)
        self._state("mode", core.operator.mode.value, now_ns)
        for node in core.graph.behaviours:
            if node.instance is None:
                self._state(node.name, "", now_ns)
                continue
            told = next((d.text for d in node.explanation if isinstance(d, Text) and d.name == "state"), "active")
            self._state(node.name, told, now_ns)

    def end(self) -> Run:
        run = self.run
        if self._command is not None:
            self._reckon(self.start_ns + round(run.end_s * 1e9))
        for spans in run.states.values():
            spans[-1].end_s = run.end_s
        run.states = {row: [s for s in spans if s.label] for row, spans in run.states.items()}
        run.states = {row: spans for row, spans in run.states.items() if spans}
        poses = {name: path for name, path in self._poses.items() if len(path) > 1}
        if poses:
            # a pose in the map says more than odometry, which drifts
            run.path_from = min(poses, key=lambda name: (not name.startswith("pose"), name))
            run.path_m = poses[run.path_from]
        else:
            run.path_from, run.path_m = "reckoned from the commands", self._reckoned
        return run

    def _time(self, now_ns: int) -> float:
        return (now_ns - self.start_ns) / 1e9

    def _message(self, slot: Slot) -> None:
        message, name = slot.message, slot.topic.name
        if message is None:
            return
        time_s = self._time(message.stamp_ns)
        if isinstance(message, Odometry | Pose2D):
            self._poses.setdefault(name, []).append((message.x_m, message.y_m))
        if isinstance(message, Odometry):
            self._line(self.run.speeds, f"{name} vx [m/s]").add(time_s, message.vx_mps)
        elif isinstance(message, LidarScan):
            ranges = message.ranges_m[np.isfinite(message.ranges_m)]
            self._line(self.run.distances, f"{name} nearest [m]").add(
                time_s, float(ranges.min()) if ranges.size else math.nan
            )
        elif isinstance(message, Target):
            self._line(self.run.distances, f"{name} [m]").add(time_s, message.range_m)

    def _written(self, applied: Applied) -> None:
        now_ns, command = applied.stamp_ns, applied.command
        time_s = self._time(now_ns)
        speeds = self.run.speeds
        if isinstance(command, Steer):
            self._line(speeds, "command speed [m/s]").add(time_s, command.speed_mps)
            self._line(speeds, "command steering [rad]").add(time_s, command.steering_rad)
        else:
            self._line(speeds, "command vx [m/s]").add(time_s, command.vx_mps)
            if command.vy_mps or "command vy [m/s]" in speeds:
                self._line(speeds, "command vy [m/s]").add(time_s, command.vy_mps)
            self._line(speeds, "command wz [rad/s]").add(time_s, command.wz_radps)
        self._state("drives", applied.by, now_ns)
        self._reckon(now_ns)
        self._command = (now_ns, command)

    def _reckon(self, now_ns: int) -> None:
        """The path that the last command means until now, along its arc in small steps."""
        if self._command is None:
            return
        then_ns, command = self._command
        if isinstance(command, Steer):
            wheelbase_m = self._kinematics.wheelbase_m if isinstance(self._kinematics, Ackermann) else 1.0
            command = steer_to_drive(command, wheelbase_m)
        steps = max(1, round((now_ns - then_ns) / 20_000_000))
        dt_s = (now_ns - then_ns) / 1e9 / steps
        x_m, y_m = self._reckoned[-1]
        for _ in range(steps):
            heading = self._yaw_rad + command.wz_radps * dt_s / 2.0
            x_m += (command.vx_mps * math.cos(heading) - command.vy_mps * math.sin(heading)) * dt_s
            y_m += (command.vx_mps * math.sin(heading) + command.vy_mps * math.cos(heading)) * dt_s
            self._yaw_rad += command.wz_radps * dt_s
            self._reckoned.append((x_m, y_m))

    def _line(self, lines: dict[str, Series], name: str) -> Series:
        return lines.setdefault(name, Series())

    def _state(self, row: str, label: str, now_ns: int) -> None:
        time_s = self._time(now_ns)
        spans = self.run.states.setdefault(row, [])
        if not spans or spans[-1].label != label:
            if spans:
                spans[-1].end_s = time_s
            spans.append(Span(label, time_s, time_s))


# ------------------------------------------------------------------------------------------------ drawing


def draw(run: Run, out: Path) -> None:
    """Write the picture; PNG, SVG or PDF by the suffix. Raises MissingExtra, OSError; ValueError for other suffixes."""
    if out.suffix.lower() not in SUFFIXES:
        raise ValueError(f"{out}: cannot draw {out.suffix or 'a file without suffix'}, only {', '.join(SUFFIXES)}")
    figure: Any = _figure_class()(figsize=(14.0, 8.0), layout="constrained")
    figure.suptitle(run.title)
    grid = figure.add_gridspec(3, 2, width_ratios=(1.0, 1.4), height_ratios=(1.0, 1.0, 0.8))
    _draw_path(figure.add_subplot(grid[:, 0]), run)
    speeds = figure.add_subplot(grid[0, 1])
    distances = figure.add_subplot(grid[1, 1], sharex=speeds)
    states = figure.add_subplot(grid[2, 1], sharex=speeds)
    _draw_lines(speeds, run.speeds, "speeds")
    _draw_lines(distances, run.distances, "distances")
    _draw_states(states, run)
    for axes in (speeds, distances, states):
        for time_s, _ in run.events:
            axes.axvline(time_s, color="#d0413c", linewidth=0.8, linestyle=":")
    speeds.set_xlim(0.0, max(run.end_s, 1e-3))
    states.set_xlabel("time [s]")
    figure.savefig(out, dpi=110)


def _figure_class() -> Any:
    try:
        from matplotlib.figure import Figure
    except ModuleNotFoundError as error:
        raise MissingExtra(f"robotd plot needs {error.name}: pip install 'robotd[plot]'") from error
    return Figure


def _draw_path(axes: Any, run: Run) -> None:
    xs, ys = [x for x, _ in run.path_m], [y for _, y in run.path_m]
    axes.plot(xs, ys, linewidth=1.2)
    axes.plot(xs[:1], ys[:1], "o", label="start")
    axes.plot(xs[-1:], ys[-1:], "s", label="end")
    axes.set_title(f"path ({run.path_from})")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.set_aspect("equal", adjustable="datalim")
    axes.grid(alpha=0.3)
    axes.legend(loc="best")


def _draw_lines(axes: Any, lines: dict[str, Series], title: str) -> None:
    for name, series in lines.items():
        # a command holds until the next one
        style = "steps-post" if name.startswith("command ") else "default"
        axes.plot(series.times_s, series.values, label=name, linewidth=1.0, drawstyle=style)
    axes.set_title(title if lines else f"{title}: none recorded")
    axes.grid(alpha=0.3)
    if lines:
        axes.legend(loc="upper right", fontsize="small")


def _draw_states(axes: Any, run: Run) -> None:
    rows = list(run.states)
    colours = dict(_MODE_COLOURS)
    narrow: dict[str, Any] = {}
    for y, row in enumerate(rows):
        for span in run.states[row]:
            colour = colours.setdefault(span.label, f"C{len(colours) % 10}")
            width_s = span.end_s - span.start_s
            bar = axes.broken_barh([(span.start_s, width_s)], (y - 0.4, 0.8), facecolors=colour, alpha=0.7)
            if width_s > _LETTER * len(span.label) * run.end_s:
                axes.text(span.start_s + width_s / 2.0, y, span.label, ha="center", va="center", fontsize="x-small")
            else:
                narrow.setdefault(span.label, bar)
    for time_s, words in run.events:
        axes.text(time_s, len(rows) - 0.45, words, fontsize="x-small", ha="left", color="#d0413c", clip_on=True)
    axes.set_yticks(range(len(rows)), rows)
    axes.set_ylim(-0.6, len(rows) - 0.4 + (0.5 if run.events else 0.0))
    axes.set_title("modes, who drives, states")
    if narrow:
        axes.legend(
            narrow.values(),
            narrow.keys(),
            ncols=4,
            fontsize="xx-small",
            loc="upper center",
            bbox_to_anchor=(0.5, -0.25),
        )
