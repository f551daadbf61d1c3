"""The parts of `floor_line`: threshold, runs, trace, metres; its memory, its drawings and the contract."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from pydantic import ValidationError

from robotd import CameraFrame
from robotd.authoring.explain import ImageBox, ImageLine, Scalar, Text
from robotd.testing import check_perceptor
from robotd.world.robot import Mount, Robot
from robotd_devices.sim.lens import FloorCamera
from robotd_devices.sim.shutter import CameraSettings
from robotd_plugins.perception.floor_line import FloorLine, FloorLineConfig, Sees
from robotd_plugins.perception.floor_line.look import Grid
from robotd_plugins.perception.floor_line.runs import runs_of
from robotd_plugins.perception.floor_line.threshold import FULL, split
from robotd_plugins.perception.floor_line.trace import Piece, fit
from robotd_plugins.toolkit.floor_view import FloorView
from robotd_plugins.toolkit.line_seen import LineSeen


@given(arrays(np.bool_, array_shapes(min_dims=2, max_dims=2, max_side=12)))
def test_runs_are_the_mask(dark: Any) -> None:
    again = np.zeros_like(dark)
    for row, runs in enumerate(runs_of(dark)):
        assert runs == sorted(runs)
        for first, end in runs:
            assert first < end
            again[row, first:end] = True
            assert first == 0 or not dark[row, first - 1]
            assert end == dark.shape[1] or not dark[row, end]
    assert np.array_equal(again, dark)


@given(st.floats(-50, 50), st.floats(-2, 2), st.integers(2, 20), st.integers(2, 12), st.floats(-10, 60))
def test_a_band_through_straight_pieces_is_that_band(
    start: float, slope: float, count: int, width: int, row: float
) -> None:
    # lefts and rights at half columns would be rounded: take slopes in whole columns for exactness
    step = round(slope)
    pieces = [Piece(40 - i, round(start) + step * i, round(start) + step * i + width) for i in range(count)]
    centre, wide = fit(pieces).at(row)
    assert centre == pytest.approx(round(start) + width / 2.0 + step * (40 - row), abs=1e-6)
    assert wide == pytest.approx(width)


def _counts(*kinds: tuple[float, int, float]) -> Any:
    """A histogram of (share, pixels, spread) kinds."""
    rng = np.random.default_rng(0)
    shares = np.concatenate([rng.normal(share * FULL, spread * FULL, pixels) for share, pixels, spread in kinds])
    return np.histogram(np.clip(shares, 0, 255), bins=256, range=(0, 256))[0].astype(np.float64)


@pytest.mark.parametrize(
    ("what", "counts", "low", "high", "why"),
    [
        ("tape and floor", _counts((0.42, 900, 0.04), (0.97, 8000, 0.03)), 0.50, 0.74, ""),
        ("glossy tape", _counts((0.55, 900, 0.08), (0.97, 8000, 0.03)), 0.60, 0.74, ""),
        ("dull tape", _counts((0.20, 900, 0.03), (0.97, 8000, 0.03)), 0.50, 0.74, ""),
        ("floor alone", _counts((0.97, 9000, 0.02)), 0, 2, "nothing darker than the floor"),
        ("noise", _counts((0.5, 9000, 0.25)), 0, 2, "no even floor to be seen"),
        ("nothing", np.zeros(256), math.nan, math.nan, "no picture"),
        ("one grey", _counts((0.3, 9000, 0.02)), 0, 2, "nothing darker than the floor"),
    ],
)
def test_the_threshold_lies_between_tape_and_floor_or_says_why_not(
    what: str, counts: Any, low: float, high: float, why: str
) -> None:
    found = split(counts, 0.50, 0.74)
    assert found.why == why, (what, found)
    if not why:
        assert low <= found.ratio <= high + 0.01, found
        assert found.tape_ratio < found.ratio < found.floor_ratio


@given(
    st.floats(0.05, 0.5), st.floats(0.0, 0.9), st.floats(-0.1, 0.1), st.floats(-0.3, 0.3),
    st.floats(-0.95, 0.95), st.floats(0.05, 0.95),
    st.sampled_from([(0.0, 0.0, 0.0, 0.0), (-0.03, 0.004, 0.0, 0.0), None]),
)  # fmt: skip
def test_metres_are_those_of_the_simulated_lens(
    height_m: float, pitch_rad: float, roll_rad: float, yaw_rad: float, x: float, row: float, distortion: Any
) -> None:
    """Two implementations of one camera model, written apart."""
    mount = Mount(0.06, -0.01, height_m, roll_rad, pitch_rad, yaw_rad)
    camera = FloorCamera(CameraSettings(fov_rad=2.1, distortion=distortion).lens(), mount)
    pixel = np.array([[(x + 1.0) / 2.0 * 320 - 0.5, row * 240 - 0.5]])
    found = FloorView(mount, 2.1, None, distortion).floor_m(x, row, 320 / 240)
    if camera.rays_base(pixel)[0, 2] > -2e-3:
        return  # at the horizon either may say that it does not know
    expected = camera.floor_m(pixel)[0]
    assert found == (pytest.approx(expected[0], rel=1e-5, abs=1e-6), pytest.approx(expected[1], rel=1e-5, abs=1e-6))


def test_without_a_height_nothing_is_told_in_metres(floor: Callable[..., Any]) -> None:
    picture = floor([[(-0.5, 0.0), (2.0, 0.0)]]).picture()
    seen = FloorLine(FloorLineConfig()).step(Sees(frame=CameraFrame(0, picture), now_ns=0))
    assert seen.near.is_seen and math.isnan(seen.near.left_m) and math.isnan(seen.heading_rad)


def test_the_focus_mask_stays_on_the_line_it_followed(
    floor: Callable[..., Any], look: Callable[..., LineSeen], robot: Robot
) -> None:
    """Two lines: it keeps to the one that it saw, and takes the other only after its memory has gone."""
    perceptor = FloorLine(FloorLineConfig(roi_center_width_share=0.3), robot)
    left = floor([[(-0.5, 0.08), (2.0, 0.08)]]).picture()
    both = floor([[(-0.5, 0.08), (2.0, 0.08)], [(-0.5, -0.03), (2.0, -0.03)]]).picture()
    right = floor([[(-0.5, -0.03), (2.0, -0.03)]]).picture()
    assert look(both).near.x > 0.0
    assert look(left, perceptor, 0).near.x < -0.3
    assert look(both, perceptor, 100_000_000).near.x < -0.3
    assert not look(right, perceptor, 200_000_000).near.is_seen
    assert look(right, perceptor, 900_000_000).near.x > 0.0


def test_it_draws_what_it_saw(floor: Callable[..., Any], robot: Robot) -> None:
    perceptor = FloorLine(FloorLineConfig(), robot)
    assert perceptor.explain() == ()
    picture = floor("line_track").picture((0.6, 0.0, 0.0))
    perceptor.step(Sees(frame=CameraFrame(0, picture), now_ns=0))
    drawn = {(type(item), item.name): item for item in perceptor.explain()}
    for wanted in (
        (ImageBox, "EXECUTION_ROI"),
        (ImageBox, "LOOKAHEAD_ROI"),
        (ImageLine, "line"),
        (ImageLine, "bar"),
        (Scalar, "threshold"),
    ):
        assert wanted in drawn
    assert drawn[Text, "exits"] == Text("exits", "left, straight, right")
    box: Any = drawn[ImageBox, "EXECUTION_ROI"]
    assert box.box_px == pytest.approx((0.0, 204.0, 320.0, 240.0))


@given(st.integers(32, 700), st.integers(40, 500), st.floats(0.0, 0.8), st.floats(-1.0, 1.0), st.floats(0.0, 1.0))
def test_grid_and_picture_correspond(width: int, height: int, top: float, x: float, row: float) -> None:
    try:
        grid = Grid.of(width, height, top)
    except ValueError:
        assert height * (1.0 - top) < 13
        return
    assert grid.x(grid.column(x)) == pytest.approx(x)
    assert grid.row_share(grid.row(row)) == pytest.approx(row)
    assert grid.rows[-1] == height - 1 and grid.rows[0] >= top * height


@pytest.mark.parametrize(
    ("config", "told"),
    [
        ({"execution_roi_top_share": 0.9}, "reach below the picture"),
        ({"lookahead_roi_top_share": 0.4}, "above look_from_share"),
        ({"lookahead_roi_top_share": 0.85}, "above execution_roi"),
        ({"ratio_min": 0.8}, "must be below ratio_max"),
    ],
)
def test_regions_that_cannot_be_are_refused(config: dict[str, float], told: str) -> None:
    with pytest.raises(ValidationError, match=told):
        FloorLineConfig(**config)  # type: ignore[arg-type]


def test_a_tiny_picture_is_an_error() -> None:
    with pytest.raises(ValueError, match="too small"):
        Grid.of(16, 16, 0.45)


def test_keeps_the_contract() -> None:
    check_perceptor(FloorLine)
