"""Gamepads through Linux's input devices, and one in `--sim` that nobody touches."""

from robotd_devices.gamepad.driver import EvdevGamepad, GamepadConfig
from robotd_devices.gamepad.idle import IdleGamepad

__all__ = ["EvdevGamepad", "GamepadConfig", "IdleGamepad"]
