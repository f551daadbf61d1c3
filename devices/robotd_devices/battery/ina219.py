"""The INA219 battery monitor on I2C: a pack's voltage, the current out of it, and how full it is."""

from __future__ import annotations

import math
import time
from typing import NamedTuple

from pydantic import Field, field_validator, model_validator

from robotd.authoring.device import DeviceUnavailable
from robotd.world.clock import ns
from robotd.world.messages import Battery
from robotd_devices.battery import ina219_chip as chip
from robotd_devices.battery.charge import LITHIUM, charge
from robotd_devices.battery.low import LowBattery
from robotd_devices.ports.i2c_bus import I2cBus
from robotd_devices.ports.i2c_sensor import I2cSensor, I2cSensorConfig

_AVERAGED_S = 0.034


class Ina219Config(I2cSensorConfig):
    """Parameters of an INA219. The defaults are the chip's on most boards; a JetBot's has the address 0x41."""

    address: int = Field(default=0x40, ge=0x40, le=0x4F)
    """Address of the chip, by its pins A0 and A1."""
    rate_hz: float = Field(default=2.0, gt=0.0, le=20.0)
    """Readings a second; each is an average over 34 ms."""
    shunt_ohm: float = Field(default=0.1, gt=0.0, le=10.0)
    """Resistance of the shunt."""
    max_a: float = Field(default=3.2, gt=0.0, le=500.0)
    """The largest current to measure; the finest range that holds it is chosen."""
    reversed: bool = False
    """IN+ and IN- are swapped: the battery is on IN-."""
    cells: int | None = Field(default=None, ge=1, le=24)
    """Cells in series; without it the charge is not known."""
    cell_table: tuple[tuple[float, float], ...] = LITHIUM
    """Volts of a cell at rest and its charge, both rising."""
    pack_ohm: float = Field(default=0.0, ge=0.0, le=5.0)
    """Inner resistance of the pack: what the current takes off its voltage is added before the table is asked."""
    low_cell_v: float = Field(default=3.5, ge=0.0, le=5.0)
    """Volts of a cell below which the battery is low; 0: never."""
    low_after_s: float = Field(default=5.0, ge=0.0, le=600.0)
    """For so long it must be below without a break: motors that start pull it down for a moment."""

    @field_validator("cell_table")
    @classmethod
    def _rising(cls, table: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
        charge(0.0, table)
        return table

    @model_validator(mode="after")
    def _within_range(self) -> Ina219Config:
        chip.gain_for(self.max_a * self.shunt_ohm)
        return self

    @property
    def gain(self) -> int:
        """The gain's bits of the range in use."""
        return chip.gain_for(self.max_a * self.shunt_ohm)


class Reading(NamedTuple):
    """What the chip measured. `current_a` positive = discharging, nan where it is beyond the range."""

    voltage_v: float
    current_a: float


class Ina219(I2cSensor[Ina219Config, Battery, Reading]):
    """Publishes the pack's voltage and current. Stamps lie in the middle of the chip's average.

    Faults that it counts: `I2C retry`, `current beyond the range`, `battery low` (when it begins). Lost where a
    transaction fails three times, and where the chip forgot its settings (its supply broke down).
    """

    sim_twin = "sim_battery"

    def prepare(self) -> None:
        config = self.config
        self._low = LowBattery(config.low_cell_v * (config.cells or 0), ns(config.low_after_s))
        self._was_low = False

    def take(self, reading: Reading, read_ns: int) -> None:
        config = self.config
        known = math.nan
        if config.cells:
            current_a = 0.0 if math.isnan(reading.current_a) else reading.current_a
            known = charge((reading.voltage_v + current_a * config.pack_ohm) / config.cells, config.cell_table)
        if math.isnan(reading.current_a):
            self.context.link.fault("current beyond the range", f"more than {config.max_a:g} A: raise `max_a`")
        low = self._low.take(reading.voltage_v, read_ns)
        if low and not self._was_low:
            self.context.link.fault("battery low", f"{reading.voltage_v:.2f} V: charge it")
        self._was_low = low
        self.publish(Battery(read_ns - ns(_AVERAGED_S / 2.0), reading.voltage_v, reading.current_a, known, low))

    # ---------------------------------------------------------------------------- on the reader's thread

    def begin(self, bus: I2cBus) -> None:
        """Reset, which proves that it is an INA219, then the settings. Raises OSError and DeviceUnavailable."""
        config = self.config
        bus.write(config.address, chip.CONFIG, chip.word(chip.RESET))
        found = bus.read(config.address, chip.CONFIG, 2)
        if found != chip.word(chip.AFTER_RESET):
            raise DeviceUnavailable(
                f"the chip at {config.place} is no INA219: after a reset its settings read {found.hex()}, "
                f"not {chip.AFTER_RESET:04x}; correct `address`"
            )
        bus.write(config.address, chip.CONFIG, chip.word(chip.settings(config.gain)))
        # until the first average is complete the registers hold what was measured before the reset
        time.sleep(1.2 * _AVERAGED_S)

    def read(self, bus: I2cBus) -> Reading:
        """One reading. Raises OSError, and DeviceUnavailable where the settings are not as they were set."""
        config = self.config
        found = bus.read(config.address, chip.CONFIG, 2)
        if found != chip.word(chip.settings(config.gain)):
            raise DeviceUnavailable(
                f"the chip at {config.place} lost its settings ({found.hex()}): its supply broke down, "
                "or another program uses it"
            )
        shunt = bus.read(config.address, chip.SHUNT, 2)
        across_v, bus_v = chip.shunt_v(shunt), chip.bus_v(bus.read(config.address, chip.BUS, 2))
        # the chip sees IN-; the battery is on the shunt's other end unless it is reversed
        voltage_v = bus_v if config.reversed else bus_v + across_v
        current_a = (-across_v if config.reversed else across_v) / config.shunt_ohm
        return Reading(voltage_v, math.nan if chip.is_at_limit(shunt, config.gain) else current_a)
