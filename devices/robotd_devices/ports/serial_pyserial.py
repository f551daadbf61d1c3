"""The default serial back end: pyserial-asyncio opens, reads and reports the loss; its traps are closed here.

Known of pyserial-asyncio 0.6 and pyserial 3.5: opening blocks the loop (so it is done in a worker thread);
`close()` with unsent output never ends (so `abort()` only); on the way out it calls tcdrain on the loop (so the
output is thrown away before); a second `abort()` raises from a callback. The `-fast` fork hangs the loop on a full
line and is not used.
"""

from __future__ import annotations

import asyncio
import fcntl
import termios
from typing import Any

from robotd_devices.ports import serial_line
from robotd_devices.ports.serial_base import SerialBase, off_loop

#: The transport never reads more at once.
_TRANSPORT_READ = 1024


class _Relay(asyncio.Protocol):
    """Passes what the transport says to the port, until the port lets go."""

    def __init__(self, port: PySerialPort) -> None:
        self.port: PySerialPort | None = port

    def data_received(self, data: bytes) -> None:
        if self.port is not None:
            self.port.received(data)

    def connection_lost(self, exc: Exception | None) -> None:
        if self.port is not None:
            self.port.transport_lost(exc)


class PySerialPort(SerialBase):
    """A `SerialPort` over pyserial-asyncio's transport."""

    _transport: Any = None
    _relay: _Relay | None = None

    async def open(self) -> None:
        import serial
        import serial_asyncio

        def blocking() -> Any:
            self.settings = settings = serial_line.find_line(self.settings)
            line = serial.Serial()
            line.port, line.baudrate, line.exclusive = settings.path, settings.baud, True
            line.timeout = line.write_timeout = 0
            if settings.dtr is not None:
                line.dtr = settings.dtr
            try:
                line.open()
            except (OSError, termios.error, ValueError) as error:
                raise serial_line.why_not_open(settings, error) from error
            serial_line.set_low_latency(line.fileno())
            return line

        line = await off_loop(blocking, lambda late: late.close())
        self._loop = asyncio.get_running_loop()
        self._relay = _Relay(self)
        self._transport = serial_asyncio.SerialTransport(self._loop, self._relay, line)
        self._fd = line.fileno()

    def received(self, data: bytes) -> None:
        """Bytes from the transport, inside the loop's reader callback."""
        self._on_data(self._with_rest(data, _TRANSPORT_READ))

    def transport_lost(self, error: Exception | None) -> None:
        """The transport's report; the descriptor is still open and is closed by the transport after this call."""
        self._transport = None
        self._lose(f"{self.settings.path} went away ({error or 'closed'})")

    def _let_go(self) -> None:
        if self._relay is not None:
            self._relay.port = None
        transport, self._transport = self._transport, None
        if transport is None:
            return
        # the transport closes the descriptor one turn later: the lock must not outlive this call
        fcntl.flock(self._fd, fcntl.LOCK_UN)
        if not transport.is_closing():
            transport.abort()
