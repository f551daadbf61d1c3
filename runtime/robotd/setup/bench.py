"""One device alone on the bench, without a runtime: listen to what it says, or drive an actuator for a moment."""

from __future__ import annotations

import asyncio
import atexit
import contextlib
import math
import signal
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator, Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np

from robotd.authoring.device import Actuator, Device
from robotd.engine.loops import real_loop, running_loop
from robotd.engine.parts import DevicePart, Parts
from robotd.safety.guard import Guard
from robotd.safety.settings import GuardConfig, Zones
from robotd.setup.doctor.sight import Sighting, Stream, Watcher, made, shut
from robotd.setup.exit_codes import OK, UNAVAILABLE, Usage
from robotd.world.clock import NS_PER_S
from robotd.world.messages import CameraFrame, Command, Drive, LidarScan, Message, Steer
from robotd.world.robot import Robot

BENCH_MPS, BENCH_RADPS = 0.2, 1.0
LONGEST_S = 10.0
WRITES_HZ = 20.0
QUESTION = "The wheels will turn. Are they off the ground, and is a hand on the power switch? [y/N] "
_LINE_S = 1.0

Say = Callable[[str], object]


def part_named(parts: Parts, name: str) -> DevicePart:
    """The device of that name. Raises Usage with the names that there are."""
    for part in parts.devices:
        if part.name == name:
            return part
    raise Usage(f"robotd device: no device {name!r}; the config has: {', '.join(p.name for p in parts.devices)}")


# --------------------------------------------------------------------------------------------- listen


async def listen(part: DevicePart, robot: Robot, seconds: float, say: Say) -> int:
    """Open the device and say once a second what it publishes. Returns 0, or 69 where nothing came.

    An actuator is opened and halted, never driven. Raises DeviceError where it does not open or goes away.
    """
    async with _opened(part, robot) as (_, watcher):
        began_s = running_loop().time()
        while (left_s := seconds - (running_loop().time() - began_s)) > 1e-6:
            await _pause(min(_LINE_S, left_s), watcher)
            say(line_of(watcher.sighting, running_loop().now_ns()))
        return OK if watcher.sighting.streams or not part.cls.emits else UNAVAILABLE


def line_of(sighting: Sighting, now_ns: int) -> str:
    """Rate, age and latest values of each kind of message, then the faults so far, in one line."""
    said = [_stream_words(stream, now_ns) for stream in sighting.streams.values()] or ["no message"]
    said += [f"{name}: {count}" for name, count in sorted(sighting.faults.items())]
    return " | ".join(said)


def _stream_words(stream: Stream, now_ns: int) -> str:
    last = stream.last[-1]
    return f"{stream.kind.__name__} {stream.hz:.1f} Hz, {(now_ns - last.stamp_ns) / NS_PER_S:.2f} s old: {values(last)}"


def values(message: Message) -> str:
    """What a message says, for people: a scan by its nearest beam, a picture by its size and brightness."""
    if isinstance(message, LidarScan):
        ranges = np.where(np.isnan(message.ranges_m), np.inf, message.ranges_m)
        unseen = float(np.mean(np.isnan(message.ranges_m))) if ranges.size else 1.0
        if not np.isfinite(ranges).any():
            return f"{ranges.size} beams, no return, {unseen:.0%} not measured"
        at = int(np.argmin(ranges))
        where = math.degrees(float(message.angles_rad[at]))
        return f"{ranges.size} beams, nearest {ranges[at]:.2f} m at {where:+.0f} deg, {unseen:.0%} not measured"
    if isinstance(message, CameraFrame):
        height, width = message.bgr.shape[:2]
        return f"{width} x {height}, number {message.sequence}, brightness {message.bgr[::4, ::4].mean():.0f} of 255"
    shown = ((field.name, getattr(message, field.name)) for field in fields(message) if field.name != "stamp_ns")
    return ", ".join(f"{name} {_short(value)}" for name, value in shown if not isinstance(value, np.ndarray))


def _short(value: object) -> str:
    return f"{value:.3f}" if isinstance(value, float) else str(value)


# ---------------------------------------------------------------------------------------------- drive


def wanted_command(part: DevicePart, robot: Robot, given: Mapping[str, float | None]) -> Command:
    """The command that the options mean, of the kind that the actuator takes.

    given: vx, vy, wz, speed, steering; None where not said. Raises Usage for a sensor, for options of the other kind
    and for a motion that this base cannot make.
    """
    if not issubclass(part.cls, Actuator):
        raise Usage(f"robotd device: {part.name} is no actuator; try `listen`")
    said = {name: value for name, value in given.items() if value is not None}
    takes_steer = part.cls.accepts is Steer
    known = ("speed", "steering") if takes_steer else ("vx", "vy", "wz")
    if not said or any(name not in known for name in said):
        options = ", ".join(f"--{name}" for name in known)
        raise Usage(f"robotd device: {part.name} takes {part.cls.accepts.__name__}: say {options}")
    if takes_steer:
        return Steer(said.get("speed", 0.0), said.get("steering", 0.0))
    if said.get("vy", 0.0) and not robot.kinematics.is_holonomic:
        raise Usage(f"robotd device: --vy: a {type(robot.kinematics).__name__.lower()} base cannot move sideways")
    return Drive(said.get("vx", 0.0), said.get("wz", 0.0), said.get("vy", 0.0))


