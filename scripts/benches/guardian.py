"""`scripts/bench guardian`: how soon the motors get their stop when the program is blocked, frozen or ended."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from benches.guardian_line import BAUD, Heard, LineFake, heard_on, wait_for
from benches.guardian_robot import KINDS, Launcher, Told
from benches.harness import Bench, Context, Figure
from robotd_devices.motor.pca9685_fake import Pca9685Fake
from robotd_devices.ports.i2c_fake import FakeI2cBus
from robotd_devices.ports.i2c_host import I2cHost
from robotd_devices.ports.pty_host import PtyHost

LOCKUPS = ("python", "gil", "sleep", "frozen", "crowded")
ENDS = ("sigkill", "sigterm", "sigterm_group", "sigtstp", "estop", "exception")
BLOCK_S = 0.25
_SCHEDULING = {os.SCHED_OTHER: "ordinary", os.SCHED_FIFO: "SCHED_FIFO"}
_SPIN = "import os\nos.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))\nwhile True: pass"


class Stage:
    """One line with its fake in this process, and a robot on it in another."""

    def __init__(self, kind: str, folder: Path, launcher: Launcher) -> None:
        self.kind = kind
        self.false_trips = 0
        self.schedulings: set[str] = set()
        """What the guardians got."""
        self._path = folder / kind
        self._launcher = launcher
        self._robot: Told | None = None
        self._bus = FakeI2cBus([Pca9685Fake()])
        self._line = LineFake()
        self._seen = 0
        self.host: I2cHost | PtyHost = (
            I2cHost(self._bus, self._path) if kind == "i2c" else PtyHost(self._line, self._path, baud=BAUD)
        )

    @contextlib.contextmanager
    def up(self) -> Iterator[Stage]:
        """With the fake on its line."""
        with self.host:
            try:
                yield self
            finally:
                self.put_away()

    def heard(self) -> list[Heard]:
        """What the motors' side heard since `drives`."""
        return heard_on(self._bus, self._seen) if self.kind == "i2c" else self._line.heard[self._seen :]

    def drives(self) -> Told:
        """A robot that is armed and drives; the same as before where that one still lives."""
        if self._robot is None:
            self._robot = self._launcher.start(self.kind, self._path)
        robot = self._robot
        self._seen = len(self._bus.log) if self.kind == "i2c" else len(self._line.heard)
        while True:
            told = robot.until(lambda told: told["ready"], "the guardian and the line")
            if not self.schedulings:
                self.schedulings.add(_SCHEDULING.get(os.sched_getscheduler(told["guardian"]), "another"))
            if not (told := robot.ask("arm"))["armed"]:
                raise RuntimeError(f"not armed: {told['why']}")
            try:
                wait_for(lambda: sum(not each.is_stop for each in self.heard()) >= 3, 1.0, "commands")
                return robot
            except TimeoutError:
                status = robot.ask("status")
                if status["mode"] != "disarmed" or "guardian" not in status["reason"]:
                    raise RuntimeError(f"it does not drive: {status}") from None
                self.false_trips += 1

    def stopped_after(self, at_ns: int) -> Callable[[], bool]:
        """Whether a stop was heard since an instant."""
        return lambda: any(each.is_stop and each.now_ns >= at_ns for each in self.heard())

    def put_away(self) -> None:
        """The next run gets a new robot."""
        if self._robot is not None:
            self._robot.end()
            self._robot = None


def one_run(stage: Stage, mode: str, rng: random.Random) -> dict[str, Any]:
    """Make a driving robot suffer one fault; returns when the stop came, and what was driven after it."""
    robot = stage.drives()
    time.sleep(rng.uniform(0.0, 0.04))
    ended = mode in ("sigkill", "sigterm", "sigterm_group", "exception")
    match mode:
        case "python" | "gil" | "sleep":
            at_ns = robot.ask(f"{mode} {BLOCK_S}")["at_ns"]
        case "crowded":
            at_ns = robot.ask(f"python {BLOCK_S}")["at_ns"]
        case "estop" | "exception":
            at_ns = robot.ask(mode)["at_ns"]
        case _:
            number = {"frozen": signal.SIGSTOP, "sigkill": signal.SIGKILL, "sigtstp": signal.SIGTSTP}
            at_ns = robot.signal(number.get(mode, signal.SIGTERM), group=mode == "sigterm_group")
    gone_ms = {"gone_ms": (robot.gone_ns() - at_ns) / 1e6} if mode == "sigkill" else {}
    wait_for(stage.stopped_after(at_ns), 3.0, f"a stop ({mode}, {stage.kind})")
    if mode in ("frozen", "sigtstp"):
        time.sleep(rng.uniform(0.03, 0.2))
        robot.signal(signal.SIGCONT)
    if ended:
        stage.put_away()
    elif mode == "estop":
        robot.ask("reset")
    else:
        robot.until(lambda told: told["mode"] == "disarmed", "the robot to be disarmed")
    time.sleep(0.06)
    since = [each for each in stage.heard() if each.now_ns >= at_ns]
    first = next(i for i, each in enumerate(since) if each.is_stop)
    return {
        "mode": mode,
        "line": stage.kind,
        "ms": (since[first].now_ns - at_ns) / 1e6,
        "drives_after": sum(not each.is_stop for each in since[first:]),
        **gone_ms,
    }


