"""docs/write-a-plugin.md is true: word for word it gives the distribution of tests/third_party, and that runs."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FINISHED = ROOT / "tests" / "third_party" / "robotd_wander"
PAGE = ROOT / "docs" / "write-a-plugin.md"

# the reader installs into an environment of her own; here it must not touch the one that runs the tests
PRELUDE = """\
set -eu
pip() { "$PYTHON" -m pip --disable-pip-version-check install -q --no-deps --no-build-isolation \
    --upgrade --target "$SITE" . 2>&1; }
"""


@dataclass(frozen=True)
class Block:
    """One fenced block. `file`: where it belongs, from its first line; empty for commands."""

    language: str
    file: str
    text: str


def blocks() -> list[Block]:
    found = []
    for language, text in re.findall(r"^```(\w+)\n(.*?)^```$", PAGE.read_text(), flags=re.MULTILINE | re.DOTALL):
        first, _, rest = text.partition("\n")
        found.append(Block(language, "", text) if language == "sh" else Block(language, first.removeprefix("# "), rest))
    return found


def files() -> dict[str, str]:
    """Whole files by path; the pieces of one file are two blank lines apart."""
    whole: dict[str, list[str]] = {}
    for block in blocks():
        if block.language != "sh":
            whole.setdefault(block.file, []).append(block.text)
    return {name: "\n\n".join(pieces) for name, pieces in whole.items()}


@pytest.mark.parametrize("name", [name for name in files() if name != "pyproject.toml"])
def test_the_page_shows_the_finished_files(name: str) -> None:
    assert files()[name] == (FINISHED / name).read_text()


def test_the_page_shows_the_finished_entry_points() -> None:
    finished = tomllib.loads((FINISHED / "pyproject.toml").read_text())["project"]["entry-points"]
    assert tomllib.loads(files()["pyproject.toml"])["project"]["entry-points"] == finished


def test_following_the_page_works(tmp_path: Path) -> None:
    """Commands are run and files written in the order of the page."""
    site, place = tmp_path / "site", tmp_path
    written = files()
    env = os.environ | {
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "PYTHON": sys.executable,
        "SITE": str(site),
        "PYTHONPATH": os.pathsep.join((str(tmp_path / "robotd_wander" / "src"), str(site))),
    }
    env.pop("PYTEST_ADDOPTS", None)
    ran = 0
    for block in blocks():
        if block.language == "sh":
            done = subprocess.run(
                ["bash", "-c", f"{PRELUDE}{block.text}pwd >'{tmp_path}/where'"],
                cwd=place,
                env=env,
                capture_output=True,
                text=True,
                timeout=180,
                check=False,
            )
            assert done.returncode == 0, f"{block.text}\n{done.stdout}\n{done.stderr}"
            place = Path((tmp_path / "where").read_text().strip())
            ran += 1
        elif block.file == "pyproject.toml":
            project = (place / block.file).read_text()
            old = re.compile(r'\[project\.entry-points\."robotd\.behaviours"\]\n.*\n')
            assert old.search(project)
            (place / block.file).write_text(old.sub(block.text, project))
        else:
            (place / block.file).write_text(written[block.file])
    assert ran == 3
    assert place.name == "robotd_wander"
