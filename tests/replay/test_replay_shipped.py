"""Every shipped robot, simulated and recorded, comes out again through the command line, and at any pace."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest
from small_robot import S

from robotd import cli
from robotd.engine.loops import virtual_loop
from robotd.engine.runtime import Runtime
from robotd.setup.load import load_config
from robotd.setup.recording import open_journal
from robotd.setup.resources import shipped


def drive(name: str, path: Path, duration_s: float, pace: float | None = None) -> None:
    loaded = load_config(name, sim=True)
    journal = open_journal(path, loaded)
    runtime = Runtime(loaded.parts, journal=journal, virtual=True)

    def started(running: Runtime) -> None:
        loop: Any = asyncio.get_running_loop()
        loop.call_at_ns(round(duration_s * S), running.stop)

    with asyncio.Runner(loop_factory=lambda: virtual_loop(pace)) as runner:
        runner.run(runtime.run(started))
    assert journal.close()


@pytest.mark.parametrize("name", shipped("configs"))
def test_a_simulated_run_of_a_shipped_robot_comes_out_again(
    tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    drive(name, tmp_path / "run.mcap", 3.0)
    assert cli.main(["replay", str(tmp_path / "run.mcap"), "--assert"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert int(lines[0].removesuffix(" commands compared")) > 20
    assert lines[1] == "all commands came out again"


def test_a_shipped_robot_gives_the_same_recording_at_any_pace(tmp_path: Path) -> None:
    drive("jetbot.yaml", tmp_path / "fast.mcap", 0.7)
    drive("jetbot.yaml", tmp_path / "real.mcap", 0.7, pace=1.0)
    assert (tmp_path / "fast.mcap").read_bytes() == (tmp_path / "real.mcap").read_bytes()


def test_a_file_that_is_no_recording_is_a_wrong_command_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "run.mcap"
    path.write_text("no recording")
    assert cli.main(["replay", str(path)]) == 64
    assert "robotd replay: " in capsys.readouterr().err
