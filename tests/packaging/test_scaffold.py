"""`robotd new`: each kind is installed as a user would, its tests and types pass, and wrong requests are refused."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

from robotd.setup.scaffold import KINDS, ScaffoldError, class_name, contents, new

NAMES = {"behaviour": "wall_turn", "perceptor": "nearest_thing", "device": "volt_meter", "bridge": "event_log"}
GROUPS = {"behaviour": "behaviours", "perceptor": "perception", "device": "devices", "bridge": "bridges"}


@dataclass(frozen=True)
class Written:
    """All four kinds, written and installed into a folder that no other test sees."""

    folder: Path
    site: Path

    def project(self, kind: str) -> Path:
        return self.folder / f"robotd_{NAMES[kind]}"

    def run(self, cwd: Path, *command: str, timeout_s: float = 120.0) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", *command],
            cwd=cwd,
            env=os.environ | {"PYTHONPATH": str(self.site)},
            capture_output=True,
            text=True,
            timeout=timeout_s,
            check=False,
        )


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Written:
    folder = tmp_path_factory.mktemp("authors")
    made = Written(folder, folder / "site")
    projects = [str(new(kind, NAMES[kind], folder)) for kind in KINDS]
    pip = ["pip", "--disable-pip-version-check", "install", "-q", "--no-deps", "--no-build-isolation"]
    done = made.run(folder, *pip, "--target", str(made.site), *projects)
    assert done.returncode == 0, done.stdout + done.stderr
    return made


@pytest.mark.parametrize("kind", KINDS)
def test_its_tests_pass_at_once(written: Written, kind: str) -> None:
    done = written.run(written.project(kind), "pytest", "-q")
    assert done.returncode == 0, done.stdout + done.stderr
    assert " passed" in done.stdout


def test_all_are_typed(written: Written) -> None:
    """One run for all four: mypy spends its time on numpy and pydantic."""
    folders = [str(written.project(kind) / part) for kind in KINDS for part in ("src", "tests")]
    done = written.run(written.folder, "mypy", "--strict", "--cache-dir", str(written.folder / "cache"), *folders)
    assert done.returncode == 0, done.stdout


def test_their_style_is_clean(written: Written) -> None:
    for command in (["check"], ["format", "--check"]):
        done = written.run(written.folder, "ruff", *command, "--no-cache", *(f"robotd_{n}" for n in NAMES.values()))
        assert done.returncode == 0, done.stdout


def test_they_are_found_by_name(written: Written) -> None:
    code = (
        "from importlib.metadata import entry_points\n"
        "for group, name in (line.split() for line in '''{}'''.splitlines()):\n"
        "    (point,) = entry_points(group=group, name=name)\n"
        "    print(point.load().__name__)\n"
    )
    wanted = [(f"robotd.{GROUPS[kind]}", NAMES[kind]) for kind in KINDS] + [("robotd.devices", "sim_volt_meter")]
    done = subprocess.run(
        [sys.executable, "-c", code.format("\n".join(" ".join(pair) for pair in wanted))],
        env=os.environ | {"PYTHONPATH": str(written.site)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == [*map(class_name, NAMES.values()), "SimVoltMeter"]


@pytest.mark.parametrize("kind", KINDS)
def test_its_robot_runs_in_the_simulator(written: Written, kind: str) -> None:
    project = written.project(kind)
    command = ["--config", "robot.yaml", "--sim", "--headless", "--duration", "2", "--speed", "max"]
    for arguments in (["check", "robot.yaml"], command):
        done = written.run(project, "robotd.cli", *arguments)
        assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_written(kind: str) -> None:
    written = {str(path): text for path, text in contents(kind, "my_thing").items()}
    assert set(written) >= {
        "README.md",
        "pyproject.toml",
        "robot.yaml",
        "src/robotd_my_thing/__init__.py",
        "src/robotd_my_thing/py.typed",
        "tests/test_my_thing.py",
    }
    project = tomllib.loads(written["pyproject.toml"])["project"]
    assert project["name"] == "robotd-my-thing"
    assert project["entry-points"][f"robotd.{GROUPS[kind]}"]["my_thing"] == "robotd_my_thing:MyThing"
    assert not [path for path, text in written.items() if "$" in text]


@pytest.mark.parametrize(
    ("kind", "name", "said"),
    [
        ("behavior", "wall_turn", "behaviour, perceptor, device, bridge"),
        ("behaviour", "WallTurn", "lower snake case"),
        ("behaviour", "wall-turn", "lower snake case"),
        ("behaviour", "2nd", "lower snake case"),
        ("behaviour", "wall_", "lower snake case"),
        ("behaviour", "", "lower snake case"),
        ("behaviour", "../wall", "lower snake case"),
        ("behaviour", "wall\n", "lower snake case"),
        ("behaviour", "a" * 31, "at most 30"),
        ("behaviour", "robotd_wall", "leave it out"),
        ("behaviour", "view", "View means something else"),
        ("behaviour", "jetbot_route", "installed already"),
        ("device", "ld19", "installed already"),
        ("bridge", "devices", "robotd_devices is installed already"),
    ],
)
def test_refused_with_the_mend(tmp_path: Path, kind: str, name: str, said: str) -> None:
    with pytest.raises(ScaffoldError, match=said):
        new(kind, name, tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("there", [["a file"], []])
def test_an_existing_folder_is_left_alone(tmp_path: Path, there: Sequence[str]) -> None:
    place = tmp_path / "robotd_wall_turn"
    place.mkdir()
    for name in there:
        (place / name).touch()
    with pytest.raises(ScaffoldError, match="exists already"):
        new("behaviour", "wall_turn", tmp_path)
    assert [file.name for file in place.iterdir()] == list(there)


def test_the_current_folder_is_the_default(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert new("bridge", "my_log") == tmp_path / "robotd_my_log"
