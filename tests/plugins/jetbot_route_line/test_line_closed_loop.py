"""The shipped JetBot follows lines in the simulator: camera, perceptor, behaviour, guard and wheels in one loop.

Tape is 50 mm wide; half of it is under the axle's middle while that is within 25 mm of the tape's middle.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robotd import CameraFrame
from robotd.world.clock import ns
from robotd_devices.sim import SimCamera

OFF_MAX_M = 0.022
OFF_RMS_M = 0.010
CROSSING = ["APPROACHING_INTERSECTION", "LEAVING_INTERSECTION", "REACQUIRING_LINE", "DRIVING_STRAIGHT"]
WORSE = ("simulation.devices.motors.motor_error=0.06", "simulation.devices.motors.wheel_error=0.04")

HARSH = tuple(
    f"simulation.devices.camera.{key}"
    for key in ("gloss=80", "brightness=0.6", "shadows_per_m2=1.0", "shadow_depth=0.4", "shadow_edge_m=0.01")
)


@pytest.mark.parametrize(
    ("what", "seed", "sets"),
    [
        ("as shipped", 0, ()),
        ("unequal wheels, one frame in ten lost", 1, (*WORSE, "simulation.devices.camera.frame_loss=0.1")),
        ("glare, little light, sharp shadows", 21, HARSH),
    ],
)
def test_the_track_is_driven_to_its_end(run: Callable[..., Any], what: str, seed: int, sets: tuple[str, ...]) -> None:
    drove = run("line_track", seed, 60.0, *sets)
    assert drove.outcome is not None, (what, drove.states)
    assert (drove.outcome.result, drove.outcome.reason) == ("SUCCEEDED", "end of the line")
    assert drove.off_max_m <= OFF_MAX_M and drove.off_rms_m <= OFF_RMS_M, (drove.off_max_m, drove.off_rms_m)
    # both crossings straight ahead, each counted once
    assert drove.states == ["WAITING_FOR_LINE", "DRIVING_STRAIGHT", *CROSSING, *CROSSING]
    # the tape ends at (0, 2.2); the axle stands 30 mm before it
    x_m, y_m, yaw_rad = drove.final
    assert x_m == pytest.approx(0.03, abs=0.02) and y_m == pytest.approx(2.2, abs=0.02)
    assert abs(math.remainder(yaw_rad - math.pi, math.tau)) < 0.25
    assert drove.runtime.world.collisions == 0


def test_it_follows_a_loop_and_is_never_lost(run: Callable[..., Any]) -> None:
    drove = run("line_loop", 3, 60.0, "simulation.devices.camera.frame_loss=0.05")
    assert drove.outcome is None
    assert drove.off_max_m <= OFF_MAX_M and drove.off_rms_m <= OFF_RMS_M, (drove.off_max_m, drove.off_rms_m)
    # 60 s at about 0.2 m/s on a loop of 6.9 m that crosses itself once: three or four crossings, each entered once
    assert drove.states.count("LEAVING_INTERSECTION") in (3, 4)
    assert set(drove.states) == {"WAITING_FOR_LINE", *CROSSING}


def _map(folder: Path, *lines: str) -> str:
    file = folder / "course.yaml"
    walls = "  - {points_m: [[-2, -2], [4, -2], [4, 2], [-2, 2]], closed: true}"
    file.write_text(
        "\n".join(["name: course", "walls:", walls, "lines:", *(f"  - {{points_m: {line}}}" for line in lines)])
    )
    return str(file)


def test_a_gap_in_the_line_is_an_end_and_it_stops_there(run: Callable[..., Any], tmp_path: Path) -> None:
    drove = run(_map(tmp_path, "[[-0.2, 0], [0.6, 0]]", "[[0.9, 0], [2, 0]]"), 0, 20.0)
    assert drove.outcome is not None and drove.outcome.reason == "end of the line"
    assert drove.final[0] == pytest.approx(0.57, abs=0.025)


@pytest.mark.parametrize(
    "lines", [("[[-0.2, 0], [0.8, 0]]", "[[0.8, -0.5], [0.8, 0.5]]"), ("[[-0.2, 0], [0.8, 0], [0.8, 0.5]]",)]
)
def test_a_crossing_without_a_way_straight_on_fails_at_its_middle(
    run: Callable[..., Any], tmp_path: Path, lines: tuple[str, ...]
) -> None:
    drove = run(_map(tmp_path, *lines), 0, 20.0)
    assert drove.outcome is not None
    assert (drove.outcome.result, drove.outcome.reason) == ("FAILED", "the crossing has no way straight on")
    assert drove.final[:2] == (pytest.approx(0.8, abs=0.03), pytest.approx(0.0, abs=0.02))


def test_without_a_line_it_never_moves(run: Callable[..., Any], tmp_path: Path) -> None:
    drove = run(_map(tmp_path, "[[-0.2, 1.5], [0.6, 1.5]]"), 0, 20.0)
    assert drove.outcome is not None
    assert (drove.outcome.result, drove.outcome.reason) == ("FAILED", "no line in sight for 10 s")
    assert drove.final == (0.0, 0.0, 0.0)


class Freezes(SimCamera):
    """Says nothing any more after three seconds."""

    def publish(self, message: CameraFrame) -> None:
        if message.stamp_ns < ns(3.0):
            super().publish(message)


class GoesDark(SimCamera):
    """Frames go on coming, but after two seconds and a half nothing is on them."""

    def publish(self, message: CameraFrame) -> None:
        dark = message.stamp_ns >= ns(2.5)
        super().publish(replace(message, bgr=np.zeros_like(message.bgr)) if dark else message)


def test_when_the_camera_freezes_it_stops_and_says_that_it_is_blind(run: Callable[..., Any]) -> None:
    drove = run("line_track", 0, 20.0, camera=Freezes)
    assert drove.outcome is not None and drove.outcome.result == "FAILED"
    assert drove.outcome.reason.startswith("blind for 2 s: line_seen")
    at_freeze = next(row for row in drove.way if row[0] >= 3.0)
    # a quarter of a second at 0.2 m/s, and the brakes
    assert math.dist(at_freeze[1:3], drove.final[:2]) < 0.10


def test_when_the_light_goes_out_it_looks_about_and_gives_up(run: Callable[..., Any]) -> None:
    """A bounded distance, a look to both sides, then a reason."""
    drove = run("line_track", 0, 40.0, camera=GoesDark)
    assert drove.outcome is not None
    assert drove.outcome.reason == "the line was lost and is not to be found on either side"
    at_dark = next(row for row in drove.way if row[0] >= 2.5)
    assert math.dist(at_dark[1:3], drove.final[:2]) < 0.26
    turned = [row[3] for row in drove.way if row[0] > 2.5]
    assert max(turned) > 0.5 and min(turned) < -0.5


def test_one_seed_is_one_run(run: Callable[..., Any]) -> None:
    first, second = (run("line_track", 5, 2.0) for _ in range(2))
    assert first.way == second.way
