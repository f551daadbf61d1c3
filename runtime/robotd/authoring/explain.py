"""The closed set of things that `explain()` may return: everything that a page, a recording or a plot draws.

All lengths in metres in the base frame, unless the type says pixels of the camera picture that `source` names.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

from robotd.world.messages import Float32s


@dataclass(frozen=True, slots=True)
class Points:
    """Loose points in base."""

    name: str
    xy_m: tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True)
class Line:
    """One straight line in base."""

    name: str
    start_m: tuple[float, float]
    end_m: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Path:
    """An open line through points in base."""

    name: str
    xy_m: tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True)
class Polygon:
    """A closed outline in base."""

    name: str
    xy_m: tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True)
class Histogram:
    """Values over bearing: `values` (n,), the first bin centred at `first_rad`, bins `step_rad` apart, CCW."""

    name: str
    values: Float32s
    first_rad: float
    step_rad: float


@dataclass(frozen=True, slots=True)
class ImageBox:
    """A box in pixels of the newest picture of `source` (left, top, right, bottom)."""

    name: str
    box_px: tuple[float, float, float, float]
    source: str = "camera_frame"


@dataclass(frozen=True, slots=True)
class ImageLine:
    """An open line in pixels of the newest picture of `source`."""

    name: str
    xy_px: tuple[tuple[float, float], ...]
    source: str = "camera_frame"


@dataclass(frozen=True, slots=True)
class Scalar:
    """One number to plot over time, with its unit."""

    name: str
    value: float
    unit: str = ""


@dataclass(frozen=True, slots=True)
class Text:
    """One short sentence or word, for example a state."""

    name: str
    text: str


Drawing: TypeAlias = Points | Line | Path | Polygon | Histogram | ImageBox | ImageLine | Scalar | Text
Explanation: TypeAlias = tuple[Drawing, ...]
