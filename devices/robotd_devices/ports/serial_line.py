"""Serial lines at the level of a descriptor: termios, locks, modem lines, and what an error number means to a user."""

from __future__ import annotations

import array
import contextlib
import errno
import fcntl
import glob
import os
import struct
import sys
import termios
from dataclasses import replace

from robotd.authoring.device import DeviceError, DeviceMisconfigured, DeviceUnavailable
from robotd_devices.ports.serial_port import SerialSettings

# Linux, generic numbers of asm-generic/ioctls.h (x86, arm, riscv); the stdlib does not name these.
_TCGETS2, _TCSETS2 = 0x802C542A, 0x402C542B
_TERMIOS2 = struct.Struct("=4IB19s2I")
_CBAUD, _BOTHER = 0o010017, 0o010000
_TIOCGSERIAL, _TIOCSSERIAL = 0x541E, 0x541F
_SERIAL_STRUCT_INTS, _FLAGS_INT, _ASYNC_LOW_LATENCY = 32, 4, 1 << 13

_BY_ID = "/dev/serial/by-id"

#: Errors by which a line says that it has no modem lines or no such setting.
_NO_SUCH_LINE = (errno.ENOTTY, errno.EINVAL, errno.EOPNOTSUPP)


def find_line(settings: SerialSettings) -> SerialSettings:
    """The same settings with the one path that their pattern fits. Raises DeviceUnavailable for none or several."""
    if not glob.has_magic(settings.path) or os.path.exists(settings.path):
        return settings
    found = sorted(glob.glob(settings.path))
    if len(found) == 1:
        return replace(settings, path=found[0])
    if found:
        raise DeviceUnavailable(f"{len(found)} serial ports fit {settings.path}: say which: {', '.join(found)}")
    there = sorted(glob.glob(f"{_BY_ID}/*"))
    raise DeviceUnavailable(
        f"no serial port fits {settings.path}: is the cable in? "
        + (f"Name one of these: {', '.join(there)}" if there else f"{_BY_ID} is empty")
    )


