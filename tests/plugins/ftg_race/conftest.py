"""Puts `scripts/` on the path, so that the closed loops of the benches can be driven in tests."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

SCRIPTS = str(Path(__file__).resolve().parents[3] / "scripts")


@pytest.fixture(scope="session", autouse=True)
def benches() -> Iterator[None]:
    """As the benches themselves have it."""
    sys.path.insert(0, SCRIPTS)
    yield
    sys.path.remove(SCRIPTS)
