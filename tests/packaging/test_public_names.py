"""What `import robotd` costs and gives: numpy and nothing heavier, at most 30 names, all of them there."""

from __future__ import annotations

import subprocess
import sys

import pytest

import robotd

HEAVY = ("cv2", "onnxruntime", "networkx", "scipy", "aiohttp", "mcap", "serial", "smbus2", "matplotlib", "ruamel.yaml")


def loaded_by(module: str) -> set[str]:
    """Names in `sys.modules` after a fresh Python imported all public names of one module."""
    code = f"from {module} import *; import sys; print(*sys.modules, sep='\\n')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    return set(done.stdout.split())


@pytest.mark.parametrize("module", ["robotd", "robotd.testing"])
def test_importing_the_api_loads_numpy_and_nothing_heavier(module: str) -> None:
    loaded = loaded_by(module)
    assert "numpy" in loaded
    assert not loaded.intersection(HEAVY)
    assert not {name for name in loaded if name.startswith(("robotd_plugins", "robotd_devices"))}


def test_at_most_thirty_names_and_each_is_there() -> None:
    assert len(robotd.__all__) <= 30
    assert list(robotd.__all__) == sorted(robotd.__all__)
    assert all(hasattr(robotd, name) for name in robotd.__all__)
