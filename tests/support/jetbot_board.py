"""A bus with the chip of a JetBot's motors, and what its wheels get."""

from __future__ import annotations

from robotd_devices.motor.pca9685_fake import BridgeFake, Pca9685Fake
from robotd_devices.ports.i2c_bus import I2cWrite
from robotd_devices.ports.i2c_fake import FakeI2cBus

STOP_WRITE = I2cWrite(0x60, 0xFD, b"\x10")


class Board(FakeI2cBus):
    """A bus with a JetBot's chip."""

    def __init__(self) -> None:
        self.chip = Pca9685Fake()
        super().__init__([self.chip])

    @property
    def forward(self) -> tuple[float, float]:
        """What the wheels get, left and right, positive forward."""
        return -BridgeFake(self.chip, 8, 10, 9).voltage, -BridgeFake(self.chip, 13, 11, 12).voltage
