"""The author's API is checked by types: right plugins pass mypy strict, each mistake is an error where it stands."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
_ERROR = re.compile(r"(?P<file>[^:]+):(?P<line>\d+): error: (?P<text>.*)  \[(?P<code>[a-z-]+)\]$")
_WANTED = re.compile(r"# error: (?P<codes>[a-z-]+(, [a-z-]+)*)$")

MISTAKES = {
    "wrong message type in a view": "class WrongTopic",
    "a view without an age": "class NoAge",
    "missing input when a view is built": "Sees(scan=scan)  #",
    "undeclared read": "seen.odometry.vx_mps",
    "wrong result of a step": "class WrongResult",
    "wrong value from a step": "return 0.3  #",
    "a config key that is not there": "self.config.speed_kmh",
}


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, set[tuple[int, str]]]:
    """Errors by file as (line, code), from one run of mypy as an outside author has it: strict, no plugin of mypy's."""
    config = tmp_path_factory.mktemp("mypy") / "mypy.ini"
    config.write_text("[mypy]\nstrict = true\n")
    cache = ROOT / ".mypy_cache" / "snippets"
    command = [sys.executable, "-m", "mypy", "--config-file", str(config), "--cache-dir", str(cache), "snippets"]
    done = subprocess.run(command, cwd=HERE, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode in (0, 1), done.stdout + done.stderr
    errors: dict[str, set[tuple[int, str]]] = {"good.py": set(), "bad.py": set()}
    for line in done.stdout.splitlines():
        if match := _ERROR.match(line):
            errors[Path(match["file"]).name].add((int(match["line"]), match["code"]))
        else:
            assert ": error: " not in line, f"an error without a code: {line}"
    return errors


def test_right_plugins_pass(found: dict[str, set[tuple[int, str]]]) -> None:
    assert found["good.py"] == set()


def test_each_mistake_is_an_error_where_it_stands(found: dict[str, set[tuple[int, str]]]) -> None:
    wanted = {
        (number, code)
        for number, line in enumerate((HERE / "snippets" / "bad.py").read_text().splitlines(), 1)
        if (match := _WANTED.search(line))
        for code in match["codes"].split(", ")
    }
    assert len(wanted) > 25
    assert found["bad.py"] == wanted


@pytest.mark.parametrize("what", MISTAKES)
def test_the_mistakes_that_the_design_names_are_among_them(what: str) -> None:
    lines = (HERE / "snippets" / "bad.py").read_text().splitlines()
    at = [number for number, line in enumerate(lines) if MISTAKES[what] in line]
    assert at, what
    assert any(_WANTED.search(line) for line in lines[at[0] : at[0] + 3]), what
