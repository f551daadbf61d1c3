"""The picture of a run shows what was recorded: where it went, how fast, how near things were, who did what."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import pytest
from recorded import SeesScan, asks, plain, record, rich
from small_robot import OFF, QUICK, ScriptConfig, behaviour

from robotd import Behaviour, Drive, NoConfig, cli
from robotd.authoring.behaviour import StepResult
from robotd.authoring.explain import Explanation, Text
from robotd.engine.codec import decode
from robotd.engine.parts import Parts
from robotd.engine.record_file import read_record
from robotd.engine.replay import known_classes
from robotd.safety.operator import EStop, Start
from robotd.setup.exit_codes import MissingExtra
from robotd.setup.load import load_config
from robotd.setup.plot import Run, Span, draw, gather
from robotd.setup.recording import open_journal


class Circle(Behaviour[NoConfig, SeesScan]):
    """A quarter of a circle of radius 0.5 m in half a turn of the clock, then the other way round."""

    def step(self, seen: SeesScan) -> StepResult:
        return Drive(0.25 * math.pi, 0.5 * math.pi)

    def explain(self) -> Explanation:
        return (Text("state", "CIRCLING"),)


def circling() -> Parts:
    parts = rich(lidar=ScriptConfig(hz=10.0, range_m=2.0))
    return Parts(QUICK, parts.devices[:2], (), (behaviour(Circle),), guard=OFF, arm_at_start=True)


def drawn(path: Path, parts: Parts) -> Run:
    return gather(read_record(path), parts)


def test_speeds_and_distances_are_those_of_the_recording(tmp_path: Path) -> None:
    path, parts = tmp_path / "run.mcap", rich()
    written = record(path, parts, 2.0)
    run = drawn(path, parts)
    assert run.speeds["command vx [m/s]"].values == [a.command.vx_mps for a in written if isinstance(a.command, Drive)]
    assert run.speeds["command wz [rad/s]"].times_s == [a.stamp_ns / 1e9 for a in written]
    classes = known_classes(parts)
    scans = [decode(e.payload, classes) for e in read_record(path) if e.topic == "lidar_scan"]
    nearest = [float(np.nanmin(scan.ranges_m)) for scan in scans]
    assert run.distances["lidar_scan nearest [m]"].values == nearest
    assert run.distances["lidar_scan nearest [m]"].times_s == [scan.stamp_ns / 1e9 for scan in scans]
    assert run.distances["target [m]"].values == nearest, "and of what perceptors made"


def test_without_odometry_the_path_is_reckoned_from_the_commands(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    record(path, circling(), 1.1)
    run = drawn(path, circling())
    assert run.path_from == "reckoned from the commands"
    x_m, y_m = run.path_m[-1]
    # from 0.1 s to 1.1 s: a quarter of a circle to the left, radius 0.5 m
    assert x_m == pytest.approx(0.5, abs=0.01) and y_m == pytest.approx(0.5, abs=0.01)
    radii = [math.hypot(x, y - 0.5) for x, y in run.path_m]
    assert radii == pytest.approx([0.5] * len(radii), abs=0.002)


def test_with_odometry_the_path_is_what_it_says(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    record(path, plain(), 1.0)
    run = drawn(path, plain())
    assert run.path_from == "odometry"
    assert [x for x, _ in run.path_m] == [float(i + 1) for i in range(len(run.path_m))]
    assert len(run.path_m) == len(run.speeds["odometry vx [m/s]"].values) >= 19


def test_states_and_events_stand_where_they_began(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    record(path, circling(), 2.0, asks(0.55, Start("me", "circle")), asks(1.0, EStop("button")))
    run = drawn(path, circling())
    assert run.states["mode"] == [Span("disarmed", 0.0, 0.0), Span("auto", 0.0, 1.0), Span("estop", 1.0, 2.0)]
    circle = run.states["circle"]
    assert circle[-1] == Span("CIRCLING", 0.6, 1.0)
    assert run.states["drives"][0] == Span("circle", 0.1, 0.55)
    assert run.events == [(0.55, "circle CANCELLED"), (1.0, "circle CANCELLED"), (1.0, "EStopped")]
    assert run.end_s == pytest.approx(2.0, abs=0.02)


def test_a_cut_recording_is_drawn_up_to_its_end(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    record(path, plain(), 3.5)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    run = drawn(path, plain())
    assert "drawn up to the first gap: the file ends too early" in run.title
    assert 0.5 < run.end_s < 3.0


@pytest.mark.parametrize("suffix", ["png", "svg"])
def test_the_picture_is_written(tmp_path: Path, suffix: str) -> None:
    path, out = tmp_path / "run.mcap", tmp_path / f"run.{suffix}"
    record(path, rich(), 1.0, asks(0.5, EStop("button")))
    draw(drawn(path, rich()), out)
    data = out.read_bytes()
    assert data.startswith(b"\x89PNG" if suffix == "png" else b"<?xml")
    assert len(data) > 10_000


def test_an_empty_run_is_drawn_too(tmp_path: Path) -> None:
    draw(Run("nothing"), tmp_path / "run.png")
    assert (tmp_path / "run.png").stat().st_size > 1000
    with pytest.raises(ValueError, match=r"cannot draw \.gif, only \.png, \.svg, \.pdf"):
        draw(Run("nothing"), tmp_path / "run.gif")


def recorded_jetbot(path: Path) -> None:
    loaded = load_config("jetbot.yaml", sim=True)
    journal = open_journal(path, loaded)
    journal.note("started", "", 0, None)
    journal.note("tick", "", 20_000_000, None)
    assert journal.close()


@pytest.mark.parametrize(
    ("argv", "code", "words"),
    [
        ("plot {file}", 0, "wrote {stem}.png"),
        ("plot {file} -o {stem}.svg", 0, "wrote {stem}.svg"),
        ("plot {file} -o {stem}.gif", 64, "expected a name that ends in .png, .svg, .pdf"),
        ("plot {stem}.txt", 64, "there is no file"),
    ],
)
def test_the_command(tmp_path: Path, argv: str, code: int, words: str, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "run.mcap"
    recorded_jetbot(file)
    names = {"file": str(file), "stem": str(tmp_path / "run")}
    assert cli.main(argv.format(**names).split()) == code
    out, err = capsys.readouterr()
    assert words.format(**names) in out + err


def test_without_matplotlib_it_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    recorded_jetbot(tmp_path / "run.mcap")
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    assert cli.main(["plot", str(tmp_path / "run.mcap")]) == 69
    assert "pip install 'robotd[plot]'" in capsys.readouterr().err
    with pytest.raises(MissingExtra):
        draw(Run("nothing"), tmp_path / "run.png")
