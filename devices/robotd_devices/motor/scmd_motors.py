"""Two wheels on a SparkFun SCMD over I2C (the SparkFun JetBot): no encoders, but a failsafe of the board's own."""

from __future__ import annotations

from pydantic import Field

from robotd.authoring.device import Watchdog
from robotd_devices.motor import scmd
from robotd_devices.motor.i2c_wheels import I2cWheels, I2cWheelsConfig, WheelsChip
from robotd_devices.motor.scmd import ScmdChip
from robotd_devices.ports.i2c_bus import I2cWrite

_LONGEST_FAILSAFE_S = 0.5


class ScmdMotorsConfig(I2cWheelsConfig):
    """Parameters of a SparkFun motor driver, whose left motor is output A. The two speeds want calibration."""

    address: int = Field(default=0x5D, ge=0x58, le=0x61)
    """Address of the board, by its solder jumpers."""
    check_s: float = Field(default=1.0, ge=0.05, le=10.0)
    """How often the board is asked whether it still is as it was set up."""
    failsafe_s: float = Field(default=0.2, ge=0.1, le=_LONGEST_FAILSAFE_S)
    """The board stops the motors after this long without a transaction; in steps of 10 ms."""


class ScmdMotors(I2cWheels[ScmdMotorsConfig]):
    """Drives two wheels; faults, odometry and errors are those of every `I2cWheels`.

    Lost also where the board forgot its settings.
    """

    watchdog = Watchdog("firmware", round(1000 * _LONGEST_FAILSAFE_S))

    def stop_writes(self) -> tuple[I2cWrite, ...]:
        return scmd.stop_writes(self.config.address)

    def make_chip(self) -> WheelsChip:
        return ScmdChip(self.config.address, self.config.failsafe_s)
