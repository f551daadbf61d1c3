"""Pure: what a device did while it was open, and what its driver said, as findings."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from robotd.authoring.device import Actuator, DeviceError, DeviceMisconfigured
from robotd.engine.devices import OPEN_LIMIT_S
from robotd.engine.parts import DevicePart
from robotd.setup.doctor.faults import found
from robotd.setup.doctor.findings import Finding
from robotd.setup.doctor.sight import Sighting, Stream
from robotd.setup.exit_codes import CONFIG, PERMISSION, TEMPORARY, causes, os_code
from robotd.world.clock import NS_PER_S
from robotd.world.messages import Battery, CameraFrame, Contact, Imu, LidarScan, Odometry

WORDS: Sequence[tuple[str, str]] = (
    (r"in use by|another program has", "taken meanwhile"),
    (r"no permission", "not allowed"),
    (r"protection stop|whether it is well|reports an error", "health error"),
    (r"does not begin|still starts|busy for ever|the same values", "does not start"),
    (r"no picture for|no stream from", "no picture"),
    (r"another chip|is no [A-Z]+[0-9]+|when asked who it is|says it is", "another chip"),
    (r"bytes came but|wrong baud", "bytes of something else"),
    (r"no byte came", "no byte"),
    (r"does not turn|not turning", "does not turn"),
    (r"no chip answers", "no chip"),
    (r"bus is stuck|arbitration lost", "bus stuck"),
    (r"lost its settings", "settings lost"),
    (r"no answer|is silent|does not answer|silent for", "no answer"),
)
"""Words of drivers' sentences, in this order, to rows of the table: a driver that uses them is understood."""
COUNTED: Sequence[tuple[str, str]] = (
    (r"battery", "weak battery"),
    (r"too hot|\bhot\b|over.?temp", "runs hot"),
    (r"voltage|supply|brown", "weak supply"),
    (r"health|protection stop|scan restarted|lidar reset|does not come back", "warns of itself"),
    (r"not turning|rotation off|speed and angles", "turns wrongly"),
    (r"old scan|events dropped|not ready in time", "falls behind"),
    (r"beyond the range", "beyond the range"),
    (r"black picture", "picture black at times"),
    (r"repeated picture", "picture repeated"),
    (r"picture", "picture spoilt"),
    (r"wheels disagree|encoder jumped|speed error", "wheels disagree"),
    (r"no finite command|cannot reverse", "command refused"),
    (r"while zeroing", "moved while zeroing"),
    (r"no event", "pad out of reach"),
    (r"checksum|stray bytes|garbled|no answer|packet|frame|node|header|I2C retry", "bad bytes"),
    (r"alignment|impossible angle|clock or speed", "bad bytes"),
    (r"latched|timed out|over.?current|without auto|line full|stall|emergency|driver fault|current error|^fault \d",
     "controller complains"),
)  # fmt: skip
"""The same for the names of faults that drivers count."""

SLOW, GAP, LATE = 0.7, 3.0, 2.0
"""Share of the declared rate; longest pause and greatest age in periods."""
OWN_SHARE = 0.25
"""A robot's own parts hide at most this share of a lidar's view, or something is wrong."""
DARK, BRIGHT, FLAT = 4.0, 251.0, 1.5
"""Mean grey of a black and a white picture; standard deviation of an empty one."""
LOW_CHARGE, NO_VOLTS = 0.2, 0.5
GRAVITY_MPS2, GRAVITY_OFF_MPS2, STILL_RADPS, STILL_MPS = 9.81, 1.5, 0.1, 0.02
CLOSE_S = 0.2


def judge_sighting(part: DevicePart, sighting: Sighting) -> list[Finding]:
    """Everything that one sighting says; one good finding where nothing is wrong."""
    if not sighting.is_open:
        return [_not_open(part, sighting)]
    findings = [*_declared(part, sighting), *_silence(part, sighting)]
    for stream in sighting.streams.values():
        findings += [*_pace(part, stream), *_content(part.name, stream)]
    findings += _counted(part, sighting)
    if sighting.close_s > CLOSE_S:
        findings.append(found("closes too slowly", part.name, close_s=sighting.close_s))
    if issubclass(part.cls, Actuator) and part.cls.watchdog.kind == "none" and not sighting.has_stop_line:
        findings.append(found("no watchdog", part.name))
    if any(finding.level in ("warning", "error") for finding in findings):
        return findings
    return [Finding("good", part.name, _all_well(sighting)), *findings]


