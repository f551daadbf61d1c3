"""Lidar cues of a crossing: markers, legs, walls, open ground; any number of beams, mirrored scans, missing beams."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from robotd import LidarScan
from robotd.testing import box_scan, corridor_scan, open_scan
from robotd.world.geometry import wrap_rad
from robotd_plugins.behaviours.jetbot_route.intersection_cues import (
    DETECTORS,
    OpenSpaceConfig,
    OpenSpaceDetector,
    OppositeMarkersConfig,
    Sighting,
    SimpleOppositeDetector,
)

MARKER_M = 0.04
LEG_M = 0.055


def post(bearing_deg: float, middle_m: float = 0.33, radius_m: float = MARKER_M) -> tuple[float, float, float]:
    """A round post in base by bearing; a marker of 4 cm radius at 0.33 m is met at about 0.3 m."""
    at = math.radians(bearing_deg)
    return middle_m * math.cos(at), middle_m * math.sin(at), radius_m


def crossing_scan(width_m: float = 0.7, beams: int = 360) -> LidarScan:
    """The middle of a crossing of two corridors: four square corners, all four ways open."""
    half_m = width_m / 2.0
    angles = np.linspace(-math.pi, math.pi, beams, endpoint=False)
    cos, sin = np.abs(np.cos(angles)), np.abs(np.sin(angles))
    # a beam leaves the square room by one way; the corner block begins where the other coordinate reaches half a width
    with np.errstate(divide="ignore"):
        ranges = half_m / np.minimum(cos, sin)
    ranges[ranges > 8.0] = math.inf
    return LidarScan(0, ranges.astype(np.float32), angles.astype(np.float32), range_max_m=8.0)


def mirrored(scan: LidarScan) -> LidarScan:
    """Left and right changed places."""
    return replace(
        scan,
        ranges_m=scan.ranges_m[::-1].copy(),
        angles_rad=-scan.angles_rad[::-1],
        y_m=-scan.y_m,
        yaw_rad=-scan.yaw_rad,
    )


def with_missing(scan: LidarScan, share: float, value: float, seed: int = 1) -> LidarScan:
    """Some beams measured nothing."""
    ranges = scan.ranges_m.copy()
    ranges[np.random.default_rng(seed).random(len(ranges)) < share] = value
    return replace(scan, ranges_m=ranges)


MARKER_ROWS = [
    ("a true pair, front left and rear right", open_scan(posts=[post(45), post(225)]), True),
    ("a true pair on the other corners", open_scan(posts=[post(-45), post(135)]), True),
    ("a true pair inside a room", box_scan(1.0, 0.9, 1.5, 2.0, posts=[post(45), post(225)]), True),
    ("a true pair, one marker a little off", open_scan(posts=[post(48), post(222)]), True),
    ("a pair across the seam of the scan", open_scan(posts=[post(0), post(180)]), False),
    ("a single marker", open_scan(posts=[post(45)]), False),
    ("two markers on one side", open_scan(posts=[post(45), post(135)]), False),
    ("a pair that is not opposite", open_scan(posts=[post(45), post(210)]), False),
    ("a pair too far away", open_scan(posts=[post(45, 0.5), post(225, 0.5)]), False),
    ("a pair too near", open_scan(posts=[post(45, 0.2), post(225, 0.2)]), False),
    ("a pair of poles too thin", open_scan(posts=[post(45, 0.3, 0.01), post(225, 0.3, 0.01)]), False),
    ("a pair of boxes too wide", open_scan(posts=[post(45, 0.45, 0.15), post(225, 0.45, 0.15)]), False),
    ("legs of one person ahead", open_scan(posts=[post(25, 0.33, LEG_M), post(-25, 0.33, LEG_M)]), False),
    (
        "legs of a person who steps over the robot",
        open_scan(posts=[post(90, 0.33, LEG_M), post(-90, 0.33, LEG_M)]),
        False,
    ),
    ("the walls of a narrow corridor", corridor_scan(0.6), False),
    ("a corner of a room", box_scan(0.3, 0.3, 3.0, 3.0), False),
    ("nothing at all", open_scan(), False),
]


@pytest.mark.parametrize(("what", "scan", "seen"), MARKER_ROWS, ids=[row[0] for row in MARKER_ROWS])
def test_opposite_markers(what: str, scan: LidarScan, seen: bool) -> None:
    cue = SimpleOppositeDetector().look(scan)
    assert cue.seen is seen, cue
    assert cue.reason
    if seen:
        assert [sighting.what for sighting in cue.evidence] == ["marker", "marker"]
        assert all(0.25 <= sighting.range_m <= 0.35 for sighting in cue.evidence)


def test_legs_astride_a_corner_pair_are_the_known_limit() -> None:
    """Two legs on a diagonal look like markers to one scan; that is why a cue is weighed and not obeyed."""
    assert SimpleOppositeDetector().look(open_scan(posts=[post(45, 0.34, LEG_M), post(225, 0.34, LEG_M)])).seen


def test_without_the_rule_of_diagonals_any_opposite_pair_counts() -> None:
    anywhere = SimpleOppositeDetector(OppositeMarkersConfig(diagonals_only=False))
    for bearing_deg in range(0, 180, 15):
        assert anywhere.look(open_scan(posts=[post(bearing_deg), post(bearing_deg + 180)])).seen


def test_evidence_says_why_a_thing_is_no_marker() -> None:
    cue = SimpleOppositeDetector().look(open_scan(posts=[post(45), post(0), post(180, 0.3, 0.01), post(270, 0.2)]))
    told = {round(math.degrees(s.bearing_rad)) % 360: s.what for s in cue.evidence}
    assert told == {45: "marker", 0: "off the diagonals", 180: "too narrow", 270: "too near"}


@pytest.mark.parametrize("beams", [180, 360, 455, 720, 1081])
def test_sizes_are_metres_whatever_the_number_of_beams(beams: int) -> None:
    """The seed counted points, so that another lidar saw other markers."""
    detector = SimpleOppositeDetector()
    assert detector.look(open_scan(posts=[post(45), post(225)], beams=beams)).seen
    assert not detector.look(open_scan(posts=[post(45, 0.3, 0.02), post(225, 0.3, 0.02)], beams=beams)).seen
    assert OpenSpaceDetector().look(crossing_scan(beams=beams)).seen


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_missing_beams_do_not_matter(value: float) -> None:
    for seed in range(5):
        pair = with_missing(open_scan(posts=[post(45), post(225)], beams=720), 0.1, value, seed)
        assert SimpleOppositeDetector().look(pair).seen
        assert OpenSpaceDetector().look(with_missing(crossing_scan(), 0.1, value, seed)).seen


def test_the_middle_of_base_counts_not_the_lidar() -> None:
    scan = open_scan(posts=[post(45), post(225)], x_m=-0.03, y_m=0.01, yaw_rad=math.pi / 2)
    cue = SimpleOppositeDetector().look(scan)
    assert cue.seen
    assert sorted(round(math.degrees(s.bearing_rad)) for s in cue.evidence) == pytest.approx([-135, 45], abs=3)


OPEN_ROWS: list[tuple[str, LidarScan, bool | None]] = [
    ("a crossing of corridors", crossing_scan(), True),
    ("a corridor", corridor_scan(0.7), False),
    ("a corridor, off its middle", corridor_scan(0.9, offset_m=0.2), False),
    ("one open side", box_scan(2.0, math.inf, 2.0, 0.35), False),
    ("open ground", open_scan(), None),
    ("open ground with one post", open_scan(posts=[post(45)]), None),
    ("a crossing marked by two flags", open_scan(posts=[post(45), post(225)]), True),
    ("a person stands in the side road", open_scan(posts=[post(45), post(225), post(90, 0.4, 0.15)]), False),
    ("a thin pole in the side road", open_scan(posts=[post(45), post(225), post(90, 0.5, 0.01)]), True),
    ("nothing measured on the left", with_missing(corridor_scan(), 1.0, math.nan), None),
]


@pytest.mark.parametrize(("what", "scan", "seen"), OPEN_ROWS, ids=[row[0] for row in OPEN_ROWS])
def test_open_space(what: str, scan: LidarScan, seen: bool | None) -> None:
    cue = OpenSpaceDetector().look(scan)
    assert cue.seen is seen, cue


def test_half_a_circle_does_not_tell_of_opposites() -> None:
    angles = np.linspace(-math.pi / 2, math.pi / 2, 181).astype(np.float32)
    half = LidarScan(0, np.full(181, 1.0, np.float32), angles)
    assert SimpleOppositeDetector().look(half).seen is None


@pytest.mark.parametrize("name", sorted(DETECTORS))
@pytest.mark.parametrize("count", [0, 1, 2])
def test_scans_of_hardly_any_beam_do_not_tell(name: str, count: int) -> None:
    scan = LidarScan(0, np.ones(count, np.float32), np.zeros(count, np.float32))
    assert DETECTORS[name]().look(scan).seen is None


def test_touching_beams_are_no_markers() -> None:
    scan = open_scan(posts=[post(45), post(225)])
    assert SimpleOppositeDetector().look(replace(scan, range_min_m=0.5)).seen is not True


def posts_strategy() -> st.SearchStrategy[list[tuple[float, float, float]]]:
    return st.lists(
        st.builds(post, st.floats(-180, 180), st.floats(0.2, 0.8), st.floats(0.01, 0.12)), min_size=0, max_size=5
    )


@pytest.mark.parametrize("name", sorted(DETECTORS))
@settings(deadline=None)
@given(posts=posts_strategy(), yaw_rad=st.floats(-3, 3), dropped=st.floats(0, 0.3))
def test_a_mirrored_scan_has_the_mirrored_cue(
    name: str, posts: list[tuple[float, float, float]], yaw_rad: float, dropped: float
) -> None:
    scan = with_missing(open_scan(posts=posts, yaw_rad=yaw_rad, beams=240), dropped, math.nan)
    here, there = DETECTORS[name]().look(scan), DETECTORS[name]().look(mirrored(scan))
    assert here.seen is there.seen
    assert len(here.evidence) == len(there.evidence)
    for sighting in here.evidence:
        assert any(is_mirror(sighting, other) for other in there.evidence), sighting


def is_mirror(a: Sighting, b: Sighting) -> bool:
    swap = {"left side": "right side", "right side": "left side"}
    return (
        swap.get(a.what, a.what) == b.what
        and a.range_m == pytest.approx(b.range_m, abs=1e-9)
        and abs(wrap_rad(a.bearing_rad + b.bearing_rad)) < 1e-9
    )


def test_wrong_spans_are_refused() -> None:
    with pytest.raises(ValidationError, match="range_min_m"):
        OppositeMarkersConfig(range_min_m=0.5)
    with pytest.raises(ValidationError, match="width_min_m"):
        OppositeMarkersConfig(width_min_m=0.5)
    assert OpenSpaceConfig().corners_min == 2
