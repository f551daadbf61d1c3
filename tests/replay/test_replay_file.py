"""A recording carries its robot: the config in its header makes the parts again, or says what is missing here."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest
from small_robot import S

from robotd.engine.codec import RecordError
from robotd.engine.loops import virtual_loop
from robotd.engine.record_file import RecordWriter, read_record
from robotd.engine.runtime import Runtime
from robotd.setup.load import Loaded, load_config
from robotd.setup.problems import ConfigError
from robotd.setup.recording import open_journal, recorded_parts, replay_file
from robotd.setup.registry import Registry

POINTS = (
    EntryPoint("fake_base", "small_robot:FakeBase", "robotd.devices"),
    EntryPoint("noisy_lidar", "recorded:NoisyLidar", "robotd.devices"),
    EntryPoint("nearest", "recorded:Nearest", "robotd.perception"),
    EntryPoint("follow", "recorded:Follow", "robotd.behaviours"),
    EntryPoint("post", "recorded:Post", "robotd.bridges"),
)
REGISTRY = Registry(POINTS)
CONFIG = """
robot:
  name: small
  kinematics: {type: differential, track_m: 0.2}
  footprint_m: [[0.1, 0.1], [-0.1, 0.1], [-0.1, -0.1], [0.1, -0.1]]
devices:
  base: {use: fake_base}
  lidar: {use: noisy_lidar, range_m: 1.2}
perception:
  nearest:
behaviours:
  follow: {priority: 10, start: true, gain: 0.3, late_gain: 0.3}
