"""Registers of the MPU-6050, MPU-6500 and MPU-9250 as data: what to write, and what their 14 bytes mean.

Sources: InvenSense, MPU-6000/MPU-6050 register map RM-MPU-6000A (revision 4.2); MPU-6500 RM-MPU-6500A (2.1); MPU-9250
RM-MPU-9250A (1.6). All words are big-endian and signed.
"""

from __future__ import annotations

import math
import struct
from typing import NamedTuple

import numpy as np

from robotd.world.messages import Float64s

SAMPLE_DIVIDER = 0x19
CONFIG = 0x1A
GYRO_CONFIG = 0x1B
ACCEL_CONFIG = 0x1C
ACCEL_CONFIG_2 = 0x1D
ACCEL_X = 0x3B
POWER_1 = 0x6B
WHO_AM_I = 0x75

RESET = 0x80
SLEEP = 0x40
CLOCK_GYRO = 0x01

GRAVITY_MPS2 = 9.80665
GYRO_RANGES_DPS = (250, 500, 1000, 2000)
ACCEL_RANGES_G = (2, 4, 8, 16)
FULL = 32768.0
SAMPLE = struct.Struct(">7h")
"""Acceleration x, y, z, temperature, rate x, y, z, from ACCEL_X on."""

FILTERS = ((184.0, 0.0029), (92.0, 0.0039), (41.0, 0.0059), (20.0, 0.0099), (10.0, 0.0178), (5.0, 0.0335))
"""Bandwidth in Hz and delay in s of the rates' low-pass, for the filter's settings 1 to 6, of an MPU-6500.

An MPU-6050's bandwidths are the same within 7 Hz; its delays are 1 to 2 ms shorter, then 4 and 15 ms.
"""


class Model(NamedTuple):
    """A member of the family: its name, and whether the accelerometer's filter has a register of its own."""

    name: str
    has_accel_filter: bool


MODELS = {
    0x68: Model("MPU-6050", False),
    0x70: Model("MPU-6500", True),
    0x71: Model("MPU-9250", True),
    0x73: Model("MPU-9255", True),
}
"""By WHO_AM_I."""


def filter_for(rate_hz: float) -> int:
    """The setting of the widest low-pass that still lies below half of the rate at which we read."""
    for setting, (bandwidth_hz, _) in enumerate(FILTERS, start=1):
        if bandwidth_hz <= rate_hz / 2.0:
            return setting
    return len(FILTERS)


def settings(rate_hz: float, gyro_range_dps: int, accel_range_g: int, model: Model) -> dict[int, int]:
    """Register values, in the order in which they are written; the chip samples at 1 kHz."""
    low_pass = filter_for(rate_hz)
    values = {
        SAMPLE_DIVIDER: 0,
        CONFIG: low_pass,
        GYRO_CONFIG: GYRO_RANGES_DPS.index(gyro_range_dps) << 3,
        ACCEL_CONFIG: ACCEL_RANGES_G.index(accel_range_g) << 3,
    }
    if model.has_accel_filter:
        values[ACCEL_CONFIG_2] = low_pass
    return values


def rates_radps(raw: tuple[int, ...], gyro_range_dps: int) -> Float64s:
    """Rates (3,) about the chip's own axes, of a SAMPLE."""
    return np.array(raw[4:7], dtype=np.float64) * (math.radians(gyro_range_dps) / FULL)


def forces_mps2(raw: tuple[int, ...], accel_range_g: int) -> Float64s:
    """Specific force (3,) along the chip's own axes, of a SAMPLE."""
    return np.array(raw[0:3], dtype=np.float64) * (accel_range_g * GRAVITY_MPS2 / FULL)


def is_at_limit(raw: tuple[int, ...]) -> bool:
    """Whether a rate or an acceleration is at the end of its range."""
    return any(value in (-32768, 32767) for value in (*raw[0:3], *raw[4:7]))
