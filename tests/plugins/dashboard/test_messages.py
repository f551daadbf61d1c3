"""What the page is told: sentences, strict JSON, binary layouts."""

from __future__ import annotations

import json
import math
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from robotd import LidarScan
from robotd.authoring.explain import Histogram, ImageLine, Path, Points, Scalar
from robotd.world.messages import EStopped, Event, Outcome
from robotd.world.robot import Robot
from robotd_plugins.bridges.dashboard.messages import (
    POINTS_MAX,
    drawings_message,
    event_text,
    hello,
    picture_message,
    scan_message,
    sentence,
    status_message,
)


def status(command: dict[str, float], by: str = "", state: str = "", **more: Any) -> dict[str, Any]:
    behaviours = [{"name": "wander", "state": state}, {"name": "other", "state": "ASLEEP"}]
    return {"command": command, "by": by, "behaviours": behaviours, "reason": "", "limited_by": [], **more}


STILL = {"vx_mps": 0.0, "vy_mps": 0.0, "wz_radps": 0.0}
AHEAD = {"vx_mps": 0.2, "vy_mps": 0.0, "wz_radps": 0.0}
TURNS = {"vx_mps": 0.0, "vy_mps": 0.0, "wz_radps": -0.1}


@pytest.mark.parametrize(
    ("told", "said"),
    [
        (status(STILL, reason="disarmed: not armed yet"), "standing still because disarmed: not armed yet"),
        (status(STILL), "standing still because nothing asks it to move"),
        (status({"speed_mps": 0.0, "steering_rad": 0.3}, reason="x"), "standing still because x"),
        (status(AHEAD, "wander", "AHEAD"), "driving: wander (AHEAD)"),
        (status(AHEAD, "wander", "active"), "driving: wander"),
        (status(AHEAD, "page 2"), "driving: page 2"),
        (status(TURNS, "wander", "TURNING"), "driving: wander (TURNING)"),
        (status({"speed_mps": -0.3, "steering_rad": 0.0}, "wander"), "driving: wander"),
        (status(AHEAD, "wander", limited_by=["slow zone", "accel"]), "driving: wander, limited by slow zone, accel"),
    ],
)
def test_the_sentence(told: dict[str, Any], said: str) -> None:
    assert sentence(told) == said
    whole = json.loads(status_message(told))
    assert whole["sentence"] == said
    assert whole["moving"] is said.startswith("driving")


FLOATS = npst.arrays(np.float32, st.integers(0, 50), elements=st.floats(width=32))


@given(FLOATS, st.integers(0, 255), st.floats(-5, 5, width=32))
def test_a_scan_comes_out_as_it_went_in(ranges: Any, index: int, x_m: float) -> None:
    angles = np.linspace(-3, 3, len(ranges), dtype=np.float32)
    scan = LidarScan(1_500_000_000, ranges.copy(), angles, x_m=x_m, y_m=0.25, yaw_rad=-0.5, range_max_m=math.inf)
    told = scan_message(index, scan)
    assert struct.unpack_from("<BBHId", told) == (1, index, 0, len(ranges), 1.5)
    assert struct.unpack_from("<5f", told, 16) == (x_m, 0.25, -0.5, 0.0, math.inf)
    np.testing.assert_array_equal(np.frombuffer(told, "<f4", len(ranges), 36), angles)
    np.testing.assert_array_equal(np.frombuffer(told, "<f4", len(ranges), 36 + 4 * len(ranges)), ranges)


def test_a_picture_says_the_size_that_overlays_count_in() -> None:
    told = picture_message(1, 1920, 1080, 2_000_000_000, b"jpeg")
    assert struct.unpack_from("<BBHId", told) == (2, 1, 1920, 1080, 2.0)
    assert told[16:] == b"jpeg"


def test_drawings_are_strict_json() -> None:
    told = drawings_message(
        {
            "tracker": (
                Scalar("range", math.nan, "m"),
                Points("seen", ((math.inf, 1.0), (0.12345, 2.0))),
                Histogram("free", np.array([0.5, math.nan], dtype=np.float32), -1.0, 0.1),
                ImageLine("line", ((1.0, 2.0), (3.0, 4.0))),
            )
        }
    )
    read = json.loads(told, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    scalar, points, histogram, line = read["by"]["tracker"]
    assert scalar == {"type": "Scalar", "name": "range", "value": None, "unit": "m"}
    assert points["xy_m"] == [[None, 1.0], [0.123, 2.0]]
    assert histogram["values"] == [0.5, None]
    assert line == {"type": "ImageLine", "name": "line", "xy_px": [[1, 2], [3, 4]], "source": "camera_frame"}


@pytest.mark.parametrize("count", [0, 1, POINTS_MAX, POINTS_MAX + 1, 50_000])
def test_long_paths_are_thinned_and_keep_their_ends(count: int) -> None:
    points = tuple((float(i), 0.0) for i in range(count))
    kept = json.loads(drawings_message({"p": (Path("way", points),)}))["by"]["p"][0]["xy_m"]
    assert len(kept) <= POINTS_MAX + 1
    assert [kept[0], kept[-1]] == [[0, 0], [count - 1, 0]] if count else kept == []
    assert count > POINTS_MAX or len(kept) == count


def test_hello_names_what_numbers_stand_for() -> None:
    told = json.loads(hello(Robot(name="Nguyễn's"), ["lidar_scan"], [], 3))
    assert (told["robot"], told["scans"], told["cameras"], told["viewer"]) == ("Nguyễn's", ["lidar_scan"], [], 3)
    assert told["footprint_m"] == [[0.1, 0.08], [0.1, -0.08], [-0.1, -0.08], [-0.1, 0.08]]


@pytest.mark.parametrize(
    ("event", "text"),
    [
        (EStopped(0, "page 1", ""), "e-stop by page 1"),
        (EStopped(0, "bumper", "touched"), "e-stop by bumper: touched"),
        (Outcome(0, "dock", "FAILED", "no dock seen for 5 s"), "dock FAILED: no dock seen for 5 s"),
        (Event(0), "Event "),
    ],
)
def test_events_are_lines_for_people(event: Event, text: str) -> None:
    assert event_text(event) == text