guard: {zones: {off: a test}}
operator: {arm_at_start: true}
"""


def load(tmp_path: Path, text: str = CONFIG, sets: tuple[str, ...] = (), env: dict[str, str] | None = None) -> Loaded:
    file = tmp_path / "small.yaml"
    file.write_text(text)
    return load_config(file, sets=sets, env=env, registry=REGISTRY)


def drive(loaded: Loaded, path: Path, duration_s: float = 1.0, registry: Registry = REGISTRY) -> Path:
    """Run a config in virtual time, recorded as the app does it."""
    journal = open_journal(path, loaded, start_ns=0, registry=registry)
    runtime = Runtime(loaded.parts, journal=journal, virtual=True)

    def started(running: Runtime) -> None:
        loop: Any = asyncio.get_running_loop()
        loop.call_at_ns(round(duration_s * S), running.stop)

    with asyncio.Runner(loop_factory=virtual_loop) as runner:
        runner.run(runtime.run(started))
    assert journal.close()
    return path


def with_header(path: Path, **changed: Any) -> Path:
    """The same entries under other words in the header."""
    recording = read_record(path)
    copy = path.with_name("other.mcap")
    writer = RecordWriter(copy, {**recording.header, **changed}, synchronous=True)
    for entry in recording:
        writer.write(entry.kind, entry.sequence, entry.now_ns, entry.payload, entry.topic)
    assert writer.close()
    return copy


def test_the_header_makes_the_robot_again_with_all_layers(tmp_path: Path) -> None:
    loaded = load(tmp_path, sets=("behaviours.follow.gain=0.7",), env={"ROBOTD__ACT_HZ": "40", "HOME": "/x"})
    path = drive(loaded, tmp_path / "run.mcap")
    recording = read_record(path)
    header = recording.header
    assert header["config_file"] == "small.yaml"
    assert header["config_text"] == CONFIG
    assert (header["sets"], header["env"], header["sim"]) == (
        ["behaviours.follow.gain=0.7"],
        {"ROBOTD__ACT_HZ": "40"},
        False,
    )
    assert "started" in header
    parts = recorded_parts(recording, REGISTRY)
    assert parts == loaded.parts
    report = replay_file(path, registry=REGISTRY)
    assert report.first_difference is None
    assert report.compared > 8


def test_a_gain_changed_in_the_header_is_found(tmp_path: Path) -> None:
    path = drive(load(tmp_path), tmp_path / "run.mcap", 3.5)
    config = read_record(path).header["config"]
    config["behaviours"]["follow"]["late_gain"] = 0.31
    report = replay_file(with_header(path, config=config), registry=REGISTRY)
    assert report.first_difference is not None
    assert report.first_difference.time_s >= 3.0
    assert "by follow" in str(report.first_difference)


def test_frames_are_kept_where_the_config_says_so(tmp_path: Path) -> None:
    for frames in ("none", "lossless"):
        loaded = load(tmp_path, f"{CONFIG}recorder: {{frames: {frames}}}\n")
        path = drive(loaded, tmp_path / "run.mcap", 0.2)
        assert read_record(path).header["frames"] is (frames == "lossless")


# ------------------------------------------------------------------------------------------- refusals


def test_a_missing_plugin_is_named_with_what_to_install(tmp_path: Path) -> None:
    path = drive(load(tmp_path), tmp_path / "run.mcap", 0.2)
    plugins = read_record(path).header["plugins"]
    assert sorted(plugins) == ["behaviours.follow", "devices.fake_base", "devices.noisy_lidar", "perception.nearest"]
    plugins["behaviours.follow"] = ["robotd-follow", "1.2.0"]
    path = with_header(path, plugins=plugins)
    without = Registry([point for point in POINTS if point.name != "follow"])
    with pytest.raises(
        RecordError, match=r"'follow' of behaviours, which is not installed: install robotd-follow 1\.2"
    ):
        replay_file(path, registry=without)
    notes = replay_file(path, registry=REGISTRY).notes
    assert any(note.startswith("behaviours.follow: recorded with robotd-follow 1.2.0, replayed") for note in notes)


def test_a_config_that_no_longer_makes_a_robot_says_where(tmp_path: Path) -> None:
    path = drive(load(tmp_path), tmp_path / "run.mcap", 0.2)
    config = read_record(path).header["config"]
    config["behaviours"]["follow"]["gian"] = 0.31
    with pytest.raises(ConfigError, match=r"behaviours\.follow\.gian"):
        replay_file(with_header(path, config=config), registry=REGISTRY)
    with pytest.raises(RecordError, match="holds no config"):
        replay_file(with_header(path, config=None), registry=REGISTRY)


def test_equal_bits_are_asked_for_only_where_they_can_be(tmp_path: Path) -> None:
    path = drive(load(tmp_path), tmp_path / "run.mcap", 0.5)
    assert replay_file(path, demand=True, registry=REGISTRY).first_difference is None
    other = with_header(path, numpy="0.1")
    with pytest.raises(RecordError, match=r"made with numpy 0\.1, .*--tolerance"):
        replay_file(other, demand=True, registry=REGISTRY)
    assert any("numpy 0.1" in note for note in replay_file(other, registry=REGISTRY).notes)
    assert replay_file(other, demand=True, tolerance=1e-9, registry=REGISTRY).first_difference is None


def test_bridges_take_no_part_and_their_passwords_stay_at_home(tmp_path: Path) -> None:
    text = CONFIG + "bridges:\n  post: {host: broker, password: swordfish}\n"
    env = {"ROBOTD__BRIDGES__POST__HOST": "b", "ROBOTD__BRIDGES__POST__PASSWORD": "joshua"}
    loaded = load(tmp_path, text, sets=("bridges.post.password=open sesame",), env=env)
    loaded = replace(loaded, parts=replace(loaded.parts, bridges=()))
    path = drive(loaded, tmp_path / "run.mcap", 0.2)
    header = read_record(path).header
    assert header["config"]["bridges"]["post"] == {"host": "b", "password": "***"}
    assert header["sets"] == ["bridges.post.password=***"]
    assert header["env"] == {"ROBOTD__BRIDGES__POST__HOST": "b", "ROBOTD__BRIDGES__POST__PASSWORD": "***"}
    assert header["config_text"] == text.replace("swordfish", "***")
    without = Registry([point for point in POINTS if point.name != "post"])
    assert replay_file(path, registry=without).first_difference is None


def test_a_file_that_changed_since_is_said(tmp_path: Path) -> None:
    loaded = load(tmp_path)
    room = tmp_path / "room.yaml"
    room.write_text("one")
    loaded = replace(loaded, merged={**loaded.merged, "simulation": {"map": str(room)}})
    journal = open_journal(tmp_path / "run.mcap", loaded, registry=REGISTRY)
    assert journal.close()
    drive(load(tmp_path), tmp_path / "good.mcap", 0.2)
    path = with_header(tmp_path / "good.mcap", files=read_record(tmp_path / "run.mcap").header["files"])
    assert not [note for note in replay_file(path, registry=REGISTRY).notes if "room" in note]
    room.write_text("another")
    assert f"{room} is not what it was when the run was recorded" in replay_file(path, registry=REGISTRY).notes
