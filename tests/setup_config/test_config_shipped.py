"""Every shipped config is good, with and without the simulation, and in an editor's eyes too."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from robotd.setup.load import check_file, load_config, parts_from_merged
from robotd.setup.resources import shipped


@pytest.mark.parametrize("sim", [False, True])
@pytest.mark.parametrize("name", shipped("configs"))
def test_it_is_good(name: str, sim: bool) -> None:
    assert [str(problem) for problem in check_file(name, sim=sim)] == []


@pytest.mark.parametrize("name", shipped("configs"))
def test_the_robot_itself_starts_disarmed(name: str) -> None:
    assert not load_config(name).parts.arm_at_start
    assert load_config(name, sim=True).parts.arm_at_start


@pytest.mark.parametrize("sim", [False, True])
@pytest.mark.parametrize("name", shipped("configs"))
def test_a_recording_of_it_makes_the_same_parts(name: str, sim: bool) -> None:
    loaded = load_config(name, sim=sim)
    assert parts_from_merged(json.loads(json.dumps(loaded.merged)), sim) == loaded.parts


@pytest.mark.parametrize("name", shipped("configs"))
def test_checking_it_imports_nothing_heavy(name: str) -> None:
    code = (
        "import sys; from robotd.setup.load import check_file; assert not check_file(sys.argv[1], sim=True); "
        "heavy = 'cv2 onnxruntime networkx scipy aiohttp mcap serial smbus2'.split(); "
        "print([m for m in heavy if m in sys.modules])"
    )
    path = str(Path(shipped("configs")[name]))
    ran = subprocess.run([sys.executable, "-c", code, path], capture_output=True, text=True, timeout=60, check=False)
    assert (ran.stdout.strip(), ran.returncode) == ("[]", 0), ran.stderr
