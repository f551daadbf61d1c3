"""What stands in a simulated picture, against projection; and light, blur and JPEG, each as its value says."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robotd.authoring.device import DeviceMisconfigured
from robotd.world.messages import Drive, Float64s
from robotd.world.robot import Mount, Robot
from robotd_devices.sim import SimBase, SimBaseConfig, SimCamera, SimCameraConfig, load_map
from robotd_devices.sim.lens import FloorCamera
from robotd_devices.sim.maps import Card, FloorLine, map_from_segments
from robotd_devices.sim.people import Person, Walk, walk_along
from robotd_devices.sim.render import Renderer

MOUNT = Mount(x_m=0.06, z_m=0.11, pitch_rad=0.35)
CLEAN: dict[str, Any] = {
    "grain_std": 0.0,
    "patches_std": 0.0,
    "gloss": 0.0,
    "vignette": 0.0,
    "noise_std": 0.0,
    "light_drift": 0.0,
    "tint_drift": 0.0,
    "shadows_per_m2": 0.0,
    "jpeg_quality": None,
}
WIDE: dict[str, Any] = {"fov_rad": 2.1}
PINHOLE: dict[str, Any] = {"fov_rad": 1.3, "distortion": None}
HERE = (0.0, 0.0, 0.0)
FIELD = map_from_segments(lines=[FloorLine(np.array([(-1.0, y_m), (2.0, y_m)])) for y_m in (-1.5, 1.5)])


def renderer(world_map: Any, seed: int = 0, **values: Any) -> tuple[FloorCamera, Renderer]:
    config = SimCameraConfig(**{**CLEAN, **values})
    camera = FloorCamera(config.lens(), MOUNT)
    return camera, Renderer(camera, world_map, config.look(), np.random.default_rng(seed))


def picture(world_map: Any, pose: tuple[float, float, float] = HERE, when_s: float = 0.0, **values: Any) -> Any:
    return renderer(world_map, **values)[1].picture(pose, when_s)


def pixels_of(camera: FloorCamera, points_base_m: Any) -> Float64s:
    offset = np.array(points_base_m, dtype=np.float64) - (MOUNT.x_m, MOUNT.y_m, MOUNT.z_m)
    return camera.lens.pixels(offset @ camera.camera_base)


# ------------------------------------------------------------------------------------------- cards


@pytest.mark.parametrize("lens", [WIDE, PINHOLE], ids=["wide", "pinhole"])
@pytest.mark.parametrize("card", [Card(0.6, 0.1, math.pi, 0.2, 0.15), Card(0.5, -0.15, 2.4, 0.12, 0.12, 0.0)])
def test_a_card_is_where_projection_puts_it(card: Card, lens: dict[str, Any]) -> None:
    import cv2

    camera, drawing = renderer(map_from_segments(cards=[card]), floor_grey=60.0, tape_grey=20.0, **lens)
    bare = picture(map_from_segments(), floor_grey=60.0, tape_grey=20.0, **lens)[..., 1].astype(float)
    there = drawing.picture(HERE)[..., 1].astype(float)
    shown = np.abs(there - 235.0) < np.abs(there - bare)
    left, right = card.segment_m.reshape(2, 2)
    edge = np.linspace(0.0, 1.0, 60)[:, None]
    low, high = card.bottom_m, card.bottom_m + card.height_m
    sides = [((left, low), (right, low)), ((right, low), (right, high)), ((right, high), (left, high))]
    sides.append(((left, high), (left, low)))
    rim = np.vstack(
        [
            np.column_stack((a + edge * (b - a), za + edge * (zb - za)))
            for (a, za), (b, zb) in sides
        ]
    )  # fmt: skip
    outline = pixels_of(camera, rim).astype(np.float32)
    found = sum(
        abs(cv2.pointPolygonTest(outline, (float(x), float(y)), True)) > 0.75
        and (cv2.pointPolygonTest(outline, (float(x), float(y)), False) > 0) != bool(shown[y, x])
        for y in range(240)
        for x in range(0, 320, 2)
    )
    assert shown.sum() > 500
    assert found == 0, "every pixel that is clearly in or out of the projected outline is so in the picture"


def test_print_reads_from_left_to_right_and_the_back_is_blank() -> None:
    front = picture(map_from_segments(cards=[Card(0.5, 0.0, math.pi, 0.16, 0.16, text="L")]))
    # the card covers columns 133 to 187 and rows 40 to 93
    face = slice(44, 90), slice(138, 182)
    ink = (front[face][..., 1] < 60).nonzero()
    assert len(ink[0]) > 40
    middle = (ink[1].min() + ink[1].max()) / 2.0
    assert (ink[1] < middle).mean() > 0.6, "the stem of an L is on its left"
    assert (ink[0] > np.mean((ink[0].min(), ink[0].max()))).mean() > 0.55, "and its foot is at the bottom"
    back = picture(map_from_segments(cards=[Card(0.5, 0.0, 0.0, 0.16, 0.16, text="L")]))
    assert (back[face] == 235).all()


def test_a_picture_file_keeps_its_colours_and_its_holes(tmp_path: Path) -> None:
    import cv2

    face = np.zeros((40, 40, 4), dtype=np.uint8)
    face[:, :20] = (0, 0, 255, 255)
    cv2.imwrite(str(tmp_path / "sign.png"), face)
    (tmp_path / "map.yaml").write_text(
        "cards: [{x_m: 0.5, y_m: 0, yaw_rad: 3.14159, width_m: 0.2, height_m: 0.2, picture: sign.png}]"
    )
    world_map = load_map(str(tmp_path / "map.yaml"))
    with_card, without = picture(world_map), picture(map_from_segments())
    changed = (with_card != without).any(axis=2)
    columns = changed.nonzero()[1]
    assert columns.max() < 165, "the right half is a hole"
    middle = with_card[60:75, round(float(columns.min() + columns.max()) / 2)]
    assert (middle == (0, 0, 255)).all()


def test_a_picture_that_cannot_be_read_is_refused_at_opening(rig: Any, tmp_path: Path) -> None:
    (tmp_path / "sign.png").write_text("not a picture")
    (tmp_path / "map.yaml").write_text("cards: [{x_m: 1, y_m: 0, yaw_rad: 3, picture: sign.png}]")
    with pytest.raises(DeviceMisconfigured, match=r"sign\.png: not a picture that can be read"):
        rig(
            {"camera": (SimCamera, SimCameraConfig())},
            robot=Robot(mounts={"camera": MOUNT}),
            map=str(tmp_path / "map.yaml"),
        ).run(0.1)


def test_the_nearer_card_hides_the_farther_whatever_their_order() -> None:
    near, far = Card(0.5, 0.0, math.pi, grey=250.0), Card(0.7, 0.0, math.pi, 0.3, 0.14, grey=20.0)
    one, other = (picture(map_from_segments(cards=order)) for order in ([near, far], [far, near]))
    assert (one == other).all()
    assert (one[..., 1] > 235).sum() > 200


# ------------------------------------------------------------------------------- walls, posts, people


def test_a_wall_stands_on_the_floor_and_is_as_high_as_the_map_says() -> None:
    camera, drawing = renderer(map_from_segments([(1.0, -3.0, 1.0, 3.0)]))
    shown = drawing.picture(HERE)
    bare = renderer(map_from_segments([(-9.0, -3.0, -9.0, 3.0)]))[1].picture(HERE)
    for side_m in (-0.4, 0.0, 0.3):
        foot, top = pixels_of(camera, [(1.0, side_m, 0.0), (1.0, side_m, 0.3)])
        column = round(foot[0])
        rows = (shown[:, column] != bare[:, column]).any(axis=1).nonzero()[0]
        assert rows.max() + 0.5 == pytest.approx(foot[1], abs=0.75)
        top_row = (shown[:, round(top[0])] != bare[:, round(top[0])]).any(axis=1).nonzero()[0].min()
        assert top_row - 0.5 == pytest.approx(top[1], abs=0.75)


@pytest.mark.parametrize(("wall_x_m", "is_seen"), [(0.4, False), (1.5, True)])
def test_a_wall_hides_what_is_behind_it(wall_x_m: float, is_seen: bool) -> None:
    world_map = map_from_segments([(wall_x_m, -2.0, wall_x_m, 2.0)], cards=[Card(0.8, 0.0, math.pi, grey=250.0)])
    assert bool((picture(world_map)[..., 1] > 235).any()) == is_seen


def test_a_box_that_comes_is_seen_from_then_on(tmp_path: Path) -> None:
    (tmp_path / "map.yaml").write_text("boxes: [{x_m: 1.0, y_m: 0.0, length_m: 0.2, width_m: 0.2, from_s: 5.0}]")
    _, drawing = renderer(load_map(str(tmp_path / "map.yaml")))
    before, after = drawing.picture(HERE, 4.9), drawing.picture(HERE, 5.0)
    assert (before != after).any(axis=2).sum() > 300
    assert (drawing.picture(HERE, 1.0) == before).all()


def test_a_person_is_seen_where_they_walk_and_from_head_to_foot() -> None:
    person = Person(walk_along([(3.0, -1.0), (3.0, 1.0)], 1.0))
    camera, drawing = renderer(map_from_segments(people=[person]))
    bare = renderer(map_from_segments())[1].picture(HERE)
    for when_s in (0.2, 1.0, 1.7):
        rows, columns = (drawing.picture(HERE, when_s) != bare).any(axis=2).nonzero()
        place = person.walk.places_m(np.array([when_s]))[0]
        foot, head = pixels_of(camera, [(*place, 0.0), (*place, 1.7)])
        assert columns.mean() == pytest.approx((foot[0] + head[0]) / 2.0, abs=6.0)
        assert rows.max() == pytest.approx(foot[1], abs=4.0)
        assert rows.min() == pytest.approx(max(head[1], 0.0), abs=4.0)


# --------------------------------------------------------------------------------- light, blur, JPEG


@pytest.mark.parametrize(
    ("values", "moves"),
    [
        ({"shadows_per_m2": 3.0, "shadow_depth": 0.4}, True),
        ({"light_drift": 0.3}, True),
        ({"tint_drift": 0.2}, True),
        ({"jpeg_quality": 60, "grain_std": 5.0}, False),
    ],
    ids=lambda value: str(value),
)
def test_each_change_of_light_is_there_changes_in_time_and_follows_from_the_seed(
    values: dict[str, Any], moves: bool
) -> None:
    _, drawing = renderer(FIELD, 5, **values)
    plain = renderer(FIELD, 5, grain_std=values.get("grain_std", 0.0))[1].picture(HERE)
    first = drawing.picture(HERE, 0.0)
    assert (first[130:] != plain[130:]).mean() > 0.02
    assert bool((drawing.picture(HERE, 4.0) != first).any()) == moves
    again = renderer(FIELD, 5, **values)[1].picture(HERE, 0.0)
    assert (again == first).all()


def test_shadows_darken_the_floor_by_at_most_their_depth_and_nothing_else() -> None:
    _, drawing = renderer(FIELD, 3, shadows_per_m2=5.0, shadow_depth=0.4)
    lit = renderer(FIELD, 3)[1].picture(HERE)
    share = np.array([drawing.picture(HERE, when_s) for when_s in (0.0, 5.0)]) / np.maximum(lit, 1.0)
    assert share.min() == pytest.approx(0.6, abs=0.15)
    assert share.max() <= 1.0
    assert (share[:, :50] == 1.0).all(), "the room behind the horizon is not in the floor's shadow"


def test_light_drifts_within_its_share_and_not_in_one_direction() -> None:
    _, drawing = renderer(map_from_segments(), light_drift=0.2, light_drift_s=5.0)
    levels = (
        np.array([drawing.picture(HERE, when_s)[200:, :, 2].mean() for when_s in np.arange(0.0, 30.0, 0.5)]) / 200.0
    )
    assert levels.min() >= 0.795
    assert levels.max() <= 1.205
    assert np.ptp(levels) > 0.15
    assert np.abs(np.diff(levels)).max() < 0.15, "smoothly"


def test_a_lower_quality_loses_more() -> None:
    world_map = load_map("line_track")
    exact = picture(world_map, grain_std=6.0).astype(float)
    errors = [
        np.abs(picture(world_map, grain_std=6.0, jpeg_quality=quality) - exact).mean() for quality in (95, 80, 30)
    ]
    assert 0.0 < errors[0] < errors[1] < errors[2]


def steepness(frame: Any) -> float:
    """The sharpest step between neighbouring pixels of a row across the tape."""
    return float(np.abs(np.diff(frame.bgr[150, :, 1].astype(float))).max())


@pytest.mark.parametrize(
    ("drive", "exposure_s", "is_blurred"),
    [(Drive(0.0, 2.5), 0.02, True), (Drive(0.0, 2.5), 0.0, False), (Drive(0.0, 0.0), 0.02, False)],
)
def test_a_turn_blurs_as_long_as_the_shutter_is_open(
    rig: Any, drive: Drive, exposure_s: float, is_blurred: bool
) -> None:
    values = {**CLEAN, "exposure_s": exposure_s, "latency_s": 0.02}
    devices = {
        "base": (SimBase, SimBaseConfig()),
        "camera": (SimCamera, SimCameraConfig(**values)),
    }
    run = rig(devices, robot=Robot(mounts={"camera": MOUNT}))
    run.run(0.33, [(0.0, lambda rig: rig.open["base"].apply(drive))])
    sharp = [steepness(frame) for frame in run.messages["camera"][2:]]
    assert (max(sharp) < 30.0) == is_blurred


def test_a_card_is_blurred_by_a_turn_as_well() -> None:
    world_map = map_from_segments(cards=[Card(0.6, 0.0, math.pi, text="8")])
    _, drawing = renderer(world_map)
    turning = [(0.0, 0.0, yaw) for yaw in (-0.03, -0.01, 0.01, 0.03)]
    still, blurred = drawing.picture(HERE), drawing.picture(HERE, 0.0, turning)
    face = slice(62, 88), slice(147, 173)
    gaps = [np.abs(np.diff(shown[face][..., 1].astype(float), axis=1)).max() for shown in (still, blurred)]
    assert gaps[1] < 0.6 * gaps[0]


def test_somebody_who_stands_is_drawn_too() -> None:
    world_map = map_from_segments(people=[Person(Walk(np.zeros(1), np.array([(2.0, 0.0)])))])
    assert (picture(world_map) != picture(map_from_segments())).any()
