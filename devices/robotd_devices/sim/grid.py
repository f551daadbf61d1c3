"""Occupancy pictures of ROS map_server as walls: the exact edges of occupied cells, merged into long segments."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from robotd.authoring.config import Config
from robotd.world.messages import Float64s


class GridFile(Config):
    """The YAML file beside an occupancy picture (nav2_map_server's map_io; ROS 1 map_server likewise)."""

    image: str
    """The picture, relative to this file."""
    resolution: float = Field(gt=0.0)
    """Metres a cell."""
    origin: tuple[float, float, float]
    """Pose of the picture's lower left corner in the map: x, y, yaw."""
    negate: bool = False
    occupied_thresh: float = Field(default=0.65, ge=0.0, le=1.0)
    free_thresh: float = Field(default=0.25, ge=0.0, le=1.0)
    mode: Literal["trinary", "scale"] = "trinary"
    """Both are cut at `occupied_thresh` here; `raw` is not taken."""


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """occupied: bool (rows, columns), row 0 is the lowest; `free` likewise (neither: unknown)."""

    occupied: NDArray[np.bool_]
    free: NDArray[np.bool_]
    resolution_m: float
    origin: tuple[float, float, float]

    def segments_m(self) -> Float64s:
        """Walls (m, 4) along every edge between an occupied cell and one that is not."""
        return edges_m(self.occupied, self.resolution_m, self.origin)


def read_grid(path: Path, content: Any) -> Grid:
    """The picture that checked YAML content names. Raises pydantic's ValidationError, or ValueError for the picture."""
    import cv2

    told = GridFile.model_validate(content)
    picture = path.parent / told.image
    # a path that OpenCV cannot read is an empty answer, whatever the cause
    grey = cv2.imread(str(picture), cv2.IMREAD_GRAYSCALE) if picture.is_file() else None
    if grey is None:
        raise ValueError(f"image: {told.image}: no such picture beside {path.name}, or not one that can be read")
    dark = grey / 255.0 if told.negate else 1.0 - grey / 255.0
    dark = dark[::-1]
    return Grid(dark > told.occupied_thresh, dark < told.free_thresh, told.resolution, told.origin)


def edges_m(occupied: NDArray[np.bool_], resolution_m: float, origin: tuple[float, float, float]) -> Float64s:
    """Edges between true and false cells as segments (m, 4), neighbours on one straight line merged.

    occupied: (rows, columns), row 0 lowest; beyond its border nothing is occupied. The cell of row r and column c spans
    c to c + 1 cells along the origin's x axis and r to r + 1 along its y axis.
    """
    padded = np.pad(occupied, 1)
    upright = _runs((padded[1:-1, 1:] != padded[1:-1, :-1]).T)
    level = _runs(padded[1:, 1:-1] != padded[:-1, 1:-1])
    cells = np.vstack((upright[:, [0, 1, 0, 2]], level[:, [1, 0, 2, 0]])) * resolution_m
    x_m, y_m, yaw_rad = origin
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    turned: Float64s = cells.reshape(-1, 2) @ np.array([[cos, sin], [-sin, cos]]) + (x_m, y_m)
    return turned.reshape(-1, 4)


def _runs(edge: NDArray[np.bool_]) -> Float64s:
    """Unbroken runs of true in each row: (n, 3) of row, first column, column after the last."""
    steps = np.diff(np.pad(edge.astype(np.int8), ((0, 0), (1, 1))), axis=1)
    row, first = np.nonzero(steps == 1)
    _, last = np.nonzero(steps == -1)
    return np.stack((row, first, last), axis=1).astype(np.float64)
