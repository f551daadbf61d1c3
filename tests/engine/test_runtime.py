"""Supervision: what is reopened, restarted or benched, what ends the run, and the stop on every way out."""

from __future__ import annotations

import asyncio
import contextlib
import gc
from dataclasses import replace
from typing import Any

import pytest
from small_robot import FakeBase, FakeLidar, FakeOdometry, S, ScriptConfig, behaviour, perceptor, robot, run

from robotd import (
    Behaviour,
    Bridge,
    Drive,
    LidarScan,
    NoConfig,
    Odometry,
    Perceptor,
    RuntimeLink,
    Target,
    View,
    every,
    needed,
)
from robotd.authoring.bridge import Refused
from robotd.authoring.device import DeviceMisconfigured, DeviceUnavailable
from robotd.engine.core import Core
from robotd.engine.devices import Unavailable
from robotd.engine.loops import real_loop, virtual_loop
from robotd.engine.parts import BridgePart, DevicePart, Parts
from robotd.engine.runtime import Runtime, skip_missed
from robotd.world.messages import Applied, Event, Mode, Outcome
from robotd.world.topics import default_topic


class Sees(View):
    scan: LidarScan = every(within_s=0.25)


class Go(Behaviour[NoConfig, Sees]):
    def step(self, seen: Sees) -> Drive | None:
        return Drive(0.4)


def with_device(parts: Parts, name: str, cls: type[Any], config: Any = None) -> Parts:
    """The same robot with one device replaced by another class."""
    return replace(
        parts,
        devices=tuple(
            DevicePart(name, cls, config if config is not None else part.config) if part.name == name else part
            for part in parts.devices
        ),
    )


def with_bridge(parts: Parts, cls: type[Bridge[Any]]) -> Parts:
    return replace(parts, bridges=(BridgePart("bridge", cls, NoConfig()),))


# ------------------------------------------------------------------------------------------ devices


class NeverThere(FakeLidar):
    async def open(self) -> None:
        raise DeviceUnavailable("no such port: plug it in")

    async def close(self) -> None:
        pass


class Wrong(NeverThere):
    async def open(self) -> None:
        raise DeviceMisconfigured("baud 12 is none that it has")


@pytest.mark.parametrize(
    ("cls", "kind", "words", "after_s"),
    [(NeverThere, Unavailable, "no such port: plug it in", 3.0), (Wrong, DeviceMisconfigured, "baud 12", 0.0)],
)
def test_a_needed_device_that_cannot_be_opened_ends_the_start(
    cls: type[Any], kind: type[Exception], words: str, after_s: float
) -> None:
    parts = with_device(robot(behaviour(Go)), "lidar", cls)
    runtime = Runtime(parts, virtual=True)
    ended: list[float] = []

    async def main() -> None:
        try:
            await runtime.run()
        finally:
            ended.append(asyncio.get_running_loop().time())

    with asyncio.Runner(loop_factory=virtual_loop) as runner, pytest.raises(ExceptionGroup) as raised:
        runner.run(main())
    found = raised.value.exceptions
    assert len(found) == 1 and isinstance(found[0], kind) and words in str(found[0])
    assert after_s <= ended[0] <= after_s + 0.6
    base = runtime.devices[0].device
    assert isinstance(base, FakeBase) and base.log[-1][1] == "halt"


def test_a_device_that_nothing_needs_may_be_absent() -> None:
    class Absent(FakeOdometry):
        async def open(self) -> None:
            raise DeviceUnavailable("no such port")

        async def close(self) -> None:
            pass

    parts = with_device(robot(behaviour(Go), odometry=ScriptConfig()), "odometry", Absent)
    runtime, base = run(parts, 5.0)
    assert base.at(4.9) == Drive(0.4)
    assert next(kept.state for kept in runtime.devices if kept.name == "odometry") == "closed"


def test_a_base_that_refuses_a_command_is_lost_and_the_robot_disarmed() -> None:
    class Breaks(FakeBase):
        def apply(self, command: Drive) -> None:
            if self.context.clock.now_ns() >= S:
                raise OSError(121, "Remote I/O error")
            super().apply(command)

    runtime, base = run(with_device(robot(behaviour(Go)), "base", Breaks), 2.0)
    assert runtime.core.operator.mode is Mode.DISARMED
    assert "Remote I/O error" in runtime.core.operator.reason
    assert base.at(1.9) == "halt"


# ------------------------------------------------------------------------------------------ bridges


