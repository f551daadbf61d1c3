"""scripts/robotd and its set-up, with stand-ins for Python: what it looks for, what it says, what it does only once."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import textwrap
import time
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

PYTHON = """\
#!/bin/bash
# A stand-in for Python {version}; it answers the questions that the set-up asks, and writes down what it was told.
here=$(dirname "$0")
case "$*" in
    *"sys.version_info[:2] <="*) exit {unsuitable} ;;
    *"import ensurepip"*) [ -z "{no_venv}" ] || [ -e "$TOLD.apt" ] ;;
    *'"%d.%d"'*) echo {version} ;;
    *fcntl*) exec {real} "$@" ;;
    -V) echo "Python {version}" ;;
    "-c import pip") exit 0 ;;
    "-m venv --clear "*)
        echo "venv {version}" >>"$TOLD"
        rm -rf "$4"
        mkdir -p "$4/bin"
        cp "$0" "$4/bin/python"
        printf '#!/bin/bash\\necho "robotd got: $*"\\n' >"$4/bin/robotd"
        for tool in ruff mypy lint-imports pytest; do
            printf '#!/bin/bash\\necho "%s $*" >>"$TOLD"; [ "$FAILS" != %s ]\\n' $tool $tool >"$4/bin/$tool"
        done
        chmod +x "$4"/bin/*
        ;;
    "-m pip "*)
        echo "pip ${{@: -1}}" >>"$TOLD"
        sleep ${{PIP_TAKES:-0}}
        exit ${{PIP_EXITS:-0}}
        ;;
esac
"""


@dataclass(frozen=True)
class Bare:
    """A copy of the scripts in a folder of its own, on a machine whose only Pythons are the stand-ins."""

    folder: Path

    @property
    def told(self) -> list[str]:
        file = self.folder / "told"
        return file.read_text().splitlines() if file.exists() else []

    def python(self, name: str, version: str, *, suits: bool = True, venv: bool = True) -> None:
        file = self.folder / "bin" / name
        text = PYTHON.format(
            version=version, unsuitable=int(not suits), no_venv="" if venv else "yes", real=sys.executable
        )
        file.write_text(textwrap.dedent(text))
        file.chmod(0o755)

    def program(self, name: str, body: str) -> None:
        file = self.folder / "bin" / name
        file.write_text(f"#!/bin/bash\n{body}\n")
        file.chmod(0o755)

    def start(self, *args: str, script: str = "robotd", **env: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [self.folder / "scripts" / script, *args],
            env={"PATH": str(self.folder / "bin"), "TOLD": str(self.folder / "told"), **env},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def run(self, *args: str, script: str = "robotd", **env: str) -> tuple[int, str, str]:
        process = self.start(*args, script=script, **env)
        out, err = process.communicate(timeout=30)
        return process.returncode, out, err


@pytest.fixture
def bare(tmp_path: Path) -> Bare:
    folder = tmp_path / "robot"
    shutil.copytree(ROOT / "scripts", folder / "scripts", ignore=shutil.ignore_patterns("__pycache__"))
    (folder / "pyproject.toml").write_text("[project]\n")
    (folder / "constraints.txt").write_text("numpy==2.0\n")
    (folder / "bin").mkdir()
    # what any Debian has; apt-get and id are left out, so that no test can install anything
    for tool in ("bash", "dirname", "cat", "cksum", "rm", "mkdir", "cp", "chmod", "sleep", "env"):
        found = shutil.which(tool)
        assert found is not None, tool
        (folder / "bin" / tool).symlink_to(found)
    made = Bare(folder)
    made.program("id", "echo 1000")
    return made


INSTALLED = ["venv 3.12", "pip hatchling", "pip ."]


def test_first_use_sets_up_and_later_uses_only_start(bare: Bare) -> None:
    bare.python("python3.12", "3.12")
    code, out, err = bare.run("--config", "my robot.yaml", "--sim")
    assert (code, out) == (0, "robotd got: --config my robot.yaml --sim\n")
    assert "making .venv with Python 3.12" in err
    assert bare.told == INSTALLED
    assert bare.run("--version") == (0, "robotd got: --version\n", "")
    assert bare.told == INSTALLED


def test_a_later_start_costs_next_to_nothing(bare: Bare) -> None:
    bare.python("python3.12", "3.12")
    bare.run()
    took = []
    for _ in range(7):
        began = time.perf_counter()
        bare.run()
        took.append(time.perf_counter() - began)
    assert min(took) < 0.05, took


@pytest.mark.parametrize("changed", ["pyproject.toml", "constraints.txt"])
def test_new_requirements_are_installed_into_the_same_environment(bare: Bare, changed: str) -> None:
    bare.python("python3.12", "3.12")
    bare.run()
    with (bare.folder / changed).open("a") as file:
        file.write("# changed\n")
    assert bare.run()[0] == 0
    assert bare.told == [*INSTALLED, "pip hatchling", "pip ."]


def test_the_newest_suitable_python_is_taken(bare: Bare) -> None:
    bare.python("python3", "3.9", suits=False)
    bare.python("python3.11", "3.11")
    bare.python("python3.12", "3.12")
    bare.python("python3.13", "3.13", suits=False)
    bare.run()
    assert bare.told[0] == "venv 3.12"


def test_one_without_the_venv_module_is_passed_over(bare: Bare) -> None:
    bare.python("python3.13", "3.13", venv=False)
    bare.python("python3.11", "3.11")
    bare.run()
    assert bare.told[0] == "venv 3.11"


def test_a_missing_venv_module_is_named_by_its_package(bare: Bare) -> None:
    bare.python("python3", "3.11", venv=False)
    code, _, err = bare.run()
    assert code == 69
    assert "sudo apt-get install python3.11-venv" in err
    assert bare.told == []


def test_root_gets_the_missing_venv_module_installed(bare: Bare) -> None:
    bare.python("python3", "3.11", venv=False)
    bare.program("id", "echo 0")
    bare.program("apt-get", 'echo "apt-get $1 ${@: -1}" >>"$TOLD"; [ "$1" = update ] || : >"$TOLD.apt"')
    code, out, err = bare.run()
    assert (code, out) == (0, "robotd got: \n")
    assert "lacks the venv module; installing python3.11-venv" in err
    assert bare.told[:2] == ["apt-get update -q", "apt-get install python3.11-venv"]


def test_a_package_that_cannot_be_had_is_said(bare: Bare) -> None:
    bare.python("python3", "3.11", venv=False)
    bare.program("id", "echo 0")
    bare.program("apt-get", "exit 100")
    code, _, err = bare.run()
    assert code == 69
    assert "python3.11-venv could not be installed" in err


def test_no_suitable_python_is_said(bare: Bare) -> None:
    bare.python("python3", "3.9", suits=False)
    code, _, err = bare.run()
    assert code == 69
    assert "needs Python 3.11, 3.12 or 3.13" in err


def test_a_wrong_wish_is_said(bare: Bare) -> None:
    bare.python("python3.12", "3.12")
    bare.python("old", "3.8", suits=False)
    code, _, err = bare.run(ROBOTD_PYTHON="old")
    assert code == 69
    assert "ROBOTD_PYTHON=old is not" in err


def test_an_installation_that_failed_is_made_anew(bare: Bare) -> None:
    bare.python("python3.12", "3.12")
    code, out, err = bare.run(PIP_EXITS="1")
    assert (code, out) == (69, "")
    assert "could not be installed" in err
    code, out, err = bare.run()
    assert (code, out) == (0, "robotd got: \n")
    assert "cut off; starting anew" in err
    assert bare.told == ["venv 3.12", "pip hatchling", *INSTALLED]


def test_an_environment_whose_python_is_gone_is_made_anew(bare: Bare) -> None:
    bare.python("python3.12", "3.12")
    bare.run()
    (bare.folder / ".venv" / "bin" / "python").unlink()
    assert bare.run()[0] == 0
    assert bare.told == [*INSTALLED, *INSTALLED]


def test_a_checkout_that_was_moved_gets_a_new_environment(bare: Bare) -> None:
    bare.python("python3.12", "3.12")
    bare.run()
    moved = Bare(bare.folder.rename(bare.folder.with_name("elsewhere")))
    assert moved.run()[0] == 0
    assert moved.told == [*INSTALLED, *INSTALLED]


def test_two_at_once_install_once(bare: Bare) -> None:
    bare.python("python3.12", "3.12")
    both = [bare.start(str(number), PIP_TAKES="0.3") for number in (1, 2)]
    outs = [process.communicate(timeout=30) for process in both]
    assert [out for out, _ in outs] == ["robotd got: 1\n", "robotd got: 2\n"]
    assert bare.told == INSTALLED
    assert sum("waiting for it" in err for _, err in outs) == 1


def test_it_can_be_started_from_anywhere(bare: Bare, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bare.python("python3.12", "3.12")
    monkeypatch.chdir(tmp_path)
    assert bare.run("x")[1] == "robotd got: x\n"
    assert os.listdir(tmp_path) == ["robot"]


STAGES = ["ruff check .", "ruff format --check .", "mypy ", "lint-imports "]


def test_every_check_is_run_and_arguments_go_to_pytest(bare: Bare) -> None:
    bare.python("python3.12", "3.12")
    code, out, _ = bare.run("-k", "arbiter", script="test")
    assert code == 0
    assert out.endswith("all checks passed\n")
    assert bare.told == [*INSTALLED[:2], "pip .[dev]", *STAGES, "pytest -k arbiter"]
    bare.run("x")
    assert "pip ." not in bare.told  # what serves the tests serves robotd


@pytest.mark.parametrize("stage", ["ruff", "mypy", "lint-imports", "pytest"])
def test_one_check_that_fails_fails_all_but_hides_none(bare: Bare, stage: str) -> None:
    bare.python("python3.12", "3.12")
    code, out, _ = bare.run(script="test", FAILS=stage)
    assert code == 1
    assert "all checks passed" not in out
    assert stage in out.splitlines()[-1]
    assert bare.told[-5:] == [*STAGES, "pytest "]
