"""`jetbot_route`: drives a marked route. So far along the line, straight on at crossings, to the line's end."""

from robotd_plugins.behaviours.jetbot_route.config import JetBotRouteConfig, JetBotRouteGoal
from robotd_plugins.behaviours.jetbot_route.line_follow import JetBotRoute, Sees

__all__ = ["JetBotRoute", "JetBotRouteConfig", "JetBotRouteGoal", "Sees"]
