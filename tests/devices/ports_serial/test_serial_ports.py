"""All serial back ends on a pty: bytes both ways, exclusion, one report of loss, stops that do not wait."""

from __future__ import annotations

import asyncio
import os
import sys
import termios
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from waiting import until

from robotd.authoring.device import DeviceError, DeviceMisconfigured, DeviceUnavailable
from robotd_devices.ports import serial_line
from robotd_devices.ports.serial_base import off_loop
from robotd_devices.ports.serial_port import Backend, SerialPort, SerialSettings, load_backend, serial_port

BACKENDS: list[Backend] = ["pyserial", "serialx", "raw"]


class Far:
    """The far end of a line: a pty's master."""

    def __init__(self) -> None:
        self.master, self.slave = os.openpty()
        tty.setraw(self.slave)
        os.set_blocking(self.master, False)
        self.path = os.ttyname(self.slave)

    def take(self) -> bytes:
        try:
            return os.read(self.master, 65536)
        except BlockingIOError:
            return b""

    def pull(self) -> None:
        for fd in (self.master, self.slave):
            if fd >= 0:
                os.close(fd)
        self.master = self.slave = -1


class Near:
    """A port and what it said."""

    def __init__(self, path: str, backend: Backend, baud: int = 115_200, dtr: bool | None = None) -> None:
        self.data = b""
        self.lost: list[str] = []
        self.port: SerialPort = serial_port(SerialSettings(path, baud, dtr), backend, self._data, self.lost.append)

    def _data(self, data: bytes) -> None:
        assert data
        self.data += data


@pytest.fixture
def far() -> Iterator[Far]:
    end = Far()
    yield end
    end.pull()


@pytest.fixture(params=BACKENDS)
def backend(request: pytest.FixtureRequest) -> Backend:
    load_backend(request.param)
    name: Backend = request.param
    return name


async def settle() -> None:
    """Let callbacks that are due run."""
    for _ in range(5):
        await asyncio.sleep(0)


async def test_bytes_both_ways(far: Far, backend: Backend) -> None:
    near = Near(far.path, backend)
    await near.port.open()
    os.write(far.master, b"\x00\x11\x13\r\n\xff")
    await until(lambda: len(near.data) == 6)
    assert near.data == b"\x00\x11\x13\r\n\xff"  # nothing is translated, echoed or taken for flow control
    near.port.write(b"\x03\x04\n")
    assert far.take() == b"\x03\x04\n"  # written in the very call
    assert near.port.unsent == 0
    assert await near.port.drain(0.5)
    near.port.abort()
    await settle()
    assert near.lost == []


async def test_old_input_is_thrown_away_at_open(far: Far, backend: Backend) -> None:
    os.write(far.master, b"stale")
    near = Near(far.path, backend)
    await near.port.open()
    os.write(far.master, b"fresh")
    await until(lambda: len(near.data) >= 5)
    assert near.data == b"fresh"
    near.port.abort()
    await settle()


async def test_a_long_backlog_comes_in_one_piece(far: Far, backend: Backend) -> None:
    """What piled up during a stall must be seen as one, or its age cannot be told."""
    pieces: list[int] = []
    port = serial_port(SerialSettings(far.path, 115_200), backend, lambda data: pieces.append(len(data)), print)
    await port.open()
    await settle()
    sent = os.write(far.master, bytes(3000))
    time.sleep(0.02)  # noqa: ASYNC251  the stall itself
    await until(lambda: sum(pieces) == sent)
    assert pieces == [3000]
    port.abort()
    await settle()


@pytest.mark.parametrize("baud", [9_600, 115_200, 230_400, 460_800, 256_000, 123_456])
async def test_speeds(far: Far, backend: Backend, baud: int) -> None:
    near = Near(far.path, backend, baud)
    await near.port.open()
    if sys.platform == "linux":
        assert serial_line.speed_of(far.slave) == baud
    near.port.abort()
    await settle()


