"""Ray casting against exact geometry: worked cases, and a slow oracle on random worlds."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robotd.world.messages import Float64s
from robotd_devices.sim.rays import cast

NOTHING = np.empty((0, 4))
NO_POSTS = np.empty((0, 3))
BOX = np.array([(-2.0, -1.0, 3.0, -1.0), (3.0, -1.0, 3.0, 2.0), (3.0, 2.0, -2.0, 2.0), (-2.0, 2.0, -2.0, -1.0)])


def slow(origins_m: Float64s, bearings_rad: Float64s, segments_m: Float64s, circles_m: Float64s) -> Float64s:
    """One ray and one obstacle at a time, each by a way of its own: 2 x 2 systems and the quadratic formula."""
    ranges = np.full(len(bearings_rad), math.inf)
    for index, bearing in enumerate(bearings_rad):
        ox, oy = origins_m if origins_m.ndim == 1 else origins_m[index]
        cos, sin = math.cos(bearing), math.sin(bearing)
        for x0, y0, x1, y1 in segments_m:
            matrix = np.array([[cos, x0 - x1], [sin, y0 - y1]])
            if abs(np.linalg.det(matrix)) > 0.0:
                reach, share = np.linalg.solve(matrix, np.array([x0 - ox, y0 - oy]))
                if reach >= 0.0 and 0.0 <= share <= 1.0:
                    ranges[index] = min(ranges[index], reach)
        for cx, cy, radius in circles_m:
            half_b = (ox - cx) * cos + (oy - cy) * sin
            rest = half_b**2 - ((ox - cx) ** 2 + (oy - cy) ** 2 - radius**2)
            if rest >= 0.0:
                for root in (-half_b - math.sqrt(rest), -half_b + math.sqrt(rest)):
                    if root >= 0.0:
                        ranges[index] = min(ranges[index], root)
                        break
    return ranges


@pytest.mark.parametrize(
    ("origin", "bearing_deg", "expected_m"),
    [
        ((0.0, 0.0), 0.0, 3.0),
        ((0.0, 0.0), 90.0, 2.0),
        ((0.0, 0.0), 180.0, 2.0),
        ((0.0, 0.0), -90.0, 1.0),
        ((0.0, 0.0), 45.0, 2.0 * math.sqrt(2.0)),
        ((0.0, 0.0), math.degrees(math.atan2(2.0, 3.0)), math.sqrt(13.0)),
        ((1.0, 1.0), -30.0, 4.0 / math.sqrt(3.0)),
        ((0.0, 0.0), 360.0 * 3 + 90.0, 2.0),
        ((0.0, 0.0), -270.0, 2.0),
    ],
)
def test_ranges_in_a_box_are_those_of_the_drawing(
    origin: tuple[float, float], bearing_deg: float, expected_m: float
) -> None:
    found = cast(np.array(origin), np.radians([bearing_deg]), BOX, NO_POSTS)
    assert found[0] == pytest.approx(expected_m, abs=1e-9)


@pytest.mark.parametrize(
    ("circle", "bearing_deg", "expected_m"),
    [
        ((2.0, 0.0, 0.5), 0.0, 1.5),
        ((2.0, 0.0, 0.5), math.degrees(math.asin(0.25)) - 1e-7, math.sqrt(4.0 - 0.25)),
        ((2.0, 0.0, 0.5), math.degrees(math.asin(0.25)) + 1e-7, math.inf),
        ((2.0, 0.0, 0.5), 180.0, math.inf),
        ((-2.0, 0.0, 0.5), 180.0, 1.5),
        ((0.1, 0.0, 0.5), 0.0, 0.6),
        ((0.1, 0.0, 0.5), 180.0, 0.4),
    ],
)
def test_posts_are_round_also_from_inside(
    circle: tuple[float, float, float], bearing_deg: float, expected_m: float
) -> None:
    found = cast(np.zeros(2), np.radians([bearing_deg]), NOTHING, np.array([circle]))
    assert found[0] == pytest.approx(expected_m, abs=1e-4)


def test_the_nearer_of_two_counts_whatever_their_order() -> None:
    walls = np.array([(2.0, -1.0, 2.0, 1.0), (1.0, -1.0, 1.0, 1.0)])
    for order in (walls, walls[::-1]):
        assert cast(np.zeros(2), np.zeros(1), order, NO_POSTS)[0] == 1.0


def test_nothing_around_is_infinite_and_no_rays_are_none() -> None:
    assert np.isinf(cast(np.zeros(2), np.linspace(-3, 3, 7), NOTHING, NO_POSTS)).all()
    assert cast(np.zeros(2), np.empty(0), BOX, NO_POSTS).shape == (0,)


coordinate = st.floats(-8.0, 8.0)
walls = st.lists(st.tuples(coordinate, coordinate, coordinate, coordinate), max_size=60).map(
    lambda rows: np.array([row for row in rows if math.hypot(row[2] - row[0], row[3] - row[1]) > 1e-3]).reshape(-1, 4)
)
posts = st.lists(st.tuples(coordinate, coordinate, st.floats(0.01, 3.0)), max_size=6).map(
    lambda rows: np.array(rows).reshape(-1, 3)
)


@settings(deadline=None, max_examples=80)
@given(walls, posts, st.integers(0, 2**32 - 1), st.booleans(), st.floats(-20.0, 20.0))
def test_fast_and_slow_agree_within_a_micrometre(
    segments_m: Float64s, circles_m: Float64s, seed: int, moving: bool, turn_rad: float
) -> None:
    rng = np.random.default_rng(seed)
    bearings = turn_rad + np.linspace(-math.pi, math.pi, 24, endpoint=False) + rng.uniform(0.0, 1.0)
    origins = rng.uniform(-8.0, 8.0, 2)
    if moving:
        origins = origins + rng.uniform(-0.5, 0.5, (len(bearings), 2))
    fast, exact = cast(origins, bearings, segments_m, circles_m), slow(origins, bearings, segments_m, circles_m)
    differs = ~np.isclose(fast, exact, rtol=0.0, atol=1e-6, equal_nan=True)
    # a ray through the very end of a wall may meet or pass it: then a hair to one side must agree
    for index in np.flatnonzero(differs):
        origin = origins if origins.ndim == 1 else origins[index]
        beside = [
            slow(origin, bearings[index : index + 1] + nudge, segments_m, circles_m)[0] for nudge in (-1e-9, 1e-9)
        ]
        assert any(abs(fast[index] - near) < 1e-3 or fast[index] == near for near in beside)


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 2**32 - 1))
def test_order_and_number_of_rays_change_no_range(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ends = rng.uniform(-8, 8, (70, 2))
    segments_m = np.hstack((ends, ends + rng.normal(0, 2, (70, 2))))
    bearings = rng.uniform(-10, 10, 50)
    whole = cast(np.zeros(2), bearings, segments_m, NO_POSTS)
    shuffled = rng.permutation(50)
    assert np.array_equal(cast(np.zeros(2), bearings[shuffled], segments_m, NO_POSTS), whole[shuffled])
    assert np.array_equal(cast(np.zeros(2), bearings[:7], segments_m, NO_POSTS), whole[:7])