def bench_robot(robot: Robot, fastest_mps: float | None) -> Robot:
    """The same body with limits for the bench: at most `fastest_mps`, by default 0.2 m/s and 1 rad/s."""
    limits = robot.limits
    most_mps = BENCH_MPS if fastest_mps is None else fastest_mps
    most_radps = min(limits.wz_radps, BENCH_RADPS) if fastest_mps is None else limits.wz_radps
    vy_mps = min(limits.vy_mps, most_mps) if robot.kinematics.is_holonomic else 0.0
    slow = replace(limits, vx_mps=min(limits.vx_mps, most_mps), vy_mps=vy_mps, wz_radps=most_radps)
    return replace(robot, limits=slow)


async def drive(
    part: DevicePart, robot: Robot, command: Command, seconds: float, say: Say, *, fastest_mps: float | None = None
) -> int:
    """Drive one actuator for `seconds` (10 at most) within the limits, then halt; it is halted on every way out.

    The limits are the guard's, without zones: the robot's own, and those of `bench_robot`. Raises DeviceError where it
    does not open or goes away, CancelledError after a signal.
    """
    loop, guard = running_loop(), Guard(bench_robot(robot, fastest_mps), GuardConfig(zones=Zones(off="bench check")))
    async with _opened(part, robot) as (device, watcher):
        assert isinstance(device, Actuator)
        written: Command = Steer() if isinstance(command, Steer) else Drive()
        limited: dict[str, None] = {}
        began_s = before_s = shown_s = loop.time()
        until_s = began_s + min(seconds, LONGEST_S)
        while (now_s := loop.time()) < until_s:
            step = guard.limit(command, by="bench", previous=written, dt_s=now_s - before_s, sensed=())
            written, before_s = step.command, now_s
            limited.update(dict.fromkeys(name for name in step.limited_by if name != "acceleration"))
            device.apply(written)
            await _pause(min(1.0 / WRITES_HZ, until_s - now_s), watcher)
            if loop.time() - shown_s >= _LINE_S:
                shown_s = loop.time()
                say(f"{values_of(written)} | {line_of(watcher.sighting, loop.now_ns())}")
        device.halt()
        by = f", limited by {', '.join(limited)}" if limited else ""
        say(f"driven: {values_of(written)}{by}; halted")
        say(line_of(watcher.sighting, loop.now_ns()))
    return OK


def is_allowed(is_terminal: bool, ask: Callable[[str], str]) -> bool:
    """Whether somebody at a terminal says yes. Raises Usage where there is none to ask."""
    if not is_terminal:
        raise Usage("robotd device: nobody to ask whether the wheels are off the ground: add --yes where they are")
    return ask(QUESTION).strip().lower() in ("y", "yes")


def values_of(command: Command) -> str:
    """A command in words."""
    if isinstance(command, Steer):
        return f"speed {command.speed_mps:+.2f} m/s, steering {command.steering_rad:+.2f} rad"
    sideways = f", vy {command.vy_mps:+.2f} m/s" if command.vy_mps else ""
    return f"vx {command.vx_mps:+.2f} m/s{sideways}, wz {command.wz_radps:+.2f} rad/s"


# --------------------------------------------------------------------------------------------- both


@contextlib.asynccontextmanager
async def _opened(part: DevicePart, robot: Robot) -> AsyncIterator[tuple[Device[Any], Watcher]]:
    """The open device and its watcher; halted and closed on every way out, also where the interpreter just ends."""
    device, watcher = made(part, robot, running_loop())
    halt = device.halt if isinstance(device, Actuator) else None
    if halt is not None:
        atexit.register(halt)
    with _signals(asyncio.current_task()):
        try:
            await device.open()
            if halt is not None:
                halt()
            yield device, watcher
        finally:
            await shut(device)
            if halt is not None:
                atexit.unregister(halt)


@contextlib.contextmanager
def _signals(task: asyncio.Task[Any] | None) -> Iterator[None]:
    """Ctrl-C, Ctrl-Z, a closed terminal and SIGTERM end the task, so that it halts its device; a frozen one could not.

    A virtual loop has no signals.
    """
    loop, taken = asyncio.get_running_loop(), []
    for number in (signal.SIGINT, signal.SIGTSTP, signal.SIGTERM, signal.SIGHUP):
        with contextlib.suppress(NotImplementedError, RuntimeError, ValueError):
            if task is not None:
                loop.add_signal_handler(number, task.cancel, f"signal {number}")
                taken.append(number)
    try:
        yield
    finally:
        for number in taken:
            loop.remove_signal_handler(number)


async def _pause(seconds: float, watcher: Watcher) -> None:
    """Wait, but not beyond a loss. Raises the loss."""
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(seconds):
            await watcher.gone.wait()
    if watcher.sighting.loss is not None:
        raise watcher.sighting.loss


def run(main: Coroutine[Any, Any, int]) -> int:
    """Run one of the two on a real loop. Raises KeyboardInterrupt after a signal, and what `main` raises."""
    with asyncio.Runner(loop_factory=real_loop) as runner:
        try:
            return runner.run(main)
        except asyncio.CancelledError:
            raise KeyboardInterrupt from None
