"""`track_position`: locates the car on its learned track with every scan, and says when that is not to be believed."""

from robotd_plugins.perception.track_position.config import TrackPositionConfig
from robotd_plugins.perception.track_position.locate import Locator
from robotd_plugins.perception.track_position.perceptor import Sees, TrackPosition

__all__ = ["Locator", "Sees", "TrackPosition", "TrackPositionConfig"]
