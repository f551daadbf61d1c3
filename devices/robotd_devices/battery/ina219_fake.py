"""An INA219 as its bus sees it, between a battery and a load; for tests and for benches without one."""

from __future__ import annotations

from robotd_devices.battery import ina219_chip as chip


class Ina219Fake:
    """The registers with their rules: reset bit, gain and range limits, words big-endian, later bytes repeat nothing.

    voltage_v: of the battery, on IN+. current_a: out of it through the shunt. The two may be changed at any time.
    """

    def __init__(self, address: int = 0x40, shunt_ohm: float = 0.1) -> None:
        self.address = address
        self.shunt_ohm = shunt_ohm
        self.voltage_v = 12.0
        self.current_a = 0.5
        self.power_on()

    def power_on(self) -> None:
        self._config = chip.AFTER_RESET
        self._calibration = 0
        self._pointer = 0

    def answers(self, address: int) -> bool:
        return address == self.address

    def write(self, data: bytes, address: int) -> None:
        self._pointer = data[0]
        if len(data) < 3:
            return
        value = int.from_bytes(data[1:3], "big")
        if self._pointer == chip.CONFIG:
            if value & chip.RESET:
                self.power_on()
            else:
                self._config = value
        elif self._pointer == 0x05:
            self._calibration = value & 0xFFFE

    def read(self, count: int) -> bytes:
        return (chip.word(self._value()) + b"\xff" * count)[:count]

    def _value(self) -> int:
        shunt_v = self.current_a * self.shunt_ohm
        if self._pointer == chip.CONFIG:
            return self._config
        if self._pointer == chip.SHUNT:
            full = round(chip.GAINS_V[self._config >> 11 & 3] / chip.SHUNT_V)
            return max(-full, min(full, round(shunt_v / chip.SHUNT_V))) & 0xFFFF
        if self._pointer == chip.BUS:
            most_v = 32.0 if self._config & chip.RANGE_32_V else 16.0
            steps = round(max(0.0, min(most_v, self.voltage_v - shunt_v)) / chip.BUS_V)
            return steps << 3 | 0x2  # a conversion is ready
        return self._calibration if self._pointer == 0x05 else 0