def _all_well(sighting: Sighting) -> str:
    said = [
        f"{stream.kind.__name__} {stream.hz:.1f} Hz, {stream.age_ns[-1] / NS_PER_S:.2f} s old"
        for stream in sighting.streams.values()
    ]
    return "opens" + (f"; {'; '.join(said)}" if said else "")


def is_mute(part: DevicePart, sighting: Sighting) -> bool:
    """Whether it gave no sign of life: it did not open for want of an answer, or a message was due and none came."""
    if sighting.streams:
        return False
    if sighting.error is not None:
        return _row(sighting.error) in ("no answer", "no byte", "bytes of something else", "cannot open")
    return sighting.hung or sighting.loss is not None or part.cls.publish_period_s(part.config) is not None


# ---------------------------------------------------------------------------------- what a driver says


def _not_open(part: DevicePart, sighting: Sighting) -> Finding:
    if sighting.error is None:
        return found("opens too slowly", part.name, limit_s=OPEN_LIMIT_S)
    return _said(part.name, _row(sighting.error), sighting.error)


def _row(error: Exception) -> str:
    """The row for an error of opening or for a loss."""
    if not isinstance(error, DeviceError | OSError):
        return "driver broken"
    code = CONFIG if isinstance(error, DeviceMisconfigured) else os_code(causes(error), 0)
    by_code = {CONFIG: "cannot be so", PERMISSION: "not allowed", TEMPORARY: "taken meanwhile"}
    return by_code.get(code) or _first(WORDS, str(error)) or "cannot open"


def _first(table: Sequence[tuple[str, str]], text: str) -> str:
    return next((row for pattern, row in table if re.search(pattern, text, re.IGNORECASE)), "")


def _said(name: str, row: str, error: Exception) -> Finding:
    words = str(error) or type(error).__name__
    if row == "driver broken":
        words = f"{type(error).__name__}: {error}"
    return found(row, name, words=words.removeprefix(f"{name}: "))


def _silence(part: DevicePart, sighting: Sighting) -> Iterator[Finding]:
    if sighting.loss is not None:
        row = _first(WORDS, str(sighting.loss))
        words = str(sighting.loss).removeprefix(f"{part.name}: ")
        yield found(row or "lost again", part.name, words=words, watched_s=sighting.watched_s)
    elif not sighting.streams and part.cls.emits:
        due = part.cls.publish_period_s(part.config) is not None
        yield found("silent" if due else "quiet", part.name, watched_s=sighting.watched_s)


def _counted(part: DevicePart, sighting: Sighting) -> Iterator[Finding]:
    own: Mapping[str, str] = part.cls.mends
    for name, count in sorted(sighting.faults.items()):
        if name == "no return anywhere":
            continue  # the scans themselves say it
        detail = sighting.details.get(name, "")
        facts = {"count": count, "name": name, "or_detail": f" ({detail})" if detail else ""}
        row = _first(COUNTED, name) or "other fault"
        yield found(row, part.name, mend=own.get(name, ""), **facts)


def _declared(part: DevicePart, sighting: Sighting) -> Iterator[Finding]:
    for kind in sighting.streams:
        if kind not in part.cls.emits:
            declared = ", ".join(known.__name__ for known in part.cls.emits) or "nothing"
            yield found("undeclared message", part.name, kind=kind.__name__, declared=declared)


# ------------------------------------------------------------------------------------ pace and content


