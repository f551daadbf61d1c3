"""The INA219's registers as data: what to write, and volts and amperes from the words that it gives.

Source: Texas Instruments, INA219 data sheet SBOS448G, section 8.6. All words are big-endian on the wire. Current is
reckoned from the shunt's voltage here, so that the chip's calibration register is not needed.
"""

from __future__ import annotations

CONFIG = 0x00
SHUNT = 0x01
BUS = 0x02

RESET = 0x8000
AFTER_RESET = 0x399F
RANGE_32_V = 0x2000
AVERAGE_32 = 0xD
"""32 samples in 17 ms, of either voltage."""
CONTINUOUS = 0x7

SHUNT_V = 10e-6
"""Volts of one step of the shunt's register, whatever its range."""
BUS_V = 4e-3
GAINS_V = (0.04, 0.08, 0.16, 0.32)
"""Full scale of the shunt's voltage by the gain's two bits."""


def gain_for(most_v: float) -> int:
    """The gain's bits of the finest range that holds a voltage. Raises ValueError where none does."""
    for bits, full_v in enumerate(GAINS_V):
        if most_v <= full_v + 1e-9:
            return bits
    raise ValueError(f"{most_v:g} V across the shunt is more than the chip's {GAINS_V[-1]:g} V")


def settings(gain: int) -> int:
    """The configuration: 32 V range, both voltages averaged over 32 samples and measured again and again."""
    return RANGE_32_V | gain << 11 | AVERAGE_32 << 7 | AVERAGE_32 << 3 | CONTINUOUS


def word(value: int) -> bytes:
    return value.to_bytes(2, "big")


def shunt_v(data: bytes) -> float:
    """Volts across the shunt, positive where IN+ is the higher end."""
    return int.from_bytes(data, "big", signed=True) * SHUNT_V


def bus_v(data: bytes) -> float:
    """Volts of IN- against ground."""
    return (int.from_bytes(data, "big") >> 3) * BUS_V


def is_at_limit(data: bytes, gain: int) -> bool:
    """Whether the shunt's voltage is at the end of its range: the current may be anything beyond."""
    return abs(shunt_v(data)) >= GAINS_V[gain] - SHUNT_V
