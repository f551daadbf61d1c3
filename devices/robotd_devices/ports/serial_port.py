"""What a driver sees of a serial line: six methods, whatever library is behind them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol

from robotd.authoring.device import DeviceMisconfigured

Backend = Literal["pyserial", "serialx", "raw"]

#: Start bit, eight data bits, stop bit.
BITS_PER_BYTE = 10


@dataclass(frozen=True, slots=True)
class SerialSettings:
    """One line: 8 data bits, no parity, one stop bit, no flow control, locked against other programs.

    path: a stable name (`/dev/serial/by-id/...`), never `/dev/ttyUSB0`, which changes with the order of plugging; or a
    pattern with `*` that fits exactly one name at the time of opening.
    dtr: state of the DTR line right after opening; None leaves what the system does (Linux raises it).
    """

    path: str
    baud: int
    dtr: bool | None = None

    @property
    def byte_ns(self) -> int:
        """Nanoseconds that one byte takes on the wire."""
        return BITS_PER_BYTE * 1_000_000_000 // self.baud


class SerialPort(Protocol):
    """An exclusive serial line on the running event loop. All calls belong on the loop thread.

    A port is opened once; after a loss or `abort` a new one is made. The two callbacks are given at construction:
    `on_data(data)` runs inside the loop's reader callback, in the turn in which the bytes arrived, `data` never empty;
    `on_lost(reason)` is called exactly once when the line goes away, never after `abort`, never from inside `write`.
    """

    @property
    def settings(self) -> SerialSettings:
        """As given; from opening on with the path that a pattern fitted."""
        ...

    @property
    def unsent(self) -> int:
        """Bytes that the kernel has not taken yet. A motor writer replaces its command while this is not zero."""
        ...

    async def open(self) -> None:
        """Open in a worker thread, lock, and begin to read. Old input is thrown away.

        Raises DeviceUnavailable (no such port, no permission, busy and by whom) and DeviceMisconfigured (not a serial
        line, a baud rate that it cannot do). Safe to cancel: a descriptor that arrives late is closed.
        """
        ...

    def write(self, data: bytes, *, first: bool = False) -> None:
        """Hand bytes to the kernel now; what it does not take is kept and follows when it does. Never blocks.

        `first=True` throws away everything unsent, here and in the kernel, so that a stop does not wait behind motion;
        it may cut a frame in two, so the stop must begin with its protocol's delimiter. On a lost line it does nothing.
        """
        ...

    async def drain(self, timeout_s: float) -> bool:
        """Wait until everything written has left the kernel; False where that took longer. Does not block the loop."""
        ...

    def abort(self) -> None:
        """Let go at once: unsent output is dropped, nothing is reported. May be called twice, and after a loss."""
        ...

    def set_dtr(self, on: bool) -> bool:
        """Set the DTR line; False where the port has no modem lines (a pty, some bridges) or is gone."""
        ...


def serial_port(
    settings: SerialSettings, backend: Backend, on_data: Callable[[bytes], None], on_lost: Callable[[str], None]
) -> SerialPort:
    """A closed port of the named back end. Raises DeviceMisconfigured for a name that is not one."""
    if backend == "pyserial":
        from robotd_devices.ports.serial_pyserial import PySerialPort

        return PySerialPort(settings, on_data, on_lost)
    if backend == "serialx":
        from robotd_devices.ports.serial_x import SerialXPort

        return SerialXPort(settings, on_data, on_lost)
    if backend == "raw":
        from robotd_devices.ports.serial_raw import RawSerialPort

        return RawSerialPort(settings, on_data, on_lost)
    raise DeviceMisconfigured(f"serial backend {backend!r} is not one of: pyserial, serialx, raw")


def load_backend(backend: Backend) -> None:
    """The imports of a back end, for a device's `load`. Raises ImportError naming the package."""
    if backend == "pyserial":
        import serial  # noqa: F401
        import serial_asyncio  # noqa: F401
    if backend == "serialx":
        try:
            import serialx  # noqa: F401
        except ImportError as error:
            raise ImportError(
                "backend: serialx is not installed: `pip install robotd[serialx]`, or leave `backend` out",
                name="serialx",
            ) from error
