"""The serial back end over serialx (an extra): it opens, locks and sets the line up; reading and writing are ours.

Its transport is not used: when a line is lost it closes the descriptor in a worker thread before it says so, and a stop
written meanwhile could go into whatever was opened under that number.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import termios
from typing import Any

from robotd_devices.ports import serial_line
from robotd_devices.ports.serial_base import off_loop
from robotd_devices.ports.serial_raw import RawSerialPort


class SerialXPort(RawSerialPort):
    """A `SerialPort` on a line that serialx opened."""

    _serial: Any = None

    async def open(self) -> None:
        import serialx

        def blocking() -> Any:
            self.settings = settings = serial_line.find_line(self.settings)
            make: Any = serialx.Serial
            pins = {} if settings.dtr is None else {"dtr_on_open": serialx.PinState(int(settings.dtr))}
            line = make(settings.path, baudrate=settings.baud, exclusive=True, **pins)
            try:
                line.open()
                os.set_blocking(line.fileno(), False)
            except (OSError, termios.error, ValueError, serialx.SerialException) as error:
                with contextlib.suppress(OSError, termios.error):
                    line.close()
                raise serial_line.why_not_open(settings, error) from error
            return line

        self._serial = line = await off_loop(blocking, lambda late: late.close())
        self._loop = asyncio.get_running_loop()
        self._fd = line.fileno()
        self._loop.add_reader(self._fd, self._readable)

    def _let_go(self) -> None:
        assert self._loop is not None
        if not self._loop.is_closed():
            self._loop.remove_reader(self._fd)
        line, self._serial = self._serial, None
        with contextlib.suppress(OSError, termios.error):  # it is gone already
            line.close()
