"""A real outside distribution: installed beside robotd, found, type-checked, tested, and run in the simulator."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

SOURCE = Path(__file__).parent / "robotd_wander"


@dataclass(frozen=True)
class Outside:
    """The distribution's own folder, and the place where pip installed it; no other test sees either."""

    project: Path
    site: Path

    def run(self, *command: str, timeout_s: float = 120.0) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", *command],
            cwd=self.project,
            env=os.environ | {"PYTHONPATH": str(self.site)},
            capture_output=True,
            text=True,
            timeout=timeout_s,
            check=False,
        )


@pytest.fixture(scope="module")
def outside(tmp_path_factory: pytest.TempPathFactory) -> Outside:
    folder = tmp_path_factory.mktemp("outside")
    ignore = shutil.ignore_patterns("__pycache__", "*.egg-info", ".*")
    made = Outside(Path(shutil.copytree(SOURCE, folder / "robotd_wander", ignore=ignore)), folder / "site")
    pip = ["pip", "--disable-pip-version-check", "install", "-q", "--no-deps", "--no-build-isolation"]
    done = made.run(*pip, "--target", str(made.site), ".")
    assert done.returncode == 0, done.stdout + done.stderr
    return made


def test_its_own_tests_pass(outside: Outside) -> None:
    done = outside.run("pytest", "-q")
    assert done.returncode == 0, done.stdout + done.stderr


def test_it_is_typed_from_outside(outside: Outside) -> None:
    done = outside.run("mypy", "src", "tests")
    assert done.returncode == 0, done.stdout


def test_a_mistake_in_it_is_a_type_error(outside: Outside, tmp_path: Path) -> None:
    wrong = (outside.project / "src" / "robotd_wander" / "wander.py").read_text().replace("seen.bumper", "seen.bumpr")
    (tmp_path / "wander.py").write_text(wrong)
    done = outside.run("mypy", "--strict", str(tmp_path / "wander.py"))
    assert done.returncode == 1
    assert '"Sees" has no attribute "bumpr"' in done.stdout


def test_it_is_listed_beside_the_built_in_plugins(outside: Outside) -> None:
    done = outside.run("robotd.cli", "plugins")
    assert done.returncode == 0, done.stderr
    rows = {line.split()[0]: line.split()[1:] for line in done.stdout.splitlines()}
    for name in ("wander", "bumper", "timed_bumper"):
        assert rows[name][1:] == ["robotd-wander", "0.1.0"]
    assert rows["jetbot_route"][1] == "robotd"


def test_its_robot_is_good(outside: Outside) -> None:
    for extra in ([], ["--sim"]):
        done = outside.run("robotd.cli", "check", "robot.yaml", *extra)
        assert done.returncode == 0, done.stdout + done.stderr


def test_its_parameters_are_checked_like_the_built_in_ones(outside: Outside) -> None:
    wrong = (outside.project / "robot.yaml").read_text().replace("cruise_mps: 0.3", "cruise_mqs: 0.3")
    (outside.project / "wrong.yaml").write_text(wrong)
    done = outside.run("robotd.cli", "check", "wrong.yaml")
    assert done.returncode == 78
    assert "behaviours.wander.cruise_mqs" in done.stderr
    assert "cruise_mps" in done.stderr


def test_it_drives_in_the_simulator(outside: Outside) -> None:
    """Five seconds: it drives, is pressed after three, backs off, turns, drives on."""
    command = ["--config", "robot.yaml", "--sim", "--headless", "--duration", "5", "--speed", "max"]
    done = outside.run("robotd.cli", *command, "--record", "run.mcap")
    assert done.returncode == 0, done.stdout + done.stderr
    again = outside.run("robotd.cli", "replay", "run.mcap", "--assert")
    assert again.returncode == 0, again.stdout + again.stderr
