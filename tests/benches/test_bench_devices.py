"""What `scripts/bench devices` counts as left behind, and that its C robot does the same as the others."""

from __future__ import annotations

import os
import select
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "scripts"))

from benches.devices import BENCH  # noqa: E402
from benches.devices_replug import RSS_GROWTH_MB, Held, left_behind, missing  # noqa: E402
from benches.devices_serial import Lines, world_apart  # noqa: E402
from benches.devices_serial_robot import bare  # noqa: E402
from benches.guardian_robot import give_up_privileges  # noqa: E402
from benches.harness import Context, Rows  # noqa: E402

BEFORE = Held(descriptors=12, tasks=5, threads=3, rss_mb=60.0)


@pytest.mark.parametrize(
    ("after", "words"),
    [
        (BEFORE, []),
        (BEFORE._replace(descriptors=11, rss_mb=60.0 + RSS_GROWTH_MB), []),
        (BEFORE._replace(descriptors=13), ["descriptors from 12 to 13"]),
        (BEFORE._replace(tasks=6, threads=4), ["tasks from 5 to 6", "threads from 3 to 4"]),
        (BEFORE._replace(rss_mb=61.0 + RSS_GROWTH_MB), [f"memory by {1.0 + RSS_GROWTH_MB:.1f} MB"]),
    ],
)
def test_left_behind(after: Held, words: list[str]) -> None:
    assert left_behind(BEFORE, after) == words


@pytest.mark.parametrize(
    ("there", "first"),
    [
        ([], 0),
        (["0", "1"], 2),
        (["0", "2"], 1),
        (["0", "1", "2", "3"], 3),  # only what it left behind is not known
        (["0", "1", "2", "3", "left"], 4),
    ],
)
def test_an_interrupted_run_goes_on_where_it_was(there: list[str], first: int) -> None:
    ctx = Context(BENCH, True, Path(), Rows("devices", None, "", print), print)
    for key in there:
        ctx.row({"what": "replug"}, key=f"replug mc {key}")
    assert missing(ctx, "mc", 4) == first


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="this system does not bind processes to cores")
def test_the_world_has_a_core_of_its_own_while_it_measures() -> None:
    before = os.sched_getaffinity(0)
    with world_apart() as robots:
        ours = os.sched_getaffinity(0)
        assert len(ours) == 1
        assert ours | robots == before
        assert robots.isdisjoint(ours) or len(before) == 1
    assert os.sched_getaffinity(0) == before


def test_without_privileges_nothing_is_left_of_them() -> None:
    told = subprocess.run(
        ["grep", "Cap", "/proc/self/status"], preexec_fn=give_up_privileges, capture_output=True, check=True, text=True
    )
    left = dict(line.split(":\t") for line in told.stdout.splitlines())
    assert {left[name].strip("0") for name in ("CapPrm", "CapEff", "CapBnd" if os.getuid() == 0 else "CapEff")} == {""}


def test_the_bare_reader_echoes_what_is_whole() -> None:
    sensor, to_sensor = os.pipe()
    from_motor, motor = os.pipe()
    readable = bare(sensor, motor)
    os.write(to_sensor, b"S 1\nS 2\nS x\n\nS 3")
    readable()
    os.write(to_sensor, b"4\n")
    readable()
    assert os.read(from_motor, 100) == b"\nD 1\n\nD 2\n\nD 34\n"
    for fd in (sensor, to_sensor, from_motor, motor):
        os.close(fd)


def test_the_c_robot_echoes(tmp_path: Path, program: Callable[[str], str]) -> None:
    source = ROOT / "scripts" / "benches" / "devices_serial_robot.c"
    subprocess.run(
        [program("cc"), "-Wall", "-Wextra", "-Werror", "-o", str(tmp_path / "robot"), str(source)], check=True
    )
    lines = Lines()
    with subprocess.Popen([str(tmp_path / "robot"), *lines.paths], stdout=subprocess.PIPE) as robot:
        assert robot.stdout is not None
        assert select.select([robot.stdout], [], [], 5.0)[0]
        assert robot.stdout.readline() == b"ready\n"
        assert all(lines.trip_ns(number) > 0 for number in (1, 999, 17))
        robot.kill()
    lines.close()
