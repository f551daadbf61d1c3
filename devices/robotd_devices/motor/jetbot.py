"""The motors of a JetBot: two wheels on a PCA9685 over I2C, without encoders and without a watchdog."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Literal

from pydantic import Field

from robotd.authoring.device import DeviceUnavailable, Watchdog
from robotd_devices.motor import pca9685
from robotd_devices.motor.i2c_wheels import I2cWheels, I2cWheelsConfig, WheelsChip
from robotd_devices.motor.jetbot_wheels import Speeds, plan
from robotd_devices.ports.i2c_bus import I2cBus, I2cWrite

_OSCILLATOR_S = 0.001


class JetBotMotorsConfig(I2cWheelsConfig):
    """Parameters of a JetBot's motor board. The defaults fit a JetBot; the two speeds want calibration."""

    address: int = Field(default=0x60, ge=0x08, le=0x77)
    """Address of the PCA9685."""
    wiring: Literal["jetbot", "adafruit", "waveshare"] = "jetbot"
    """Which outputs drive the motors; `jetbot` writes those of both boards, as NVIDIA's library does."""
    pwm_hz: float = Field(default=1600.0, ge=24.0, le=1600.0)
    """Frequency of the PWM; the chip's fastest is 1526 Hz."""


class JetBotMotors(I2cWheels[JetBotMotorsConfig]):
    """Drives two wheels; faults, odometry and errors are those of every `I2cWheels`.

    Nothing stops the motors when the program falls silent: the chip holds its outputs for ever (`watchdog` is none).
    Lost also where the chip forgot its settings (its supply broke down).
    """

    watchdog = Watchdog("none")

    def stop_writes(self) -> tuple[I2cWrite, ...]:
        return (pca9685.all_off(self.config.address),)

    def make_chip(self) -> WheelsChip:
        return _Chip(self.config)


class _Chip:
    """What the writer's thread does with the PCA9685."""

    def __init__(self, config: JetBotMotorsConfig) -> None:
        self._config = config

    def begin(self, bus: I2cBus) -> None:
        *writes, restart = pca9685.begin_writes(self._config.address, self._config.pwm_hz)
        for write in writes:
            bus.write(*write)
        time.sleep(_OSCILLATOR_S)
        bus.write(*restart)
        self.check(bus)

    def plan(self, before: Speeds | None, wanted: Speeds) -> Sequence[I2cWrite]:
        return plan(self._config.address, self._config.wiring, before, wanted)

    def check(self, bus: I2cBus) -> None:
        config = self._config
        (mode1,) = bus.read(config.address, pca9685.MODE1, 1)
        (prescale,) = bus.read(config.address, pca9685.PRESCALE, 1)
        want = pca9685.AUTO_INCREMENT | pca9685.ALLCALL, pca9685.prescale(config.pwm_hz)
        if (mode1, prescale) != want:
            raise DeviceUnavailable(
                f"the chip at {config.place} lost its settings (MODE1 {mode1:02X}, PRESCALE {prescale:02X}, set were "
                f"{want[0]:02X}, {want[1]:02X}): its supply broke down, another program uses it, or it is no PCA9685"
            )

    def stopped(self) -> None:
        """Nothing to remember."""
