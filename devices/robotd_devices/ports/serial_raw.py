"""The serial back end without a library: a termios descriptor and the loop's reader callback."""

from __future__ import annotations

import asyncio
import os
import termios

from robotd_devices.ports import serial_line
from robotd_devices.ports.serial_base import READ_BYTES, SerialBase, off_loop


class RawSerialPort(SerialBase):
    """A `SerialPort` over a bare descriptor; any speed the line can do, no dependency, the lowest latency."""

    async def open(self) -> None:
        def blocking() -> int:
            self.settings = settings = serial_line.find_line(self.settings)
            try:
                return serial_line.open_line(settings)
            except (OSError, termios.error, ValueError) as error:
                raise serial_line.why_not_open(settings, error) from error

        fd = await off_loop(blocking, os.close)
        self._loop = asyncio.get_running_loop()
        self._fd = fd
        self._loop.add_reader(fd, self._readable)

    def _readable(self) -> None:
        try:
            data = os.read(self._fd, READ_BYTES)
        except (BlockingIOError, InterruptedError):
            return
        except OSError as error:
            self._lose(f"{self.settings.path} went away ({error.strerror})")
            return
        if data:
            self._on_data(data if len(data) < READ_BYTES else self._with_rest(data))
        else:
            self._lose(f"{self.settings.path} went away (end of file)")

    def _let_go(self) -> None:
        assert self._loop is not None
        if not self._loop.is_closed():
            self._loop.remove_reader(self._fd)
        os.close(self._fd)
