"""`race_track`: makes walls and the line to race on from a surveyed lap, beside the event loop."""

from robotd_plugins.perception.race_track.config import RaceTrackConfig
from robotd_plugins.perception.race_track.learn import learn
from robotd_plugins.perception.race_track.perceptor import RaceTrackLearner, Sees

__all__ = ["RaceTrackConfig", "RaceTrackLearner", "Sees", "learn"]
