"""On rendered floors, whose geometry is known: places in metres, crossings and their exits, ends, and no phantoms."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest

from robotd_devices.sim import load_map
from robotd_devices.sim.maps import rounded
from robotd_plugins.toolkit.line_seen import LineSeen

STRAIGHT = [(-0.5, 0.0), (2.0, 0.0)]


def _shaded(picture: Any, darkness: float, *corners: tuple[float, float]) -> Any:
    height, width = picture.shape[:2]
    mask = np.zeros((height, width), np.float32)
    cv2.fillPoly(mask, [(np.array(corners) * (width, height)).astype(np.int32)], 1.0)
    return (picture * (1.0 - (1.0 - darkness) * mask[..., None])).astype(np.uint8)


@pytest.mark.parametrize("size", [(320, 240), (224, 224), (640, 480), (160, 120)])
@pytest.mark.parametrize(("left_m", "yaw_rad"), [(0.0, 0.0), (0.03, 0.0), (-0.03, 0.1), (0.02, -0.2), (-0.02, 0.25)])
def test_the_line_is_where_it_is_in_metres(
    floor: Callable[..., Any], left_m: float, yaw_rad: float, size: tuple[int, int]
) -> None:
    seen = floor([STRAIGHT], width_px=size[0], height_px=size[1]).seen((0.0, left_m, yaw_rad))
    for roi in (seen.near, seen.far):
        # where the tape's middle passes this region, in base
        true_left_m = -left_m / math.cos(yaw_rad) - roi.ahead_m * math.tan(yaw_rad)
        assert roi.left_m == pytest.approx(true_left_m, abs=0.004)
    assert seen.heading_rad == pytest.approx(-yaw_rad, abs=0.03)
    assert (seen.bar, seen.end, seen.reason) == (None, None, "the line")


def test_line_centres_are_within_two_pixels(floor: Callable[..., Any]) -> None:
    """RMSE against geometry, at 320 wide, over places, headings and lights."""
    rng = np.random.default_rng(3)
    off_px = []
    for seed in range(4):
        made = floor([STRAIGHT], seed, gloss=float(rng.uniform(0, 80)), brightness=float(rng.uniform(0.6, 1.3)))
        for _ in range(8):
            left_m, yaw_rad = rng.uniform(-0.04, 0.04), rng.uniform(-0.25, 0.25)
            seen = made.seen((float(rng.uniform(0.0, 0.5)), left_m, yaw_rad))
            for roi in (seen.near, seen.far):
                true_left_m = -left_m / math.cos(yaw_rad) - roi.ahead_m * math.tan(yaw_rad)
                place = made.camera.floor_px(np.array([[roi.ahead_m, true_left_m]]))[0, 0]
                off_px.append((roi.x + 1.0) / 2.0 * 320.0 - 0.5 - place)
    assert float(np.sqrt(np.mean(np.square(off_px)))) <= 2.0
    assert float(np.max(np.abs(off_px))) <= 5.0


@pytest.mark.parametrize("pose", [(0.0, 0.0), (0.03, 0.1), (-0.03, -0.12)])
@pytest.mark.parametrize(
    ("kind", "tapes", "exits", "straight"),
    [
        ("crossing", [STRAIGHT, [(1.0, -0.5), (1.0, 0.5)]], "left, straight, right", True),
        ("branch to the left", [STRAIGHT, [(1.0, 0.0), (1.0, 0.5)]], "left, straight", True),
        ("branch to the right", [STRAIGHT, [(1.0, 0.0), (1.0, -0.5)]], "straight, right", True),
        ("T", [[(-0.5, 0.0), (1.0, 0.0)], [(1.0, -0.5), (1.0, 0.5)]], "left, right", False),
        ("corner to the left", [[(-0.5, 0.0), (1.0, 0.0), (1.0, 0.5)]], "left", False),
        ("corner to the right", [[(-0.5, 0.0), (1.0, 0.0), (1.0, -0.5)]], "right", False),
    ],
)
def test_crossings_have_their_exits_and_their_place(
    floor: Callable[..., Any],
    kind: str,
    tapes: list[list[tuple[float, float]]],
    exits: str,
    straight: bool,
    pose: tuple[float, float],
) -> None:
    made = floor(tapes, 1)
    looks = {ahead_m: made.seen((1.0 - ahead_m, *pose)) for ahead_m in (0.30, 0.25, 0.20)}
    # a corner that is seen aslant may pass for a bend once; a crossing never passes for nothing
    assert sum(seen.bar is not None for seen in looks.values()) >= (2 if len(tapes) == 1 else 3), kind
    for ahead_m, seen in looks.items():
        if seen.bar is None:
            continue
        assert (seen.bar.exits, seen.bar.straight) == (exits, straight), (kind, ahead_m)
        true_m = (ahead_m + pose[0] * math.sin(pose[1])) / math.cos(pose[1])
        assert seen.bar.ahead_m == pytest.approx(true_m, abs=0.035), kind
        assert seen.end is None


@pytest.mark.parametrize("how", [{"gloss": 60.0}, {"shadows_per_m2": 1.0, "shadow_depth": 0.4, "shadow_edge_m": 0.01}])
@pytest.mark.parametrize("name", ["line_track", "line_loop"])
def test_along_the_shipped_maps_nothing_is_seen_that_is_not_there(
    floor: Callable[..., Any], name: str, how: dict[str, float]
) -> None:
    rng = np.random.default_rng(11)
    made = floor(name, 22, **how)
    points = load_map(name).lines[0].points_m
    crossings = np.array([(0.9, 0.0), (2.2, 1.1)] if name == "line_track" else [(0.0, 0.0)])
    steps = np.diff(points, axis=0)
    lengths = np.hypot(*steps.T)
    cumulated = np.cumsum(lengths)
    for along_m in np.arange(0.2, lengths.sum() - 0.5, 0.05):
        piece = int(np.searchsorted(cumulated, along_m))
        share = 1.0 - (cumulated[piece] - along_m) / lengths[piece]
        x_m, y_m = points[piece] + share * steps[piece]
        yaw_rad = math.atan2(steps[piece][1], steps[piece][0])
        off_m, turned_rad = rng.uniform(-0.02, 0.02), rng.uniform(-0.15, 0.15)
        pose = (x_m - off_m * math.sin(yaw_rad), y_m + off_m * math.cos(yaw_rad), yaw_rad + turned_rad)
        seen = made.seen(pose)
        ahead_m = np.hypot(*(crossings - pose[:2]).T).min()
        assert seen.end is None, (along_m, seen)
        if seen.bar is not None:
            assert ahead_m < 0.45, (along_m, seen)
        if ahead_m > 0.2:
            assert seen.near.is_seen and seen.near.left_m == pytest.approx(-off_m, abs=0.06), (along_m, seen)


@pytest.mark.parametrize("radius_m", [0.15, 0.25, 0.4])
def test_a_bend_is_no_crossing_and_no_end(floor: Callable[..., Any], radius_m: float) -> None:
    made = floor([[tuple(point) for point in rounded([(-0.5, 0.0), (1.0, 0.0), (1.0, 1.0)], radius_m, False)]], 5)
    for left_m, yaw_rad in ((0.0, 0.0), (0.03, 0.1), (-0.03, -0.1)):
        for before_m in np.arange(0.0, 0.5, 0.05):
            seen = made.seen((1.0 - radius_m - before_m, left_m, yaw_rad))
            assert (seen.bar, seen.end) == (None, None), (before_m, seen)


@pytest.mark.parametrize("pose", [(0.0, 0.0), (0.02, 0.15), (-0.03, -0.1)])
def test_the_end_of_the_line(floor: Callable[..., Any], pose: tuple[float, float]) -> None:
    made = floor([[(-0.5, 0.0), (1.0, 0.0)]], 3)
    for ahead_m in (0.28, 0.22, 0.17):
        seen = made.seen((1.0 - ahead_m, *pose))
        assert seen.end is not None, (ahead_m, seen.reason)
        assert seen.end.ahead_m == pytest.approx(ahead_m, abs=0.03)
        assert seen.bar is None
    assert made.seen((0.3, *pose)).end is None


@pytest.mark.parametrize(
    ("what", "change", "reason"),
    [
        ("a plain floor", lambda picture: picture, "no line"),
        ("a black picture", lambda picture: np.zeros_like(picture), "too dark"),
        ("a white picture", lambda picture: np.full_like(picture, 255), "no line"),
        ("noise without a picture", lambda p: np.random.default_rng(0).integers(0, 256, p.shape, np.uint8), "no line"),
        (
            "a shadow over half of it",
            lambda p: _shaded(p, 0.5, (0.0, 0.0), (0.5, 0.0), (0.3, 1.0), (0.0, 1.0)),
            "no line",
        ),
        (
            "a shadow near the robot",
            lambda p: _shaded(p, 0.5, (0.0, 0.8), (1.0, 0.7), (1.0, 1.0), (0.0, 1.0)),
            "no line",
        ),
        (
            "a band of shadow across",
            lambda p: _shaded(p, 0.6, (0.0, 0.7), (1.0, 0.7), (1.0, 0.8), (0.0, 0.8)),
            "no line",
        ),
    ],
)
def test_where_there_is_no_line_none_is_seen(
    floor: Callable[..., Any], look: Callable[..., LineSeen], what: str, change: Callable[[Any], Any], reason: str
) -> None:
    for gloss in (0.0, 40.0, 90.0):
        seen = look(change(floor([[(-1.5, 0.0), (-1.0, 0.0)]], gloss=gloss).picture()))
        assert not seen.near.is_seen and not seen.far.is_seen, (what, seen)
        assert (seen.bar, seen.end) == (None, None), what
        assert seen.reason.startswith(reason), (what, seen.reason)


@pytest.mark.parametrize("darkness", [0.5, 0.65])
@pytest.mark.parametrize("top", [0.5, 0.6, 0.7, 0.8])
@pytest.mark.parametrize("thick", [0.06, 0.12, 0.3])
def test_a_shadow_across_the_line_is_no_crossing_and_no_end(
    floor: Callable[..., Any], look: Callable[..., LineSeen], darkness: float, top: float, thick: float
) -> None:
    picture = floor([STRAIGHT], 4).picture((0.0, 0.01, 0.05))
    seen = look(_shaded(picture, darkness, (0.0, top), (1.0, top - 0.03), (1.0, top + thick), (0.0, top + thick)))
    assert (seen.bar, seen.end) == (None, None)
    assert seen.near.is_seen or seen.far.is_seen


def test_glare_along_the_tape_is_no_end(floor: Callable[..., Any]) -> None:
    """Lamps mirrored along the tape split it lengthwise; a strip of it that ends is not the line's end."""
    for seed in range(6):
        made = floor("line_track", seed, gloss=110.0, noise_std=8.0)
        for y_m in np.linspace(0.5, 0.85, 6):
            assert made.seen((2.2, float(y_m), math.pi / 2.0)).end is None
