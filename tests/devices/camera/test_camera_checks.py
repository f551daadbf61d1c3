"""Repeated, torn and black pictures, and that none of them is seen in real ones; the boards' pipelines."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from robotd.authoring.device import DeviceMisconfigured
from robotd_devices.camera.checks import CheckSettings, FrameCheck, Verdict
from robotd_devices.camera.pipelines import pipeline

PERIOD_NS = 33_000_000
SHAPE = (120, 160, 3)


def noisy(seed: int, level: float = 100.0, shape: tuple[int, ...] = SHAPE) -> Any:
    """The same scene each time, a ramp, with a live sensor's noise."""
    rng = np.random.default_rng(seed)
    scene = level + np.linspace(-20.0, 20.0, shape[1]).reshape((1, -1) + (1,) * (len(shape) - 2))
    return np.clip(scene + rng.normal(0.0, 1.5, shape), 0, 255).astype(np.uint8)


def judge(pictures: list[Any], **settings: Any) -> list[Verdict]:
    check = FrameCheck(CheckSettings(**settings))
    return [check.judge(picture, beat * PERIOD_NS) for beat, picture in enumerate(pictures)]


def faults(verdicts: list[Verdict]) -> list[str]:
    return [name for verdict in verdicts for name, _ in verdict.faults]


@pytest.mark.parametrize("shape", [SHAPE, (120, 160), (120, 160, 4), (7, 5, 3), (480, 640, 3)])
def test_a_still_scene_is_not_frozen(shape: tuple[int, ...]) -> None:
    count = 8 if shape[0] > 400 else 40
    assert judge([noisy(seed, shape=shape) for seed in range(count)]) == [Verdict()] * count


def test_the_same_picture_again_is_not_passed_on_and_frozen_in_time() -> None:
    still = noisy(1)
    verdicts = judge([noisy(0), still, *[still.copy() for _ in range(70)]], frozen_ns=2_000_000_000)
    assert [verdict.publish for verdict in verdicts[:4]] == [True, True, False, False]
    frozen = next(beat for beat, verdict in enumerate(verdicts) if verdict.lost)
    assert frozen == 1 + 61  # the first beat at which the picture of beat 1 is 2 s old
    assert verdicts[frozen].lost == "frozen: the very same picture for 2 s, it is opened anew"
    assert set(faults(verdicts)) == {"repeated picture"}


def test_one_pixel_that_differs_off_the_grid_is_a_new_picture() -> None:
    first, second = noisy(1), noisy(1)
    second[1, 1, 0] ^= 1
    assert [verdict.publish for verdict in judge([first, second])] == [True, True]


def test_repeats_are_not_judged_where_they_say_nothing() -> None:
    still = noisy(1)
    assert judge([still] * 100, frozen_ns=0) == [Verdict()] * 100
    # darkness and glare have no noise either
    for level in (0, 255):
        flat = np.full(SHAPE, level, np.uint8)
        assert not any(verdict.lost or not verdict.publish for verdict in judge([flat] * 100, black_pictures=0))


@pytest.mark.parametrize(("rows", "is_torn"), [(60, True), (35, True), (100, False), (8, False)])
@pytest.mark.parametrize("upper", [True, False])
@pytest.mark.parametrize("back", [1, 3])
def test_rows_of_an_older_picture(rows: int, is_torn: bool, upper: bool, back: int) -> None:
    pictures = [noisy(seed) for seed in range(6)]
    torn = noisy(99)
    piece = slice(0, rows) if upper else slice(SHAPE[0] - rows, None)
    torn[piece] = pictures[-back][piece]
    verdict = judge([*pictures, torn])[-1]
    assert verdict.publish is not is_torn
    assert faults([verdict]) == (["torn picture"] if is_torn else [])
    assert judge([*pictures, torn], partial=False)[-1] == Verdict()
    assert judge([*pictures, torn], torn=False)[-1] == Verdict()


def test_a_sky_that_is_too_bright_is_not_torn() -> None:
    pictures = [noisy(seed) for seed in range(10)]
    for picture in pictures:
        picture[:60] = 255
    assert judge(pictures) == [Verdict()] * 10


@pytest.mark.parametrize("shape", [SHAPE, (120, 160)])
def test_grey_of_a_decoder_that_had_no_more_data(shape: tuple[int, ...]) -> None:
    cut = noisy(1, shape=shape)
    cut[-16:] = 128
    assert faults(judge([noisy(0, shape=shape), cut])) == ["torn picture"]
    assert not judge([cut])[0].publish
    assert judge([cut], torn=False) == [Verdict()]
    card = np.clip(np.random.default_rng(3).normal(128, 1.0, shape), 0, 255).astype(np.uint8)
    assert judge([card]) == [Verdict()]  # a grey wall has noise


