"""What every serial back end shares: writing without blocking, one report of loss, opening off the loop."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable
from typing import TypeVar

from robotd_devices.ports import serial_line
from robotd_devices.ports.serial_port import SerialSettings

T = TypeVar("T")

_DRAIN_STEP_S = 0.001

#: What the kernel hands over at once when more is waiting (its line buffer has 4096 bytes, one of them unused).
READ_BYTES = 4095
#: The most that one callback takes from the kernel: a second and more of the fastest lidar.
_LONGEST_READ = 262_144


async def off_loop(call: Callable[[], T], undo: Callable[[T], object]) -> T:
    """Run a blocking opening in a worker thread; where we are cancelled meanwhile, its late result is undone."""
    future = asyncio.get_running_loop().run_in_executor(None, call)
    try:
        return await asyncio.shield(future)
    except asyncio.CancelledError:

        def late(done: asyncio.Future[T]) -> None:
            if not done.cancelled() and done.exception() is None:
                undo(done.result())

        future.add_done_callback(late)
        raise


class SerialBase:
    """Writing, draining, modem lines and the one report of loss over a non-blocking descriptor `_fd`.

    The back ends write here and not through their library: pyserial's own write spins on a full line, and
    pyserial-asyncio holds back its report of a loss while its buffer is not empty.
    """

    def __init__(
        self, settings: SerialSettings, on_data: Callable[[bytes], None], on_lost: Callable[[str], None]
    ) -> None:
        self.settings = settings
        """As given; from opening on with the path that a pattern fitted."""
        self._on_data = on_data
        self._on_lost = on_lost
        self._fd = -1
        self._out = bytearray()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._failing = False

    @property
    def is_open(self) -> bool:
        """Whether the line is open and not lost."""
        return self._fd >= 0

    @property
    def unsent(self) -> int:
        return len(self._out)

    def write(self, data: bytes, *, first: bool = False) -> None:
        if self._fd < 0 or self._failing:
            return
        if first:
            self._drop_output()
        if self._out:
            self._out += data
            return
        sent = self._send(data)
        if sent < len(data) and not self._failing:
            assert self._loop is not None
            self._out += data[sent:]
            self._loop.add_writer(self._fd, self._writable)

    async def drain(self, timeout_s: float) -> bool:
        loop = asyncio.get_running_loop()
        until = loop.time() + timeout_s
        # tcdrain has no time limit and cannot be interrupted: ask the kernel for its count instead
        while self._out or (self._fd >= 0 and serial_line.output_waiting(self._fd)):
            if loop.time() >= until:
                return False
            await asyncio.sleep(_DRAIN_STEP_S)
        return self._fd >= 0

    def set_dtr(self, on: bool) -> bool:
        if self._fd < 0:
            return False
        try:
            return serial_line.set_dtr(self._fd, on)
        except OSError:
            return False

    def abort(self) -> None:
        if self._fd >= 0:
            self._drop_output()
            self._let_go()
            self._fd = -1

    def _with_rest(self, data: bytes) -> bytes:
        """What a full read gave, and all that waits behind it.

        After a stall of the loop the driver must see how much came at once, or it takes old bytes for new ones.
        """
        pieces, total = [data], len(data)
        while total < _LONGEST_READ:
            try:
                piece = os.read(self._fd, _LONGEST_READ)
            except OSError:
                break  # nothing more, or lost: the next reader callback says which
            if not piece:
                break
            pieces.append(piece)
            total += len(piece)
        return b"".join(pieces)

    def _let_go(self) -> None:
        """Stop reading and release the descriptor; the output has been dropped already."""
        raise NotImplementedError

    def _lose(self, reason: str) -> None:
        """The line went away: let go of it and say so, once."""
        if self._fd < 0:
            return
        self.abort()
        self._on_lost(reason)

    def _send(self, data: bytes | bytearray) -> int:
        try:
            return os.write(self._fd, data)
        except (BlockingIOError, InterruptedError):
            return 0
        except OSError as error:
            # not from inside the caller, who may be half way through a turn of his own
            assert self._loop is not None
            self._failing = True
            self._loop.call_soon(self._lose, f"{self.settings.path} went away while writing ({error.strerror})")
            return 0

    def _writable(self) -> None:
        sent = self._send(self._out)
        del self._out[:sent]
        if not self._out or self._failing:
            self._stop_writing()

    def _stop_writing(self) -> None:
        self._out.clear()
        if self._loop is not None and not self._loop.is_closed():
            self._loop.remove_writer(self._fd)

    def _drop_output(self) -> None:
        self._stop_writing()
        serial_line.discard_output(self._fd)
