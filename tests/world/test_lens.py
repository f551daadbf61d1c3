"""The lens model against OpenCV's two, its exact inverse, its fold, and its way into the base frame."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotd.world.lens import Lens, MountedLens
from robotd.world.robot import Mount
from robotd.world.rotation import sensor_base

PINHOLE = Lens(640, 480, 520.0, 515.0, 322.3, 238.1, "pinhole", (-0.28, 0.09, 0.0012, -0.0007, -0.011))
RADIAL = Lens(640, 480, 520.0, 515.0, 322.3, 238.1, "pinhole", (-0.28, 0.09))
BARREL = Lens(640, 480, 400.0, 400.0, 319.5, 239.5, "pinhole", (0.11, 0.04, -0.002, 0.003, 0.01))
IDEAL = Lens.of_fov(640, 480, 1.2)
FISHEYE = Lens(640, 480, 285.0, 284.0, 318.2, 241.7, "fisheye", (-0.012, 0.006, -0.004, 0.0006))
EQUIDISTANT = Lens.of_fov(640, 480, 2.8, "fisheye")
LENSES = {
    "pinhole": PINHOLE,
    "radial": RADIAL,
    "barrel": BARREL,
    "ideal": IDEAL,
    "fisheye": FISHEYE,
    "equidistant": EQUIDISTANT,
}
rows, columns = np.mgrid[0:480:11, 0:640:13]
GRID = np.column_stack((columns.ravel(), rows.ravel())).astype(np.float64)


def matrix(lens: Lens) -> Any:
    return np.array([[lens.fx_px, 0.0, lens.cx_px], [0.0, lens.fy_px, lens.cy_px], [0.0, 0.0, 1.0]])


def opencv_rays(lens: Lens, pixels: Any) -> Any:
    if lens.model == "fisheye":
        terms = np.array(lens.distortion + (0.0,) * (4 - len(lens.distortion)))
        plane = cv2.fisheye.undistortPoints(pixels[:, None], matrix(lens), terms, criteria=(3, 100, 1e-14))[:, 0]
    else:
        terms = np.array(lens.distortion + (0.0,) * (5 - len(lens.distortion)))
        plane = cv2.undistortPoints(pixels[:, None], matrix(lens), terms, criteria=(3, 300, 1e-14))[:, 0]
    rays = np.column_stack((plane, np.ones(len(plane))))
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


@pytest.mark.parametrize("name", LENSES)
def test_rays_are_those_of_opencv(name: str) -> None:
    lens = LENSES[name]
    ours, theirs = lens.rays(GRID), opencv_rays(lens, GRID)
    near = ours[:, 2] > 0.2  # OpenCV knows a fisheye's rays by their tangent, which is of no use near 90 degrees
    assert near.sum() > 1500
    np.testing.assert_allclose(ours[near], theirs[near], atol=1e-8)


@pytest.mark.parametrize("name", LENSES)
def test_pixels_are_those_of_opencv(name: str) -> None:
    lens = LENSES[name]
    points = np.random.default_rng(1).uniform((-0.7, -0.5, 0.9), (0.7, 0.5, 2.0), (400, 3))
    terms = np.array(lens.distortion + (0.0,) * ((4 if lens.model == "fisheye" else 5) - len(lens.distortion)))
    project = cv2.fisheye.projectPoints if lens.model == "fisheye" else cv2.projectPoints
    theirs = project(points[:, None], np.zeros(3), np.zeros(3), matrix(lens), terms)[0].reshape(-1, 2)
    np.testing.assert_allclose(lens.pixels(points), theirs, atol=1e-8)


@pytest.mark.parametrize("name", LENSES)
def test_there_and_back_is_exact(name: str) -> None:
    lens = LENSES[name]
    rays = lens.rays(GRID)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(lens.pixels(7.5 * rays), GRID, atol=1e-9)


@given(
    k=st.tuples(*[st.floats(-0.3, 0.3)] * 3),
    p=st.tuples(*[st.floats(-0.01, 0.01)] * 2),
    at=st.tuples(st.floats(0.0, 639.0), st.floats(0.0, 479.0)),
    fisheye=st.booleans(),
)
def test_a_ray_that_is_given_leads_back_to_its_pixel(
    k: tuple[float, float, float], p: tuple[float, float], at: tuple[float, float], fisheye: bool
) -> None:
    terms = k if fisheye else (k[0], k[1], *p, k[2])
    lens = Lens(640, 480, 500.0, 500.0, 320.0, 240.0, "fisheye" if fisheye else "pinhole", terms)
    (ray,) = lens.rays(np.array([at]))
    if not np.isnan(ray).any():
        np.testing.assert_allclose(lens.pixels(ray[None])[0], at, atol=1e-6)


def test_beyond_the_fold_nothing_is_invented() -> None:
    lens = Lens(640, 480, 200.0, 200.0, 319.5, 239.5, "pinhole", (-0.3,))
    fold = math.sqrt(1.0 / 0.9)  # 1 - 3 * 0.3 * r^2 = 0
    inside, outside = np.array([[0.999 * fold, 0.0, 1.0]]), np.array([[1.001 * fold, 0.0, 1.0], [4.0, 0.0, 1.0]])
    assert not np.isnan(lens.pixels(inside)).any()
    assert np.isnan(lens.pixels(outside)).all()
    edge = float(lens.pixels(np.array([[fold * (1 - 1e-12), 0.0, 1.0]]))[0, 0])
    rays = lens.rays(np.array([[edge - 0.5, 239.5], [edge + 0.5, 239.5]]))
    assert not np.isnan(rays[0]).any()
    assert np.isnan(rays[1]).all()


def test_behind_the_camera() -> None:
    behind = np.array([[0.3, 0.0, -0.1], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    assert np.isnan(IDEAL.pixels(behind)).all()
    seen = EQUIDISTANT.pixels(behind)
    assert np.isfinite(seen[0]).all() and np.isnan(seen[1]).all() and np.isfinite(seen[2]).all()
    np.testing.assert_allclose(EQUIDISTANT.rays(seen[:1])[0], behind[0] / np.linalg.norm(behind[0]), atol=1e-12)


@pytest.mark.parametrize("model", ["pinhole", "fisheye"])
def test_field_of_view_is_from_edge_to_edge(model: Any) -> None:
    lens = Lens.of_fov(320, 240, 1.5, model)
    left, right = lens.rays(np.array([[-0.5, 119.5], [319.5, 119.5]]))
    assert math.acos(float(left @ right)) == pytest.approx(1.5)


def test_a_resized_picture_shows_the_same_rays() -> None:
    small = FISHEYE.scaled(160, 240)
    # the corners of the pictures stay where they are
    big_px = np.array([[-0.5, -0.5], [639.5, 479.5], [100.0, 300.0]])
    small_px = (big_px + 0.5) * (160 / 640, 240 / 480) - 0.5
    np.testing.assert_allclose(small.rays(small_px), FISHEYE.rays(big_px), atol=1e-12)


@pytest.mark.parametrize(
    ("mount", "pixel", "bearing", "elevation"),
    [
        (Mount(), (319.5, 239.5), 0.0, 0.0),
        (Mount(pitch_rad=0.35), (319.5, 239.5), 0.0, -0.35),  # nose down
        (Mount(yaw_rad=0.5), (319.5, 239.5), 0.5, 0.0),
        (Mount(), (0.0, 239.5), math.atan(319.5 / IDEAL.fx_px), 0.0),  # the left edge is to the left
        (Mount(), (319.5, 0.0), 0.0, math.atan(239.5 / IDEAL.fy_px)),  # the upper edge is above
        (Mount(roll_rad=math.pi / 2), (0.0, 239.5), 0.0, math.atan(319.5 / IDEAL.fx_px)),
    ],
)
def test_bearings(mount: Mount, pixel: tuple[float, float], bearing: float, elevation: float) -> None:
    found = MountedLens(IDEAL, mount).bearings_rad(np.array([pixel]))
    np.testing.assert_allclose(found, [[bearing, elevation]], atol=1e-12)


def test_points_of_base_and_back() -> None:
    view = MountedLens(FISHEYE, Mount(0.06, -0.02, 0.11, 0.05, 0.35, -0.4))
    points = np.random.default_rng(2).uniform((0.3, -1.0, 0.0), (3.0, 1.0, 0.4), (200, 3))
    rays = view.rays_base(view.pixels(points))
    along = points - (0.06, -0.02, 0.11)
    np.testing.assert_allclose(rays, along / np.linalg.norm(along, axis=1, keepdims=True), atol=1e-10)


@pytest.mark.parametrize(
    ("mount", "forward", "left"),
    [
        (Mount(yaw_rad=math.pi / 2), (0, 1, 0), (-1, 0, 0)),
        (Mount(pitch_rad=math.pi / 2), (0, 0, -1), (0, 1, 0)),
        (Mount(roll_rad=math.pi / 2), (1, 0, 0), (0, 0, 1)),
        (Mount(roll_rad=math.pi / 2, yaw_rad=math.pi / 2), (0, 1, 0), (0, 0, 1)),
    ],
)
def test_mounts_turn_as_rep_103_says(mount: Mount, forward: Any, left: Any) -> None:
    turn = sensor_base(mount)
    np.testing.assert_allclose(turn @ (1, 0, 0), forward, atol=1e-12)
    np.testing.assert_allclose(turn @ (0, 1, 0), left, atol=1e-12)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Lens(640, 480, 0.0, 1.0, 1.0, 1.0), "positive width, height and focal length"),
        (lambda: Lens(640, 480, 1.0, 1.0, 1.0, 1.0, "fisheye", (0.0,) * 5), "a fisheye lens takes up to 4"),
        (lambda: Lens(640, 480, 1.0, 1.0, 1.0, 1.0, "pinhole", (math.nan,)), "finite terms"),
        (lambda: Lens.of_fov(640, 480, math.pi), "a pinhole lens cannot show 180 degrees"),
        (lambda: Lens.of_fov(640, 480, 3.0, "fisheye", distortion=(-0.4,)), "folds the picture within"),
    ],
)
def test_impossible_lenses_are_refused(make: Any, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        make()
