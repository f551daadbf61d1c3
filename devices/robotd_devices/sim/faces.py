"""Pictures of things that stand: the face of a card, and a drawn figure of a person who walks."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from robotd.world.messages import Bytes2D
from robotd_devices.sim.maps import Card
from robotd_devices.sim.people import Person

GAIT_STEPS = 8
"""Figures of one stride."""

_FACE_PX = 160
_FIGURE_PX = (130, 260)
_FIGURE_SHARE = 0.5
"""Width of a drawn figure's picture as a share of its height."""


def read_face(path: str) -> Bytes2D:
    """A picture file as uint8 (h, w, 4), blue green red and opacity. Raises ValueError for one that cannot be read."""
    import cv2

    picture = cv2.imread(path, cv2.IMREAD_UNCHANGED) if Path(path).is_file() else None
    if picture is None or picture.dtype != np.uint8:
        raise ValueError(f"{path}: not a picture that can be read")
    if picture.ndim == 2:
        picture = cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR)
    if picture.shape[2] == 3:
        picture = cv2.cvtColor(picture, cv2.COLOR_BGR2BGRA)
    return np.asarray(picture, dtype=np.uint8)


def front_of(card: Card) -> Bytes2D:
    """The face of a card, uint8 (h, w, 4). Raises ValueError for a picture that cannot be read."""
    if card.picture is not None:
        return read_face(card.picture)
    face = blank(card)
    if card.text is not None:
        _print(face, card.text, 20 if card.grey > 127.0 else 235)
    return face


def blank(card: Card) -> Bytes2D:
    """A card without print, as it looks from behind."""
    scale = _FACE_PX / max(card.width_m, card.height_m)
    shape = (max(2, round(card.height_m * scale)), max(2, round(card.width_m * scale)), 4)
    face = np.full(shape, round(card.grey), dtype=np.uint8)
    face[..., 3] = 255
    return face


def _print(face: Bytes2D, text: str, ink: int) -> None:
    """Letters as large as fit, in the middle."""
    import cv2

    height, width = face.shape[:2]
    font = cv2.FONT_HERSHEY_SIMPLEX
    (across, up), below = cv2.getTextSize(text, font, 1.0, 2)
    scale = min(0.8 * width / across, 0.7 * height / (up + below))
    thick = max(1, round(4.0 * scale))
    (across, up), _ = cv2.getTextSize(text, font, scale, thick)
    at = (round((width - across) / 2.0), round((height + up) / 2.0))
    plain = np.ascontiguousarray(face[..., 0])
    cv2.putText(plain, text, at, font, scale, ink, thick, cv2.LINE_AA)
    face[..., :3] = plain[..., None]


def figures(person: Person) -> list[Bytes2D]:
    """A person as uint8 (h, w, 4): one picture, or a stride in `GAIT_STEPS` figures. ValueError as of `read_face`."""
    if person.picture is not None:
        return [read_face(person.picture)]
    return [_figure(math.tau * step / GAIT_STEPS, person.greys) for step in range(GAIT_STEPS)]


def figure_width_m(person: Person, figure: Bytes2D) -> float:
    """How wide a figure's picture stands, from the person's height."""
    if person.picture is None:
        return _FIGURE_SHARE * person.height_m
    height, width = figure.shape[:2]
    return person.height_m * float(width) / float(height)


def _figure(gait_rad: float, greys: tuple[float, float]) -> Bytes2D:
    import cv2

    width, height = _FIGURE_PX
    figure = np.zeros((height, width, 4), dtype=np.uint8)

    def limb(start: tuple[float, float], end: tuple[float, float], thick: float, grey: float) -> None:
        ends = [(round(x * height + width / 2.0), round(y * height)) for x, y in (start, end)]
        cv2.line(figure, ends[0], ends[1], (grey, grey, grey, 255), round(thick * height), cv2.LINE_AA)

    jacket, trousers = greys
    swing = 0.11 * math.sin(gait_rad)
    for side, way in ((-0.035, swing), (0.035, -swing)):
        limb((side, 0.52), (side + way, 0.95), 0.075, trousers)
        limb((side + way, 0.965), (side + way + 0.01, 0.97), 0.05, 30.0)
    limb((0.0, 0.24), (0.0, 0.48), 0.19, jacket)
    for side, way in ((-0.115, -swing), (0.115, swing)):
        limb((side, 0.2), (side + 0.6 * way, 0.5), 0.05, jacket * 0.9)
    cv2.circle(figure, (width // 2, round(0.08 * height)), round(0.065 * height), (120, 150, 190, 255), -1, cv2.LINE_AA)
    cv2.ellipse(
        figure, (width // 2, round(0.055 * height)), (round(0.068 * height), round(0.05 * height)), 0.0, 180.0, 360.0,
        (35, 40, 50, 255), -1, cv2.LINE_AA,
    )  # fmt: skip
    return figure
