"""Any recorded run comes out again bit for bit, at any pace and on both loops, whatever happened in it."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recorded import (
    Bright,
    Event,
    Follow,
    Nearest,
    Slow,
    TourGoal,
    again,
    asks,
    plain,
    record,
    record_real,
    rich,
)
from small_robot import OFF, FakeBase, S, ScriptConfig

from robotd import Drive, LidarScan, Odometry, Target
from robotd.authoring.explain import Explanation
from robotd.engine.parts import Parts
from robotd.engine.record_file import read_record
from robotd.engine.runtime import Runtime
from robotd.safety.operator import Arm, Cancel, Disarm, EStop, Pause, Request, ResetEStop, Resume, Start, Teleop
from robotd.world.messages import Steer


class FailingBase(FakeBase):
    """Its cable comes off in the middle of a write, once a second."""

    def apply(self, command: Drive) -> None:
        super().apply(command)
        if len(self.log) % 40 == 39:
            raise OSError("write failed")


class ReportingBase(FakeBase):
    """Publishes from inside `apply`, as a base with its own odometry may."""

    emits = (Odometry,)
    _steps = 0.0

    def apply(self, command: Drive) -> None:
        super().apply(command)
        self._steps += command.vx_mps
        self.publish(Odometry(self.context.clock.now_ns(), self._steps, 0.0, 0.0))


def listen(runtime: Runtime) -> None:
    """Somebody looks at explanations for a while."""
    runtime.core.stepping.explain_until_ns = 2 * S


def without_camera(parts: Parts) -> Parts:
    """For a base that publishes the odometry itself."""
    perceptors = tuple(part for part in parts.perceptors if part.name != "bright")
    return replace(parts, devices=parts.devices[:2], perceptors=perceptors)


RUNS: dict[str, tuple[Parts, tuple[Event, ...]]] = {
    "nothing happens": (rich(), ()),
    "e-stop, reset, arm": (
        rich(),
        (asks(1.0, EStop("button", "test")), asks(1.2, Arm("me")), asks(1.4, ResetEStop("me")), asks(1.6, Arm("me"))),
    ),
    "driven by hand": (
        rich(),
        (
            asks(0.8, Teleop("pad", Drive(-0.0, 1.0), S // 5)),
            asks(0.9, Teleop("other", Drive(0.1), S // 5)),
            asks(0.95, Teleop("pad", Steer(0.2, 0.1), S // 5)),
            asks(1.0, Teleop("pad", Drive(float("nan")), S // 5)),
            asks(2.0, Resume("me")),
        ),
    ),
    "goals": (
        rich(),
        (
            asks(0.7, Start("me", "tour", TourGoal(speed_mps=0.7))),
            asks(0.9, Start("me", "nonsense")),
            asks(2.2, Start("me", "tour")),
            asks(2.4, Cancel("me", "tour")),
            asks(2.5, Pause("me")),
            asks(2.8, Resume("me")),
            asks(3.0, Disarm("me")),
        ),
    ),
    "a goal takes too long": (rich(timeout_s=1.1), ()),
    "lidar silent: inputs expire, behaviours are blind": (rich(lidar=ScriptConfig(silent_after_s=1.5)), ()),
    "lidar silent, and no zones that stop the rest": (
        replace(rich(lidar=ScriptConfig(silent_after_s=1.5)), guard=OFF),
        (),
    ),
    "lidar lost and back": (rich(lidar=ScriptConfig(lost_at_s=1.0, back_after_s=0.7)), (asks(2.5, Arm("me")),)),
    "needed odometry falls silent": (plain(silent_after_s=1.5), ()),
    "odometry lost and back": (plain(lost_at_s=1.2, back_after_s=0.5), (asks(2.2, Arm("me")),)),
    "the base breaks in a write": (
        rich(base=FailingBase),
        tuple(asks(t, Arm("me")) for t in (1.5, 2.0, 2.5, 3.0)),
    ),
    "the base speaks in a write": (without_camera(rich(base=ReportingBase)), ()),
    "somebody listens": (rich(), ((0.5, listen),)),
}


@pytest.mark.parametrize("name", RUNS)
def test_a_recorded_run_comes_out_again(tmp_path: Path, name: str) -> None:
    parts, events = RUNS[name]
    path = tmp_path / "run.mcap"
    written = record(path, parts, 3.5, *events)
    report = again(path, parts)
    assert report.first_difference is None, str(report.first_difference)
    assert (report.compared, report.uncompared) == (len(written), 0)
    assert len(written) > 10


def test_the_runs_above_contain_every_kind_of_input(tmp_path: Path) -> None:
    seen: Counter[str] = Counter()
    for name in ("e-stop, reset, arm", "lidar silent: inputs expire, behaviours are blind", "lidar lost and back"):
        parts, events = RUNS[name]
        record(tmp_path / "run.mcap", parts, 2.0, *events)
        seen.update(entry.kind for entry in read_record(tmp_path / "run.mcap"))
    assert set(seen) == {
        "started", "message", "tick", "timer", "expiry", "offloaded", "request", "opened", "lost",
        "perceived", "command",
    }  # fmt: skip


def test_a_broken_write_is_a_turn_of_its_own(tmp_path: Path) -> None:
    parts, events = RUNS["the base breaks in a write"]
    record(tmp_path / "run.mcap", parts, 3.5, *events)
    entries = list(read_record(tmp_path / "run.mcap"))
    lost = [i for i, entry in enumerate(entries) if entry.kind == "lost"]
    assert lost
    for i in lost:
        assert entries[i - 1].sequence == entries[i].sequence - 1, "nothing of the broken turn comes after the loss"
        assert (entries[i + 1].kind, entries[i + 1].sequence) == ("command", entries[i].sequence)


@pytest.mark.parametrize("frames", [True, False])
def test_a_perceptor_that_sees_frames_and_breaks_breaks_again(
    tmp_path: Path, frames: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Bright, "breaks_at", 7)
    path = tmp_path / "run.mcap"
    record(path, rich(), 3.0, frames=frames)
    report = again(path, rich())
    assert report.first_difference is None
    monkeypatch.setattr(Bright, "breaks_at", 10**9)
    difference = again(path, rich()).first_difference
    assert (difference is not None) is frames, "the picture is seen again only where it was kept"


def test_what_is_not_run_is_not_even_loaded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "run.mcap"
    record(path, rich(), 1.0)
    stepped: list[str] = []
    for cls in (Bright, Slow, Nearest, Follow):

        def load(config: object, name: str = cls.__name__) -> None:
            stepped.append(name)

        monkeypatch.setattr(cls, "load", load)
    report = again(path, rich())
    assert stepped == ["Nearest", "Follow"]
    assert "played back, not run: bright, slow" in report.notes


def test_an_explanation_that_raises_changes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def explain(self: object) -> Explanation:
        raise ValueError("no picture")

    monkeypatch.setattr(Follow, "explain", explain)
    monkeypatch.setattr(Nearest, "explain", explain)
    parts, events = RUNS["somebody listens"]
    loud = record(tmp_path / "a.mcap", parts, 2.0, *events)
    assert loud == record(tmp_path / "b.mcap", parts, 2.0)
    assert again(tmp_path / "a.mcap", parts).first_difference is None


def test_a_narrower_message_than_declared_comes_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Named(Target):
        __slots__ = ()

    def step(self: Slow, seen: object) -> Target | None:
        scan: LidarScan = seen.scan  # type: ignore[attr-defined]
        return Named(scan.stamp_ns, 0.2)

    monkeypatch.setattr(Slow, "step", step)
    path = tmp_path / "run.mcap"
    record(path, rich(), 1.0)
    assert again(path, rich()).first_difference is None


@pytest.mark.parametrize("wrong", [object(), "left", 3])
def test_a_perceptor_that_returns_something_else_is_benched_again(
    tmp_path: Path, wrong: object, monkeypatch: pytest.MonkeyPatch
) -> None:
    def step(self: object, seen: object) -> object:
        return wrong if seen.now_ns > S else None  # type: ignore[attr-defined]

    monkeypatch.setattr(Bright, "step", step)
    monkeypatch.setattr(Slow, "step", step)
    path = tmp_path / "run.mcap"
    record(path, rich(), 2.0)
    report = again(path, rich())
    assert report.first_difference is None
    assert report.uncompared == 0


# --------------------------------------------------------------------------------------- pace and loops


def test_real_pace_and_virtual_time_give_the_same_commands(tmp_path: Path) -> None:
    parts, events = rich(), (asks(0.4, Teleop("pad", Drive(0.1), S // 10)), asks(0.5, Resume("me")))
    fast = record(tmp_path / "fast.mcap", parts, 0.8, *events)
    real = record(tmp_path / "real.mcap", parts, 0.8, *events, pace=1.0)
    assert fast == real and len(fast) > 10
    assert (tmp_path / "fast.mcap").read_bytes() == (tmp_path / "real.mcap").read_bytes()


def test_a_run_on_the_real_loop_comes_out_again(tmp_path: Path) -> None:
    path, parts = tmp_path / "run.mcap", rich(lidar=ScriptConfig(hz=40.0, range_m=1.1))
    written = record_real(path, parts, 0.7)
    report = again(path, parts)
    assert report.first_difference is None, str(report.first_difference)
    assert report.compared == len(written) > 10
    entries = list(read_record(path))
    assert {"offloaded", "perceived", "timer"} <= {entry.kind for entry in entries}
    instants = [entry.now_ns for entry in entries]
    assert instants == sorted(instants) and instants[-1] - instants[0] < S


# ------------------------------------------------------------------------------------------------- law

_REQUESTS: tuple[Request, ...] = (
    Arm("a"), Disarm("a"), EStop("a", "why"), ResetEStop("a"), Pause("a"), Resume("a"), Start("a", "tour"),
    Start("a", "follow"), Cancel("a", "follow"), Cancel("a", "tour"), Teleop("a", Drive(0.3, -0.4), S // 4),
    Teleop("b", Drive(-0.2), S // 10), Teleop("a", Drive(float("inf")), S // 10),
)  # fmt: skip


@settings(max_examples=40, deadline=None)
@given(
    script=st.lists(st.tuples(st.integers(0, 240), st.sampled_from(_REQUESTS)), max_size=12),
    silent_s=st.sampled_from((0.7, 1.3, 9.0)),
    lost_s=st.sampled_from((0.9, 1.5, 9.0)),
    base=st.sampled_from((FakeBase, FailingBase)),
)
def test_any_script_of_requests_and_losses_comes_out_again(
    tmp_path_factory: pytest.TempPathFactory,
    script: list[tuple[int, Request]],
    silent_s: float,
    lost_s: float,
    base: type[FakeBase],
) -> None:
    path = tmp_path_factory.mktemp("law") / "run.mcap"
    lidar = ScriptConfig(silent_after_s=silent_s, lost_at_s=lost_s, back_after_s=0.2, range_m=1.0)
    parts = rich(lidar=lidar, base=base)
    written = record(path, parts, 2.5, *(asks(at / 100.0, request) for at, request in script))
    report = again(path, parts)
    assert report.first_difference is None, str(report.first_difference)
    assert report.compared == len(written)
