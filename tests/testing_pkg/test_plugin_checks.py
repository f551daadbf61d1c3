"""`check_behaviour` and `check_perceptor`: the good pass, and each way of breaking the contract is named."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import BaseModel, Field, field_validator

from robotd import (
    Behaviour,
    CameraFrame,
    Config,
    Detections,
    Done,
    Drive,
    Failed,
    Goal,
    LidarScan,
    Message,
    Odometry,
    Perceptor,
    Plan,
    Sequence,
    Steer,
    Target,
    View,
    every,
    latest,
    needed,
)
from robotd.authoring.explain import Explanation, Histogram, Scalar
from robotd.testing import (
    CheckFailed,
    check_behaviour,
    check_perceptor,
    corridor_scan,
    example_message,
    example_view,
)
from robotd.world.messages import (
    ActiveGoal,
    Applied,
    Battery,
    Contact,
    EStopped,
    Imu,
    Mode,
    ModeChange,
    Outcome,
    Pose2D,
)


class SeesAll(View):
    scan: LidarScan = every(within_s=0.3)
    odometry: Odometry = needed(within_s=0.3)
    target: Target | None = latest(within_s=0.5)


class SlowConfig(Config):
    speed_mps: float = Field(default=0.2, gt=0.0)
    names: tuple[str, ...] = ("a", "b")


class GoodGoal(Goal):
    steps: int = 10


class Good(Behaviour[SlowConfig, SeesAll, GoodGoal]):
    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.count = 0
        self.nearest_m = math.inf

    def step(self, seen: SeesAll) -> Drive | Done | None:
        self.count += 1
        self.nearest_m = float(seen.scan.ranges_m.min())
        if seen.target is None:
            return None
        return Done("there") if self.count > self.goal.steps else Drive(self.config.speed_mps * self.nearest_m)

    def explain(self) -> Explanation:
        return (Scalar("nearest", self.nearest_m, "m"), Histogram("free", np.ones(3, np.float32), 0.0, 0.1))


class ScanOnly(View):
    scan: LidarScan = every(within_s=0.3)


def test_a_good_behaviour_passes_and_its_answers_come_back() -> None:
    results = check_behaviour(Good)
    assert results[0] == Drive(0.4)
    assert results[2] is None
    assert isinstance(results[-1], Done)
    assert len(results) == 11


def test_config_goal_and_views_can_be_given() -> None:
    class Counts(Behaviour[SlowConfig, ScanOnly]):
        emits = Steer

        def step(self, seen: ScanOnly) -> Steer:
            return Steer(float(seen.scan.ranges_m.min()), 0.0)

    results = check_behaviour(
        Counts,
        SlowConfig(speed_mps=0.1),
        lambda number: ScanOnly(now_ns=number, scan=corridor_scan(2.0 + number, stamp_ns=number)),
        steps=3,
    )
    assert results == [Steer(1.0), Steer(1.5), Steer(2.0)]
    assert len(check_behaviour(Good, SlowConfig(), goal=GoodGoal(steps=2))) == 4


def test_a_sequence_passes() -> None:
    class Two(Sequence[SlowConfig, ScanOnly]):
        def plan(self, seen: ScanOnly) -> Plan[ScanOnly]:
            for _ in range(2):
                yield Drive(0.1)
            return Failed("on purpose")

    assert check_behaviour(Two) == [Drive(0.1), Drive(0.1), Failed("on purpose")]


COUNTER = itertools.count()


class Sees(ScanOnly):
    pass


class Base(Behaviour[SlowConfig, Sees]):
    def step(self, seen: Sees) -> Any:
        return Drive(0.1)


class SharesMemory(Base):
    def step(self, seen: Sees) -> Any:
        return Drive(float(next(COUNTER)))


class ReadsTheClock(Base):
    def step(self, seen: Sees) -> Any:
        return Drive(time.monotonic() % 1.0)


class Sleeps(Base):
    def step(self, seen: Sees) -> Any:
        time.sleep(0.0)
        return None


class NotFinite(Base):
    def step(self, seen: Sees) -> Any:
        return Drive(math.nan)


class NotANumber(Base):
    def step(self, seen: Sees) -> Any:
        return Drive(True)


class OtherKind(Base):
    def step(self, seen: Sees) -> Any:
        return Steer(0.1, 0.0)


class NoCommand(Base):
    def step(self, seen: Sees) -> Any:
        return 0.3


class BadReason(Base):
    def step(self, seen: Sees) -> Any:
        return Failed(None)  # type: ignore[arg-type]


class ChangesItsView(Base):
    def step(self, seen: Sees) -> Any:
        seen.scan.ranges_m.flags.writeable = True
        seen.scan.ranges_m[0] += 1.0
        seen.scan.ranges_m.flags.writeable = False
        return None


class ExplainCounts(Base):
    speed = 0.0

    def step(self, seen: Sees) -> Any:
        return Drive(self.speed)

    def explain(self) -> Explanation:
        self.speed += 0.1
        return ()


class ExplainsList(Base):
    def explain(self) -> Any:
        return [Scalar("a", 1.0)]


class ExplainsWords(Base):
    def explain(self) -> Any:
        return ("a word",)


class ExplainsLists(Base):
    def explain(self) -> Any:
        return (Scalar("a", {1, 2}),)  # type: ignore[arg-type]


class CloseRaises(Base):
    def close(self) -> None:
        raise RuntimeError("on purpose")


class Loose(BaseModel):
    speed_mps: float = 0.1


class LooseConfig(Base):
    config_type = Loose  # type: ignore[assignment]


class Drifting(Config):
    speed_mps: float = 0.1

    @field_validator("speed_mps")
    @classmethod
    def _more(cls, value: float) -> float:
        return value + 1.0


class DriftingConfig(Base):
    config_type = Drifting


class Needy(Config):
    port: str


class NeedyConfig(Base):
    config_type = Needy


@pytest.mark.parametrize(
    ("cls", "complaint"),
    [
        (SharesMemory, "a second fresh instance answered the same views differently: step 0 gave"),
        (ReadsTheClock, r"step 0 calls time\.monotonic; seen\.now_ns is the time"),
        (Sleeps, r"step 0 calls time\.sleep; never wait in a step"),
        (NotFinite, "step 0 returned vx_mps = nan"),
        (NotANumber, "step 0 returned vx_mps = True"),
        (OtherKind, "step 0 returned Steer, it declares Drive; declare emits = Steer"),
        (NoCommand, "step 0 returned float, it declares Drive"),
        (BadReason, "step 0 ended with the reason None"),
        (ChangesItsView, "step 0 changed its view"),
        (ExplainCounts, r"explain\(\) changes what step\(\) answers: step 1"),
        (ExplainsList, r"explain\(\) after step 0 returned list; return a tuple"),
        (ExplainsWords, r"explain\(\) after step 0 returned a str"),
        (ExplainsLists, r"explain\(\) after step 0: Scalar cannot be shown"),
        (LooseConfig, "Loose must be frozen and forbid unknown keys"),
        (DriftingConfig, "Drifting changes in a round trip"),
        (NeedyConfig, "Needy has no default for port; give the check a config"),
    ],
)
def test_each_way_of_breaking_the_contract_is_named(cls: type[Behaviour[Any, Any, Any]], complaint: str) -> None:
    with pytest.raises(CheckFailed, match=rf"{cls.__qualname__}: {complaint}"):
        check_behaviour(cls)


def test_what_a_plugin_raises_comes_through() -> None:
    with pytest.raises(RuntimeError, match="on purpose"):
        check_behaviour(CloseRaises)


def test_a_wrong_config_or_view_is_named() -> None:
    with pytest.raises(CheckFailed, match="takes SlowConfig, was given Needy"):
        check_behaviour(Base, Needy(port="x"))
    with pytest.raises(CheckFailed, match=r"sees Sees, make_view\(0\) gave SeesAll"):
        check_behaviour(Base, None, lambda number: example_view(SeesAll, number))


def test_the_clock_is_given_back() -> None:
    with pytest.raises(CheckFailed):
        check_behaviour(ReadsTheClock)
    assert time.monotonic() > 0.0


# ------------------------------------------------------------------------------------------ perceptors


class SeesFrame(View):
    frame: CameraFrame = every(within_s=0.3)


class GoodEyes(Perceptor[SlowConfig, SeesFrame, Detections]):
    def step(self, seen: SeesFrame) -> Any:
        height, width = seen.frame.bgr.shape[:2]
        return Detections(seen.frame.stamp_ns, (), width, height)


class FromTheFuture(GoodEyes):
    def step(self, seen: SeesFrame) -> Any:
        return Detections(seen.now_ns + 1)


class OtherMessage(GoodEyes):
    def step(self, seen: SeesFrame) -> Any:
        return Target(1, 0.0)


class Unrecordable(GoodEyes):
    def step(self, seen: SeesFrame) -> Any:
        return Detections(1, {1, 2})  # type: ignore[arg-type]


class OpenArray(Perceptor[SlowConfig, SeesFrame, CameraFrame]):
    def step(self, seen: SeesFrame) -> Any:
        frame = CameraFrame(seen.frame.stamp_ns, seen.frame.bgr.copy())
        frame.bgr.flags.writeable = True
        return frame


class EyesShareMemory(GoodEyes):
    def step(self, seen: SeesFrame) -> Any:
        return Detections(1, width_px=next(COUNTER))


def test_a_good_perceptor_passes() -> None:
    messages = check_perceptor(GoodEyes, steps=4)
    assert [m.width_px for m in messages if isinstance(m, Detections)] == [64] * 4


@pytest.mark.parametrize(
    ("cls", "complaint"),
    [
        (FromTheFuture, "step 0 stamped 50000001 ns, later than the view's 50000000 ns"),
        (OtherMessage, "step 0 returned Target, it declares Detections"),
        (Unrecordable, "step 0 returned a message that cannot be recorded: items"),
        (OpenArray, "step 0: the array bgr can be written to"),
        (EyesShareMemory, "a second fresh instance answered"),
    ],
)
def test_each_broken_perceptor_is_named(cls: type[Perceptor[Any, Any, Any]], complaint: str) -> None:
    with pytest.raises(CheckFailed, match=complaint):
        check_perceptor(cls)


# -------------------------------------------------------------------------------------------- examples


@pytest.mark.parametrize(
    "message_type",
    [
        LidarScan, CameraFrame, Odometry, Pose2D, Target, Detections, Imu, Battery, Contact, ModeChange, ActiveGoal,
        Applied, Outcome, EStopped,
    ],
)  # fmt: skip
def test_every_message_has_an_example(message_type: type[Message]) -> None:
    message = example_message(message_type, 7)
    assert type(message) is message_type
    assert message.stamp_ns == 7


@dataclass(frozen=True, slots=True, eq=False)
class Grid(Message):
    cells: NDArray[np.uint8]
    heights_m: NDArray[np.float32]
    mean_m: float
    origin: Drive
    mode: Mode
    label: str | None
    parts: tuple[Drive, ...]


@dataclass(frozen=True, slots=True)
class Odd(Message):
    handler: Callable[[], None]


def test_a_message_of_ones_own_has_an_example_too() -> None:
    grid = example_message(Grid, 7)
    assert (grid.cells.dtype, grid.heights_m.dtype) == (np.uint8, np.float32)
    assert (grid.mean_m, grid.origin, grid.label, grid.parts) == (0.0, Drive(), None, ())
    assert grid.mode is Mode.ESTOP
    with pytest.raises(CheckFailed, match="no example can be guessed for its field handler"):
        example_message(Odd)


def test_a_view_of_examples_leaves_optional_ones_out_on_demand() -> None:
    view = example_view(SeesAll, 50_000_000, with_latest=False)
    assert view.target is None
    assert view.scan.stamp_ns == view.odometry.stamp_ns == 49_000_000
    assert example_view(SeesAll, 0).scan.stamp_ns == 0