def _pace(part: DevicePart, stream: Stream) -> Iterator[Finding]:
    kind, name = stream.kind.__name__, part.name
    period_s = part.cls.publish_period_s(part.config)
    if min(stream.age_ns) < 0:
        yield found("from the future", name, kind=kind, ahead_s=-min(stream.age_ns) / NS_PER_S)
    if period_s is None or len(stream.arrived_ns) < 3 or (len(part.cls.emits) > 1 and kind != "Odometry"):
        return  # of several kinds only the quickest keeps the declared period
    gap_s = max(b - a for a, b in itertools.pairwise(stream.arrived_ns)) / NS_PER_S
    if stream.hz < SLOW / period_s:
        yield found("too few", name, kind=kind, hz=stream.hz, wanted_hz=1.0 / period_s)
    elif gap_s > GAP * period_s:
        yield found("pauses", name, kind=kind, gap_s=gap_s, period_s=period_s)
    age_s = float(np.median(stream.age_ns)) / NS_PER_S
    if age_s > LATE * period_s:
        yield found("old when they come", name, kind=kind, age_s=age_s)


def _content(name: str, stream: Stream) -> Iterator[Finding]:
    last = stream.last[-1]
    match last:
        case LidarScan():
            yield from _scans(name, [m for m in stream.last if isinstance(m, LidarScan)])
        case CameraFrame():
            yield from _pictures(name, [m for m in stream.last if isinstance(m, CameraFrame)])
        case Battery():
            if last.voltage_v < NO_VOLTS:
                yield found("battery absent", name, volts=last.voltage_v)
            elif last.charge < LOW_CHARGE:
                yield found("battery low", name, charge=last.charge)
        case Imu():
            yield from _imu(name, [m for m in stream.last if isinstance(m, Imu)])
        case Odometry():
            speeds = [float(np.hypot(m.vx_mps, m.vy_mps)) for m in stream.last if isinstance(m, Odometry)]
            if min(speeds) > STILL_MPS:
                yield found("odometry drifts", name, mps=min(speeds))
        case Contact(closed=True):
            yield found("bumper pressed", name, where=last.where)


def _scans(name: str, scans: Sequence[LidarScan]) -> Iterator[Finding]:
    ranges = np.concatenate([scan.ranges_m for scan in scans])
    if not ranges.size or np.isnan(ranges).all():
        yield found("nothing measured", name)
        return
    if not np.isfinite(ranges).any():
        yield found("no return", name)
        return
    last = scans[-1]
    near = float(np.mean(last.ranges_m < last.range_min_m))
    if near > OWN_SHARE:
        yield found("something touches", name, share=near, least_m=last.range_min_m)
    if len(scans) >= 3 and all(
        np.array_equal(a.ranges_m, b.ranges_m, equal_nan=True) and np.array_equal(a.angles_rad, b.angles_rad)
        for a, b in itertools.pairwise(scans)
    ):
        yield found("stands still", name, kind="LidarScan")


def _pictures(name: str, frames: Sequence[CameraFrame]) -> Iterator[Finding]:
    seen = frames[-1].bgr[::4, ::4]
    mean, spread = float(seen.mean()), float(seen.std())
    if mean < DARK:
        yield found("picture black", name)
    elif mean > BRIGHT:
        yield found("picture white", name)
    elif spread < FLAT:
        yield found("picture empty", name)
    elif len(frames) >= 3 and all(np.array_equal(a.bgr, b.bgr) for a, b in itertools.pairwise(frames)):
        yield found("stands still", name, kind="CameraFrame")


def _imu(name: str, readings: Sequence[Imu]) -> Iterator[Finding]:
    table = np.array([[m.wx_radps, m.wy_radps, m.wz_radps, m.ax_mps2, m.ay_mps2, m.az_mps2] for m in readings])
    seen = ~np.isnan(table).all(axis=0)
    if not seen.any():
        yield found("imu mute", name)
        return
    mean = np.full(6, np.nan)
    mean[seen] = np.nanmean(table[:, seen], axis=0)
    felt, rate = float(np.linalg.norm(mean[3:])), float(np.linalg.norm(mean[:3][seen[:3]]))
    if seen[3:].all() and abs(felt - GRAVITY_MPS2) > GRAVITY_OFF_MPS2:
        yield found("imu off", name, felt=felt)
    elif seen[5] and mean[5] < -GRAVITY_MPS2 / 2.0:
        yield found("imu upside down", name)
    if rate > STILL_RADPS:
        yield found("imu turns", name, rate=rate)
