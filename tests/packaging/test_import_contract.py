"""The import contract catches what it forbids: bad imports planted in a copy of the packages are reported."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SHELVES = ("runtime", "plugins", "devices")

PLANTS = {
    "the core knows no plugin": ("runtime/robotd/world/robot.py", "import robotd_plugins"),
    "the core knows no device": ("runtime/robotd/safety/guard.py", "import robotd_devices.sim"),
    "imports go one way": ("runtime/robotd/world/topics.py", "import robotd.safety.arbiter"),
    "a plugin knows no device": ("plugins/robotd_plugins/toolkit/__init__.py", "import robotd_devices.sim"),
    "a device knows no plugin": ("devices/robotd_devices/ports/ticker.py", "import robotd_plugins.toolkit"),
}


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("house")
    for shelf in SHELVES:
        shutil.copytree(ROOT / shelf, folder / shelf, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", folder)
    return folder


def lint(folder: Path) -> subprocess.CompletedProcess[str]:
    command = Path(sys.executable).with_name("lint-imports")
    path = os.pathsep.join(str(folder / shelf) for shelf in SHELVES)
    return subprocess.run(
        [command, "--no-cache"],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": path, "COLUMNS": "200", "NO_COLOR": "1"},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


def test_the_house_keeps_its_contract(copy: Path) -> None:
    done = lint(copy)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("rule", PLANTS)
def test_a_planted_import_is_caught(copy: Path, rule: str) -> None:
    name, planted = PLANTS[rule]
    file = copy / name
    before = file.read_text()
    # at the end, so that a `from __future__` line stays first
    file.write_text(f"{before}\n{planted}\n")
    try:
        done = lint(copy)
    finally:
        file.write_text(before)
    assert done.returncode == 1, done.stdout + done.stderr
    module = ".".join(Path(name).with_suffix("").parts[1:]).removesuffix(".__init__")
    assert f"{module} -> {planted.split()[1]}" in " ".join(done.stdout.split())
