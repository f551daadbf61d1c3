"""The guardian: a small process of its own that stops the motors when the runtime is blocked, frozen or killed.

    python -I -S guardian.py FD DEADLINE_MS

It is run by its path, isolated and without site packages, in a session of its own, and uses the standard library
only: nothing that a robot installs can slow it down or break it. FD is its end of a Unix socket pair that keeps packets
apart. The first byte of a packet says what it is:

    from the runtime                                      from the guardian
    B  time   armed and alive; time in ns, 8 bytes        R  words  ready, and which privileges it has
    b         alive, nothing may move                     H         the line is held, the stop was written once
    S         write the stop now, watch no longer         N  why    the line is not held
    A         acknowledges a trip: the robot is disarmed  T  time   tripped: no B for that long, in ns, 8 bytes
    s  bytes  a serial line: the stop; its descriptor comes along
    i  path, NUL, then address, size, bytes for each write: an I2C bus
    D         one last stop, then let go of the line
    Q         the end of a run in good order: one last stop, then exit

A line's stop is data: the guardian knows no protocol. It holds a descriptor of its own, never waits on a full line, and
leaves modem lines alone. After a trip it repeats the stop until `A`; when the other end of the socket closes, it
repeats the stop for a while and ends.
"""

from __future__ import annotations

import errno
import fcntl
import os
import select
import signal
import socket
import struct
import sys
import termios
import time
from typing import Protocol

REPEAT_NS = 20_000_000
RETRY_NS = 2_000_000
"""After a stop that the line did not take."""
LAST_STOPS = 10
"""Stops that are written after the runtime is gone."""
LONGEST_END_NS = 2_000_000_000
"""How long that is tried on a line that takes none."""

_IGNORED = ("INT", "TERM", "HUP", "QUIT", "TSTP", "TTIN", "TTOU", "PIPE", "USR1", "USR2", "ALRM")
_I2C_SLAVE_FORCE = 0x0706  # linux/i2c-dev.h; forced, since a stop asks nobody's leave
_FAKE_REQUEST, _FAKE_ANSWER = struct.Struct(">cBBH"), struct.Struct(">HI")  # robotd_devices.ports.i2c_socket
_FAKE_WITHIN_S = 0.05
_MCL_CURRENT, _MCL_ONFAULT = 1, 4  # asm-generic/mman.h
_CLOCK = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)


def clock_ns() -> int:
    """The clock of both processes in nanoseconds; it also counts the time for which the computer was suspended."""
    return time.clock_gettime_ns(_CLOCK)


