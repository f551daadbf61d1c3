"""An I2C bus of the machine, `/dev/i2c-N`, through smbus2."""

from __future__ import annotations

from typing import Any


class SmbusBus:
    """One open `/dev/i2c-N`. Whole transactions (`I2C_RDWR`), so that blocks may be longer than SMBus's 32 bytes.

    `smbus`: an open `smbus2.SMBus`, or what stands for one in a test; by default `path` is opened. Raises OSError.
    """

    def __init__(self, path: str, smbus: Any = None) -> None:
        import smbus2

        self._message = smbus2.i2c_msg
        self._smbus = smbus if smbus is not None else smbus2.SMBus(path)

    def read(self, address: int, register: int, count: int) -> bytes:
        answer = self._message.read(address, count)
        self._smbus.i2c_rdwr(self._message.write(address, (register,)), answer)
        return bytes(answer)

    def write(self, address: int, register: int, data: bytes) -> None:
        self._smbus.i2c_rdwr(self._message.write(address, (register, *data)))

    def close(self) -> None:
        self._smbus.close()
