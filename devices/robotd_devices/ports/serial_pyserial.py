"""The default serial back end: pyserial-asyncio opens, waits for bytes and reports the loss; its traps are closed here.

Known of pyserial-asyncio 0.6 and pyserial 3.5: opening blocks the loop (so it is done in a worker thread);
`close()` with unsent output never ends (so `abort()` only); on the way out it calls tcdrain on the loop (so the
output is thrown away before); a second `abort()` raises from a callback; pyserial's own `read` asks select before each
of its reads and once more after the last (so the transport is given a plain read). The `-fast` fork hangs the loop on
a full line and is not used.
"""

from __future__ import annotations

import asyncio
import fcntl
import os
import termios
from functools import partial
from typing import Any

from robotd_devices.ports import serial_line
from robotd_devices.ports.serial_base import READ_BYTES, SerialBase, off_loop


def _read(fd: int, gone: type[Exception], size: int) -> bytes:
    """What waits on a line, for a transport that asks for `size` bytes; empty for nothing. Raises `gone`."""
    try:
        data = os.read(fd, READ_BYTES)
    except (BlockingIOError, InterruptedError):
        return b""
    except OSError as error:
        raise gone(error.strerror) from error
    if not data:
        raise gone("end of file")
    return data


class PySerialPort(SerialBase, asyncio.Protocol):
    """A `SerialPort` over pyserial-asyncio's transport, whose protocol it is until it lets go."""

    _transport: Any = None

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
        line.read = partial(_read, line.fileno(), serial.SerialException)
        self._loop = asyncio.get_running_loop()
        self._transport = serial_asyncio.SerialTransport(self._loop, self, line)
        self._fd = line.fileno()

    def data_received(self, data: bytes) -> None:
        """Bytes from the transport, inside the loop's reader callback."""
        if self._transport is not None:
            self._on_data(data if len(data) < READ_BYTES else self._with_rest(data))

    def connection_lost(self, exc: Exception | None) -> None:
        """The transport's report; the descriptor is still open and is closed by the transport after this call."""
        if self._transport is not None:
            self._transport = None
            self._lose(f"{self.settings.path} went away ({exc or 'closed'})")

    def _let_go(self) -> None:
        transport, self._transport = self._transport, None
        if transport is None:
            return
        # the transport closes the descriptor one turn later: the lock must not outlive this call
        fcntl.flock(self._fd, fcntl.LOCK_UN)
        if not transport.is_closing():
            transport.abort()
