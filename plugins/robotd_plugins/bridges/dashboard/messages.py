"""What the page is told, built from the robot's own data: JSON texts and two binary layouts, without any I/O.

JSON messages are objects with `kind`. Binary messages are little-endian and begin alike:

    offset 0   u8   1 = scan, 2 = picture
    offset 1   u8   which stream: its place in `scans` or `cameras` of the hello
    offset 2   u16  picture: width of the original (px), else 0
    offset 4   u32  scan: beams n; picture: height of the original (px)
    offset 8   f64  stamp on the robot's clock (s)
    offset 16  scan: f32 x, y, yaw of the lidar in base, f32 range_min, range_max, f32 angles[n], f32 ranges[n]
               picture: the JPEG

Ranges keep `inf` (nothing there) and `nan` (not measured). Overlays are in pixels of the original picture.
"""

from __future__ import annotations

import dataclasses
import json
import math
import struct
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from robotd import LidarScan
from robotd.authoring.explain import Drawing, Explanation, Histogram
from robotd.world.messages import BatteryLow, EStopped, Event, Outcome
from robotd.world.robot import Robot

PROTOCOL = 1
"""Counts up when a page of another version would misread us; the page compares and asks to be reloaded."""
POINTS_MAX = 1000
"""Points of one drawing; longer ones are thinned evenly, their last point kept."""
SCAN, PICTURE = 1, 2

_HEAD = struct.Struct("<BBHId")
_POSE = struct.Struct("<5f")


def dumps(message: Mapping[str, Any]) -> str:
    """JSON that every browser reads: nan and infinities become null."""
    return json.dumps(_plain(message), allow_nan=False, separators=(",", ":"))


def hello(robot: Robot, scans: Sequence[str], cameras: Sequence[str], viewer: int) -> str:
    """The first message: who this is, and the names that stand for the numbers in binary messages."""
    limits = robot.limits
    return dumps(
        {
            "kind": "hello",
            "protocol": PROTOCOL,
            "robot": robot.name,
            "viewer": viewer,
            "footprint_m": robot.footprint_m,
            "limits": {"vx_mps": limits.vx_mps, "vy_mps": limits.vy_mps, "wz_radps": limits.wz_radps},
            "scans": scans,
            "cameras": cameras,
        }
    )


def status_message(status: Mapping[str, Any]) -> str:
    """The runtime's status, with the sentence that says why the robot stands or who drives it."""
    return dumps({"kind": "status", **status, "moving": is_moving(status), "sentence": sentence(status)})


def is_moving(status: Mapping[str, Any]) -> bool:
    """Whether the command last written moves the base."""
    command = status["command"]
    if "speed_mps" in command:
        return bool(command["speed_mps"] != 0.0)
    return any(value != 0.0 for value in command.values())


def sentence(status: Mapping[str, Any]) -> str:
    """`standing still because ...`, or `driving: wander (AHEAD)`; never empty."""
    if not is_moving(status):
        return f"standing still because {status['reason'] or 'nothing asks it to move'}"
    by = status["by"]
    state = next((b["state"] for b in status["behaviours"] if b["name"] == by), "")
    who = f"{by} ({state})" if state and state != "active" else by
    limited = status["limited_by"]
    return f"driving: {who or 'nobody says why'}" + (f", limited by {', '.join(limited)}" if limited else "")


def scan_message(index: int, scan: LidarScan) -> bytes:
    """One scan in binary; both arrays start at a multiple of four, so that the page reads them in place."""
    count = len(scan.ranges_m)
    head = _HEAD.pack(SCAN, index, 0, count, scan.stamp_ns / 1e9)
    pose = _POSE.pack(scan.x_m, scan.y_m, scan.yaw_rad, scan.range_min_m, scan.range_max_m)
    return b"".join((head, pose, scan.angles_rad.astype("<f4").tobytes(), scan.ranges_m.astype("<f4").tobytes()))


def picture_message(index: int, width_px: int, height_px: int, stamp_ns: int, jpeg: bytes) -> bytes:
    """One camera picture in binary; width and height are the original's, the JPEG may be smaller."""
    return _HEAD.pack(PICTURE, index, width_px, height_px, stamp_ns / 1e9) + jpeg


def drawings_message(explanations: Mapping[str, Explanation]) -> str:
    """What each plugin draws: {plugin: [{"type": "Line", "name": ..., its own fields}]}."""
    return dumps(
        {
            "kind": "drawings",
            "by": {name: [_drawing(drawn) for drawn in explanation] for name, explanation in explanations.items()},
        }
    )


def event_text(event: Event) -> str:
    """One event as a line for people."""
    match event:
        case EStopped():
            return f"e-stop by {event.source}" + (f": {event.reason}" if event.reason else "")
        case BatteryLow():
            return f"battery low: {event.voltage_v:.1f} V ({event.device})"
        case Outcome():
            return f"{event.behaviour} {event.result}" + (f": {event.reason}" if event.reason else "")
    fields = [f.name for f in dataclasses.fields(event) if f.name != "stamp_ns"]
    return f"{type(event).__name__} " + ", ".join(f"{name} {getattr(event, name)}" for name in fields)


def _drawing(drawn: Drawing) -> dict[str, Any]:
    """One drawing as a dict of its fields; lengths to the millimetre, thinned where it has too many points."""
    fields: dict[str, Any] = {"type": type(drawn).__name__}
    for field in dataclasses.fields(drawn):
        value = getattr(drawn, field.name)
        fields[field.name] = _thinned(value) if field.name in ("xy_m", "xy_px") else value
    if isinstance(drawn, Histogram):
        fields["values"] = np.round(drawn.values.astype(np.float64), 4).tolist()
    return fields


def _thinned(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    step = max(1, math.ceil(len(points) / POINTS_MAX))
    kept = list(points[::step])
    if step > 1 and kept[-1] != points[-1]:
        kept.append(points[-1])
    return [(round(x, 3), round(y, 3)) if math.isfinite(x) and math.isfinite(y) else (x, y) for x, y in kept]


def _plain(value: Any) -> Any:
    """The same with tuples as lists, numpy scalars as numbers, and null for what JSON cannot say."""
    if isinstance(value, str) or value is None or isinstance(value, bool | int):
        return value
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, np.integer):
        return int(value)
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [_plain(item) for item in value]
    return str(value)
