"""Opens an input device of Linux and asks it for its axes."""

from __future__ import annotations

import errno
import fcntl
import glob
import os
import stat
import struct
from collections.abc import Iterator

from robotd.authoring.device import DeviceMisconfigured, DeviceUnavailable
from robotd_devices.gamepad.input_events import AxisRange, axis_name

_READ = 2
_ABSINFO = struct.Struct("@6i")
"""Value, minimum, maximum, fuzz, flat, resolution."""
_AXES = 0x40


def _request(number: int, size: int) -> int:
    """`_IOR('E', number, size)` of the kernel's generic numbering (x86, arm, riscv)."""
    return _READ << 30 | size << 16 | ord("E") << 8 | number


def open_node(pattern: str) -> int:
    """A descriptor that does not block, of the first device that the pattern names. Raises DeviceError."""
    found = sorted(glob.glob(pattern))
    if not found:
        raise DeviceUnavailable(
            f"`path`: nothing is at {pattern}: plug the pad in or switch it on; `ls /dev/input/by-id` names what is "
            "there, a pad on Bluetooth is only at /dev/input/eventN (`cat /proc/bus/input/devices`)"
        )
    try:
        mode = os.stat(found[0]).st_mode
        if not (stat.S_ISCHR(mode) or stat.S_ISFIFO(mode)):
            raise DeviceMisconfigured(f"`path`: {found[0]} is no input device")
        return os.open(found[0], os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except PermissionError as error:
        raise DeviceUnavailable(
            f"`path`: no permission for {found[0]}: `sudo usermod -aG input $USER`, then log in again"
        ) from error
    except OSError as error:
        raise DeviceUnavailable(f"`path`: {found[0]} cannot be opened: {error.strerror}") from error


def ask_axes(fd: int) -> dict[str, AxisRange]:
    """The device's axes by name, each with its range and place; empty where it cannot be asked (a pipe of events)."""
    try:
        bits = fcntl.ioctl(fd, _request(0x20 + 0x03, _AXES // 8), bytes(_AXES // 8))
        return dict(_axes(fd, int.from_bytes(bits, "little")))
    except OSError as error:
        if error.errno in (errno.ENODEV, errno.EIO):
            raise
        return {}


def _axes(fd: int, bits: int) -> Iterator[tuple[str, AxisRange]]:
    for code in range(_AXES):
        if bits >> code & 1:
            value, low, high, _, flat, _ = _ABSINFO.unpack(
                fcntl.ioctl(fd, _request(0x40 + code, _ABSINFO.size), bytes(_ABSINFO.size))
            )
            yield axis_name(code), AxisRange(low, high, flat, value)
