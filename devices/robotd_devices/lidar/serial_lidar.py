"""The parameters that every spinning lidar on a serial port has."""

from __future__ import annotations

import math

from pydantic import Field

from robotd.authoring.config import Config
from robotd.world.robot import Mount
from robotd_devices.ports.serial_port import Backend


class SerialLidarConfig(Config):
    """Each driver sets its own defaults of speed and range."""

    port: str = Field(default="/dev/serial/by-id/usb-Silicon_Labs_CP210*", min_length=1)
    """Serial port by its stable name, or a pattern that fits one; the default is the kit's own adapter."""
    backend: Backend = "pyserial"
    """How the port is read: pyserial (pyserial-asyncio), serialx (its extra) or raw (no library, lower latency)."""
    rotation_hz: float = Field(default=10.0, ge=2.0, le=20.0)
    """Revolutions a second that are expected."""
    range_min_m: float = Field(default=0.1, ge=0.0, le=1.0)
    """Nearer than this something is touching, in metres."""
    inverted: bool = False
    """Mounted upside down, so that it turns counter-clockwise seen from above; a mount rolled over says the same."""
    seam_deg: float = Field(default=180.0, ge=0.0, lt=360.0)
    """Device angle (clockwise from the mark) at which a scan begins and ends; 180 puts it behind the lidar."""
    trust_empty: bool = False
    """Take a revolution without any return for free space; by default it counts as not measured."""
    silent_s: float = Field(default=3.0, ge=0.5, le=60.0)
    """Without a good packet for this long the port is opened anew, in seconds."""

    def is_inverted(self, mount: Mount) -> bool:
        """Whether it turns counter-clockwise: upside down by this key or by its mount; both together cancel."""
        return self.inverted != (math.cos(mount.roll_rad) < 0.0)
