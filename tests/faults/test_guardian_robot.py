"""A whole robot that is blocked, frozen, killed or unplugged, and a guardian that is: stopped, disarmed, back by hand.

Each fault once, as `scripts/bench guardian` has it two hundred times; times here are loose, for a busy machine.
"""

from __future__ import annotations

import os
import random
import signal
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "scripts"))

from benches.guardian import ENDS, Stage, one_run  # noqa: E402
from benches.guardian_line import wait_for  # noqa: E402
from benches.guardian_robot import KINDS, Launcher  # noqa: E402

pytestmark = pytest.mark.skipif("sys.platform != 'linux'", reason="the guardian is for Linux")

LOOSE_MS = 1000.0
BLOCKED = (("python", "serial"), ("gil", "i2c"), ("sleep", "serial"), ("frozen", "i2c"), ("frozen", "serial"))


@pytest.fixture(scope="module")
def stages() -> Iterator[dict[str, Stage]]:
    with tempfile.TemporaryDirectory(prefix="robotd") as name, Launcher() as launcher, ExitStack() as stack:
        yield {kind: stack.enter_context(Stage(kind, Path(name), launcher).up()) for kind in KINDS}


@pytest.mark.parametrize(
    ("mode", "kind"),
    [*BLOCKED, ("sigkill", "i2c"), *((mode, KINDS[i % 2]) for i, mode in enumerate(ENDS, start=1))],
)
def test_stopped_and_nothing_drives_until_somebody_arms_it(stages: dict[str, Stage], mode: str, kind: str) -> None:
    row = one_run(stages[kind], mode, random.Random(1))
    assert row["ms"] < LOOSE_MS
    assert row["drives_after"] == 0
    if mode not in ENDS:
        assert row["ms"] > 40.0, "it was the guardian, at its deadline"


@pytest.mark.parametrize(("number", "words"), [(signal.SIGKILL, "died"), (signal.SIGSTOP, "does not answer")])
def test_the_guardians_own_end_disarms_and_another_one_takes_over(
    stages: dict[str, Stage], number: signal.Signals, words: str
) -> None:
    stage = stages["serial"]
    robot = stage.drives()
    first = robot.ask("status")["guardian"]
    os.kill(first, number)
    status = robot.until(lambda told: told["mode"] == "disarmed", "the robot to be disarmed")
    assert f"the guardian {words}" in status["reason"]
    status = robot.until(lambda told: told["ready"], "another guardian")
    assert status["guardian"] != first and status["mode"] == "disarmed"
    assert not Path(f"/proc/{first}").exists(), "the old one is gone, and no zombie"
    assert one_run(stage, "sigkill", random.Random(1))["ms"] < LOOSE_MS


def test_a_forked_child_does_not_pass_for_the_runtime(stages: dict[str, Stage]) -> None:
    stage = stages["serial"]
    stage.drives().ask("fork")
    assert one_run(stage, "sigkill", random.Random(1))["ms"] < 70.0, "the end of file, not the deadline of 100 ms"


def test_after_a_replug_it_holds_the_new_line(stages: dict[str, Stage]) -> None:
    stage = stages["serial"]
    robot = stage.drives()
    stage.host.unplug()
    status = robot.until(lambda told: not told["ready"], "the loss")
    assert status["mode"] == "disarmed"
    stage.host.plug()
    robot.until(lambda told: told["ready"], "the line and the guardian")
    row = one_run(stage, "frozen", random.Random(1))
    assert (row["drives_after"], row["ms"] > 40.0) == (0, True)


def test_a_good_end_leaves_no_guardian_behind(stages: dict[str, Stage]) -> None:
    stage = stages["i2c"]
    robot = stage.drives()
    guardian = robot.ask("status")["guardian"]
    robot.signal(signal.SIGTERM)
    wait_for(lambda: not Path(f"/proc/{guardian}").exists(), 10.0, "the guardian's end")
    wait_for(lambda: not Path(f"/proc/{robot.pid}").exists(), 10.0, "the program's end")
    assert stage.heard()[-1].is_stop
    stage.put_away()