def test_a_bridge_that_raises_is_restarted_and_the_robot_drives_on() -> None:
    begun: list[float] = []

    class Falls(Bridge[NoConfig]):
        async def run(self, runtime: RuntimeLink) -> None:
            begun.append(runtime.clock.now_ns() / S)
            raise ConnectionError("no broker")

    _, base = run(with_bridge(robot(behaviour(Go)), Falls), 3.0)
    assert begun == [0.0, 0.2, 1.2]
    assert base.at(2.9) == Drive(0.4)


def test_a_bridge_asks_and_is_answered() -> None:
    said: list[str] = []
    events: list[Event] = []
    applied: list[Drive] = []

    class Asks(Bridge[NoConfig]):
        async def run(self, runtime: RuntimeLink) -> None:
            async with asyncio.TaskGroup() as group:
                group.create_task(self.listen(runtime))
                group.create_task(self.watch(runtime))
                await asyncio.sleep(0.5)
                for ask in (
                    lambda: runtime.start("bridge", "no_such", None),
                    lambda: runtime.start("bridge", "go", {"speed": 3}),
                    lambda: runtime.cancel("bridge", "gone"),
                    lambda: runtime.teleop("bridge", Drive(0.1), 60.0),
                    lambda: runtime.reset_estop("bridge"),
                ):
                    try:
                        ask()
                    except Refused as refused:
                        said.append(str(refused))
                assert runtime.status()["mode"] == "auto"
                assert runtime.newest(default_topic(LidarScan)) is not None
                runtime.cancel("bridge", "go")

        async def listen(self, runtime: RuntimeLink) -> None:
            async for event in runtime.events():
                events.append(event)

        async def watch(self, runtime: RuntimeLink) -> None:
            async for message in runtime.watch(default_topic(Applied)):
                assert isinstance(message, Applied)
                assert isinstance(message.command, Drive)
                applied.append(message.command)

    _, base = run(with_bridge(robot(behaviour(Go)), Asks), 1.0)
    assert [any(word in text for text in said) for word in ("no behaviour 'no_such'", "speed", "gone", "lease")] == [
        True
    ] * 4
    assert len(said) == 5
    assert [(type(e), e.result) for e in events if isinstance(e, Outcome)] == [(Outcome, "CANCELLED")]
    assert applied[-1] == Drive() and Drive(0.4) in applied
    assert base.at(0.9) == "halt"


@pytest.mark.parametrize(("deaf", "said"), [(1, 0), (5, 1)])
def test_a_bridge_that_does_not_end_holds_nobody_up(deaf: int, said: int, caplog: pytest.LogCaptureFixture) -> None:
    """Told once is not always enough: since Python 3.12 a server waits for its connections when it is cancelled."""

    class Lingers(Bridge[NoConfig]):
        async def run(self, runtime: RuntimeLink) -> None:
            for _ in range(deaf + 1):
                with contextlib.suppress(asyncio.CancelledError):
                    await asyncio.Event().wait()

    runtime = Runtime(with_bridge(robot(behaviour(Go)), Lingers), virtual=True)

    def started(running: Runtime) -> None:
        asyncio.get_running_loop().call_later(1.0, running.stop)

    async def main() -> float:
        await runtime.run(started)
        ended_s = asyncio.get_running_loop().time()
        for task in asyncio.all_tasks() - {asyncio.current_task()}:
            while not task.done():
                task.cancel()
                await asyncio.sleep(0)
        return ended_s

    with asyncio.Runner(loop_factory=virtual_loop) as runner:
        assert runner.run(main()) <= 2.05
    assert sum("does not end" in record.getMessage() for record in caplog.records) == said


# -------------------------------------------------------------------------------------- ways out


def test_a_turn_that_breaks_stops_the_motors_and_ends_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    ticks = 0
    whole = Core.tick

    def tick(self: Core, now_ns: int) -> None:
        nonlocal ticks
        ticks += 1
        if ticks == 30:
            raise AssertionError("a fault of robotd")
        whole(self, now_ns)

    monkeypatch.setattr(Core, "tick", tick)
    runtime = Runtime(robot(behaviour(Go)), virtual=True)
    with asyncio.Runner(loop_factory=virtual_loop) as runner, pytest.raises(ExceptionGroup) as raised:
        runner.run(runtime.run())
    assert "a fault of robotd" in str(raised.value.exceptions[0])
    base = runtime.devices[0].device
    assert isinstance(base, FakeBase)
    driven = [i for i, (_, what) in enumerate(base.log) if what == Drive(0.4)]
    assert driven and all(what == "halt" for _, what in base.log[driven[-1] + 1 :]) and driven[-1] + 1 < len(base.log)
    assert base.log[driven[-1] + 1][0] == 30 * S // 50