async def test_unplug_is_reported_once_and_at_once(far: Far, backend: Backend) -> None:
    near = Near(far.path, backend)
    await near.port.open()
    await settle()
    begun = time.monotonic()
    far.pull()
    await until(lambda: bool(near.lost))
    assert time.monotonic() - begun < 0.05
    near.port.write(b"nobody hears this")
    near.port.write(b"nor this", first=True)
    assert near.port.unsent == 0
    assert not near.port.set_dtr(True)
    assert not await near.port.drain(0.1)
    near.port.abort()
    near.port.abort()
    await settle()
    assert len(near.lost) == 1
    assert "went away" in near.lost[0]


async def test_unplug_with_output_waiting_is_reported_once(far: Far, backend: Backend) -> None:
    """pyserial-asyncio by itself keeps a loss back until its buffer is empty."""
    near = Near(far.path, backend)
    await near.port.open()
    near.port.write(bytes(200_000))
    assert near.port.unsent > 0
    far.pull()
    await until(lambda: bool(near.lost), within_s=0.5)
    await settle()
    assert len(near.lost) == 1
    assert near.port.unsent == 0


async def test_loss_found_by_writing_is_not_reported_from_inside_write(far: Far, backend: Backend) -> None:
    near = Near(far.path, backend)
    await near.port.open()
    far.pull()
    near.port.write(b"x")
    assert near.lost == []
    await until(lambda: bool(near.lost))
    await settle()
    assert len(near.lost) == 1


async def test_full_line_does_not_block_and_a_stop_goes_first(far: Far, backend: Backend) -> None:
    near = Near(far.path, backend)
    await near.port.open()
    begun = time.monotonic()
    near.port.write(b"m" * 300_000)
    assert near.port.unsent > 0
    assert not await near.port.drain(0.05)
    near.port.write(b"\x00STOP", first=True)
    assert time.monotonic() - begun < 0.5
    # what the kernel had taken is gone or comes first; nothing of the rest follows the stop
    got = b""

    def read_all() -> bool:
        nonlocal got
        got += far.take()
        return b"\x00STOP" in got

    await until(read_all)
    await settle()
    assert got.endswith(b"\x00STOP")
    assert len(got) < 100_000
    near.port.abort()
    await settle()


async def test_what_the_kernel_did_not_take_follows(far: Far, backend: Backend) -> None:
    near = Near(far.path, backend)
    await near.port.open()
    data = os.urandom(60_000)
    near.port.write(data)
    near.port.write(b"end")
    got = b""

    def read_all() -> bool:
        nonlocal got
        got += far.take()
        return got.endswith(b"end")

    await until(read_all)
    assert got == data + b"end"
    assert near.port.unsent == 0
    assert await near.port.drain(0.5)
    near.port.abort()
    await settle()


async def test_abort_with_output_waiting_is_quick_and_quiet(far: Far, backend: Backend) -> None:
    near = Near(far.path, backend)
    await near.port.open()
    near.port.write(bytes(300_000))
    begun = time.monotonic()
    near.port.abort()
    await settle()
    assert time.monotonic() - begun < 0.2
    assert near.lost == []
    again = Near(far.path, backend)
    await again.port.open()  # the lock is free at once
    again.port.abort()
    await settle()


@pytest.mark.parametrize("second", BACKENDS)
async def test_one_program_at_a_time(far: Far, backend: Backend, second: Backend) -> None:
    near = Near(far.path, backend)
    await near.port.open()
    other = Near(far.path, second)
    with pytest.raises(DeviceUnavailable, match=rf"{far.path} is in use by .*\(pid {os.getpid()}\)"):
        await other.port.open()
    near.port.abort()
    await other.port.open()
    other.port.abort()
    await settle()


async def test_no_modem_lines_on_a_pty(far: Far, backend: Backend) -> None:
    near = Near(far.path, backend, dtr=True)
    await near.port.open()
    assert near.port.set_dtr(True) is False
    assert near.port.set_dtr(False) is False
    near.port.abort()
    await settle()
    assert near.lost == []


