"""What drivers of sensors on an I2C bus share: opening, the reader's thread, closing."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Generic

from pydantic import Field
from typing_extensions import TypeVar

from robotd.authoring.device import DeviceContext, DeviceError, MessageT, Sensor
from robotd_devices.ports import i2c_bus
from robotd_devices.ports.i2c_bus import I2cBus
from robotd_devices.ports.i2c_config import I2cConfig
from robotd_devices.ports.i2c_reader import I2cReader, SensorPlan


class I2cSensorConfig(I2cConfig):
    """Parameters that every sensor on an I2C bus has; each driver sets its own rate."""

    rate_hz: float = Field(gt=0.0)
    """Readings a second."""


SensorConfigT = TypeVar("SensorConfigT", bound=I2cSensorConfig, default=I2cSensorConfig)
ReadingT = TypeVar("ReadingT", default=object)


class I2cSensor(Sensor[SensorConfigT, MessageT], Generic[SensorConfigT, MessageT, ReadingT]):
    """The shell around a chip that is read at a steady beat. A driver says how, and makes messages of the readings.

    Faults counted here: `I2C retry`. Lost where a transaction fails three times, and where `read` says so.

    open_bus: what opens the bus, on the reader's thread; a fake's in tests.
    """

    def __init__(
        self,
        config: SensorConfigT,
        context: DeviceContext | None = None,
        *,
        open_bus: Callable[[], I2cBus] | None = None,
    ) -> None:
        super().__init__(config, context)
        self._open_bus = open_bus if open_bus is not None else partial(i2c_bus.open_bus, config.bus)
        self._reader: I2cReader[ReadingT] | None = None

    @classmethod
    def load(cls, config: SensorConfigT) -> None:
        i2c_bus.load_bus(config.bus)

    @classmethod
    def publish_period_s(cls, config: SensorConfigT) -> float | None:
        return 1.0 / config.rate_hz

    # ------------------------------------------------------------------------------------ a driver's part

    def begin(self, bus: I2cBus) -> None:
        """On the reader's thread: get the chip ready. Raises OSError, and DeviceUnavailable for another chip."""
        raise NotImplementedError(f"{type(self).__qualname__}.begin")

    def read(self, bus: I2cBus) -> ReadingT:
        """On the reader's thread: one reading. Raises OSError, and DeviceUnavailable where the chip forgot itself."""
        raise NotImplementedError(f"{type(self).__qualname__}.read")

    def prepare(self) -> None:
        """Before each opening: forget what was before."""

    def take(self, reading: ReadingT, read_ns: int) -> None:
        """On the loop: publish a reading; `read_ns` is the instant before it was asked for."""
        raise NotImplementedError(f"{type(self).__qualname__}.take")

    # ---------------------------------------------------------------------------------- the sensor's part

    async def open(self) -> None:
        self.prepare()
        self._reader = I2cReader(
            self.context.name,
            SensorPlan(
                begin=self.begin,
                read=self.read,
                period_s=1.0 / self.config.rate_hz,
                explain=partial(i2c_bus.explain, bus=self.config.bus, address=self.config.address),
            ),
            self._open_bus,
            self.context.clock,
            on_reading=self.take,
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
