"""What all tests share: where test data is, and the rule that continuous integration never passes by skipping."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


def absent(what: str) -> None:
    """Something that a test needs is not here: a failure where CI=true, a skip with a reason elsewhere."""
    if os.environ.get("CI") == "true":
        pytest.fail(f"{what}; with CI=true that is a failure", pytrace=False)
    pytest.skip(what)


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder of real test data: ROBOTD_DATA, or shared/data beside the checkout."""
    folder = Path(os.environ.get("ROBOTD_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        absent(f"test data folder {folder.name!r} is absent (set ROBOTD_DATA)")
    return folder


@pytest.fixture(scope="session")
def program() -> object:
    """Finds a program that a test starts, by name."""

    def find(name: str) -> str:
        path = shutil.which(name)
        if path is None:
            absent(f"program {name!r} is not installed")
        assert path is not None
        return path

    return find
