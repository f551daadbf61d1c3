"""Perception: bins, three states, holes, smoothing towards nearer only, stray returns."""

from __future__ import annotations

import math

import numpy as np
import pytest
from race_cars import corridor

from robotd.world.messages import LidarScan
from robotd_plugins.behaviours.ftg_race.perception import ScanPreprocessor, noise_m
from robotd_plugins.behaviours.ftg_race.planning_types import FREE, HIT, MISSING, Motion, Scan

STEP = math.radians(1.0)
STILL = Motion()


def scan_of(ranges: list[float], first_deg: float, step_deg: float = 1.0, stamp_ns: int = 1) -> LidarScan:
    angles = np.radians(first_deg + step_deg * np.arange(len(ranges))).astype(np.float32)
    return LidarScan(stamp_ns, np.array(ranges, dtype=np.float32), angles, range_max_m=12.0)


def process(scan: LidarScan, **how: float) -> Scan:
    made = ScanPreprocessor(STEP, math.pi / 2.0, 0.15, 6.0, int(how.get("median", 1)), bool(how.get("confirm", 0)))
    return made.process(scan, STILL)


def test_a_bin_holds_its_nearest_return() -> None:
    binned = process(scan_of([3.0, 2.0, 4.0, 5.0], -0.75, 0.5))
    assert np.degrees(binned.bearing_rad).round().tolist() == [-1.0, 0.0, 1.0]
    assert binned.ranges_m.tolist() == [3.0, 2.0, 5.0]


@pytest.mark.parametrize(
    ("given", "range_m", "state"),
    [
        ("a return", 2.0, HIT),
        ("beyond what is looked at", 7.0, FREE),
        ("no return", math.inf, FREE),
        ("touching", 0.05, HIT),
    ],
)
def test_what_a_single_beam_says(given: str, range_m: float, state: int) -> None:
    binned = process(scan_of([2.0, range_m, 2.0], -1.0))
    assert binned.state[1] == state, given
    assert binned.ranges_m[1] == (0.0 if given == "touching" else min(range_m, 6.0))


def test_a_narrow_hole_takes_its_nearer_neighbour_and_a_wide_one_is_missing() -> None:
    nan = math.nan
    binned = process(scan_of([3.0, nan, nan, 2.0, *[nan] * 6, 4.0], -5.0))
    assert binned.state.tolist() == [HIT] * 4 + [MISSING] * 6 + [HIT]
    assert binned.ranges_m[1:3].tolist() == [2.0, 2.0]
    assert binned.ranges_m[4:10].max() <= 1.0


def test_nothing_measured_is_an_obstacle_everywhere() -> None:
    binned = process(scan_of([math.nan] * 11, -5.0))
    assert set(binned.state.tolist()) == {MISSING} and binned.ranges_m.max() == 0.0


def test_smoothing_never_makes_anything_farther() -> None:
    post = [5.0] * 10 + [1.0] + [5.0] * 10
    binned = process(scan_of(post, -10.0), median=3)
    assert binned.ranges_m[10] == 1.0 and binned.ranges_m.min() == 1.0


def test_a_stray_return_counts_when_it_is_seen_twice() -> None:
    made = ScanPreprocessor(STEP, math.pi / 2.0, 0.15, 6.0, 1, True)
    clear, post = scan_of([5.0] * 21, -10.0), scan_of([5.0] * 10 + [1.0] + [5.0] * 10, -10.0)
    ahead = [float(made.process(scan, STILL).ranges_m[10]) for scan in (clear, post, post)]
    assert ahead == [5.0, 5.0, 1.0]


def test_the_order_and_the_turn_of_the_beams_do_not_matter() -> None:
    scan = corridor(heading_rad=0.3)
    turned = LidarScan(0, scan.ranges_m[::-1].copy(), scan.angles_rad[::-1].copy(), range_max_m=12.0, x_m=0.165)
    one, other = process(scan), process(turned)
    assert one.bearing_rad.tolist() == other.bearing_rad.tolist()
    assert one.ranges_m.tolist() == other.ranges_m.tolist()


def test_a_lidar_that_sees_nothing_there_is_refused() -> None:
    with pytest.raises(ValueError, match="no beam in the field of view"):
        process(scan_of([1.0, 1.0], 120.0))


@pytest.mark.parametrize("dropout", [0.0, 0.1])
@pytest.mark.parametrize("sigma_m", [0.01, 0.03, 0.05])
def test_how_much_the_ranges_err_is_found_from_the_scan(sigma_m: float, dropout: float) -> None:
    rng = np.random.default_rng(11)
    ranges = corridor(heading_rad=0.2, ahead_m=5.0).ranges_m + sigma_m * rng.standard_normal(1080)
    ranges[rng.random(1080) < dropout] = math.nan
    assert noise_m(ranges.astype(np.float32)) == pytest.approx(sigma_m, rel=0.15)


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_where_nothing_is_measured_no_error_is_seen(value: float) -> None:
    assert noise_m(np.full(20, value, dtype=np.float32)) == 0.0