@pytest.mark.parametrize(
    ("name", "make", "error", "words"),
    [
        ("gone", None, DeviceUnavailable, "no serial port .*gone: is the cable in"),
        ("file", Path.touch, DeviceMisconfigured, "is not a serial port"),
        ("folder", Path.mkdir, DeviceMisconfigured, "is not a serial port"),
    ],
)
async def test_what_cannot_be_opened(
    tmp_path: Path,
    backend: Backend,
    name: str,
    make: Callable[[Path], None] | None,
    error: type[DeviceError],
    words: str,
) -> None:
    path = tmp_path / name
    if make is not None:
        make(path)
    near = Near(str(path), backend)
    with pytest.raises(error, match=words):
        await near.port.open()
    near.port.abort()


async def test_a_pattern_finds_the_one_port(far: Far, backend: Backend, tmp_path: Path) -> None:
    pattern = str(tmp_path / "usb-Maker_*")
    with pytest.raises(DeviceUnavailable, match=r"no serial port fits .*usb-Maker_\*: is the cable in"):
        await Near(pattern, backend).port.open()
    (tmp_path / "usb-Maker_1").symlink_to(far.path)
    near = Near(pattern, backend)
    await near.port.open()
    far.pull()
    await until(lambda: bool(near.lost))
    assert "usb-Maker_1 went away" in near.lost[0]
    (tmp_path / "usb-Maker_2").symlink_to(far.path)
    with pytest.raises(DeviceUnavailable, match=r"2 serial ports fit .*say which: .*usb-Maker_1, .*usb-Maker_2"):
        await Near(pattern, backend).port.open()


@pytest.mark.parametrize(
    ("number", "error", "words"),
    [
        (13, DeviceUnavailable, "usermod -aG dialout"),
        (5, DeviceUnavailable, "check the cable"),
        (22, DeviceMisconfigured, "cannot do 230400 baud"),
        (12, DeviceUnavailable, "cannot open /dev/x"),
    ],
)
def test_errors_say_the_mend(number: int, error: type[DeviceError], words: str) -> None:
    chained = RuntimeError("could not configure")
    chained.__context__ = termios.error(number, os.strerror(number))
    for cause in (OSError(number, os.strerror(number)), termios.error(number, "x"), chained):
        found = serial_line.why_not_open(SerialSettings("/dev/x", 230_400), cause)
        assert type(found) is error
        assert words in str(found)


def test_unknown_backend() -> None:
    with pytest.raises(DeviceMisconfigured, match="'fast' is not one of: pyserial, serialx, raw"):
        serial_port(SerialSettings("/dev/x", 9600), "fast", print, print)  # type: ignore[arg-type]


def test_byte_time() -> None:
    assert SerialSettings("/dev/x", 230_400).byte_ns == 43_402


async def test_a_late_descriptor_is_closed_when_nobody_waits_for_it() -> None:
    import threading

    go = threading.Event()
    undone: list[int] = []

    def slow() -> int:
        go.wait(5.0)
        return 7

    task = asyncio.ensure_future(off_loop(slow, undone.append))
    await settle()
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert undone == []
    go.set()
    await until(lambda: bool(undone))
    assert undone == [7]


def descriptors() -> int:
    return len(os.listdir("/proc/self/fd"))


@pytest.mark.skipif(sys.platform != "linux", reason="counts descriptors in /proc")
async def test_no_descriptor_stays_behind(backend: Backend) -> None:
    async def cycle() -> None:
        end = Far()
        near = Near(end.path, backend)
        await near.port.open()
        near.port.write(b"x" * 50_000)
        end.pull()
        await until(lambda: bool(near.lost))
        await settle()

    await cycle()
    before = descriptors()
    for _ in range(10):
        await cycle()
    assert descriptors() == before
