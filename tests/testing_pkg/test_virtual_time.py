"""`run_virtual`, `virtual_time` and what `robotd.testing` pulls in."""

from __future__ import annotations

import asyncio
import subprocess
import sys

import pytest

import robotd.testing
from robotd.engine.loops import VirtualDeadlock, VirtualLoop
from robotd.testing import AmbientClock, run_virtual, virtual_time


@pytest.fixture
def hours() -> int:
    return 3


@virtual_time
async def test_a_decorated_test_runs_on_virtual_time_with_fixtures(hours: int) -> None:
    await asyncio.sleep(hours * 3600.0)
    loop = asyncio.get_running_loop()
    assert isinstance(loop, VirtualLoop)
    assert loop.now_ns() == AmbientClock().now_ns() == hours * 3600 * 1_000_000_000


def test_the_result_and_the_first_instant_come_through() -> None:
    async def main() -> float:
        await asyncio.sleep(1.0)
        return asyncio.get_running_loop().time()

    assert run_virtual(main(), start_ns=2_000_000_000) == 3.0
    assert run_virtual(main(), pace=200.0) == 1.0


def test_waiting_for_ever_fails_instead() -> None:
    async def main() -> None:
        await asyncio.Event().wait()

    with pytest.raises(VirtualDeadlock, match=r"Event\.wait"):
        run_virtual(main())


async def test_the_ambient_clock_runs_on_an_ordinary_loop() -> None:
    clock = AmbientClock()
    before = clock.now_ns()
    await asyncio.sleep(0.001)
    assert clock.now_ns() > before


def test_importing_it_is_light() -> None:
    code = "import sys, robotd.testing; print([m for m in ('pytest', 'mcap', 'cv2', 'scipy') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_public_names_exist() -> None:
    assert all(hasattr(robotd.testing, name) for name in robotd.testing.__all__)
    assert sorted(robotd.testing.__all__) == robotd.testing.__all__
