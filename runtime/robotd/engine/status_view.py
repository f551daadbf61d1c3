"""Draws the state of a running robot as a few lines of text, and says what changed between two states.

Pure: `render` and `changes` know no terminal. `robotd.engine.console` puts what they return on one.
"""

from __future__ import annotations

import math
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass

from robotd.engine.logs import printable
from robotd.engine.status import BehaviourStatus, DeviceStatus, Status, StreamStatus
from robotd.world.kinematics import Ackermann
from robotd.world.messages import Drive, Steer
from robotd.world.robot import Robot

MOST_ROWS = 20
BAR_CELLS = 7
"""Cells on either side of a bar's middle."""


@dataclass(frozen=True, slots=True)
class Scale:
    """What a full bar means. `turn`: rad/s for a Drive, rad of steering for a Steer."""

    speed_mps: float = 0.5
    turn: float = 2.0


def scale_of(robot: Robot) -> Scale:
    """The scale on which this robot's own limits fill the bars."""
    kinematics, limits = robot.kinematics, robot.limits
    turn = kinematics.max_steering_rad if isinstance(kinematics, Ackermann) else limits.wz_radps
    return Scale(max(limits.vx_mps, 1e-3), max(turn, 1e-3))


# --------------------------------------------------------------------------------------------- words


def width_of(text: str) -> int:
    """Columns that `text` takes on a terminal."""
    if text.isascii():
        return len(text)
    return sum(
        0 if unicodedata.combining(char) else 2 if unicodedata.east_asian_width(char) in "WF" else 1 for char in text
    )


def fit(text: str, width: int, *, pad: bool = False) -> str:
    """`text` in at most `width` columns, its cut end marked with `~`; filled with spaces where `pad`."""
    if width <= 0:
        return ""
    taken = width_of(text)
    if taken > width:
        kept, taken = "", 0
        for char in text:
            step = width_of(char)
            if taken + step > width - 1:
                break
            kept, taken = kept + char, taken + step
        text, taken = f"{kept}~", taken + 1
    return text + " " * (width - taken) if pad else text


def standing(status: Status) -> str:
    """Why the robot stands still, never empty while it does; empty while it moves."""
    if status.reason:
        return status.reason
    if is_moving(status):
        return ""
    if status.by:
        return f"{status.by} asks to stand still"
    away = [device.name for device in status.devices if device.state != "open"]
    if away:
        return f"not open: {', '.join(away)}"
    return "no behaviour has an opinion"


def is_moving(status: Status) -> bool:
    """Whether the command last written moves the base."""
    command = status.command
    if isinstance(command, Steer):
        return command.speed_mps != 0.0
    return (command.vx_mps, command.vy_mps, command.wz_radps) != (0.0, 0.0, 0.0)


def bar(value: float, full: float, cells: int = BAR_CELLS) -> str:
    """A bar from the middle: `[.......|===....]` to the right for positive values, full at `full`.

    Any value but zero shows at least one cell; a value beyond `full` ends in `>` or `<`.
    """
    if not math.isfinite(value):
        return f"[{'?' * cells}|{'?' * cells}]"
    share = abs(value) / full
    filled = 0 if value == 0.0 else max(1, min(cells, round(share * cells)))
    over = share > 1.0 + 1e-9
    side = "=" * (filled - over) + (">" if over else "") + "." * (cells - filled)
    idle = "." * cells
    if value >= 0.0:
        return f"[{idle}|{side}]"
    return f"[{side.replace('>', '<')[::-1]}|{idle}]"


def _age(age_s: float) -> str:
    if not math.isfinite(age_s):
        return "never"
    if age_s < 10.0:
        return f"{age_s:.2f} s"
    return f"{age_s:.0f} s" if age_s < 1000.0 else f"{age_s / 60.0:.0f} min"


def _elapsed(now_ns: int) -> str:
    seconds = now_ns // 1_000_000_000
    return f"{seconds // 3600:d}:{seconds // 60 % 60:02d}:{seconds % 60:02d}"


# --------------------------------------------------------------------------------------------- lines


def _head(status: Status, since_ns: int) -> str:
    time = "simulated " if status.virtual else ""
    late = f"tick {status.tick_late_ms:.1f} ms late"
    return f"robotd  {status.mode.value.upper():<9} {time}{_elapsed(status.now_ns - since_ns)}  {late}"


def _reason(status: Status) -> str:
    why = standing(status)
    if why and is_moving(status):
        return f"stopping: {why}"
    if why:
        return f"standing still: {why}"
    return f"driving: {status.by}" if status.by else "driving"


def _command(status: Status, scale: Scale, width: int) -> str:
    command = status.command
    if isinstance(command, Drive):
        parts = [("vx", command.vx_mps, "m/s", scale.speed_mps), ("turn", command.wz_radps, "rad/s", scale.turn)]
        if command.vy_mps:
            parts.insert(1, ("vy", command.vy_mps, "m/s", scale.speed_mps))
    else:
        speed = ("speed", command.speed_mps, "m/s", scale.speed_mps)
        parts = [speed, ("steer", command.steering_rad, "rad", scale.turn)]
    plain = "  ".join(f"{name} {value:+.2f} {unit}" for name, value, unit, _ in parts)
    bars = "  ".join(f"{name} {value:+.2f} {unit} {bar(value, full)}" for name, value, unit, full in parts)
    limited = f"  limited: {', '.join(status.limited_by)}" if status.limited_by else ""
    line = f"command  {bars}{limited}"
    return line if width_of(line) <= width else f"command  {plain}{limited}"


