"""The lens's mathematics, rendered lines against projected truth, grey levels against the real pictures."""

from __future__ import annotations

import asyncio
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from robotd.authoring.device import DeviceContext, DeviceMisconfigured
from robotd.world.lens import Lens
from robotd.world.messages import Drive, Float64s
from robotd.world.robot import Mount, Robot
from robotd_devices.sim import FloorLine, SimBase, SimBaseConfig, SimCamera, SimCameraConfig, load_map
from robotd_devices.sim.lens import FloorCamera, floor_to_base
from robotd_devices.sim.maps import map_from_segments
from robotd_devices.sim.render import Renderer
from robotd_devices.sim.world import world_from_segments

MOUNT = Mount(x_m=0.06, z_m=0.11, pitch_rad=0.35)
CLEAN: dict[str, Any] = {
    "grain_std": 0.0,
    "patches_std": 0.0,
    "gloss": 0.0,
    "vignette": 0.0,
    "noise_std": 0.0,
    "brightness": 1.0,
    "light_drift": 0.0,
    "tint_drift": 0.0,
    "shadows_per_m2": 0.0,
    "jpeg_quality": None,
}
WIDE = Lens.of_fov(320, 240, 2.1, "fisheye")


# ------------------------------------------------------------------------------------------------- lens


@pytest.mark.parametrize(
    ("values", "down_rad"),
    [
        ({"fov_rad": 1.2, "distortion": None}, None),
        ({"fov_rad": 2.1, "width_px": 224, "height_px": 224, "vertical_fov_rad": 1.75}, 1.75),
        ({"fov_rad": 2.4, "distortion": (0.05, -0.01, 0.0, 0.0)}, None),
        ({"fov_rad": 3.4}, None),
    ],
)
def test_the_edges_of_the_picture_are_half_the_field_of_view_off_the_axis(
    values: dict[str, Any], down_rad: float | None
) -> None:
    lens = SimCameraConfig(**values).lens()
    left, top = lens.rays(np.array([[-0.5, lens.cy_px], [lens.cx_px, -0.5]]))
    assert math.atan2(-left[0], left[2]) == pytest.approx(values["fov_rad"] / 2.0, abs=1e-9)
    if down_rad is None:
        assert lens.fx_px == lens.fy_px
    else:
        assert math.atan2(-top[1], top[2]) == pytest.approx(down_rad / 2.0, abs=1e-9)


@pytest.mark.parametrize(
    ("mount", "floor_m", "where"),
    [
        (Mount(z_m=0.1, pitch_rad=math.pi / 4), (0.1, 0.0), "centre"),
        (Mount(x_m=0.2, z_m=0.1, pitch_rad=math.pi / 4), (0.3, 0.0), "centre"),
        (Mount(z_m=0.1, pitch_rad=math.pi / 4, yaw_rad=math.pi / 2), (0.0, 0.1), "centre"),
        (MOUNT, (0.4, 0.1), "left"),
        (MOUNT, (0.4, -0.1), "right"),
        (Mount(z_m=0.11, pitch_rad=0.35, roll_rad=0.2), (0.11 / math.tan(0.35), 0.0), "centre"),
    ],
)
def test_floor_points_fall_where_the_mount_says(mount: Mount, floor_m: tuple[float, float], where: str) -> None:
    camera = FloorCamera(WIDE, mount)
    across, down = camera.floor_px(np.array([floor_m]))[0]
    assert camera.floor_m(np.array([[across, down]]))[0] == pytest.approx(floor_m, abs=1e-9)
    if where == "centre":
        assert (across, down) == pytest.approx((WIDE.cx_px, WIDE.cy_px), abs=1e-6)
    else:
        assert (across < WIDE.cx_px) == (where == "left")


def test_a_roll_to_the_right_side_lifts_the_left_of_the_picture_s_world() -> None:
    # REP-103: positive roll about x puts the robot's left side up, so the floor on the left falls lower in the picture
    level, rolled = (FloorCamera(WIDE, Mount(z_m=0.11, pitch_rad=0.35, roll_rad=roll)) for roll in (0.0, 0.1))
    left = np.array([[0.3, 0.15]])
    assert rolled.floor_px(left)[0, 1] > level.floor_px(left)[0, 1]


