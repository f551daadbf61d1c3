"""`floor_line`: finds the black line on a light floor, its crossings and its end, in each camera frame."""

from robotd_plugins.perception.floor_line.config import FloorLineConfig
from robotd_plugins.perception.floor_line.perceptor import FloorLine, Sees

__all__ = ["FloorLine", "FloorLineConfig", "Sees"]