def _devices(devices: Sequence[DeviceStatus]) -> list[str]:
    if not devices:
        return []
    trouble = [device for device in devices if device.state != "open" or device.detail]
    fine = [device.name for device in devices if device.state == "open"]
    names = max((width_of(device.name) for device in trouble), default=0)
    rows = [f"devices  {len(fine)} of {len(devices)} open{': ' + ', '.join(fine) if fine else ''}"]
    rows += [
        f"  {fit(device.name, names, pad=True)}  {device.state}{f': {device.detail}' if device.detail else ''}"
        for device in trouble
    ]
    return rows


def _behaviours(behaviours: Sequence[BehaviourStatus], by: str, width: int) -> list[str]:
    if not behaviours:
        return []
    ordered = sorted(behaviours, key=lambda b: (not b.active, -b.priority))
    names = min(24, max(width_of(b.name) for b in ordered))
    states = min(28, max(8, max(width_of(b.state) for b in ordered)))
    if width < names + states + 30:
        states = max(8, width - names - 30)
    rows = ["behaviours"]
    for b in ordered:
        mark = ">" if b.name == by and b.active else "*" if b.active else " "
        state = b.state or ("active" if b.active else "inactive")
        name = fit(b.name, names, pad=True)
        rows.append(f"{mark} {name} {b.priority:>4}  {fit(state, states, pad=True)}  {b.verdict_reason}".rstrip())
    return rows


def _streams(streams: Sequence[StreamStatus]) -> list[str]:
    if not streams:
        return []
    names = min(24, max(7, max(width_of(s.topic) for s in streams)))
    rows = [f"{'streams':<{names + 2}} {'rate':>9} {'age':>8} {'unseen':>7} {'faults':>7}  from"]
    rows += [
        f"  {fit(s.topic, names, pad=True)} {s.rate_hz:>6.1f} Hz {_age(s.age_s):>8} {s.overwritten:>7} {s.faults:>7}"
        f"  {s.source}"
        for s in streams
    ]
    return rows


def _share(sections: Sequence[list[str]], rows: int) -> list[str]:
    """As much of each section as `rows` allow, in turns; its first line counts what is left out."""
    wanted = [len(section) for section in sections]
    given = [0] * len(sections)
    left = rows
    while left > 0 and given != wanted:
        for i, want in enumerate(wanted):
            if left > 0 and given[i] < want:
                given[i] += 1
                left -= 1
    lines: list[str] = []
    for section, want, count in zip(sections, wanted, given, strict=True):
        if 0 < count < want:
            lines += [f"{section[0]}  (+{want - count} more)", *section[1:count]]
        else:
            lines += section[:count]
    return lines


def render(
    status: Status, width: int, height: int, *, scale: Scale | None = None, since_ns: int = 0, most: int = MOST_ROWS
) -> list[str]:
    """The picture of one state: at most `min(height, most)` lines of at most `width` columns, plain text.

    The first line says the mode, the second why the robot stands still (or who drives), the third the command; these
    three stay however low the terminal is, down to one line that holds the first two. since_ns: start of the run.
    """
    rows = max(1, min(height, most))
    scale = scale if scale is not None else Scale()
    if rows == 1:
        lines = [f"{status.mode.value.upper()}  {_reason(status)}"]
    else:
        lines = [_head(status, since_ns), _reason(status), _command(status, scale, width)][:rows]
        if status.zones_off and len(lines) < rows:
            lines.append(f"no zones: {status.zones_off}")
        sections = (
            _devices(status.devices),
            _behaviours(status.behaviours, status.by, width),
            _streams(status.streams),
        )
        lines += _share(sections, rows - len(lines))
    return [fit(printable(line), max(1, width)) for line in lines]


# ------------------------------------------------------------------------------------------- changes


def changes(before: Status | None, after: Status) -> list[str]:
    """Sentences for what changed between two looks and is not logged where it happens, for a log without a view.

    The engine itself logs modes, reasons for standing still, outcomes and lost devices; a behaviour its own states.
    """
    said: list[str] = []
    if before is None and after.zones_off:
        said.append(f"the guard has no zones: {after.zones_off}")
    was_open = {device.name for device in before.devices if device.state == "open"} if before else set()
    known = {device.name: device.state for device in before.devices} if before else {}
    for device in after.devices:
        if device.state == "open" and device.name not in was_open and known.get(device.name) != "lost":
            said.append(f"{device.name} is open")
    active = {b.name for b in before.behaviours if b.active} if before else set()
    for b in after.behaviours:
        if b.active and b.name not in active:
            said.append(f"{b.name} is active{f': {b.state}' if b.state not in ('', 'active') else ''}")
    drove = before.by if before is not None and is_moving(before) else ""
    if is_moving(after) and after.by and after.by != drove:
        said.append(f"driving: {after.by}")
    return said
