"""The runtime's side of the guardian: who gets one, what its words do to a run and to a replay, who may arm again."""

from __future__ import annotations

import asyncio
import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from recorded import Event, again, asks, plain
from small_robot import FakeBase, behaviour, robot, run

from robotd import Behaviour, Drive, LidarScan, NoConfig, View, every
from robotd.authoring.device import I2cStop, StopLine
from robotd.engine.armed_mark import ArmedMark
from robotd.engine.guarding import descriptor_of
from robotd.engine.journal import FORMAT, RunJournal
from robotd.engine.loops import real_loop, virtual_loop
from robotd.engine.parts import DevicePart, Parts
from robotd.engine.record_file import RecordWriter
from robotd.engine.runtime import Runtime
from robotd.safety.operator import Arm
from robotd.safety.settings import GuardianConfig
from robotd.world.messages import Mode


class Sees(View):
    scan: LidarScan = every(within_s=0.25)


class Go(Behaviour[NoConfig, Sees]):
    def step(self, seen: Sees) -> Drive | None:
        return Drive(0.4)


class HeldBase(FakeBase):
    def stop_line(self) -> StopLine:
        return I2cStop("/nowhere/i2c-1", ((0x60, b"\xfd\x10"),))


def held(parts: Parts, base: type[HeldBase] = HeldBase, **more: Any) -> Parts:
    """The same robot with a base whose line a guardian could hold."""
    devices = tuple(DevicePart("base", base, NoConfig()) if d.name == "base" else d for d in parts.devices)
    return replace(parts, devices=devices, **more)


# ------------------------------------------------------------------------------------- who gets one


def started(parts: Parts) -> Runtime:
    """A run on the real loop that ends as soon as it began."""
    runtime = Runtime(parts)
    with asyncio.Runner(loop_factory=real_loop) as runner:
        runner.run(runtime.run(Runtime.stop))
    return runtime


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        (robot(behaviour(Go)), "FakeBase offers no stop line"),
        (held(robot(behaviour(Go)), guardian=GuardianConfig(off="wheels in the air")), "wheels in the air"),
    ],
)
def test_without_a_guardian_the_log_says_why(parts: Parts, words: str, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING, "robotd")
    assert started(parts).guarding is None
    assert any(words in record.getMessage() for record in caplog.records)


def test_a_simulated_robot_has_none_and_says_nothing(caplog: pytest.LogCaptureFixture) -> None:
    runtime, base = run(held(robot(behaviour(Go))), 1.0)
    assert runtime.guarding is None and base.at(0.9) == Drive(0.4)
    assert not caplog.records


def test_a_line_that_cannot_be_held_keeps_the_robot_from_being_armed(caplog: pytest.LogCaptureFixture) -> None:
    runtime = Runtime(held(robot(behaviour(Go))))
    told: list[str] = []

    said = asyncio.Event()
    lost = runtime.guardian_lost

    def guardian_lost(reason: str) -> None:
        lost(reason)
        if "No such file" in reason:
            said.set()

    runtime.guardian_lost = guardian_lost  # type: ignore[method-assign]

    async def look() -> None:
        await said.wait()
        told.append(runtime.core.request(Arm("test"), 0))
        told.extend(d.state for d in runtime.handle.snapshot().devices if d.name == "guardian")
        runtime.stop()

    async def main() -> None:
        async with asyncio.timeout(20.0), asyncio.TaskGroup() as group:
            group.create_task(runtime.run(lambda running: looks.append(group.create_task(look()))))

    looks: list[asyncio.Task[None]] = []
    with asyncio.Runner(loop_factory=real_loop) as runner:
        runner.run(main())
    assert told == ["waiting for the guardian", "opening"]
    assert any("cannot hold the line: No such file" in record.getMessage() for record in caplog.records)
    base = runtime.devices[0].device
    assert isinstance(base, FakeBase) and {what for _, what in base.log} == {"halt"}


def test_a_base_without_a_line_this_time_drives_and_the_log_says_so(caplog: pytest.LogCaptureFixture) -> None:
    class Remote(HeldBase):
        def stop_line(self) -> StopLine | None:
            return None

    parts = held(robot(behaviour(Go)), base=Remote)
    runtime = Runtime(parts)

    async def main() -> None:
        async with asyncio.timeout(20.0):
            await runtime.run(lambda running: running.core.on_armed.append(running.stop))

    with asyncio.Runner(loop_factory=real_loop) as runner:
        runner.run(main())
    assert "base offers no stop line" in caplog.text
    assert runtime.guarding is not None and runtime.guarding.process is None, "it was there, and has ended"


