"""A motor controller's serial line: the newest command only, a stop before everything else, a stop on every way out."""

from __future__ import annotations

import asyncio
import atexit
import contextlib
from collections.abc import Callable
from typing import TypeAlias

from robotd_devices.ports.serial_port import Backend, SerialPort, SerialSettings

MakePort: TypeAlias = Callable[
    [SerialSettings, Backend, Callable[[bytes], None], Callable[[str], None]],
    SerialPort,
]
"""What makes a port; `robotd_devices.ports.serial_port.serial_port`, or a fake's in tests."""

FRESH_S = 0.06
"""A command that waited longer is not written any more: a program that was frozen meanwhile wakes up to a stop."""
_DRAIN_S = 0.1
BLOCKED_S = 0.2
"""What was written and has not left the kernel for so long does not leave it any more."""


class MotorLine:
    """One open line. `stop_bytes`: the stop behind as many delimiters as it takes to end a frame that was cut in two.

    At most one command waits, the newest, and no command waits in the kernel: what a full line did not take is thrown
    away and replaced. A stop goes out in the very call, before anything that waits, and once more after `again_s`, for
    a controller that lost the first one; commands wait for that second stop. `gap_s`: least time between two writes,
    for controllers that lose what comes sooner. `delimiter`: ends a frame that was cut, before a command that replaces
    it. `on_full`: called each time that a command replaced one that the line did not take.
    """

    def __init__(
        self,
        port: SerialPort,
        stop_bytes: bytes,
        *,
        delimiter: bytes = b"",
        gap_s: float = 0.0,
        again_s: float = 0.01,
        on_full: Callable[[], None] = lambda: None,
    ) -> None:
        self.stop_bytes = stop_bytes
        self._port = port
        self._delimiter = delimiter
        self._gap_s = gap_s
        self._again_s = max(again_s, gap_s)
        self._on_full = on_full
        self._is_open = False
        self._wanted: bytes | None = None
        self._wanted_s = 0.0
        self._free_s = 0.0
        self._again = False
        self._timer: asyncio.TimerHandle | None = None
        self._draining: asyncio.Task[bool] | None = None

    @property
    def path(self) -> str:
        """The line's path; from opening on the one that a pattern fitted."""
        return self._port.settings.path

    async def open(self) -> None:
        """Open the port and write the stop before a byte of it is read. Raises what the port raises."""
        await self._port.open()
        self._loop = asyncio.get_running_loop()
        self._is_open = True
        atexit.register(self._at_exit)
        self.stop()

    def put(self, frame: bytes) -> None:
        """Write a command, now or as soon as it may; one that still waits is forgotten. Never blocks."""
        if not self._is_open:
            return
        if self._timer is None:
            self._send(frame)
        else:
            self._wanted, self._wanted_s = frame, self._loop.time()

    def ask(self, frame: bytes) -> bool:
        """Write a question where nothing is in its way; False where it was not written. Questions never wait."""
        if not self._is_open or self._timer is not None or self._port.unsent:
            return False
        self._send(frame)
        return True

    def stop(self, behind: bytes = b"") -> None:
        """Write the stop now, before everything that waits here and in the kernel. Never blocks, never raises.

        behind: what is to follow it in the same write.
        """
        self._wanted = None
        if not self._is_open:
            return
        self._port.write(self.stop_bytes + behind, first=True)
        self._again = True
        self._wait(self._again_s + self._wire_s(self.stop_bytes))

    def is_blocked(self) -> bool:
        """Whether a look that is over found bytes that did not leave for `BLOCKED_S`; begins the next look."""
        if not self._is_open:
            return False
        looked, self._draining = self._draining, None
        if looked is not None and not looked.done():
            self._draining = looked
            return False
        self._draining = self._loop.create_task(self._port.drain(BLOCKED_S))
        return looked is not None and not looked.cancelled() and not looked.result()

    async def close(self) -> None:
        """Write the stop as the last thing, give it 0.1 s to leave, let go. May be called twice."""
        was_open = self._is_open
        self._end()
        if was_open:
            self._port.write(self.stop_bytes, first=True)
            await self._port.drain(_DRAIN_S)
        self._port.abort()

    def _end(self) -> None:
        self._is_open, self._wanted = False, None
        atexit.unregister(self._at_exit)
        if self._draining is not None:
            self._draining.cancel()
            self._draining = None
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _at_exit(self) -> None:
        """The program ends without closing its devices: the stop all the same."""
        with contextlib.suppress(Exception):  # the loop is gone; what the kernel takes at once is what counts
            self._port.write(self.stop_bytes, first=True)

    # -------------------------------------------------------------------------------------------- timing

    def _send(self, frame: bytes) -> None:
        if self._port.unsent:
            # what waits is older than this, in the kernel too
            self._port.write(self._delimiter + frame, first=True)
            self._on_full()
        else:
            self._port.write(frame)
        if self._gap_s:
            self._wait(self._gap_s + self._wire_s(frame))

    def _wire_s(self, data: bytes) -> float:
        """How long bytes take on the wire."""
        return len(data) * self._port.settings.byte_ns / 1e9

    def _wait(self, seconds: float) -> None:
        if self._timer is not None:
            self._timer.cancel()
        self._timer = self._loop.call_later(seconds, self._due)

    def _due(self) -> None:
        self._timer = None
        if self._again:
            self._again = False
            if not self._port.unsent:  # else the first one is still on its way
                self._port.write(self.stop_bytes)
            if self._gap_s:
                self._wait(self._gap_s + self._wire_s(self.stop_bytes))
                return
        wanted, self._wanted = self._wanted, None
        if wanted is None:
            return
        if self._loop.time() - self._wanted_s > FRESH_S:
            self.stop()
        else:
            self._send(wanted)
