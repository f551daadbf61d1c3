"""That `scripts/bench core` gives each of the programs it compares its fixed place in time."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path
from typing import Any

import pytest

from robotd.testing import run_virtual
from robotd_devices.lidar.ld_packets import LdParser
from robotd_devices.lidar.ld_sweep import LdSweep

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "scripts"))

from benches.core_robots import PACKET_NS, TURN_NS, Line, first_due_ns  # noqa: E402


@pytest.mark.parametrize(
    ("now_ns", "phase", "due_ns"),
    [
        (0, 0.0, 0),
        (1, 0.0, TURN_NS),
        (TURN_NS, 0.0, TURN_NS),
        (7 * TURN_NS + 1, 0.25, 7 * TURN_NS + TURN_NS // 4),
        (7 * TURN_NS + TURN_NS // 2, 0.25, 8 * TURN_NS + TURN_NS // 4),
    ],
)
def test_a_beat_begins_at_its_part_of_the_next_turn(now_ns: int, phase: float, due_ns: int) -> None:
    assert first_due_ns(now_ns, phase) == due_ns


async def _scan_ends(phase: float, start_after_s: float) -> list[int]:
    """When a line that is started at some time completes its scans."""
    loop: Any = asyncio.get_running_loop()
    parser, sweep = LdParser(), LdSweep()
    ends: list[int] = []

    def take(data: bytes) -> None:
        ends.extend(loop.now_ns() for packet in parser.feed(data, loop.now_ns()) if sweep.add(packet) is not None)

    await asyncio.sleep(start_after_s)
    line = Line(phase, take)
    line.start()
    await asyncio.sleep(1.0)
    line.stop()
    return ends


@pytest.mark.parametrize("start_after_s", [0.0, 0.013, 0.049])
@pytest.mark.parametrize("phase", [0.0, 0.5])
def test_scans_end_at_their_phase_whenever_the_line_was_started(phase: float, start_after_s: float) -> None:
    ends = run_virtual(_scan_ends(phase, start_after_s))
    assert len(ends) >= 17
    late_ns = [(end_ns - round(phase * TURN_NS)) % TURN_NS for end_ns in ends]
    assert max(late_ns) <= 2 * PACKET_NS