@pytest.mark.parametrize("pattern", ["line", "l*e"])
def test_finds_the_programs_own_descriptor(tmp_path: Path, pattern: str) -> None:
    (tmp_path / "line").touch()
    assert descriptor_of(str(tmp_path / pattern)) is None
    with open(tmp_path / "line") as file:
        assert descriptor_of(str(tmp_path / pattern)) == file.fileno()
    assert descriptor_of(str(tmp_path / "gone")) is None


# ------------------------------------------------------------------------------- what its words do


def trips_in_a_write(runtime: Runtime) -> None:
    """From now on the base's way is closed, as after a freeze."""

    def may_write() -> bool:
        runtime.guardian_tripped("the guardian stopped the motors")
        return False

    runtime.devices[0].may_write = may_write


def recorded(path: Path, parts: Parts, duration_s: float, *events: Event) -> tuple[Runtime, FakeBase]:
    """A run in virtual time that is written down."""
    journal = RunJournal(RecordWriter(path, {"format": FORMAT}, synchronous=True))
    try:
        return run(parts, duration_s, *events, journal=journal)
    finally:
        assert journal.close()


RUNS: dict[str, list[Event]] = {
    "it dies": [(0.5, lambda runtime: runtime.guardian_lost("the guardian died"))],
    "it trips": [(0.5, lambda runtime: runtime.guardian_tripped("the guardian stopped the motors"))],
    "it trips in a write": [(0.49, trips_in_a_write)],
}


@pytest.mark.parametrize("name", list(RUNS))
def test_it_disarms_at_once_and_a_replay_agrees(name: str, tmp_path: Path) -> None:
    path, parts = tmp_path / "run.mcap", plain()
    runtime, base = recorded(path, parts, 1.0, *RUNS[name])
    assert runtime.core.operator.mode is Mode.DISARMED and "the guardian" in runtime.core.operator.reason
    driven = [ns for ns, what in base.log if what != "halt"]
    assert driven and max(driven) <= 500_000_000
    assert again(path, parts).first_difference is None


def test_back_again_it_may_be_armed_by_hand(tmp_path: Path) -> None:
    path, parts = tmp_path / "run.mcap", plain()
    events = [
        RUNS["it dies"][0],
        asks(0.6, Arm("refused")),
        (0.8, lambda runtime: runtime.guardian_ready()),
        asks(1.0, Arm("me")),
    ]
    _, base = recorded(path, parts, 2.0, *events)
    assert base.at(0.79) == "halt" and base.at(0.99) == "halt" and base.at(1.9) != "halt"
    assert again(path, parts).first_difference is None


# ---------------------------------------------------------------------------------- who may arm again


def test_a_program_that_died_armed_does_not_arm_itself(tmp_path: Path) -> None:
    dead = ArmedMark(tmp_path / "armed")
    dead.set(True)
    for expected in (Mode.DISARMED, Mode.AUTO):  # the second start is after a good end
        mark = ArmedMark(tmp_path / "armed")
        runtime = Runtime(robot(behaviour(Go)), virtual=True, mark=mark)
        seen: list[Mode] = []
        run_until(runtime, 0.5, seen)
        assert seen == [expected]
        assert not mark.path.exists()


def run_until(runtime: Runtime, at_s: float, seen: list[Mode]) -> None:
    def look(running: Runtime) -> None:
        seen.append(running.core.operator.mode)
        running.stop()

    def started(running: Runtime) -> None:
        loop: Any = asyncio.get_running_loop()
        loop.call_at_ns(round(at_s * 1e9), look, running)

    with asyncio.Runner(loop_factory=virtual_loop) as runner:
        runner.run(runtime.run(started))


def test_the_mark_is_there_while_it_is_armed(tmp_path: Path) -> None:
    mark = ArmedMark(tmp_path / "state" / "armed", boot="monday")
    mark.set(True)
    assert ArmedMark(mark.path, boot="monday").found
    assert not ArmedMark(mark.path, boot="tuesday").found, "the computer was started anew meanwhile"
    mark.set(False)
    assert not ArmedMark(mark.path, boot="monday").found


def test_a_mark_that_cannot_be_written_is_said(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "file").touch()
    mark = ArmedMark(tmp_path / "file" / "armed")
    mark.set(True)
    assert not mark.found
    assert "cannot be written" in caplog.text
