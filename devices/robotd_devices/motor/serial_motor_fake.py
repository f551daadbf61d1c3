"""Hosts a fake controller in memory: a `MemoryHost` that speaks at the driver's own speed and powers on when opened."""

from __future__ import annotations

from robotd_devices.motor.serial_motor_line import MakePort
from robotd_devices.ports.fakes import FakeDevice
from robotd_devices.ports.memory_host import MemoryHost, now_ns
from robotd_devices.ports.serial_port import SerialSettings

_STEP_S = 0.0005


class MemoryLine(MemoryHost):
    """The cable between a driver and a controller; `port` is what a `SerialMotor` takes as `make_port`.

    Whatever speed the driver opens is right, and opening it resets the controller, as the DTR line of most boards does.
    """

    def __init__(self, fake: FakeDevice) -> None:
        super().__init__(fake, 0, step_s=_STEP_S)

    @property
    def make_port(self) -> MakePort:
        """What a `SerialMotor` takes of that name."""
        return self.port

    @property
    def writes(self) -> list[tuple[float, bytes]]:
        """Every write of the driver, with the loop's time in seconds."""
        return self.written

    @property
    def is_plugged(self) -> bool:
        """Whether the cable is in."""
        return not self.is_out

    def unplug(self) -> None:
        """Pull the cable; the driver hears of it in the next turn."""
        self.is_out = True

    def plug(self) -> None:
        """Put it in again."""
        self.is_out = False

    def port_opened(self, settings: SerialSettings) -> None:
        self.baud = settings.baud
        self.fake.power_on(now_ns())
