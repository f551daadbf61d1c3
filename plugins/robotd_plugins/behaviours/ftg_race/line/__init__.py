"""Lap 2 and later: the race line, its speeds, and how the car is held on it."""

from robotd_plugins.behaviours.ftg_race.line.corridor import WallField
from robotd_plugins.behaviours.ftg_race.line.learned import LearnedLine, learned_line
from robotd_plugins.behaviours.ftg_race.line.profile import LineLimits

__all__ = ["LearnedLine", "LineLimits", "WallField", "learned_line"]
