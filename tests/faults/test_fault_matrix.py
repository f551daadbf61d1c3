"""The table of faults is whole: each row has a test, each fault that a fake can be given a row, and each row a fake."""

from __future__ import annotations

import importlib.util
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import ModuleType

import pytest
from fault_matrix import ROWS, TESTS
from mjpeg_server import MjpegServer

from robotd.testing import virtual_time
from robotd_devices.camera.capture_fake import CaptureFake
from robotd_devices.lidar.rplidar_fake import RplidarFake
from robotd_devices.lidar.ydlidar_fake import YdlidarFake
from robotd_devices.motor.mc_fake import McFake
from robotd_devices.motor.rosmaster_fake import RosmasterFake
from robotd_devices.motor.vesc_fake import VescFake
from robotd_devices.ports.breakable import CATALOGUE, Breakable
from robotd_devices.ports.i2c_fake import BUS_FAULTS
from robotd_devices.ports.memory_host import MemoryHost

HERE = Path(__file__).parent


def load(path: Path) -> ModuleType:
    """A module of tests, so that its marks count also where this module alone is run."""
    spec = importlib.util.spec_from_file_location(f"matrix_{path.stem}", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


MODULES = [load(path) for path in sorted(HERE.glob("test_faults_*.py"))]
MAKE: list[Callable[[], Breakable]] = [
    RplidarFake,
    YdlidarFake,
    McFake,
    RosmasterFake,
    VescFake,
    partial(MemoryHost, RosmasterFake(), 115_200),
    CaptureFake,
    MjpegServer,
]
OF_TESTS = [
    thing
    for module in MODULES
    for thing in vars(module).values()
    if isinstance(thing, type) and issubclass(thing, Breakable) and thing.__module__ == module.__name__
]
FAKES = [*(type(make()) for make in MAKE), *OF_TESTS]
CAN_BE_GIVEN = {fault for fake in FAKES for fault in fake.breaks} | set(BUS_FAULTS)
INJECTED = {fault for tests in TESTS.values() for faults in tests.values() for fault in faults}
PAGE = (HERE.parents[1] / "docs" / "faults.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("number", ROWS)
def test_each_row_has_a_test_that_injects_it(number: int) -> None:
    assert TESTS.get(number), f"row {number}, {ROWS[number].name}, has no test"
    for name, faults in TESTS[number].items():
        assert faults, f"{name} injects nothing"


def test_the_catalogue_is_what_fakes_can_be_given_and_what_tests_inject() -> None:
    assert set(CATALOGUE) == CAN_BE_GIVEN
    assert set(CATALOGUE) == INJECTED


def test_no_row_is_unknown() -> None:
    assert set(TESTS) <= set(ROWS)


@pytest.mark.parametrize("make", MAKE, ids=lambda make: type(make()).__name__)
@virtual_time
async def test_a_fake_can_be_given_each_fault_that_it_names(make: Callable[[], Breakable]) -> None:
    for fault, name in make().breaks.items():
        fake = make()
        fake.inject(fault, 1)
        if not callable(getattr(fake, name)):
            assert getattr(fake, name) is True
            fake.mend(fault)
            assert getattr(fake, name) is False


def test_a_fault_that_a_fake_cannot_have_is_refused_with_those_that_it_can() -> None:
    with pytest.raises(ValueError, match="RosmasterFake has no fault 'brown-out'; it has: controller silent, wheel"):
        RosmasterFake().inject("brown-out")
    with pytest.raises(ValueError, match="over as soon as it has happened"):
        RplidarFake().mend("brown-out")


def test_the_page_has_each_row_with_its_bound_its_faults_and_its_tests() -> None:
    told = {
        int(number): (name, bound, set(re.findall("`([^`]+)`", faults)))
        for number, name, faults, bound in re.findall(
            r"^\| (\d+) \| ([^|]+) \| ([^|]+) \| [^|]+ \| ([^|]+) \|$", PAGE, re.MULTILINE
        )
    }
    real = {
        number: (row.name, row.bound, {fault for faults in TESTS[number].values() for fault in faults})
        for number, row in ROWS.items()
    }
    assert told == real
