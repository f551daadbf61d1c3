"""The wheel holds the three packages with their types and data, and a program installed from it finds them."""

from __future__ import annotations

import configparser
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "wheel", "-q", "--no-deps"]
    done = subprocess.run(
        [*pip, "--no-build-isolation", "-w", str(folder), str(ROOT)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    (built,) = folder.glob("robotd-*.whl")
    return built


@pytest.fixture(scope="module")
def names(wheel: Path) -> set[str]:
    return set(zipfile.ZipFile(wheel).namelist())


def test_configs_and_maps_are_inside(names: set[str]) -> None:
    for shelf in ("configs", "maps"):
        shipped = {f"robotd/_data/{shelf}/{file.name}" for file in (ROOT / shelf).glob("*.yaml")}
        assert shipped, shelf
        assert shipped <= names


def test_types_and_templates_are_inside_and_tests_are_not(names: set[str]) -> None:
    assert {f"{package}/py.typed" for package in ("robotd", "robotd_plugins", "robotd_devices")} <= names
    assert "robotd/setup/templates/every/pyproject.toml.template" in names
    tops = {name.split("/")[0] for name in names}
    assert {top for top in tops if not top.endswith(".dist-info")} == {"robotd", "robotd_plugins", "robotd_devices"}


def test_every_entry_point_names_something_inside(wheel: Path, names: set[str]) -> None:
    archive = zipfile.ZipFile(wheel)
    (listed,) = (name for name in names if name.endswith(".dist-info/entry_points.txt"))
    parser = configparser.ConfigParser()
    parser.read_string(archive.read(listed).decode())
    targets = [value for section in parser.sections() for _, value in parser.items(section)]
    assert len(targets) > 5
    for target in targets:
        module, _, attribute = target.partition(":")
        path = module.replace(".", "/")
        (file,) = {f"{path}.py", f"{path}/__init__.py"} & names
        assert attribute in archive.read(file).decode(), target


def test_a_shipped_config_is_found_without_the_checkout(wheel: Path, tmp_path: Path) -> None:
    site = tmp_path / "site"
    zipfile.ZipFile(wheel).extractall(site)
    code = (
        "import robotd; from robotd.setup.resources import find_config as f; print(robotd.__file__, f('jetbot.yaml'))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(site)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert all(Path(found).is_relative_to(site) for found in done.stdout.split())