class Watch:
    """Decides when the stop is written. Pure: every call says what time it is, on one clock, in nanoseconds."""

    def __init__(self, deadline_ns: int) -> None:
        self.deadline_ns = deadline_ns
        self.is_tripped = False
        self.is_over = False
        """Nothing is left to do: the process may end."""
        self._beat_ns: int | None = None
        self._next_ns: int | None = None
        self._left: int | None = 0
        self._end_ns: int | None = None
        self._is_written = True

    def beat(self, sent_ns: int | None) -> None:
        """A sign of life: when it was sent, or None where nothing may move. After a trip only `acknowledge` counts."""
        if self.is_tripped:
            return
        self._beat_ns = sent_ns
        if sent_ns is not None and self._is_written and self._end_ns is None:
            self._next_ns = None  # armed again: what was asked for before is over

    def stop(self, now_ns: int, count: int = 3) -> None:
        """Write the stop so many times from now on, and watch no longer."""
        self._beat_ns = None
        if not self.is_tripped:
            self._begin(now_ns, count)

    def acknowledge(self, now_ns: int) -> None:
        """The runtime knows of the trip and is disarmed: one more stop, for what it wrote before it knew."""
        self.is_tripped, self._beat_ns = False, None
        self._begin(now_ns, 1)

    def end(self, now_ns: int, count: int = LAST_STOPS) -> None:
        """The runtime is gone: some last stops, then `is_over`."""
        self._beat_ns = None
        self._end_ns = now_ns + LONGEST_END_NS
        self._begin(now_ns, count)

    def look(self, now_ns: int) -> int | None:
        """For how long no armed beat came, where that trips the guardian now; else None."""
        if self._beat_ns is None or self.is_tripped or now_ns - self._beat_ns <= self.deadline_ns:
            return None
        self.is_tripped = True
        self._begin(now_ns, None)
        return now_ns - self._beat_ns

    def is_due(self, now_ns: int) -> bool:
        """Whether the stop is to be written now; say afterwards how that went, by `wrote`."""
        return self._next_ns is not None and now_ns >= self._next_ns

    def wrote(self, now_ns: int, *, taken: bool) -> None:
        """The stop was written; where the line did not take it, it follows again soon and does not count."""
        if taken:
            self._is_written = True
            if self._left is not None:
                self._left -= 1
        if self._left == 0 or (self._end_ns is not None and now_ns >= self._end_ns):
            self._next_ns, self.is_over = None, self._end_ns is not None
        else:
            self._next_ns = now_ns + (REPEAT_NS if taken else RETRY_NS)

    def wait_ms(self, now_ns: int) -> int | None:
        """How long nothing is to be done unless a packet comes; None: for ever."""
        due = [at for at in (self._next_ns, self._trip_ns()) if at is not None]
        return max(0, -(-(min(due) - now_ns) // 1_000_000)) if due else None

    def _trip_ns(self) -> int | None:
        return None if self._beat_ns is None or self.is_tripped else self._beat_ns + self.deadline_ns + 1

    def _begin(self, now_ns: int, count: int | None) -> None:
        self._next_ns, self._left, self._is_written = now_ns, count, False


class Line(Protocol):
    """Where the stop goes. `write_stop` raises OSError and never waits for a line that is full."""

    def write_stop(self) -> None: ...
    def close(self) -> None: ...


class SerialLine:
    """A duplicate of the runtime's own descriptor.

    Opening the line anew would raise DTR, which resets many a controller, and fails where the line is exclusive.
    """

    def __init__(self, fd: int, data: bytes) -> None:
        self._fd = fd
        self._data = data
        os.set_blocking(fd, False)

    def write_stop(self) -> None:
        """Motion that still waits in the kernel is thrown away; what is cut in two ends at the stop's delimiter."""
        try:
            termios.tcflush(self._fd, termios.TCOFLUSH)
        except termios.error as error:
            raise OSError(*error.args) from error
        if os.write(self._fd, self._data) < len(self._data):
            raise OSError(errno.EAGAIN, "the line took a part of the stop only")

    def close(self) -> None:
        os.close(self._fd)


class I2cLine:
    """A bus of the machine, `/dev/i2c-N`: one transaction a write, as i2c-dev's write(2) makes it."""

    def __init__(self, path: str, writes: list[tuple[int, bytes]]) -> None:
        self._writes = writes
        self._fd = os.open(path, os.O_RDWR | os.O_CLOEXEC)

    def write_stop(self) -> None:
        for address, data in self._writes:
            fcntl.ioctl(self._fd, _I2C_SLAVE_FORCE, address)
            os.write(self._fd, data)

    def close(self) -> None:
        os.close(self._fd)


class FakeI2cLine:
    """A fake bus behind a Unix socket; connected anew after an error."""

    def __init__(self, path: str, writes: list[tuple[int, bytes]]) -> None:
        self._path = path
        self._writes = writes
        self._socket = self._connect()

    def _connect(self) -> socket.socket:
        made = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            made.settimeout(_FAKE_WITHIN_S)
            made.connect(self._path)
        except BaseException:
            made.close()
            raise
        return made

    def write_stop(self) -> None:
        if self._socket.fileno() < 0:
            self._socket = self._connect()
        try:
            for address, data in self._writes:
                self._socket.sendall(_FAKE_REQUEST.pack(b"W", address, data[0], len(data) - 1) + data[1:])
                number, _ = _FAKE_ANSWER.unpack(self._socket.recv(_FAKE_ANSWER.size, socket.MSG_WAITALL))
                if number:
                    raise OSError(number, os.strerror(number))
        except (OSError, struct.error) as error:
            self._socket.close()
            raise error if isinstance(error, OSError) else ConnectionResetError(self._path) from error

    def close(self) -> None:
        self._socket.close()


def open_line(packet: bytes, fds: list[int]) -> Line:
    """The line that a packet `s` or `i` describes. Raises OSError, and ValueError for a packet that is neither."""
    if packet[:1] == b"s" and fds:
        return SerialLine(fds[0], packet[1:])
    if packet[:1] != b"i":
        raise ValueError(f"no line: {packet[:1]!r} with {len(fds)} descriptors")
    path, _, rest = packet[1:].partition(b"\0")
    writes, at = [], 0
    while at < len(rest):
        address, size = rest[at], rest[at + 1]
        writes.append((address, rest[at + 2 : at + 2 + size]))
        at += 2 + size
    name = os.fsdecode(path)
    return FakeI2cLine(name, writes) if _is_socket(name) else I2cLine(name, writes)


def _is_socket(path: str) -> bool:
    return os.stat(path).st_mode & 0o170000 == 0o140000


class Guardian:
    """The loop around the watch: packets in, stops out."""

    def __init__(self, runtime: socket.socket, deadline_ns: int) -> None:
        self._runtime = runtime
        self._watch = Watch(deadline_ns)
        self._line: Line | None = None

    def run(self) -> None:
        """Until the runtime is gone and the last stop is written; also on a fault of its own it stops the motors."""
        self._runtime.setblocking(False)
        self._tell(b"R" + ", ".join(privileges()).encode())
        poll = select.poll()
        poll.register(self._runtime, select.POLLIN)
        try:
            while not self._watch.is_over:
                if poll.poll(self._watch.wait_ms(clock_ns())) and not self._read_all():
                    poll.unregister(self._runtime)
                    self._watch.end(clock_ns())
                self._act(clock_ns())
        finally:
            self._write_stop()

    def _act(self, now_ns: int) -> None:
        late_ns = self._watch.look(now_ns)
        if self._watch.is_due(now_ns):
            self._watch.wrote(now_ns, taken=self._write_stop())
        if late_ns is not None:
            self._tell(b"T" + late_ns.to_bytes(8, "big"))

    def _read_all(self) -> bool:
        """Every packet that waits, so that a late guardian judges by the newest; False at the end of file."""
        while True:
            try:
                packet, fds, _, _ = socket.recv_fds(self._runtime, 4096, 4)
            except BlockingIOError:
                return True
            except OSError:
                return False
            if not packet:
                return False
            self._take(packet, fds)

    def _take(self, packet: bytes, fds: list[int]) -> None:
        now_ns = clock_ns()
        match packet[:1]:
            case b"B":
                self._watch.beat(int.from_bytes(packet[1:9], "big"))
            case b"b":
                self._watch.beat(None)
            case b"S":
                self._watch.stop(now_ns)
            case b"A":
                self._watch.acknowledge(now_ns)
            case b"Q":
                self._watch.end(now_ns, 1)
            case b"D":
                self._write_stop()
                self._let_go()
            case b"s" | b"i":
                self._let_go()
                self._hold(packet, fds)

    def _hold(self, packet: bytes, fds: list[int]) -> None:
        """Get hold of a line and prove it by a stop, now that everything stands anyway."""
        try:
            self._line = open_line(packet, fds)
            self._line.write_stop()
        except (OSError, ValueError) as error:
            self._let_go()
            self._tell(b"N" + str(getattr(error, "strerror", None) or error).encode())
        else:
            self._tell(b"H")

    def _let_go(self) -> None:
        line, self._line = self._line, None
        if line is not None:
            line.close()

    def _write_stop(self) -> bool:
        """Whether the line took it; where there is no line there is nothing to stop."""
        try:
            if self._line is not None:
                self._line.write_stop()
        except OSError:
            return False
        return True

    def _tell(self, packet: bytes) -> None:
        try:
            self._runtime.send(packet)
        except OSError:
            return  # it is gone, or does not read: what it must know it learns by its own clock


def take_name() -> None:
    """Be recognised by `ps`, and by whoever asks who holds the line."""
    try:
        with open("/proc/self/comm", "w") as name:
            name.write("robotd-guardian")
    except OSError:
        return


def privileges() -> list[str]:
    """Ask for what a safety process should have, and name what was granted; none of it is needed on a quiet machine."""
    granted = []
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
        granted.append("real-time priority")
    except (OSError, AttributeError):
        pass
    try:
        with open("/proc/self/oom_score_adj", "w") as score:
            score.write("-1000")
        granted.append("spared when memory runs out")
    except OSError:
        pass
    try:
        import ctypes

        if ctypes.CDLL(None).mlockall(_MCL_CURRENT | _MCL_ONFAULT) == 0:
            granted.append("locked in memory")
    except (ImportError, OSError, AttributeError):
        pass
    return granted


def main(arguments: list[str]) -> None:
    """Run as the guardian of whoever holds the other end of the socket."""
    for name in _IGNORED:
        signal.signal(getattr(signal, f"SIG{name}"), signal.SIG_IGN)
    take_name()
    fd, deadline_ms = map(int, arguments)
    with socket.socket(fileno=fd) as runtime:
        Guardian(runtime, deadline_ms * 1_000_000).run()


if __name__ == "__main__":
    main(sys.argv[1:])
