"""What a driver sees of an I2C bus: blocking reads and writes of register blocks, whatever is behind them."""

from __future__ import annotations

import errno
import os
import stat
from typing import NamedTuple, Protocol

from robotd.authoring.device import DeviceMisconfigured, DeviceUnavailable

GENERAL_CALL = 0x00
"""The address that all chips hear."""

EREMOTEIO = 121
"""Linux's number; other systems have no such error."""
NO_ANSWER = (EREMOTEIO, errno.ENXIO)
"""What Linux reports where no chip acknowledges; which of the two depends on the adapter."""


class I2cWrite(NamedTuple):
    """One write as data: what to send where. `data` begins at `register`."""

    address: int
    register: int
    data: bytes


class I2cBus(Protocol):
    """One bus, used by one thread at a time. Every call blocks: about 0.1 ms a byte at 100 kHz.

    `address`: 7 bits. Errors are OSError with the numbers that Linux gives: EREMOTEIO or ENXIO (nobody acknowledged),
    ETIMEDOUT (a line is held low), EAGAIN (arbitration lost), ENODEV and others (the bus itself went away).
    """

    def read(self, address: int, register: int, count: int) -> bytes:
        """`count` bytes from `register` on, in one transaction with a repeated start."""
        ...

    def write(self, address: int, register: int, data: bytes) -> None:
        """The register's number and then `data`, in one transaction."""
        ...

    def close(self) -> None:
        """Let go. May be called twice."""
        ...


def bus_path(bus: int | str) -> str:
    """The path that a config's `bus` means: a number is `/dev/i2c-N`; `unix:` before a socket's path is left out."""
    text = str(bus)
    return f"/dev/i2c-{text}" if text.isdigit() else text.removeprefix("unix:")


def load_bus(bus: int | str) -> None:
    """The import that a bus needs, for a device's `load`."""
    if not _is_socket(bus_path(bus)):
        import smbus2  # noqa: F401  # the import is the work


def open_bus(bus: int | str) -> I2cBus:
    """Open a bus of the machine, or of a fake behind a Unix socket. Blocks; raises DeviceUnavailable with the mend.

    Raises DeviceMisconfigured for a path that is something else.
    """
    path = bus_path(bus)
    try:
        if _is_socket(path):
            from robotd_devices.ports.i2c_socket import SocketBus

            return SocketBus(path)
        from robotd_devices.ports.i2c_smbus import SmbusBus

        return SmbusBus(path)
    except OSError as error:
        if error.errno == errno.ENOTTY:
            raise DeviceMisconfigured(f"{path} is no I2C bus: correct `bus`") from error
        raise DeviceUnavailable(f"I2C bus {path}: {_why_closed(error)}") from error


def explain(error: OSError, bus: int | str, address: int) -> str:
    """What a failed transaction means to a user, with the mend."""
    where = f"address 0x{address:02X} on I2C bus {bus_path(bus)}"
    if error.errno in NO_ANSWER:
        return f"no chip answers at {where}: is the board powered and plugged in, and are `bus` and `address` right?"
    if error.errno == errno.ETIMEDOUT:
        return (
            f"the bus is stuck ({where}): a chip holds a line low; switch the board off and on, "
            "or free it with nine clock pulses"
        )
    if error.errno == errno.EAGAIN:
        return f"arbitration lost again and again ({where}): another master, or noise on the wires"
    return f"the bus went away ({where}: {error.strerror or type(error).__name__})"


def _why_closed(error: OSError) -> str:
    if error.errno == errno.ENOENT:
        return (
            "does not exist: is `bus` right, and the bus switched on (Raspberry Pi: `sudo raspi-config`, "
            "Interface Options; else `sudo modprobe i2c-dev`; a fake: started)?"
        )
    if error.errno in (errno.EACCES, errno.EPERM):
        return "no permission: `sudo usermod -aG i2c $USER`, then log in again"
    if error.errno == errno.ECONNREFUSED:
        return "nobody listens on this socket: start the fake bus again"
    return error.strerror or str(error)


def _is_socket(path: str) -> bool:
    try:
        return stat.S_ISSOCK(os.stat(path).st_mode)
    except OSError:
        return False
