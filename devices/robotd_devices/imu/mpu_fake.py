"""An MPU-6050, MPU-6500 or MPU-9250 as its bus sees it, on a robot that moves as told; for tests and benches."""

from __future__ import annotations

import math

import numpy as np

from robotd_devices.imu import mpu_chip as chip


class MpuFake:
    """The register file with its rules: asleep after power-on, reset bit, ranges, clipped values, restless noise.

    rates_radps, forces_mps2: what the chip feels along its own axes; may be changed at any time. `stuck`: the same
    values for ever.
    """

    def __init__(self, address: int = 0x68, who_am_i: int = 0x68, noise: float = 4.0) -> None:
        self.address = address
        self.who_am_i = who_am_i
        self.rates_radps: tuple[float, float, float] = (0.0, 0.0, 0.0)
        self.forces_mps2: tuple[float, float, float] = (0.0, 0.0, chip.GRAVITY_MPS2)
        self.stuck = False
        self._noise = noise
        self._rng = np.random.default_rng(1)
        self._sample = bytes(chip.SAMPLE.size)
        self.power_on()

    def power_on(self) -> None:
        self.registers = bytearray(128)
        # an MPU-6050 wakes up asleep, the later ones awake
        self.registers[chip.POWER_1] = chip.SLEEP if self.who_am_i == 0x68 else chip.CLOCK_GYRO
        self.registers[chip.WHO_AM_I] = self.who_am_i
        self._pointer = 0

    def answers(self, address: int) -> bool:
        return address == self.address

    def write(self, data: bytes, address: int) -> None:
        self._pointer = data[0] & 0x7F
        for value in data[1:]:
            if self._pointer == chip.POWER_1 and value & chip.RESET:
                self.power_on()
                return
            if self._pointer != chip.WHO_AM_I:
                self.registers[self._pointer] = value
            self._pointer = (self._pointer + 1) & 0x7F

    def read(self, count: int) -> bytes:
        if self._pointer == chip.ACCEL_X and not self.stuck and not self.registers[chip.POWER_1] & chip.SLEEP:
            self._sample = self._measure()
        self.registers[chip.ACCEL_X : chip.ACCEL_X + chip.SAMPLE.size] = self._sample
        out = bytes(self.registers[(self._pointer + i) & 0x7F] for i in range(count))
        self._pointer = (self._pointer + count) & 0x7F
        return out

    def _measure(self) -> bytes:
        gyro_dps = chip.GYRO_RANGES_DPS[self.registers[chip.GYRO_CONFIG] >> 3 & 3]
        accel_g = chip.ACCEL_RANGES_G[self.registers[chip.ACCEL_CONFIG] >> 3 & 3]
        forces = np.array(self.forces_mps2) / (accel_g * chip.GRAVITY_MPS2) * chip.FULL
        rates = np.array(self.rates_radps) / math.radians(gyro_dps) * chip.FULL
        values = np.concatenate((forces, (0.0,), rates))
        values += self._noise * self._rng.standard_normal(7)
        return chip.SAMPLE.pack(*np.clip(np.round(values), -32768, 32767).astype(int).tolist())