@contextlib.contextmanager
def crowd(mode: str) -> Iterator[None]:
    """Twice as many busy processes as cores, for the mode that is about that."""
    if mode != "crowded":
        yield
        return
    busy = [subprocess.Popen([sys.executable, "-S", "-c", _SPIN]) for _ in range(2 * (os.cpu_count() or 1))]
    try:
        yield
    finally:
        for each in busy:
            each.kill()
            each.wait()


class Guardian(Bench):
    """Every way in which a program can fail to stop its motors, on a serial line and on an I2C bus.

    plain: the robot and its guardian have no privileges, as on a computer that nobody set up for it.
    """

    plain: ClassVar[bool] = False
    name: ClassVar[str] = "guardian"
    about: ClassVar[str] = "from the fault to the stop on the motors' side of the line"
    figures: ClassVar[tuple[Figure, ...]] = (
        Figure("lockup_stop_ms_max", "ms", "<= 150", f"blocked or frozen: {', '.join(LOCKUPS)}"),
        Figure("kill_stop_ms_p99", "ms", "<= 10", f"ended: {', '.join(ENDS)}"),
        Figure("kill_stop_ms_max", "ms", "<= 50", "the same, worst"),
        Figure("drives_after_stop", "", "= 0", "commands between the stop and the next arming"),
    )

    def run(self, ctx: Context) -> None:
        count = 4 if ctx.quick else 200
        with tempfile.TemporaryDirectory() as name, Launcher(plain=self.plain) as launcher, ExitStack() as stack:
            fakes = _punctual()
            stages = [stack.enter_context(Stage(kind, Path(name), launcher).up()) for kind in KINDS]
            for mode in (*LOCKUPS, *ENDS):
                with crowd(mode):
                    for stage in stages:
                        self._mode(ctx, stage, mode, count)
        guardians = ", ".join(sorted(set().union(*(stage.schedulings for stage in stages)))) or "not looked at"
        ctx.note(f"scheduling: fakes' side {fakes}, guardian {guardians}, robot ordinary")
        trips = sum(stage.false_trips for stage in stages)
        ctx.note(f"{trips} times the guardian stopped a robot that was only slow (crowded or shared cores)")
        self._figures(ctx)

    def _mode(self, ctx: Context, stage: Stage, mode: str, count: int) -> None:
        rng = random.Random(f"{mode} {stage.kind}")
        for i in ctx.each(range(count), f"{mode} {stage.kind}"):
            key = f"{mode} {stage.kind} {i}"
            if ctx.saved(key) is None:
                ctx.row(one_run(stage, mode, rng), key=key)

    def _figures(self, ctx: Context) -> None:
        lockups = [row["ms"] for row in ctx.rows.all if row["mode"] in LOCKUPS]
        ends = [row["ms"] for row in ctx.rows.all if row["mode"] in ENDS]
        ctx.figure("lockup_stop_ms_max", max(lockups), runs=len(lockups))
        killed = [row for row in ctx.rows.all if row["mode"] == "sigkill"]
        gone = [row["gone_ms"] for row in killed]
        behind = [row["ms"] - row["gone_ms"] for row in killed]
        ctx.figure(
            "kill_stop_ms_p99",
            float(np.percentile(ends, 99)),
            baseline=float(np.percentile([row.get("gone_ms", 0.0) for row in ctx.rows.all if row["mode"] in ENDS], 99)),
            runs=len(ends),
        )
        ctx.note(
            f"sigkill: the kernel closes a killed robot's sockets after p50/p99 {np.median(gone):.1f}/"
            f"{np.percentile(gone, 99):.1f} ms, before which nobody can know (the baseline: these among all ends); the "
            f"stop comes {np.median(behind):.1f}/{np.percentile(behind, 99):.1f} ms behind that"
        )
        ctx.figure("kill_stop_ms_max", max(ends), runs=len(ends))
        ctx.figure("drives_after_stop", sum(row["drives_after"] for row in ctx.rows.all), runs=len(ctx.rows.all))
        for mode in (*LOCKUPS, *ENDS):
            for kind in KINDS:
                ms = [row["ms"] for row in ctx.rows.all if (row["mode"], row["line"]) == (mode, kind)]
                ctx.note(
                    f"{mode} {kind}: p50 {np.median(ms):.1f}, p99 {np.percentile(ms, 99):.1f}, max {max(ms):.1f} ms"
                )

    def plot(self, axes: Any, rows: Sequence[Mapping[str, Any]]) -> None:
        names = [f"{mode} {kind}" for mode in (*LOCKUPS, *ENDS) for kind in KINDS]
        axes.boxplot(
            [[row["ms"] for row in rows if f"{row['mode']} {row['line']}" == name] for name in names],
            orientation="horizontal",
            tick_labels=names,
        )
        axes.set_xlabel("ms from the fault to the stop")


def _punctual() -> str:
    """Let the measuring side look in time, where that is permitted; says so."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(2))
    except (OSError, AttributeError):
        return "ordinary"
    return "SCHED_FIFO 2"


BENCH = Guardian()
