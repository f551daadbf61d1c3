"""Cameras: V4L2, network streams, and folders or videos in their place."""

from robotd_devices.camera.config import CameraConfig
from robotd_devices.camera.driver import Camera

__all__ = ["Camera", "CameraConfig"]