@pytest.mark.parametrize("share", [0.3, 0.6, 0.9])
def test_real_pictures_cut_off(data_dir: Path, share: float, capfd: pytest.CaptureFixture[str]) -> None:
    for file in sorted((data_dir / "jetbot" / "cards").glob("*.jpg"))[:8]:
        data = file.read_bytes()
        cut = data[: int(share * len(data))] + b"\xff\xd9"
        picture = cv2.imdecode(np.frombuffer(cut, np.uint8), cv2.IMREAD_COLOR)
        if picture is not None:
            assert faults(judge([picture])) == ["torn picture"], file.name
    capfd.readouterr()  # libjpeg's own words about it


def test_real_pictures_are_good(data_dir: Path) -> None:
    files = sorted((data_dir / "jetbot").rglob("*.jpg"))
    assert len(files) >= 20
    pictures = [cv2.imread(str(file)) for file in files]
    assert faults(judge(pictures)) == []
    assert all(verdict.publish for verdict in judge(pictures))


@pytest.mark.parametrize(
    ("levels", "dark"),
    [
        ([2.0] * 9, 0),
        ([2.0] * 10, 1),
        ([2.0] * 12, 3),
        ([2.0] * 9 + [60.0] + [2.0] * 9, 0),
        ([12.0] * 20, 0),
    ],
)
def test_black_pictures_in_a_row(levels: list[float], dark: int) -> None:
    pictures = [
        np.clip(np.random.default_rng(i).normal(level, 1.0, SHAPE), 0, 255).astype(np.uint8)
        for i, level in enumerate(levels)
    ]
    verdicts = judge(pictures)
    assert faults(verdicts) == ["black picture"] * dark
    assert all(verdict.publish for verdict in verdicts)  # dark is what there is to see
    assert faults(judge(pictures, black_pictures=0)) == []


def test_a_source_that_changes_its_size() -> None:
    verdicts = judge([noisy(0), noisy(1, shape=(60, 80, 3)), noisy(2, shape=(60, 80)), noisy(3)])
    assert verdicts == [Verdict()] * 4


# ------------------------------------------------------------------------------------ the boards' pipelines


@pytest.mark.parametrize(
    ("source", "keys", "expected"),
    [
        (
            "csi",
            (30.0, 224, 224, 0),
            "nvarguscamerasrc sensor-id=0 "
            "! video/x-raw(memory:NVMM), width=1640, height=1232, framerate=30/1 "
            "! nvvidconv flip-method=0 ! video/x-raw, width=224, height=224, format=BGRx "
            "! videoconvert ! video/x-raw, format=BGR ! appsink drop=true max-buffers=1 sync=false",
        ),
        (
            "csi:1",
            (60.0, None, None, 90),
            "nvarguscamerasrc sensor-id=1 "
            "! video/x-raw(memory:NVMM), width=1280, height=720, framerate=60/1 "
            "! nvvidconv flip-method=3 ! video/x-raw, width=480, height=640, format=BGRx "
            "! videoconvert ! video/x-raw, format=BGR ! appsink drop=true max-buffers=1 sync=false",
        ),
        (
            "libcamera",
            (29.97, 320, None, 180),
            "libcamerasrc ! video/x-raw, width=320, height=240, framerate=30000/1001 "
            "! videoconvert ! videoflip video-direction=180 "
            "! video/x-raw, format=BGR ! appsink drop=true max-buffers=1 sync=false",
        ),
        (
            "libcamera:/base/soc/i2c0mux/i2c@1/imx219@10",
            (30.0, None, 240, 270),
            'libcamerasrc camera-name="/base/soc/i2c0mux/i2c@1/imx219@10" '
            "! video/x-raw, width=240, height=180, framerate=30/1 "
            "! videoconvert ! videoflip video-direction=90l "
            "! video/x-raw, format=BGR ! appsink drop=true max-buffers=1 sync=false",
        ),
    ],
)
def test_pipelines(source: str, keys: tuple[float, Any, Any, int], expected: str) -> None:
    assert pipeline(source, *keys) == expected


@pytest.mark.parametrize("source", ["csi:x", 'libcamera:a" ! filesink location=x', "libcamera:a b"])
def test_pipelines_that_cannot_be(source: str) -> None:
    with pytest.raises(DeviceMisconfigured, match="write csi, csi:1, libcamera or libcamera:NAME"):
        pipeline(source, 30.0, None, None, 0)
