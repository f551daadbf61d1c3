"""`dashboard`: one web page on which people see what the robot sees, why it moves or stands, and can stop it."""

from robotd_plugins.bridges.dashboard.bridge import Dashboard
from robotd_plugins.bridges.dashboard.config import DashboardConfig

__all__ = ["Dashboard", "DashboardConfig"]
