"""Foreign clients in a folder of their own, beside nothing but numpy and pyserial, and a shim for ptys' modem lines."""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
CACHE = ROOT / ".interop-venv"
REQUIREMENTS = HERE / "requirements.txt"

#: Runs a client of `clients/` with arguments and gives what it printed as JSON; `modem=True` under the shim.
RunClient = Callable[..., Any]


def absent(what: str) -> None:
    """As in tests/conftest.py: a failure where CI=true, a skip with a reason elsewhere."""
    if os.environ.get("CI") == "true":
        pytest.fail(f"{what}; with CI=true that is a failure", pytrace=False)
    pytest.skip(what)


@pytest.fixture(scope="session")
def foreign() -> Path:
    """The folder with the packages of requirements.txt; put there once for each list and Python."""
    key = hashlib.sha256(REQUIREMENTS.read_bytes()).hexdigest()[:12]
    site = CACHE / f"{sys.implementation.cache_tag}-{key}"
    CACHE.mkdir(exist_ok=True)
    with (CACHE / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not site.is_dir():
            part = CACHE / f"{site.name}.part"
            shutil.rmtree(part, ignore_errors=True)
            # without their requirements: numpy and pyserial come from our own environment
            command = [sys.executable, "-m", "pip", "--disable-pip-version-check", "install", "-q", "--no-deps"]
            done = subprocess.run(
                [*command, "--target", str(part), "-r", str(REQUIREMENTS)],
                capture_output=True,
                text=True,
                timeout=120,
                check=False,
            )
            if done.returncode:
                absent(f"foreign clients could not be installed: {done.stderr.strip().splitlines()[-1:]}")
            part.rename(site)
    return site


@pytest.fixture(scope="session")
def modem_shim(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A library that lends a pty the modem lines which it lacks, and logs what is done to them."""
    compiler = shutil.which(sysconfig.get_config_var("CC").split()[0]) or shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        absent("no C compiler for the modem-line shim")
    assert compiler is not None
    library = tmp_path_factory.mktemp("shim") / "modem_lines.so"
    command = [compiler, "-shared", "-fPIC", "-O1", "-o", str(library), str(HERE / "modem_lines.c"), "-ldl"]
    subprocess.run(command, check=True, timeout=60)
    return library


@pytest.fixture
def run_client(foreign: Path, request: pytest.FixtureRequest, tmp_path: Path) -> RunClient:
    def run(name: str, *arguments: object, modem: bool = False) -> Any:
        env = {key: value for key, value in os.environ.items() if key in ("PATH", "HOME", "LANG", "LD_LIBRARY_PATH")}
        env["PYTHONPATH"] = str(foreign)
        if modem:
            env["LD_PRELOAD"] = str(request.getfixturevalue("modem_shim"))
            env["MODEM_LOG"] = str(tmp_path / "modem.log")
        done = subprocess.run(
            [sys.executable, str(HERE / "clients" / name), *map(str, arguments)],
            env=env,
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return json.loads(done.stdout.splitlines()[-1])

    return run
