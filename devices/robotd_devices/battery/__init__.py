"""Battery monitors on I2C."""

from robotd_devices.battery.ina219 import Ina219, Ina219Config

__all__ = ["Ina219", "Ina219Config"]
