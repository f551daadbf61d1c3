"""The table of real faults that the drivers must answer: its rows, and the mark by which a test becomes one of them."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import pytest

T = TypeVar("T", bound=Callable[..., Any])


class Row(NamedTuple):
    """One fault. `name`: as the research on devices calls it (section 8); `bound`: from the fault to the answer."""

    name: str
    bound: str


ROWS = {
    1: Row("motor stall (lidar)", "2 rotations or 500 ms; 3 tries"),
    2: Row("bytes stop, port alive", "stale 250 ms, STOP and SCAN 1 s, RESET 3 s, opened anew 6 s"),
    3: Row("partial packet across reads", "0 lost"),
    4: Row("dropped or inserted byte", "3 packet times"),
    5: Row("corrupt byte", "the same packet"),
    6: Row("stale bytes from a previous session at open", "1.2 s"),
    7: Row("health warning or error", "3 s"),
    8: Row("wrong baud", "2.5 s"),
    9: Row("brown-out reset", "2 s"),
    10: Row("USB unplug", "50 ms"),
    11: Row("replug", "1 s after the node is back"),
    12: Row("second process opens the port", "at open"),
    13: Row("point count varies", "always"),
    14: Row("duplicate or merged rotation", "1 scan"),
    15: Row("zero range, quality 0", "always"),
    16: Row("whole scan zero", "0.5 s"),
    17: Row("motor MCU silent", "300 ms"),
    18: Row("stuck wheel, driver over-current", "300 ms"),
    19: Row("output buffer full", "1 tick; given up after 200 ms"),
    20: Row("I2C NACK or stuck bus", "50 ms"),
    21: Row("camera frame torn, JPEG cut short", "the same frame"),
    22: Row("camera repeats a frame", "stale 3 periods, opened anew 2 s"),
    23: Row("clock step", "always"),
    24: Row("event loop stalls over 100 ms", "1 rotation"),
}

TESTS: dict[int, dict[str, tuple[str, ...]]] = {}
"""Number of a row to its tests: file and name, and the faults that it injects. Filled as modules are imported."""


def answers(row: int, *faults: str) -> Callable[[T], T]:
    """Decorator: the test belongs to a row of the table, and runs once for each fault, which it gets as `fault`."""

    def mark(test: T) -> T:
        file = Path(inspect.unwrap(test).__code__.co_filename).name
        TESTS.setdefault(row, {})[f"{file}::{test.__name__}"] = faults
        made: T = pytest.mark.parametrize("fault", faults)(test)
        return made

    return mark
