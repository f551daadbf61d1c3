"""A PCA9685 as its bus sees it, and a motor bridge behind three of its outputs; for tests and for benches without one.

Source of the behaviour: NXP, PCA9685 product data sheet, section 7.3.
"""

from __future__ import annotations

from robotd_devices.motor.pca9685 import (
    ALL_LED,
    ALL_LED_OFF_H,
    ALLCALL,
    AUTO_INCREMENT,
    CHANNELS,
    EXTCLK,
    FULL,
    LAST_LED,
    LEAST_PRESCALE,
    LED0,
    MODE1,
    MODE2,
    OSCILLATOR_HZ,
    PRESCALE,
    RESTART,
    SLEEP,
    STEPS,
)
from robotd_devices.ports.i2c_bus import GENERAL_CALL

_SOFTWARE_RESET = b"\x06"
_ALLCALL_ADDRESS = 0x05
_OUTPUT_CHANGE_ON_ACK = 0x08


class Pca9685Fake:
    """The register file with its rules.

    Registers count up only with AUTO_INCREMENT; the prescaler is locked unless asleep; a write to ALL_LED goes to all
    channels and reads as 0; RESTART is set by the chip, holds the outputs until it is written as 1, and is also cleared
    by a write to a channel; EXTCLK is cleared by a reset only; the software reset and the all-call address are heard.
    `log`: every byte that reached a register, as (register, value); not a byte that a locked register refused.
    """

    def __init__(self, address: int = 0x60) -> None:
        self.address = address
        self.log: list[tuple[int, int]] = []
        self.power_on()

    def power_on(self) -> None:
        self._registers = bytearray(256)
        self._registers[MODE1] = SLEEP | ALLCALL
        self._registers[MODE2] = 0x04
        self._registers[0x02:0x06] = bytes((0xE2, 0xE4, 0xE8, 0xE0))
        self._registers[PRESCALE] = 0x1E
        for channel in range(CHANNELS):
            self._registers[LED0 + 4 * channel + 3] = FULL >> 8
        self._pointer = 0

    def answers(self, address: int) -> bool:
        if address == GENERAL_CALL:
            return True
        called = self._registers[MODE1] & ALLCALL and address == self._registers[_ALLCALL_ADDRESS] >> 1
        return address == self.address or bool(called)

    def write(self, data: bytes, address: int) -> None:
        if address == GENERAL_CALL:
            if data == _SOFTWARE_RESET:
                self.power_on()
            return
        self._pointer = data[0]
        touched = False
        for value in data[1:]:
            self._store(self._pointer, value)
            touched = touched or _is_level(self._pointer)
            self._count_up()
        if touched and not self._registers[MODE2] & _OUTPUT_CHANGE_ON_ACK:
            self._registers[MODE1] &= ~RESTART & 0xFF

    def read(self, count: int) -> bytes:
        out = bytearray()
        for _ in range(count):
            # ALL_LED can be written only
            out.append(0 if ALL_LED <= self._pointer <= ALL_LED_OFF_H else self._registers[self._pointer])
            self._count_up()
        return bytes(out)

    @property
    def pwm_hz(self) -> float:
        """The frequency that the prescaler gives."""
        return OSCILLATOR_HZ / STEPS / (self._registers[PRESCALE] + 1)

    def levels(self, channel: int) -> tuple[int, int]:
        """The counters of a channel, ON and OFF, as registers hold them."""
        on_l, on_h, off_l, off_h = self._registers[LED0 + 4 * channel : LED0 + 4 * channel + 4]
        return on_l | on_h << 8, off_l | off_h << 8

    def duty(self, channel: int) -> float:
        """Share of the time for which an output is on, 0 to 1; 0 asleep, and until a pending restart."""
        if self._registers[MODE1] & (SLEEP | RESTART):
            return 0.0
        return self._set_duty(channel)

    def _set_duty(self, channel: int) -> float:
        on, off = self.levels(channel)
        if off & FULL:
            return 0.0
        if on & FULL:
            return 1.0
        return (off - on) % STEPS / STEPS

    def _count_up(self) -> None:
        if self._registers[MODE1] & AUTO_INCREMENT:
            # from the last channel, and from the prescaler, back to the first register
            self._pointer = 0 if self._pointer in (LAST_LED, PRESCALE) else (self._pointer + 1) & 0xFF

    def _store(self, register: int, value: int) -> None:
        if register == PRESCALE and not self._registers[MODE1] & SLEEP:
            return
        self.log.append((register, value))
        if register == MODE1:
            self._store_mode1(value)
        elif register == PRESCALE:
            self._registers[PRESCALE] = max(value, LEAST_PRESCALE)
        elif ALL_LED <= register <= ALL_LED_OFF_H:
            for channel in range(CHANNELS):
                self._registers[LED0 + 4 * channel + register - ALL_LED] = value & _mask(register - ALL_LED)
        elif LED0 <= register <= LAST_LED:
            self._registers[register] = value & _mask((register - LED0) % 4)
        elif register < LED0:
            self._registers[register] = value

    def _store_mode1(self, value: int) -> None:
        old = self._registers[MODE1]
        restart = old & RESTART
        if value & SLEEP and not old & SLEEP and any(self._set_duty(channel) for channel in range(CHANNELS)):
            restart = RESTART
        elif value & RESTART and not value & SLEEP:
            restart = 0
        self._registers[MODE1] = (value & ~RESTART & 0xFF) | restart | (old & EXTCLK)


class BridgeFake:
    """One motor bridge (TB6612) on three outputs of a chip: what the motor gets, -1 to 1, positive with IN1 high."""

    def __init__(self, chip: Pca9685Fake, pwm: int, in1: int, in2: int) -> None:
        self._chip = chip
        self._pwm, self._in1, self._in2 = pwm, in1, in2

    @property
    def voltage(self) -> float:
        """Share of the supply; 0 also where the motor is braked or left free."""
        return self._chip.duty(self._pwm) * (self._chip.duty(self._in1) - self._chip.duty(self._in2))


def _is_level(register: int) -> bool:
    return LED0 <= register <= LAST_LED or ALL_LED <= register <= ALL_LED_OFF_H


def _mask(byte: int) -> int:
    """The high bytes of the counters have five bits."""
    return 0x1F if byte % 2 else 0xFF
