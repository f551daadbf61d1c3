"""The two real pictures of a JetBot's floor: glossy vinyl, black tape, barrel distortion; truth taken by eye.

The seed's own rule (V below 75, no line far ahead means a crossing) calls the first phantom on its own second picture.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from robotd_plugins.toolkit.line_seen import LineSeen

# near x, far x, bar's place (x, row), straight on; both have arms to the left and right
TRUTH: dict[str, tuple[float, float, tuple[float, float], bool]] = {
    "test.jpg": (-0.14, -0.19, (-0.21, 0.60), False),
    "test2.jpg": (0.46, 0.34, (0.29, 0.60), True),
}


def _light(factor: float) -> Callable[[Any], Any]:
    return lambda image: np.clip(image * factor, 0, 255).astype(np.uint8)


def _gamma(power: float) -> Callable[[Any], Any]:
    return lambda image: (255.0 * (image / 255.0) ** power).astype(np.uint8)


def _noise(std: float) -> Callable[[Any], Any]:
    return lambda image: np.clip(image + np.random.default_rng(7).normal(0.0, std, image.shape), 0, 255).astype(
        np.uint8
    )


def _size(width: int, height: int) -> Callable[[Any], Any]:
    return lambda image: cv2.resize(image, (width, height), interpolation=cv2.INTER_LINEAR)


def _side_light(image: Any) -> Any:
    ramp = np.linspace(0.5, 1.2, image.shape[1])[None, :, None]
    return np.clip(image * ramp, 0, 255).astype(np.uint8)


def _jpeg(image: Any) -> Any:
    return cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 30])[1], cv2.IMREAD_COLOR)


def _shade(darkness: float, *corners: tuple[float, float]) -> Callable[[Any], Any]:
    """A shadow with a sharp edge over a polygon in shares of the picture."""

    def darken(image: Any) -> Any:
        height, width = image.shape[:2]
        mask = np.zeros((height, width), np.float32)
        cv2.fillPoly(mask, [(np.array(corners) * (width, height)).astype(np.int32)], 1.0)
        return (image * (1.0 - (1.0 - darkness) * cv2.GaussianBlur(mask, (3, 3), 0)[..., None])).astype(np.uint8)

    return darken


CHANGES: dict[str, Callable[[Any], Any]] = {
    "as it is": lambda image: image,
    "brightness 0.5": _light(0.5),
    "brightness 0.7": _light(0.7),
    "brightness 1.3": _light(1.3),
    "brightness 1.6, most floor white": _light(1.6),
    "gamma 0.7": _gamma(0.7),
    "gamma 1.4": _gamma(1.4),
    "gamma 2.0": _gamma(2.0),
    "noise of 10": _noise(10.0),
    "noise of 20": _noise(20.0),
    "320 x 240": _size(320, 240),
    "640 x 480": _size(640, 480),
    "out of focus": lambda image: cv2.GaussianBlur(image, (5, 5), 0),
    "JPEG of quality 30": _jpeg,
    "light from one side": _side_light,
    "a shadow over the near floor": _shade(0.6, (0.0, 0.8), (1.0, 0.75), (1.0, 1.0), (0.0, 1.0)),
    "a band of shadow across": _shade(0.5, (0.0, 0.68), (1.0, 0.70), (1.0, 0.75), (0.0, 0.73)),
    "a soft band of shadow across": _shade(0.65, (0.0, 0.78), (1.0, 0.74), (1.0, 0.84), (0.0, 0.88)),
}


def _read(data_dir: Path, name: str) -> Any:
    image = cv2.imread(str(data_dir / "jetbot" / "floor" / name))
    assert image is not None, name
    return image


@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("name", TRUTH)
def test_line_and_crossing_are_where_they_are(
    data_dir: Path, look: Callable[..., LineSeen], name: str, change: str
) -> None:
    near_x, far_x, (bar_x, bar_row), straight = TRUTH[name]
    seen = look(CHANGES[change](_read(data_dir, name)))
    assert seen.near.x == pytest.approx(near_x, abs=0.03)
    assert seen.far.x == pytest.approx(far_x, abs=0.03)
    assert seen.bar is not None, seen.reason
    assert (seen.bar.left, seen.bar.right, seen.bar.straight) == (True, True, straight)
    assert (seen.bar.x, seen.bar.row) == (pytest.approx(bar_x, abs=0.03), pytest.approx(bar_row, abs=0.02))
    assert seen.end is None


@pytest.mark.parametrize("name", TRUTH)
def test_a_mirrored_picture_gives_the_mirrored_answer(data_dir: Path, look: Callable[..., LineSeen], name: str) -> None:
    image = _read(data_dir, name)
    seen, mirrored = look(image), look(image[:, ::-1])
    assert mirrored.near.x == pytest.approx(-seen.near.x, abs=1e-6)
    assert mirrored.far.x == pytest.approx(-seen.far.x, abs=1e-6)
    assert seen.bar is not None and mirrored.bar is not None
    assert mirrored.bar.x == pytest.approx(-seen.bar.x, abs=0.01)
    assert mirrored.bar.left_end == pytest.approx((-seen.bar.right_end[0], seen.bar.right_end[1]), abs=0.03)
    assert mirrored.heading_rad == pytest.approx(-seen.heading_rad, abs=1e-6)


@pytest.mark.parametrize(
    ("name", "shadow"),
    [
        # the bar is painted over with floor, so that only the shadow is left to be taken for one
        (name, _shade(darkness, *corners))
        for name in TRUTH
        for darkness in (0.45, 0.55, 0.65, 0.75)
        for corners in (
            ((0.0, 0.70), (1.0, 0.68), (1.0, 0.74), (0.0, 0.76)),
            ((0.0, 0.70), (1.0, 0.62), (1.0, 1.0), (0.0, 1.0)),
            ((0.0, 0.80), (1.0, 0.88), (1.0, 0.96), (0.0, 0.90)),
        )
    ],
)
def test_no_shadow_is_a_crossing(
    data_dir: Path, look: Callable[..., LineSeen], name: str, shadow: Callable[[Any], Any]
) -> None:
    image = _read(data_dir, name)
    # only what lies before the bar: rows from 0.64 on, stretched to a whole picture
    near = image[round(0.655 * image.shape[0]) :]
    plain = np.vstack([np.repeat(near[:1], round(0.655 * image.shape[0]), axis=0), near])
    assert look(plain).bar is None
    assert look(shadow(plain)).bar is None
