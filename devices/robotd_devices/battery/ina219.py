"""The INA219 battery monitor on I2C: a pack's voltage, the current out of it, and how full it is."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

from pydantic import Field, field_validator, model_validator

from robotd.authoring.config import Config
from robotd.authoring.device import DeviceContext, DeviceError, DeviceUnavailable, Sensor
from robotd.world.clock import ns
from robotd.world.messages import Battery
from robotd_devices.battery import ina219_chip as chip
from robotd_devices.battery.charge import LITHIUM, charge
from robotd_devices.ports import i2c_bus
from robotd_devices.ports.i2c_bus import I2cBus
from robotd_devices.ports.i2c_reader import I2cReader, SensorPlan

_AVERAGED_S = 0.034


class Ina219Config(Config):
    """Parameters of an INA219. The defaults are the chip's on most boards; a JetBot's has the address 0x41."""

    bus: int | str = Field(default=1, union_mode="left_to_right")
    """Number of the I2C bus (1 is /dev/i2c-1), a path, or `unix:` and the path of a fake bus's socket."""
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
    """Volts of a cell below which `battery low` is counted; 0: never."""
    low_after_s: float = Field(default=5.0, ge=0.0, le=600.0)
    """For so long it must be below without a break: motors that start pull it down for a moment."""

    @field_validator("bus")
    @classmethod
    def _plain_path(cls, bus: int | str) -> int | str:
        return bus.removeprefix("unix:") if isinstance(bus, str) else bus

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


class Ina219(Sensor[Ina219Config, Battery]):
    """Publishes the pack's voltage and current. Stamps lie in the middle of the chip's average.

    Faults that it counts: `I2C retry`, `current beyond the range`, `battery low`. Lost where a transaction fails three
    times, and where the chip forgot its settings (its supply broke down).

    open_bus: what opens the bus, on the reader's thread; a fake's in tests.
    """

    sim_twin = "sim_battery"

    def __init__(
        self,
        config: Ina219Config,
        context: DeviceContext | None = None,
        *,
        open_bus: Callable[[], I2cBus] | None = None,
    ) -> None:
        super().__init__(config, context)
        self._open_bus = open_bus if open_bus is not None else partial(i2c_bus.open_bus, config.bus)
        self._reader: I2cReader[Reading] | None = None
        self._low_since_ns: int | None = None

    @classmethod
    def load(cls, config: Ina219Config) -> None:
        i2c_bus.load_bus(config.bus)

    @classmethod
    def publish_period_s(cls, config: Ina219Config) -> float | None:
        return 1.0 / config.rate_hz

    async def open(self) -> None:
        config = self.config
        self._low_since_ns = None
        self._reader = I2cReader(
            self.context.name,
            SensorPlan(
                begin=partial(begin, config),
                read=partial(read, config),
                period_s=1.0 / config.rate_hz,
                explain=partial(i2c_bus.explain, bus=config.bus, address=config.address),
            ),
            self._open_bus,
            self.context.clock,
            on_reading=self._tell,
            on_fault=self.context.link.fault,
            on_lost=self.lost,
        )
        try:
            await self._reader.open()
        except DeviceError as error:
            raise type(error)(f"{self.context.name}: {error}") from error

    async def close(self) -> None:
        reader, self._reader = self._reader, None
        if reader is not None:
            await reader.close()

    def _tell(self, reading: Reading, read_ns: int) -> None:
        config = self.config
        cell_v = reading.voltage_v / config.cells if config.cells else math.nan
        known = math.nan
        if config.cells:
            current_a = 0.0 if math.isnan(reading.current_a) else reading.current_a
            known = charge((reading.voltage_v + current_a * config.pack_ohm) / config.cells, config.cell_table)
        if math.isnan(reading.current_a):
            self.context.link.fault("current beyond the range", f"more than {config.max_a:g} A: raise `max_a`")
        if cell_v >= config.low_cell_v or math.isnan(cell_v):
            self._low_since_ns = None
        elif self._low_since_ns is None:
            self._low_since_ns = read_ns
        if self._low_since_ns is not None and read_ns - self._low_since_ns >= ns(config.low_after_s):
            self.context.link.fault("battery low", f"{reading.voltage_v:.2f} V, {cell_v:.2f} V a cell: charge it")
        self.publish(Battery(read_ns - ns(_AVERAGED_S / 2.0), reading.voltage_v, reading.current_a, known))


# ------------------------------------------------------------------------------- on the reader's thread


def begin(config: Ina219Config, bus: I2cBus) -> None:
    """Reset, which proves that it is an INA219, then the settings. Raises OSError and DeviceUnavailable."""
    bus.write(config.address, chip.CONFIG, chip.word(chip.RESET))
    found = bus.read(config.address, chip.CONFIG, 2)
    if found != chip.word(chip.AFTER_RESET):
        raise DeviceUnavailable(
            f"the chip at 0x{config.address:02X} on I2C bus {i2c_bus.bus_path(config.bus)} is no INA219: after a reset "
            f"its settings read {found.hex()}, not {chip.AFTER_RESET:04x}; correct `address`"
        )
    bus.write(config.address, chip.CONFIG, chip.word(chip.settings(config.gain)))
    # until the first average is complete the registers hold what was measured before the reset
    time.sleep(1.2 * _AVERAGED_S)


def read(config: Ina219Config, bus: I2cBus) -> Reading:
    """One reading. Raises OSError, and DeviceUnavailable where the settings are not as they were set."""
    found = bus.read(config.address, chip.CONFIG, 2)
    if found != chip.word(chip.settings(config.gain)):
        raise DeviceUnavailable(
            f"the chip at 0x{config.address:02X} on I2C bus {i2c_bus.bus_path(config.bus)} lost its settings "
            f"({found.hex()}): its supply broke down, or another program uses it"
        )
    shunt = bus.read(config.address, chip.SHUNT, 2)
    across_v, bus_v = chip.shunt_v(shunt), chip.bus_v(bus.read(config.address, chip.BUS, 2))
    # the chip sees IN-; the battery is on the shunt's other end unless it is reversed
    voltage_v = bus_v if config.reversed else bus_v + across_v
    current_a = (-across_v if config.reversed else across_v) / config.shunt_ohm
    return Reading(voltage_v, math.nan if chip.is_at_limit(shunt, config.gain) else current_a)