def test_cancelling_the_run_stops_the_motors() -> None:
    runtime = Runtime(robot(behaviour(Go)), virtual=True)

    async def main() -> None:
        async with asyncio.timeout(1.0):
            await runtime.run()

    with asyncio.Runner(loop_factory=virtual_loop) as runner, pytest.raises(TimeoutError):
        runner.run(main())
    base = runtime.devices[0].device
    assert isinstance(base, FakeBase)
    assert (S, "halt") in base.log and base.log[-1][1] == "halt"


def test_nothing_drives_while_the_devices_are_being_closed() -> None:
    class Slow(FakeLidar):
        async def close(self) -> None:
            await asyncio.sleep(0.3)
            self._timer.cancel()

    _, base = run(with_device(robot(behaviour(Go)), "lidar", Slow), 1.005)
    assert base.at(0.95) == Drive(0.4)
    assert [what for ns, what in base.log if ns > S] == ["halt"] * 2, "scans and ticks went on for 0.3 s, unheard"


def test_perceptors_that_raise_or_lie_are_benched_and_their_topic_goes_missing() -> None:
    class Lies(Perceptor[NoConfig, Sees, Target]):
        def step(self, seen: Sees) -> Target | None:
            if seen.now_ns >= S:
                return Target(seen.now_ns + 5, 0.0)
            return Target(seen.scan.stamp_ns, 0.0)

    class SeesTarget(View):
        target: Target = every(within_s=0.3)

    class Follow(Behaviour[NoConfig, SeesTarget]):
        def step(self, seen: SeesTarget) -> Drive | None:
            return Drive(0.2)

    runtime, base = run(robot(behaviour(Follow), perceptors=[perceptor(Lies)]), 2.0)
    assert "in the future" in runtime.core.graph.perceptors[0].benched
    assert base.at(0.9) == Drive(0.2) and base.at(1.5) == "halt"
    assert "the inputs of follow are too old" in runtime.core.standing_reason


# ------------------------------------------------------------------------------------------- timing


@pytest.mark.parametrize(
    ("due", "now", "missed", "following"),
    [(100, 100, 0, 120), (100, 119, 0, 120), (100, 120, 1, 140), (100, 205, 5, 220), (100, 99, 0, 120)],
)
def test_missed_ticks_are_counted_and_skipped(due: int, now: int, missed: int, following: int) -> None:
    assert skip_missed(due, 20, now) == (missed, following)


def test_arming_freezes_what_is_alive() -> None:
    gc.unfreeze()
    try:
        run(robot(behaviour(Go)), 0.3)
        assert gc.get_freeze_count() > 1000
    finally:
        gc.unfreeze()


def test_the_same_robot_runs_on_the_real_loop() -> None:
    """Until its tenth step, however long that takes: the stop first, a command in the turn of a scan, the stop last."""
    steps = 0

    class Ten(Go):
        def step(self, seen: Sees) -> Drive | None:
            nonlocal steps
            steps += 1
            if steps == 10:
                runtime.stop()
            return super().step(seen)

    runtime = Runtime(robot(behaviour(Ten), lidar=ScriptConfig(hz=100.0)))
    with asyncio.Runner(loop_factory=real_loop) as runner:
        runner.run(asyncio.wait_for(runtime.run(), 30.0))
    base = runtime.devices[0].device
    assert isinstance(base, FakeBase)
    assert base.log[0][1] == "halt" and base.log[-1][1] == "halt"
    assert Drive(0.4) in [what for _, what in base.log]
    assert runtime.core.turns >= 10


def test_messages_that_nobody_saw_are_counted() -> None:
    class SeesBoth(View):
        scan: LidarScan = every(within_s=0.25)
        odometry: Odometry = needed(within_s=0.2)

    class Both(Behaviour[NoConfig, SeesBoth]):
        def step(self, seen: SeesBoth) -> Drive | None:
            return None

    runtime, _ = run(robot(behaviour(Both), odometry=ScriptConfig(hz=50.0)), 1.005)
    slots = runtime.core.graph.slots
    assert slots["lidar_scan"].overwritten == 0
    assert 38 <= slots["odometry"].overwritten <= 40, "ten of fifty were seen"
