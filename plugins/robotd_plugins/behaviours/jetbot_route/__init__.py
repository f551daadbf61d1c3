"""`jetbot_route`: drives a marked route from node to node of a map, or without a map along the line to its end."""

from robotd_plugins.behaviours.jetbot_route.behaviour import JetBotRoute
from robotd_plugins.behaviours.jetbot_route.config import JetBotRouteConfig, JetBotRouteGoal
from robotd_plugins.behaviours.jetbot_route.sees import Sees

__all__ = ["JetBotRoute", "JetBotRouteConfig", "JetBotRouteGoal", "Sees"]
