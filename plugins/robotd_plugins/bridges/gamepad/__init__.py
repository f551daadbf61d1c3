"""Driving by hand with a gamepad."""

from robotd_plugins.bridges.gamepad.bridge import GamepadTeleop
from robotd_plugins.bridges.gamepad.config import GamepadTeleopConfig

__all__ = ["GamepadTeleop", "GamepadTeleopConfig"]
