"""The parameters that every chip on an I2C bus has."""

from __future__ import annotations

from pydantic import Field, field_validator

from robotd.authoring.config import Config
from robotd_devices.ports.i2c_bus import bus_path


class I2cConfig(Config):
    """Where a chip is found; each driver sets its own address."""

    bus: int | str = Field(default=1, union_mode="left_to_right")
    """Number of the I2C bus (1 is /dev/i2c-1), a path, or `unix:` and the path of a fake bus's socket."""
    address: int = Field(ge=0x08, le=0x77)
    """Address of the chip."""

    @field_validator("bus")
    @classmethod
    def _plain_path(cls, bus: int | str) -> int | str:
        return bus.removeprefix("unix:") if isinstance(bus, str) else bus

    @property
    def place(self) -> str:
        """Address and bus, for messages."""
        return f"0x{self.address:02X} on I2C bus {bus_path(self.bus)}"
