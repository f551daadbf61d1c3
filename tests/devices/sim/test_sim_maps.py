"""Map files: the shipped ones hold what they promise, bad ones are refused in words, corners become arcs."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from robotd_devices.sim.maps import MapError, WorldMap, find_map, load_map
from robotd_devices.sim.polyline import distance_to_segments_m, rounded


def crossings(world: WorldMap) -> int:
    """Places where pieces of tape cross inside both."""
    pieces = [(index, at, piece) for index, line in enumerate(world.lines) for at, piece in enumerate(line.segments_m)]
    count = 0
    for first, (line_a, at_a, a) in enumerate(pieces):
        for line_b, at_b, b in pieces[first + 1 :]:
            if line_a == line_b and abs(at_a - at_b) <= 1:
                continue
            (px, py), (rx, ry) = a[:2], a[2:] - a[:2]
            (qx, qy), (sx, sy) = b[:2], b[2:] - b[:2]
            turn = rx * sy - ry * sx
            if abs(turn) > 1e-12:
                t = ((qx - px) * sy - (qy - py) * sx) / turn
                u = ((qx - px) * ry - (qy - py) * rx) / turn
                count += 1e-9 < t <= 1.0 - 1e-9 and 1e-9 < u <= 1.0 - 1e-9
    return count


@pytest.mark.parametrize(("name", "expected"), [("line_track", 2), ("line_loop", 1)])
def test_shipped_maps_have_their_crossings_and_room_around(name: str, expected: int) -> None:
    world = load_map(name)
    assert world.name == name
    assert crossings(world) == expected
    course = world.lines[0].points_m
    posts_m = np.hypot(*(course[:, None, :] - world.circles_m[None, :, :2]).transpose(2, 0, 1)) - world.circles_m[:, 2]
    assert distance_to_segments_m(course, world.segments_m).min() > 1.0
    assert posts_m.min() > 0.7
    assert world.line_distance_m(np.array([world.start[:2]]))[0] < 1e-9
    turns = np.unwrap(np.arctan2(*np.diff(course, axis=0).T[::-1]))
    assert np.abs(np.diff(turns)).max() < math.radians(5)


def test_the_track_ends_and_the_loop_does_not() -> None:
    track, loop = load_map("line_track").lines[0], load_map("line_loop").lines[0]
    assert not track.closed
    assert loop.closed
    assert np.array_equal(loop.points_m[0], loop.points_m[-1])


def test_a_rounded_corner_is_an_arc_of_its_radius_tangent_to_both_sides() -> None:
    line = rounded([(0.0, 0.0), (2.0, 0.0), (2.0, 2.0)], 0.5, closed=False)
    arc = line[1:-1]
    assert np.hypot(arc[:, 0] - 1.5, arc[:, 1] - 0.5) == pytest.approx(np.full(len(arc), 0.5))
    assert (line[0], line[-1]) == (pytest.approx((0.0, 0.0)), pytest.approx((2.0, 2.0)))
    assert arc[0] == pytest.approx((1.5, 0.0))
    assert arc[-1] == pytest.approx((2.0, 0.5))


def test_an_arc_takes_no_more_than_half_of_a_side() -> None:
    ring = rounded([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)], 9.0, closed=True)
    assert np.hypot(ring[:, 0] - 0.5, ring[:, 1] - 0.5) == pytest.approx(np.full(len(ring), 0.5))
    assert rounded([(0.0, 0.0), (1.0, 0.0), (2.0, 0.0)], 0.3, closed=False)[1] == pytest.approx((1.0, 0.0))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("lines: [{points_m: [[0, 0]]}]", r"lines\.0\.points_m: .*at least 2"),
        ("lines: [{points_m: [[0, 0], [0, 0]]}]", r"lines\[0\]\.points_m\[1\] repeats the corner"),
        ("lines: [{points_m: [[0, 0], [1, 0]], widht_m: 0.05}]", r"lines\.0\.widht_m: Extra inputs"),
        ("posts: [{x_m: 0, y_m: 0, radius_m: 0}]", r"posts\.0\.radius_m: .*greater than 0"),
        ("posts: [{x_m: .nan, y_m: 0, radius_m: 1}]", r"posts\.0\.x_m: .*finite"),
        ("start: {x: 1}", r"start\.x: Extra inputs"),
        ("start: {x_m: 1}\nstart: {x_m: 2}", "duplicate key"),
        ("[1, 2]", "expected keys such as start"),
        ("walls: [{points_m: [[0, 0], [1, 0]", "while parsing"),
    ],
)
def test_a_bad_map_is_refused_naming_file_and_place(tmp_path: Path, text: str, words: str) -> None:
    file = tmp_path / "bad.yaml"
    file.write_text(text)
    with pytest.raises(MapError, match=rf"(?s)bad\.yaml.*{words}"):
        load_map(str(file))


def test_maps_are_found_by_path_and_by_name_with_or_without_ending(tmp_path: Path) -> None:
    own = tmp_path / "own.yaml"
    own.write_text("name: own")
    assert find_map(str(own)) == own
    assert find_map("line_loop") == find_map("line_loop.yaml")
    with pytest.raises(MapError, match=r"no such file, and no such shipped map \(shipped: line_loop, line_track"):
        find_map("line_lop")


def test_an_empty_map_is_an_open_field(tmp_path: Path) -> None:
    own = tmp_path / "own.yaml"
    own.write_text("name: own")
    world = load_map(str(own))
    assert world.segments_m.shape == (0, 4)
    assert np.isinf(world.line_distance_m(np.zeros((1, 2)))).all()
