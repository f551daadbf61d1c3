"""The small worlds: each beam meets the wall or post where plane geometry says it does."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotd import LidarScan
from robotd.testing import box_scan, corridor_scan, open_scan
from robotd.world.geometry import scan_points_base


def ahead(scan: LidarScan, bearing_rad: float) -> float:
    """The range of the beam nearest to a bearing in the lidar's frame."""
    off = np.abs(np.angle(np.exp(1j * (scan.angles_rad.astype(float) - bearing_rad))))
    return float(scan.ranges_m[int(np.argmin(off))])


def test_open_ground_is_inf_everywhere() -> None:
    scan = open_scan(stamp_ns=5, beams=90)
    assert scan.ranges_m.shape == (90,)
    assert np.isposinf(scan.ranges_m).all()
    assert scan.stamp_ns == scan.start_ns == 5


def test_the_sides_of_a_box() -> None:
    scan = box_scan(1.0, 2.0, 3.0, 4.0)
    measured = [ahead(scan, bearing) for bearing in (0.0, math.pi / 2, -math.pi, -math.pi / 2)]
    assert measured == pytest.approx([1.0, 2.0, 3.0, 4.0], rel=1e-6)


@given(
    st.floats(0.6, 3.0), st.floats(-0.2, 0.2), st.floats(-1.0, 1.0), st.floats(-0.1, 0.1), st.floats(-3.0, 3.0)
)  # fmt: skip
def test_corridor_points_lie_on_its_walls(
    width_m: float, offset_m: float, heading_rad: float, x_m: float, yaw_rad: float
) -> None:
    scan = corridor_scan(width_m, offset_m=offset_m, heading_rad=heading_rad, x_m=x_m, yaw_rad=yaw_rad, ahead_m=2.0)
    points = scan_points_base(scan)
    assert len(points) > 100
    along = math.cos(heading_rad) * points[:, 0] - math.sin(heading_rad) * points[:, 1]
    across = math.sin(heading_rad) * points[:, 0] + math.cos(heading_rad) * points[:, 1] + offset_m
    on_side = np.abs(np.abs(across) - width_m / 2.0) < 1e-4
    on_end = np.abs(along - 2.0) < 1e-4
    assert (on_side | on_end).all()
    assert (np.abs(across) < width_m / 2.0 + 1e-4).all()
    assert (along < 2.0 + 1e-4).all()


def test_posts_hide_what_is_behind_them() -> None:
    scan = box_scan(posts=[(1.0, 0.0, 0.1), (0.0, 0.0, 0.01)], x_m=0.2)
    assert ahead(scan, 0.0) == pytest.approx(0.7)
    assert ahead(scan, math.pi / 2) == pytest.approx(2.0)
    inside = open_scan(posts=[(0.0, 0.0, 0.5)])
    assert (inside.ranges_m == 0.0).all()
    beside = open_scan(posts=[(1.0, 0.5, 0.1)])
    assert 0 < np.isfinite(beside.ranges_m).sum() < 30


def test_nothing_is_seen_beyond_the_range() -> None:
    assert np.isinf(ahead(corridor_scan(1.0, ahead_m=9.0, range_max_m=8.0), 0.0))
    assert ahead(corridor_scan(1.0, ahead_m=7.0, range_max_m=8.0), 0.0) == pytest.approx(7.0)


def test_standing_behind_a_wall_is_refused() -> None:
    with pytest.raises(ValueError, match="behind the wall"):
        corridor_scan(0.5, offset_m=0.4)
    with pytest.raises(ValueError, match="behind the wall"):
        box_scan(0.1, x_m=0.2)
