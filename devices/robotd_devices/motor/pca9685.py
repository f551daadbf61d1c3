"""The PCA9685, a chip of sixteen PWM outputs on I2C: its registers, and writes to it as data.

Source: NXP, PCA9685 product data sheet (section 7.3, register definitions).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeAlias

from robotd_devices.ports.i2c_bus import I2cWrite

MODE1, MODE2 = 0x00, 0x01
RESTART, EXTCLK, AUTO_INCREMENT, SLEEP, ALLCALL = 0x80, 0x40, 0x20, 0x10, 0x01
TOTEM_POLE = 0x04
LED0, CHANNELS, LAST_LED = 0x06, 16, 0x45
ALL_LED, ALL_LED_OFF_H = 0xFA, 0xFD
PRESCALE, LEAST_PRESCALE, MOST_PRESCALE = 0xFE, 0x03, 0xFF
FULL = 0x1000
"""Bit 12 of a counter: the output is on, or off, for the whole period; off wins."""
OSCILLATOR_HZ = 25_000_000
STEPS = 4096

Level: TypeAlias = tuple[int, int]
"""Counts at which an output goes on and off, 0 to 4095, or FULL."""
ON: Level = (FULL, 0)
OFF: Level = (0, FULL)


def prescale(pwm_hz: float) -> int:
    """The prescaler's value nearest to a frequency, within what the chip can do (24 to 1526 Hz)."""
    return min(max(round(OSCILLATOR_HZ / STEPS / pwm_hz) - 1, LEAST_PRESCALE), MOST_PRESCALE)


def level_bytes(level: Level) -> bytes:
    """The four registers of one channel: ON_L, ON_H, OFF_L, OFF_H."""
    on, off = level
    return bytes((on & 0xFF, on >> 8, off & 0xFF, off >> 8))


def level_writes(address: int, levels: Mapping[int, Level]) -> list[I2cWrite]:
    """Levels of channels as the fewest writes: neighbouring channels in one block. Needs AUTO_INCREMENT."""
    writes: list[I2cWrite] = []
    for channel in sorted(levels):
        register, data = LED0 + 4 * channel, level_bytes(levels[channel])
        if writes and writes[-1].register + len(writes[-1].data) == register:
            writes[-1] = I2cWrite(address, writes[-1].register, writes[-1].data + data)
        else:
            writes.append(I2cWrite(address, register, data))
    return writes


def all_off(address: int) -> I2cWrite:
    """Every output off, in one byte: it works whatever mode the chip is in."""
    return I2cWrite(address, ALL_LED_OFF_H, bytes((FULL >> 8,)))


def begin_writes(address: int, pwm_hz: float) -> tuple[I2cWrite, ...]:
    """From any state to running at `pwm_hz` with auto-increment, all outputs off; the first write is the stop.

    After the last but one the chip's oscillator needs 0.5 ms. The prescaler can only be set asleep.
    """
    asleep, awake = AUTO_INCREMENT | SLEEP | ALLCALL, AUTO_INCREMENT | ALLCALL

    def one(register: int, value: int) -> I2cWrite:
        return I2cWrite(address, register, bytes((value,)))

    return (
        all_off(address),
        one(MODE1, asleep),
        one(MODE2, TOTEM_POLE),
        one(PRESCALE, prescale(pwm_hz)),
        one(MODE1, awake),
        one(MODE1, awake | RESTART),
    )
