"""Occupancy pictures become exact edges, and real race tracks a room whose walls are where the track file says."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robotd_devices.sim.grid import edges_m
from robotd_devices.sim.maps import MapError, load_map
from robotd_devices.sim.rays import cast

NO_POSTS = np.empty((0, 3))


def drawn(picture: str) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Rows as written, the last one lowest."""
    return np.array([[cell == "#" for cell in row] for row in picture.split()])[::-1]


@pytest.mark.parametrize(
    ("picture", "count"),
    [("#", 4), ("##", 4), ("#. ##", 6), ("### #.# ###", 8), ("#. .#", 6), ("...", 0)],
)
def test_neighbouring_edges_are_one_segment(picture: str, count: int) -> None:
    assert len(edges_m(drawn(picture), 0.05, (0.0, 0.0, 0.0))) == count


def test_a_cell_stands_where_resolution_and_origin_put_it() -> None:
    segments = edges_m(drawn("... .#. ..."), 0.1, (-1.0, 2.0, 0.0))
    assert (segments[:, [0, 2]].min(), segments[:, [0, 2]].max()) == pytest.approx((-0.9, -0.8))
    assert (segments[:, [1, 3]].min(), segments[:, [1, 3]].max()) == pytest.approx((2.1, 2.2))
    turned = edges_m(drawn("... .#. ..."), 0.1, (-1.0, 2.0, math.pi / 2.0))
    assert (turned[:, [0, 2]].min(), turned[:, [0, 2]].max()) == pytest.approx((-1.2, -1.1))


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 2**32 - 1))
def test_a_ray_ends_where_a_walk_over_the_cells_ends(seed: int) -> None:
    rng = np.random.default_rng(seed)
    occupied = rng.random((9, 9)) < 0.3
    occupied[4, 4] = False
    segments = edges_m(occupied, 1.0, (0.0, 0.0, 0.0))
    start = 4.0 + rng.uniform(0.2, 0.8, 2)
    bearings = rng.uniform(-math.pi, math.pi, 8)
    for bearing, found in zip(bearings, cast(start, bearings, segments, NO_POSTS), strict=True):
        way = np.arange(0.0, 14.0, 0.001)[:, None] * (math.cos(bearing), math.sin(bearing)) + start
        cells = np.floor(way).astype(int)
        on = ((cells >= 0) & (cells < 9)).all(axis=1)
        hit = np.zeros(len(way), dtype=bool)
        hit[on] = occupied[cells[on, 1], cells[on, 0]]
        walked = float(hit.argmax()) * 0.001 if hit.any() else math.inf
        # a corner may be cut by less than a step
        assert found == pytest.approx(walked, abs=2e-3) or found < walked


def test_thresholds_negation_and_the_wrapped_form(tmp_path: Path) -> None:
    import cv2

    grey = np.array([[0, 100, 205, 254]], dtype=np.uint8)
    cv2.imwrite(str(tmp_path / "room.pgm"), grey)
    common = "image: room.pgm\nresolution: 1.0\norigin: [0, 0, 0]\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    (tmp_path / "room.yaml").write_text(common + "negate: 0\n")
    (tmp_path / "dark.yaml").write_text(common + "negate: 1\n")
    (tmp_path / "ours.yaml").write_text(
        "start: {x_m: 2.5, y_m: 0.5}\ngrid: {file: room.yaml}\nwalls: [{points_m: [[0, 9], [1, 9]]}]"
    )
    assert load_map(str(tmp_path / "room.yaml")).bounds_m()[2] == 1.0, "only the black cell is a wall"
    assert load_map(str(tmp_path / "dark.yaml")).segments_m[:, [0, 2]].min() == 2.0
    ours = load_map(str(tmp_path / "ours.yaml"))
    assert (len(ours.segments_m), ours.start) == (5, (2.5, 0.5, 0.0))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("image: no.png\nresolution: 1\norigin: [0, 0, 0]", "image: no.png: no such picture"),
        ("image: bad.yaml\nresolution: 1\norigin: [0, 0, 0]", "not one that can be read"),
        ("image: no.png\nresolution: 0\norigin: [0, 0, 0]", "resolution: .*greater than 0"),
        ("image: no.png\nresolution: 1\norigin: [0, 0, 0]\nmode: raw", "mode: "),
    ],
)
def test_a_bad_occupancy_map_is_refused_naming_file_and_place(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "bad.yaml").write_text(text)
    with pytest.raises(MapError, match=rf"(?s)bad\.yaml.*{words}"):
        load_map(str(tmp_path / "bad.yaml"))


@pytest.mark.parametrize("name", ["aut", "gbr"])
def test_walls_of_a_real_track_are_as_far_from_its_middle_as_its_file_says(data_dir: Path, name: str) -> None:
    world = load_map(str(data_dir / "tracks_evans" / f"{name}.yaml"))
    middle = np.loadtxt(data_dir / "tracks_evans" / f"{name}_centerline.csv", delimiter=",")[::10]
    ahead = np.roll(middle, -1, axis=0) - np.roll(middle, 1, axis=0)
    heading = np.arctan2(ahead[:, 1], ahead[:, 0])
    for column, side in ((2, -math.pi / 2.0), (3, math.pi / 2.0)):
        found = np.array(
            [
                cast(place, np.array([way]), world.segments_m, NO_POSTS)[0]
                for place, way in zip(middle[:, :2], heading + side, strict=True)
            ]
        )
        # half widths are those of the nearest wall, in cells of 5 cm
        assert np.median(np.abs(found - middle[:, column])) < 0.06
        assert np.abs(found - middle[:, column]).max() < 0.4
