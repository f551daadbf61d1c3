"""One turn at a time: what wakes a step, what withdraws a command, and how stale data stops the robot."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import ClassVar

import pytest
from small_robot import FakeBase, S, ScriptConfig, behaviour, perceptor, robot, run

from robotd import (
    Behaviour,
    Done,
    Drive,
    Failed,
    LidarScan,
    NoConfig,
    Odometry,
    Perceptor,
    Plan,
    Sequence,
    Target,
    View,
    every,
    latest,
    needed,
)
from robotd.authoring.behaviour import StepResult
from robotd.engine.parts import DevicePart
from robotd.engine.runtime import Runtime
from robotd.safety.operator import Arm, Disarm, EStop, ResetEStop, Resume, Teleop
from robotd.world.messages import Mode


class Sees(View):
    scan: LidarScan = every(within_s=0.25)


class Go(Behaviour[NoConfig, Sees]):
    def step(self, seen: Sees) -> Drive | None:
        return Drive(0.4)


class Slower(Behaviour[NoConfig, Sees]):
    def step(self, seen: Sees) -> Drive | None:
        return Drive(0.1)


def test_it_drives_in_the_turn_of_the_scan() -> None:
    _, base = run(robot(behaviour(Go)), 0.5)
    first = next(ns for ns, what in base.log if what == Drive(0.4))
    assert first == S // 10, "the command came in the very turn of the first scan"
    assert base.log[0][1] == "halt" and base.log[-1][1] == "halt", "a stop first, a stop last"


def test_a_silent_lidar_stops_within_its_age_and_one_tick() -> None:
    _, base = run(robot(behaviour(Go), lidar=ScriptConfig(silent_after_s=1.0)), 2.0)
    stopped = next(ns for ns, what in base.log if what == "halt" and ns > S)
    assert 0.9 + 0.25 <= stopped / S <= 0.9 + 0.25 + 0.021


def test_a_lost_lidar_stops_at_once_and_needs_arming_again() -> None:
    parts = robot(behaviour(Go), lidar=ScriptConfig(lost_at_s=1.0, back_after_s=0.5))
    runtime, base = run(parts, 4.0, (3.0, lambda r: r.core.request(Arm("me"), 3 * S)))
    stopped = next(ns for ns, what in base.log if what == "halt" and ns > S // 2)
    assert stopped == S, "in the turn of the loss"
    assert base.at(2.9) == "halt", "it does not drive off by itself when the cable is back"
    assert base.at(3.5) == Drive(0.4)
    assert runtime.core.operator.mode is Mode.AUTO


def test_the_higher_priority_drives_and_an_exception_benches_it() -> None:
    class Breaks(Behaviour[NoConfig, Sees]):
        def step(self, seen: Sees) -> Drive | None:
            if seen.now_ns > S:
                raise ZeroDivisionError("one over nothing")
            return Drive(0.7)

    runtime, base = run(robot(behaviour(Go, 10), behaviour(Breaks, 20)), 2.0)
    assert base.at(0.9) == Drive(0.7)
    assert base.at(1.15) == Drive(0.4), "the others drive on"
    broken = next(node for node in runtime.core.graph.behaviours if node.name == "breaks")
    assert "one over nothing" in broken.benched


@pytest.mark.parametrize("wrong", [3, "left", (0.1, 0.2)])
def test_a_step_that_returns_something_else_is_benched(wrong: object) -> None:
    class Odd(Behaviour[NoConfig, Sees]):
        def step(self, seen: Sees) -> StepResult:
            return wrong  # type: ignore[return-value]

    runtime, base = run(robot(behaviour(Odd)), 0.5)
    assert type(wrong).__name__ in runtime.core.graph.behaviours[0].benched
    assert base.at(0.4) == "halt"


@pytest.mark.parametrize(("outcome", "result"), [(Done("there"), "SUCCEEDED"), (Failed("no way"), "FAILED")])
def test_an_outcome_stops_at_once(outcome: Done | Failed, result: str) -> None:
    class Ends(Behaviour[NoConfig, Sees]):
        def step(self, seen: Sees) -> StepResult:
            return Drive(0.4) if seen.now_ns < S else outcome

    runtime, base = run(robot(behaviour(Ends)), 1.5)
    assert (S, "halt") in base.log
    assert runtime.core.graph.behaviours[0].outcome.startswith(result)
    assert outcome.reason in runtime.core.standing_reason


def test_a_sequence_reads_from_top_to_bottom_and_cleans_up() -> None:
    cleaned: list[str] = []

    class Dance(Sequence[NoConfig, Sees]):
        def plan(self, seen: Sees) -> Plan[Sees]:
            try:
                yield Drive(0.1)
                yield Drive(0.2)
                yield None
                while True:
                    yield Drive(0.3)
            finally:
                cleaned.append("cleaned")

    _, base = run(robot(behaviour(Dance)), 1.0, (0.75, lambda r: r.core.request(Disarm("me"), S * 3 // 4)))
    assert [base.at(t) for t in (0.15, 0.25, 0.35, 0.45)] == [Drive(0.1), Drive(0.2), "halt", Drive(0.3)]
    assert cleaned == ["cleaned"]


def test_a_missing_needed_input_means_no_step() -> None:
    class SeesBoth(View):
        scan: LidarScan = every(within_s=0.25)
        odometry: Odometry = needed(within_s=0.2)

    class Both(Behaviour[NoConfig, SeesBoth]):
        def step(self, seen: SeesBoth) -> Drive | None:
            return Drive(0.4)

    parts = robot(behaviour(Both), odometry=ScriptConfig(hz=20, silent_after_s=1.0))
    runtime, base = run(parts, 2.0)
    assert base.at(0.9) == Drive(0.4)
    assert base.at(1.3) == "halt"
    assert "waits for odometry" in runtime.core.standing_reason


class Tracker(Perceptor[NoConfig, Sees, Target]):
    def step(self, seen: Sees) -> Target | None:
        return Target(seen.scan.stamp_ns, 0.1)


class SeesTarget(View):
    target: Target | None = latest(within_s=0.3)
    odometry: Odometry = every(within_s=0.1)


def test_an_optional_input_that_became_stale_wakes_the_step_with_none() -> None:
    seen_at: list[tuple[int, bool]] = []

    class SeesOnce(View):
        odometry: Odometry = every(within_s=10.0)
        target: Target | None = latest(within_s=0.3)

    class Watches(Behaviour[NoConfig, SeesOnce]):
        def step(self, seen: SeesOnce) -> Drive | None:
            seen_at.append((seen.now_ns, seen.target is not None))
            return None

    parts = robot(
        behaviour(Watches),
        perceptors=[perceptor(Tracker)],
        lidar=ScriptConfig(silent_after_s=1.05),
        odometry=ScriptConfig(hz=1.0, silent_after_s=1.5),
    )
    run(parts, 3.0)
    assert (S, True) in seen_at
    assert seen_at[-1] == (S + 300_000_001, False), "woken at the very instant the target became too old"


def test_perceptors_run_before_behaviours_in_the_same_turn_whatever_the_order_in_the_file() -> None:
    ages: list[int] = []

    class Second(Perceptor[NoConfig, SeesTarget, LidarScan]):
        pass

    class SeesT(View):
        target: Target = every(within_s=0.3)

    class Follow(Behaviour[NoConfig, SeesT]):
        def step(self, seen: SeesT) -> Drive | None:
            ages.append(seen.now_ns - seen.target.stamp_ns)
            return Drive(0.2)

    run(robot(behaviour(Follow), perceptors=[perceptor(Tracker)]), 1.0)
    assert len(ages) >= 9 and set(ages) == {0}


def test_an_authors_stamp_cannot_freshen_old_data() -> None:
    class Freshener(Perceptor[NoConfig, SeesTarget, LidarScan]):
        pass

    class SeesOld(View):
        odometry: Odometry = every(within_s=0.1)
        scan: LidarScan = needed(within_s=2.0)

    class Lies(Perceptor[NoConfig, SeesOld, Target]):
        def step(self, seen: SeesOld) -> Target | None:
            return Target(seen.now_ns, 0.0)

    class SeesFresh(View):
        target: Target = every(within_s=0.5)

    class Trusts(Behaviour[NoConfig, SeesFresh]):
        def step(self, seen: SeesFresh) -> Drive | None:
            return Drive(0.4)

    parts = robot(
        behaviour(Trusts),
        perceptors=[perceptor(Lies)],
        lidar=ScriptConfig(silent_after_s=1.05),
        odometry=ScriptConfig(hz=20),
    )
    _, base = run(parts, 3.0)
    assert base.at(1.4) == Drive(0.4)
    assert base.at(1.6) == "halt", "the target is stamped now, but made from a scan of 1.0 s"


def test_a_view_on_time_alone_steps_at_its_rate() -> None:
    steps: list[int] = []

    class OnTime(View, hz=20):
        scan: LidarScan | None = latest(within_s=0.25)

    class Ticks(Behaviour[NoConfig, OnTime]):
        def step(self, seen: OnTime) -> Drive | None:
            steps.append(seen.now_ns)
            return Drive(0.1)

    run(robot(behaviour(Ticks)), 2.04)
    assert len(steps) == 40
    assert {b - a for a, b in itertools.pairwise(steps)} == {S // 20}


def test_an_offloaded_perceptor_answers_after_its_declared_latency() -> None:
    class Slow(Perceptor[NoConfig, Sees, Target]):
        offload: ClassVar[bool] = True
        sim_latency_s: ClassVar[float] = 0.07

        def step(self, seen: Sees) -> Target | None:
            return Target(seen.scan.stamp_ns, 0.0)

    delays: list[int] = []

    class SeesT(View):
        target: Target = every(within_s=0.3)

    class Follow(Behaviour[NoConfig, SeesT]):
        def step(self, seen: SeesT) -> Drive | None:
            delays.append(seen.now_ns - seen.target.stamp_ns)
            return Drive(0.2)

    run(robot(behaviour(Follow), perceptors=[perceptor(Slow)]), 1.0)
    assert len(delays) >= 8 and set(delays) == {70_000_000}


def test_estop_is_latched_through_arming() -> None:
    def at(r: Runtime, request: object, t: float) -> None:
        r.core.request(request, round(t * S))  # type: ignore[arg-type]

    _, base = run(
        robot(behaviour(Go)),
        4.0,
        (1.0, lambda r: at(r, EStop("button", "test"), 1.0)),
        (1.5, lambda r: at(r, Arm("me"), 1.5)),
        (2.0, lambda r: at(r, ResetEStop("me"), 2.0)),
        (3.0, lambda r: at(r, Arm("me"), 3.0)),
    )
    assert (S, "halt") in base.log
    assert [base.at(t) for t in (0.9, 1.4, 1.9, 2.9, 3.5)] == [Drive(0.4), "halt", "halt", "halt", Drive(0.4)]


def test_a_hand_takes_over_and_autonomy_returns_only_by_resume() -> None:
    stepped: list[int] = []

    class Counts(Go):
        def step(self, seen: Sees) -> Drive | None:
            stepped.append(seen.now_ns)
            return Drive(0.4)

    _, base = run(
        robot(behaviour(Counts)),
        3.0,
        (1.02, lambda r: r.core.request(Teleop("pad", Drive(0.0, 1.0), S // 5), round(1.02 * S))),
        (2.0, lambda r: r.core.request(Resume("me"), 2 * S)),
    )
    assert base.at(1.1) == Drive(0.0, 1.0)
    assert base.at(1.3) == "halt", "the lease ended"
    assert base.at(2.5) == Drive(0.4)
    assert not [ns for ns in stepped if 1.02 * S < ns < 2 * S], "behaviours are not stepped meanwhile"


@pytest.mark.parametrize(
    ("offset_ns", "fault"), [(5, "stamp in the future"), (-10 * S, "stamp not newer than the last")]
)
def test_stamps_from_the_future_or_the_past_are_faults(offset_ns: int, fault: str) -> None:
    from small_robot import FakeLidar

    class Odd(FakeLidar):
        def message(self, now_ns: int) -> LidarScan:
            scan = super().message(now_ns)
            if self._count == 5:
                object.__setattr__(scan, "stamp_ns", max(0, now_ns + offset_ns))
            return scan

    parts = robot(behaviour(Go))
    lidar = type(parts.devices[1])("lidar", Odd, parts.devices[1].config)
    runtime, _ = run(replace(parts, devices=(parts.devices[0], lidar)), 1.0)
    kept = next(kept for kept in runtime.devices if kept.name == "lidar")
    assert kept.faults == {fault: 1}


def test_two_runs_give_the_same_log_and_so_does_a_paced_one() -> None:
    logs = [run(robot(behaviour(Go), behaviour(Slower, 5)), 1.0, pace=pace)[1].log for pace in (None, None, 20.0)]
    assert logs[0] == logs[1] == logs[2]
    assert isinstance(run(robot(), 0.2)[1], FakeBase)


def test_an_estop_reaches_the_base_first_and_as_what_it_is() -> None:
    class Latches(FakeBase):
        def estop(self) -> None:
            self.log.append((self.context.clock.now_ns(), "estop"))

    parts = robot(behaviour(Go))
    parts = replace(parts, devices=(DevicePart("base", Latches, NoConfig()), *parts.devices[1:]))
    _, base = run(parts, 2.0, (1.05, lambda r: r.core.request(EStop("button", "test"), round(1.05 * S))))
    assert [what for ns, what in base.log if ns == 1_050_000_000] == ["estop", "halt"]
