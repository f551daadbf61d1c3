"""An MPU-6050, MPU-6500 or MPU-9250 on I2C as an inertial unit in the base frame."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Literal, TypeAlias

import numpy as np
from pydantic import Field

from robotd.authoring.device import DeviceContext, DeviceUnavailable
from robotd.world.clock import ns
from robotd.world.messages import Float64s, Imu
from robotd.world.rotation import sensor_base
from robotd_devices.imu import mpu_chip as chip
from robotd_devices.imu.zeroing import zero
from robotd_devices.ports.i2c_bus import I2cBus
from robotd_devices.ports.i2c_sensor import I2cSensor, I2cSensorConfig

Three: TypeAlias = tuple[float, float, float]
Raw: TypeAlias = tuple[int, ...]

_AFTER_RESET_S = 0.1
_AFTER_WAKING_S = 0.035


class Mpu6050Config(I2cSensorConfig):
    """Parameters of an MPU-6050, MPU-6500 or MPU-9250. Where it sits and how it is turned is in `robot.mounts`."""

    address: Literal[0x68, 0x69] = 0x68
    """0x69 where the pin AD0 is high."""
    who_am_i: int | None = Field(default=None, ge=0, le=255)
    """Identity of a clone that is to be taken for an MPU-6500; by default only the known ones are accepted."""
    rate_hz: float = Field(default=100.0, ge=5.0, le=500.0)
    """Samples a second. The chip's low-pass is chosen to fit: the widest below half of this."""
    gyro_range_dps: Literal[250, 500, 1000, 2000] = 500
    """Fastest rate of turn that can be measured, degrees a second."""
    accel_range_g: Literal[2, 4, 8, 16] = 4
    """Largest acceleration that can be measured, in g."""
    gyro_scale: Three = (1.0, 1.0, 1.0)
    """Factors on the rates about the chip's own axes; measure them with whole turns."""
    gyro_offset_radps: Three = (0.0, 0.0, 0.0)
    """What the rates show at rest about the chip's own axes; used where `zero_s` is 0 or the robot moves."""
    accel_scale: Three = (1.0, 1.0, 1.0)
    """Factors on the accelerations along the chip's own axes."""
    accel_offset_mps2: Three = (0.0, 0.0, 0.0)
    """What is taken off the accelerations along the chip's own axes before the factors."""
    zero_s: float = Field(default=0.5, ge=0.0, le=30.0)
    """For so long at opening the rates at rest are measured, and taken off from then on; 0: not."""
    frozen_s: float = Field(default=0.5, ge=0.1, le=10.0)
    """The very same values for so long mean that the chip hangs: it is set up anew."""


class Mpu6050(I2cSensor[Mpu6050Config, Imu, Raw]):
    """Publishes rates and specific force in base axes, as at the place where the chip sits.

    Stamps lie before the reading by the low-pass's delay. Nothing is published while the rates at rest are measured.
    Faults that it counts: `I2C retry`, `beyond the range`, `moved while zeroing` (the offsets before, or the config's,
    stay). Lost where a transaction fails three times, and where the chip repeats itself for `frozen_s`, as it does
    after its supply broke down.
    """

    sim_twin = "sim_imu"

    def __init__(
        self,
        config: Mpu6050Config,
        context: DeviceContext | None = None,
        *,
        open_bus: Callable[[], I2cBus] | None = None,
    ) -> None:
        super().__init__(config, context, open_bus=open_bus)
        self._turn = sensor_base(self.context.mount)
        self._gyro_offset: Float64s = np.array(config.gyro_offset_radps)
        self._zeroing: list[Float64s] | None = None
        self._zero_until_ns = 0
        self._before: Raw = ()
        self._same_since_ns = 0

    def prepare(self) -> None:
        self._before, self._zero_until_ns = (), 0
        self._zeroing = [] if self.config.zero_s > 0.0 else None

    def take(self, raw: Raw, read_ns: int) -> None:
        config = self.config
        if raw != self._before:
            self._before, self._same_since_ns = raw, read_ns
        elif read_ns - self._same_since_ns >= ns(config.frozen_s):
            self.lost(
                f"the same values for {config.frozen_s:g} s: its supply broke down, or it hangs; it is set up anew"
            )
            return
        if chip.is_at_limit(raw):
            self.context.link.fault("beyond the range", "raise `gyro_range_dps` or `accel_range_g`")
        rates = chip.rates_radps(raw, config.gyro_range_dps)
        if self._zeroing is not None:
            self._zero(rates, read_ns)
            return
        forces = chip.forces_mps2(raw, config.accel_range_g)
        wx, wy, wz = (self._turn @ ((rates - self._gyro_offset) * config.gyro_scale)).tolist()
        ax, ay, az = (self._turn @ ((forces - config.accel_offset_mps2) * config.accel_scale)).tolist()
        _, delay_s = chip.FILTERS[chip.filter_for(config.rate_hz) - 1]
        self.publish(Imu(read_ns - ns(delay_s), wx, wy, wz, ax, ay, az))

    def _zero(self, rates: Float64s, read_ns: int) -> None:
        assert self._zeroing is not None
        if not self._zeroing:
            self._zero_until_ns = read_ns + ns(self.config.zero_s)
        self._zeroing.append(rates)
        if read_ns < self._zero_until_ns:
            return
        found, why_not = zero(np.array(self._zeroing))
        self._zeroing = None
        if found is None:
            self.context.link.fault(
                "moved while zeroing", f"{why_not}; let it stand still for {self.config.zero_s:g} s"
            )
        else:
            self._gyro_offset = found

    # ---------------------------------------------------------------------------- on the reader's thread

    def begin(self, bus: I2cBus) -> None:
        """Reset, wake up, set up and read back. Raises OSError, and DeviceUnavailable for another chip."""
        config = self.config
        (identity,) = bus.read(config.address, chip.WHO_AM_I, 1)
        model = chip.MODELS.get(identity)
        if model is None and identity == config.who_am_i:
            model = chip.Model(f"0x{identity:02X}", True)
        if model is None:
            known = ", ".join(f"0x{number:02X} {known.name}" for number, known in chip.MODELS.items())
            raise DeviceUnavailable(
                f"the chip at {config.place} says 0x{identity:02X} when asked who it is; known are {known}. "
                f"Correct `address`, or, if it is a clone, set `who_am_i: {identity}`"
            )
        bus.write(config.address, chip.POWER_1, bytes((chip.RESET,)))
        time.sleep(_AFTER_RESET_S)
        bus.write(config.address, chip.POWER_1, bytes((chip.CLOCK_GYRO,)))
        time.sleep(_AFTER_WAKING_S)
        settings = chip.settings(config.rate_hz, config.gyro_range_dps, config.accel_range_g, model)
        for register, value in settings.items():
            bus.write(config.address, register, bytes((value,)))
            (found,) = bus.read(config.address, register, 1)
            if found != value:
                raise DeviceUnavailable(
                    f"the {model.name} at 0x{config.address:02X} does not keep what is written to register "
                    f"0x{register:02X} ({value:02x} became {found:02x}): noise on the wires, or another chip"
                )

    def read(self, bus: I2cBus) -> Raw:
        """One sample as the chip's own numbers, all of the same instant. Raises OSError."""
        return chip.SAMPLE.unpack(bus.read(self.config.address, chip.ACCEL_X, chip.SAMPLE.size))