def open_line(settings: SerialSettings) -> int:
    """A non-blocking, locked, raw descriptor at the given speed, its input empty. Raises OSError or termios.error."""
    fd = os.open(settings.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        # first the lock: nothing may be changed on a line that somebody else is using
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        _make_raw(fd, settings.baud)
        if settings.dtr is not None:
            set_dtr(fd, settings.dtr)
        set_low_latency(fd)
        termios.tcflush(fd, termios.TCIFLUSH)
    except BaseException:
        os.close(fd)
        raise
    return fd


def _make_raw(fd: int, baud: int) -> None:
    """8N1, no flow control, no echo, no translation."""
    mode = termios.tcgetattr(fd)
    known = getattr(termios, f"B{baud}", None)
    custom = known is None and sys.platform == "linux"
    # macOS takes the number itself as its constant; Linux needs a second call for a speed without a constant
    speed = termios.B38400 if custom else known if known is not None else baud
    mode[0] = 0
    mode[1] = 0
    mode[2] = termios.CS8 | termios.CREAD | termios.CLOCAL
    mode[3] = 0
    mode[4] = mode[5] = speed
    mode[6][termios.VMIN], mode[6][termios.VTIME] = 1, 0
    termios.tcsetattr(fd, termios.TCSANOW, mode)
    if custom:
        fields = list(_TERMIOS2.unpack(fcntl.ioctl(fd, _TCGETS2, bytes(_TERMIOS2.size))))
        fields[2] = (fields[2] & ~_CBAUD) | _BOTHER
        fields[6] = fields[7] = baud
        fcntl.ioctl(fd, _TCSETS2, _TERMIOS2.pack(*fields))


def speed_of(fd: int) -> int:
    """The output speed that the kernel has for a line, in baud. Linux only; raises OSError."""
    return int(_TERMIOS2.unpack(fcntl.ioctl(fd, _TCGETS2, bytes(_TERMIOS2.size)))[7])


def set_low_latency(fd: int) -> bool:
    """Ask the driver to hand over bytes at once (an FTDI chip otherwise waits 16 ms); False where it cannot."""
    if sys.platform != "linux":
        return False
    state = array.array("i", [0] * _SERIAL_STRUCT_INTS)
    try:
        fcntl.ioctl(fd, _TIOCGSERIAL, state)
        state[_FLAGS_INT] |= _ASYNC_LOW_LATENCY
        fcntl.ioctl(fd, _TIOCSSERIAL, state)
    except OSError:
        return False
    return True


def set_dtr(fd: int, on: bool) -> bool:
    """Set DTR; False where the line has none. Raises OSError where the line is gone."""
    try:
        fcntl.ioctl(fd, termios.TIOCMBIS if on else termios.TIOCMBIC, struct.pack("i", termios.TIOCM_DTR))
    except OSError as error:
        if error.errno in _NO_SUCH_LINE:
            return False
        raise
    return True


def discard_output(fd: int) -> None:
    """Throw away what the kernel still holds for a line; a line that is gone holds nothing.

    Before a close this is a must: closing a UART with output waits for it, up to 30 s, and that on the event loop.
    """
    with contextlib.suppress(OSError, termios.error):
        termios.tcflush(fd, termios.TCOFLUSH)


def output_waiting(fd: int) -> int:
    """Bytes that the kernel still holds for a line; 0 where it is gone or does not say."""
    try:
        return int(struct.unpack("i", fcntl.ioctl(fd, termios.TIOCOUTQ, bytes(4)))[0])
    except OSError:
        return 0


def holders_of(path: str) -> list[str]:
    """Programs that have a line open, as `name (pid 123)`; only those that we may look at. Linux only."""
    found: list[str] = []
    target = os.path.realpath(path)
    try:
        processes = [entry for entry in os.listdir("/proc") if entry.isdigit()]
    except OSError:
        return found
    for pid in processes:
        # a process may end, or be another user's, at any point of this
        with contextlib.suppress(OSError):
            if any(os.readlink(f"/proc/{pid}/fd/{fd}") == target for fd in os.listdir(f"/proc/{pid}/fd")):
                with open(f"/proc/{pid}/comm", encoding="utf-8", errors="replace") as comm:
                    found.append(f"{comm.read().strip()} (pid {pid})")
    return found


def why_not_open(settings: SerialSettings, error: BaseException) -> DeviceError:
    """The cause and the mend for an error of opening. Looks into /proc, so not on the loop thread."""
    path, number = settings.path, _error_number(error)
    if number == errno.ENOENT:
        return DeviceUnavailable(
            f"no serial port {path}: is the cable in, and is the name right? "
            "`ls -l /dev/serial/by-id` shows what is there"
        )
    if number in (errno.EACCES, errno.EPERM):
        return DeviceUnavailable(
            f"no permission to open {path}: add the user to the group that owns it "
            f"(`sudo usermod -aG dialout $USER`, then log in again)"
        )
    if number in (errno.EAGAIN, errno.EWOULDBLOCK, errno.EBUSY):
        who = ", ".join(holders_of(path)) or "another program"
        return DeviceUnavailable(f"{path} is in use by {who}: stop it, or give this robot another port")
    if number in (errno.ENXIO, errno.ENODEV, errno.EIO):
        return DeviceUnavailable(
            f"{path} is going away or not ready ({os.strerror(number)}): check the cable and power"
        )
    if number in (errno.ENOTTY, errno.EISDIR):
        return DeviceMisconfigured(f"{path} is not a serial port: name one from `ls -l /dev/serial/by-id`")
    if number == errno.EINVAL or isinstance(error, ValueError):
        return DeviceMisconfigured(f"{path} cannot do {settings.baud} baud: check `baud` against the device's page")
    return DeviceUnavailable(f"cannot open {path}: {error}")


def _error_number(error: BaseException | None) -> int | None:
    """The error number anywhere in a chain; termios.error has it as its first argument, pyserial hides it."""
    while error is not None:
        number = error.errno if isinstance(error, OSError) else error.args[0] if error.args else None
        if isinstance(number, int):
            return number
        error = error.__cause__ or error.__context__
    return None
