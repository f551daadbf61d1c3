"""`ftg_race`: a car races round a track that it has no map of, by follow-the-gap."""

from robotd_plugins.behaviours.ftg_race.behaviour import FtgRace, Sees
from robotd_plugins.behaviours.ftg_race.config import FtgRaceConfig, RaceGoal

__all__ = ["FtgRace", "FtgRaceConfig", "RaceGoal", "Sees"]
