"""The composition root: how a run begins and ends, who is shown the state, and where a recording goes."""

from __future__ import annotations

import math
import signal
import threading
from dataclasses import replace
from pathlib import Path

import pytest
from small_robot import FakeLidar, behaviour, robot

from robotd import Behaviour, Drive, LidarScan, NoConfig, View, every
from robotd.app import Options, run
from robotd.authoring.device import DeviceUnavailable
from robotd.engine.devices import Unavailable
from robotd.engine.parts import DevicePart, Parts
from robotd.engine.record_reader import read_record
from robotd.engine.status import Status
from robotd.setup.load import Loaded, load_config
from robotd.setup.sections import RecorderSection
from robotd.world.messages import Mode

FAST = Options(sim=True, speed=math.inf, duration_s=1.0)


class Sees(View):
    scan: LidarScan = every(within_s=0.25)


class Go(Behaviour[NoConfig, Sees]):
    def step(self, seen: Sees) -> Drive | None:
        return Drive(0.4)


class Shown:
    """A view that keeps what it is shown."""

    def __init__(self) -> None:
        self.states: list[Status] = []

    def update(self, status: Status) -> None:
        self.states.append(status)


def loaded(parts: Parts, folder: Path | None = None) -> Loaded:
    return Loaded(parts, RecorderSection(folder=folder), "", {}, Path("robot.yaml"), True)


def test_it_runs_for_its_time_and_shows_how_it_ended() -> None:
    shown = Shown()
    assert run(loaded(robot(behaviour(Go))), FAST, shown) == 0
    assert shown.states[-1].now_ns == 1_000_000_000
    assert shown.states[-1].mode is Mode.AUTO and shown.states[-1].by == "go"
    assert shown.states[-1].virtual


@pytest.mark.parametrize(
    ("arm_at_start", "arm", "mode"),
    [(False, False, Mode.DISARMED), (False, True, Mode.AUTO), (True, False, Mode.AUTO), (True, True, Mode.AUTO)],
)
def test_it_is_armed_where_the_file_or_the_command_line_says_so(arm_at_start: bool, arm: bool, mode: Mode) -> None:
    shown = Shown()
    parts = replace(robot(behaviour(Go)), arm_at_start=arm_at_start)
    run(loaded(parts), replace(FAST, arm=arm), shown)
    assert shown.states[-1].mode is mode
    assert (shown.states[-1].reason == "") is (mode is Mode.AUTO)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_it_in_good_order(number: signal.Signals) -> None:
    class Kills(Go):
        def step(self, seen: Sees) -> Drive | None:
            if seen.now_ns == 500_000_000:
                signal.pthread_kill(threading.main_thread().ident or 0, number)
            return super().step(seen)

    shown = Shown()
    before = signal.getsignal(number)
    assert run(loaded(robot(behaviour(Kills))), replace(FAST, duration_s=3600.0), shown) == 0
    assert 500_000_000 <= shown.states[-1].now_ns < 3600 * 10**9
    assert signal.getsignal(number) == before


def test_what_cannot_be_opened_ends_it() -> None:
    class Absent(FakeLidar):
        async def open(self) -> None:
            raise DeviceUnavailable("nothing there")

        async def close(self) -> None:
            pass

    parts = robot(behaviour(Go))
    parts = replace(parts, devices=(parts.devices[0], DevicePart("lidar", Absent, parts.devices[1].config)))
    with pytest.raises(ExceptionGroup) as raised:
        run(loaded(parts), replace(FAST, duration_s=10.0), Shown())
    assert isinstance(raised.value.exceptions[0], Unavailable)


def test_recordings_go_where_the_config_says(tmp_path: Path) -> None:
    jetbot = load_config("jetbot.yaml", sim=True)
    kept = replace(jetbot, recorder=RecorderSection(folder=tmp_path / "runs"))
    assert run(kept, replace(FAST, duration_s=0.5), Shown()) == 0
    (file,) = (tmp_path / "runs").iterdir()
    assert file.name.startswith("jetbot-") and file.suffix == ".mcap"
    recording = read_record(file)
    assert sum(1 for entry in recording if entry.kind == "message") > 10
    assert recording.end.is_complete


def test_a_recording_that_cannot_be_made_is_an_error_before_anything_moves(tmp_path: Path) -> None:
    shown = Shown()
    with pytest.raises(OSError):
        run(loaded(robot(behaviour(Go))), replace(FAST, record=tmp_path / "no" / "such" / "x.mcap"), shown)
    assert not shown.states