def test_above_the_horizon_there_is_no_floor_and_behind_no_pixel() -> None:
    camera = FloorCamera(Lens.of_fov(320, 240, 1.2), MOUNT)
    assert np.isnan(camera.floor_m(np.array([[160.0, 0.0]]))).all()
    assert np.isnan(camera.floor_px(np.array([[-1.0, 0.0]]))).all()


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"fov_rad": 3.2, "distortion": None}, "a pinhole lens cannot show 183.*degrees"),
        ({"fov_rad": 3.0, "distortion": (-0.4, 0.0, 0.0, 0.0)}, "folds the picture"),
    ],
)
def test_a_lens_that_cannot_be_is_refused(values: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        SimCameraConfig(**values)


# ------------------------------------------------------------------------- rendered line against projection

TAPE = map_from_segments(lines=[FloorLine(np.array([(-1.0, 0.0), (3.0, 0.0)]))])


def render(lens: dict[str, Any], pose: tuple[float, float, float], world_map: Any = TAPE, **look: Any) -> Any:
    config = SimCameraConfig(**lens, **{**CLEAN, **look})
    camera = FloorCamera(config.lens(), MOUNT)
    return camera, Renderer(camera, world_map, config.look(), np.random.default_rng(0)).picture(pose)


def edges_px(grey: Float64s) -> tuple[Float64s, Float64s]:
    """Left and right edge of the dark stretch in each row where there is exactly one: pixels (n, 2) each."""
    middle = (82.0 + 200.0) / 2.0
    left, right = [], []
    for row, values in enumerate(grey):
        falls = np.flatnonzero((values[:-1] >= middle) & (values[1:] < middle))
        rises = np.flatnonzero((values[:-1] < middle) & (values[1:] >= middle))
        if len(falls) == 1 and len(rises) == 1 and falls[0] < rises[0]:
            for found, at in ((left, falls[0]), (right, rises[0])):
                found.append((at + (values[at] - middle) / (values[at] - values[at + 1]), row))
    return np.array(left), np.array(right)


def true_edge_px(camera: FloorCamera, lens: Lens, pose: tuple[float, float, float], side_m: float) -> Float64s:
    along = pose[0] + 0.02 + np.geomspace(0.02, 2.5, 4000)
    edge = floor_to_base(np.stack((along, np.full(len(along), side_m)), axis=1), pose)
    found = FloorCamera(lens, camera.mount).floor_px(edge)
    return found[~np.isnan(found).any(axis=1)]


def gap_px(points: Float64s, truth: Float64s) -> Float64s:
    """Distance of each point to the projected edge, drawn densely."""
    return np.array([np.hypot(*(truth - point).T).min() for point in points])


BARE = map_from_segments(lines=[FloorLine(np.array([(-0.5, y_m), (0.5, y_m)])) for y_m in (-3.0, 3.0)])
"""Floor without tape in sight of its middle."""

POSES = [(0.0, 0.0, 0.0), (0.31, 0.03, 0.12), (0.1003, -0.05, -0.25), (0.7, 0.011, 0.3)]


@pytest.mark.parametrize("pose", POSES)
@pytest.mark.parametrize("size", [(320, 240), (224, 224)])
def test_before_distortion_the_rendered_line_is_where_projection_puts_it(
    pose: tuple[float, float, float], size: tuple[int, int]
) -> None:
    lens = {"fov_rad": 1.3, "distortion": None, "width_px": size[0], "height_px": size[1]}
    camera, bgr = render(lens, pose)
    grey = bgr[..., 2].astype(np.float64)
    horizon = camera.floor_px(np.array([(1.5, 0.0)]))[0, 1]
    for found, side_m in zip(edges_px(grey), (0.025, -0.025), strict=True):
        found = found[found[:, 1] > horizon]
        assert len(found) > 60
        assert gap_px(found, true_edge_px(camera, camera.lens, pose, side_m)).max() < 0.5


@pytest.mark.parametrize("pose", POSES)
@pytest.mark.parametrize("distortion", [(0.0, 0.0, 0.0, 0.0), (0.04, -0.01, 0.0, 0.0)])
def test_after_distortion_is_undone_it_is_there_as_well(
    pose: tuple[float, float, float], distortion: tuple[float, float, float, float]
) -> None:
    camera, bgr = render({"fov_rad": 2.1, "distortion": distortion}, pose)
    grey = bgr[..., 2].astype(np.float64)
    horizon = camera.floor_px(np.array([(1.2, 0.0)]))[0, 1]
    plain = replace(camera.lens, model="pinhole", distortion=())
    for found, side_m in zip(edges_px(grey), (0.025, -0.025), strict=True):
        found = found[found[:, 1] > horizon]
        assert len(found) > 60
        undone = plain.pixels(camera.lens.rays(found))
        # undoing stretches the picture's margin: a margin's pixel is worth as many of the plain picture
        stretch = np.hypot(*(plain.pixels(camera.lens.rays(found + np.array((1.0, 0.0)))) - undone).T)
        gaps = gap_px(undone, true_edge_px(camera, plain, pose, side_m))
        assert (gaps / np.maximum(stretch, 1.0)).max() < 0.5
        inner = np.abs(undone[:, 0] - plain.cx_px) < 160
        assert gaps[inner & (undone[:, 1] < 240)].max() < 0.5


def test_where_the_tape_ends_the_floor_begins_at_the_right_row() -> None:
    ending = map_from_segments(lines=[FloorLine(np.array([(-1.0, 0.0), (0.5, 0.0)]))])
    camera, bgr = render({}, (0.0, 0.0, 0.0), ending)
    across, down = camera.floor_px(np.array([(0.5, 0.0)]))[0]
    column = bgr[:, round(across), 2].astype(float)
    dark = np.flatnonzero(column[75:] < 141.0) + 75
    assert abs(dark.min() - 0.5 - down) < 1.0


def test_beyond_the_drawn_floor_there_is_more_floor() -> None:
    for pose in [(40.0, -70.0, 1.0), (-300.0, 2.0, 0.3)]:
        _, bgr = render({}, pose)
        assert (bgr[120:, :, 2] == 200).all()


# -------------------------------------------------------------------------------------------- grey levels


def floor_parts(camera: FloorCamera, pose: tuple[float, float, float], world_map: Any) -> tuple[Any, Any]:
    """Masks of what is surely tape and surely floor within 1 m, from geometry alone."""
    width, height = camera.lens.width_px, camera.lens.height_px
    columns, rows = np.meshgrid(np.arange(width), np.arange(height))
    base_m = camera.floor_m(np.stack((columns.ravel(), rows.ravel()), axis=1).astype(float))
    near = np.flatnonzero(np.hypot(*base_m.T) < 1.0)
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    away_m = np.full(len(base_m), math.nan)
    away_m[near] = world_map.line_distance_m(base_m[near] @ np.array([[cos, sin], [-sin, cos]]) + pose[:2])
    return (away_m < 0.018).reshape(height, width), (away_m > 0.035).reshape(height, width)


@pytest.mark.parametrize("size", [{}, {"width_px": 224, "height_px": 224, "vertical_fov_rad": 1.75}], ids=str)
@pytest.mark.parametrize("seed", range(2))
def test_grey_levels_are_those_of_the_real_pictures(size: dict[str, Any], seed: int) -> None:
    import cv2

    world_map = load_map("line_track")
    config = SimCameraConfig(**size)
    camera = FloorCamera(config.lens(), MOUNT)
    renderer = Renderer(camera, world_map, config.look(), np.random.default_rng(seed))
    for pose in [(0.3, 0.0, 0.0), (0.6, 0.03, -0.2), (2.18, 0.5, 1.6)]:
        value = renderer.picture(pose).max(axis=2)
        tape, floor = floor_parts(camera, pose, world_map)
        otsu, _ = cv2.threshold(value[tape | floor], 0, 255, cv2.THRESH_OTSU)
        assert 66 <= np.median(value[tape]) <= 89
        assert 85 <= np.percentile(value[tape], 95) <= 115
        assert 129 <= np.percentile(value[floor], 1) <= 156
        assert np.median(value[floor]) <= 200
        assert 110 <= otsu <= 142


def test_the_real_pictures_have_these_levels_too(data_dir: Any) -> None:
    import cv2

    for name in ("test.jpg", "test2.jpg"):
        value = cv2.imread(str(data_dir / "jetbot" / "floor" / name)).max(axis=2)[115:]
        otsu, _ = cv2.threshold(value, 0, 255, cv2.THRESH_OTSU)
        assert 115 <= otsu <= 145
        assert 66 <= np.median(value[value < 110]) <= 89


@pytest.mark.parametrize("imperfection", ["grain_std", "patches_std", "gloss", "vignette", "noise_std"])
def test_each_imperfection_can_be_switched_on_alone(imperfection: str) -> None:
    _, clean = render({}, (0.0, 0.0, 0.0), BARE)
    _, worse = render({}, (0.0, 0.0, 0.0), BARE, **{imperfection: SimCameraConfig.model_fields[imperfection].default})
    assert (clean[130:, :, 2] == 200).all()
    assert (worse[130:] != clean[130:]).mean() > 0.05


def test_brightness_scales_and_saturates() -> None:
    _, dim = render({}, (0.0, 0.0, 0.0), BARE, brightness=0.5)
    _, glaring = render({}, (0.0, 0.0, 0.0), BARE, brightness=3.0)
    assert set(np.unique(dim[130:, :, 2])) == {100}
    assert set(np.unique(glaring[130:, :, 2])) == {255}


# ------------------------------------------------------------------------------------------------ device


def camera_rig(rig: Any, seconds: float, **values: Any) -> Any:
    devices = {
        "base": (SimBase, SimBaseConfig()),
        "camera": (SimCamera, SimCameraConfig(width_px=80, height_px=60, **values)),
    }
    run = rig(devices, robot=Robot(mounts={"camera": MOUNT}), seed=1)
    return run.run(seconds, [(0.0, lambda rig: rig.open["base"].apply(Drive(0.3)))])


def test_frames_are_stamped_with_the_exposure_and_come_after_the_latency(rig: Any) -> None:
    run = camera_rig(rig, 0.5, rate_hz=20.0, latency_s=0.03)
    assert [m.stamp_ns for m in run.messages["camera"]] == [50_000_000 * n for n in range(1, 10)]
    assert [m.sequence for m in run.messages["camera"]] == list(range(1, 10))
    assert all(m.bgr.shape == (60, 80, 3) and not m.bgr.flags.writeable for m in run.messages["camera"])
    assert run.messages["camera"][0].source == "camera"


def test_lost_frames_leave_gaps_in_the_numbers(rig: Any) -> None:
    run = camera_rig(rig, 5.0, frame_loss=0.3)
    numbers = [m.sequence for m in run.messages["camera"]]
    assert numbers == sorted(set(numbers))
    assert 50 <= len(numbers) <= 88
    assert numbers[-1] >= 97


def test_the_picture_is_that_of_the_stamp_and_not_of_its_arrival(rig: Any) -> None:
    pictures: dict[int, Any] = {}
    values = {**CLEAN, "latency_s": 0.045, "exposure_s": 0.0}

    def look(run: Any) -> None:
        pictures[0] = run.open["camera"].picture(run.world.pose())

    devices = {"base": (SimBase, SimBaseConfig()), "camera": (SimCamera, SimCameraConfig(**values))}
    run = rig(devices, robot=Robot(mounts={"camera": MOUNT}))
    run.run(1.0, [(0.0, lambda rig: rig.open["base"].apply(Drive(0.3, 1.0))), (0.5, look)])
    at = next(m for m in run.messages["camera"] if m.stamp_ns == 500_000_000)
    later = next(m for m in run.messages["camera"] if m.stamp_ns == 550_000_000)
    assert np.abs(at.bgr.astype(int) - pictures[0]).max() <= 1
    assert np.abs(later.bgr.astype(int) - pictures[0]).max() > 50


def test_a_camera_on_the_floor_is_refused_with_the_line_to_write() -> None:
    world = world_from_segments()
    device = SimCamera(SimCameraConfig(), DeviceContext("front", world=world))
    with pytest.raises(DeviceMisconfigured, match=r"front: a camera needs its height.*mounts: \{front: \{x_m"):
        asyncio.run(device.open())
