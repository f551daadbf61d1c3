"""The guardian's process by itself: a real one, on a pty and on a fake I2C bus, with this test as its runtime."""

from __future__ import annotations

import os
import select
import signal
import socket
import subprocess
import sys
import tempfile
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest

import robotd.safety
from robotd.safety.guardian import clock_ns
from robotd_devices.motor.pca9685_fake import Pca9685Fake
from robotd_devices.ports.i2c_fake import FakeI2cBus
from robotd_devices.ports.i2c_host import I2cHost

pytestmark = pytest.mark.skipif("sys.platform != 'linux'", reason="the guardian is for Linux")

STOP = b"\n\nS\n"
I2C_STOP = bytes((0x60, 2)) + b"\xfd\x10"
PROGRAM = Path(robotd.safety.__file__).with_name("guardian.py")
WITHIN_S = 10.0


class Guardian:
    """One guardian and this end of its socket."""

    def __init__(self, deadline_ms: int = 40) -> None:
        self.line, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.line.settimeout(WITHIN_S)
        with theirs:
            self.process = subprocess.Popen(
                [sys.executable, "-I", "-S", str(PROGRAM), str(theirs.fileno()), str(deadline_ms)],
                pass_fds=(theirs.fileno(),),
                start_new_session=True,
            )
        assert self.hear()[:1] == b"R"

    def hear(self) -> bytes:
        return self.line.recv(4096)

    def hold(self, packet: bytes, fd: int | None = None) -> bytes:
        """Hand over a line; returns what it says to that."""
        socket.send_fds(self.line, [packet], [fd] if fd is not None else [])
        return self.hear()

    def beat(self) -> None:
        self.line.send(b"B" + clock_ns().to_bytes(8, "big"))

    def end(self) -> int:
        self.line.close()
        return self.process.wait(WITHIN_S)


@pytest.fixture
def guardian() -> Iterator[Guardian]:
    made = Guardian()
    yield made
    made.line.close()
    made.process.kill()
    made.process.wait()


class Pty:
    """A serial line: the motors' end and the runtime's."""

    def __init__(self) -> None:
        self.motors, self.runtime = os.openpty()
        tty.setraw(self.runtime)
        os.set_blocking(self.runtime, False)

    def read(self, count: int) -> bytes:
        """So many bytes as the motors get them."""
        data = b""
        while len(data) < count:
            assert select.select([self.motors], [], [], WITHIN_S)[0], f"only {data!r} came"
            data += os.read(self.motors, count - len(data))
        return data

    def close(self) -> None:
        for fd in (self.motors, self.runtime):
            os.close(fd)


@pytest.fixture
def pty() -> Iterator[Pty]:
    made = Pty()
    yield made
    made.close()


@pytest.fixture
def bus() -> Iterator[tuple[FakeI2cBus, bytes]]:
    """A fake bus behind a socket, and the packet that hands it over."""
    with (
        tempfile.TemporaryDirectory(prefix="robotd") as name,
        I2cHost(FakeI2cBus([Pca9685Fake()]), Path(name) / "i2c") as host,
    ):
        yield host.bus, b"i" + os.fsencode(host.path) + b"\0" + I2C_STOP


def test_silence_stops_the_motors_until_it_is_acknowledged(guardian: Guardian, pty: Pty) -> None:
    assert guardian.hold(b"s" + STOP, pty.runtime) == b"H"
    assert pty.read(len(STOP)) == STOP, "proved by a stop when it is handed over"
    guardian.beat()
    told = guardian.hear()
    assert told[:1] == b"T" and int.from_bytes(told[1:], "big") > 40e6
    assert pty.read(3 * len(STOP)) == 3 * STOP, "again and again"
    guardian.line.send(b"A")
    guardian.line.send(b"b")
    assert guardian.hold(b"s" + STOP, pty.runtime) == b"H", "it goes on watching"
    assert guardian.end() == 0


@pytest.mark.parametrize("on", ["serial", "i2c"])
def test_the_end_of_the_runtime_stops_the_motors_and_ends_the_guardian(
    guardian: Guardian, pty: Pty, bus: tuple[FakeI2cBus, bytes], on: str
) -> None:
    packet, fd = (b"s" + STOP, pty.runtime) if on == "serial" else (bus[1], None)
    assert guardian.hold(packet, fd) == b"H"
    before = len(bus[0].writes)
    assert guardian.end() == 0
    if on == "serial":
        assert pty.read(4 * len(STOP)) == 4 * STOP
    else:
        assert len(bus[0].writes) - before >= 3 and set(bus[0].writes) == {(0x60, 0xFD, b"\x10")}


def test_good_order_is_one_stop_and_an_end_at_once(guardian: Guardian, pty: Pty) -> None:
    assert guardian.hold(b"s" + STOP, pty.runtime) == b"H"
    assert pty.read(len(STOP)) == STOP  # or the next one throws away what nobody has read yet
    guardian.line.send(b"Q")
    assert guardian.process.wait(WITHIN_S) == 0
    assert pty.read(len(STOP)) == STOP


def test_signals_to_it_and_to_its_group_change_nothing(guardian: Guardian, pty: Pty) -> None:
    assert os.getsid(guardian.process.pid) == guardian.process.pid, "a session of its own"
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGTSTP, signal.SIGQUIT):
        os.killpg(guardian.process.pid, number)
    assert guardian.hold(b"s" + STOP, pty.runtime) == b"H"


def test_it_is_small_and_knows_nothing_that_is_installed(guardian: Guardian) -> None:
    status = Path(f"/proc/{guardian.process.pid}/status").read_text()
    (resident_kb,) = (int(line.split()[1]) for line in status.splitlines() if line.startswith("VmRSS"))
    assert resident_kb < 16_000
    assert "site-packages" not in Path(f"/proc/{guardian.process.pid}/maps").read_text()


def test_a_full_line_delays_nobody_and_the_stop_is_what_arrives_last(guardian: Guardian, pty: Pty) -> None:
    assert guardian.hold(b"s" + STOP, pty.runtime) == b"H"
    try:
        while True:
            os.write(pty.runtime, b"\nD 1 0.500\n" * 100)
    except BlockingIOError:
        pass
    guardian.line.close()
    data = b""
    while not data.endswith(2 * STOP):
        data += pty.read(1)
    assert guardian.process.wait(WITHIN_S) == 0
    assert data.count(b"D") < 2000, "what still waited in the kernel was thrown away"


def test_a_bus_that_fails_is_tried_again(guardian: Guardian, bus: tuple[FakeI2cBus, bytes]) -> None:
    fake, packet = bus
    assert guardian.hold(packet) == b"H"
    fake.fail("nack", times=5)
    before = len(fake.log)
    assert guardian.end() == 0
    assert [bool(entry.error) for entry in fake.log[before : before + 6]] == [True] * 5 + [False]


@pytest.mark.parametrize(
    ("packet", "why"),
    [
        (b"i/nowhere/i2c-1\0" + I2C_STOP, b"No such file"),
        (b"i/dev/null\0" + I2C_STOP, b"ioctl"),
        (b"s" + STOP, b"no line"),
    ],
)
def test_a_line_that_cannot_be_held_is_said(guardian: Guardian, packet: bytes, why: bytes) -> None:
    told = guardian.hold(packet)
    assert told[:1] == b"N" and why in told


def test_a_chip_that_does_not_answer_is_said(guardian: Guardian, bus: tuple[FakeI2cBus, bytes]) -> None:
    bus[0].fail("nack")
    assert guardian.hold(bus[1]) == b"NRemote I/O error"
    bus[0].heal()
    assert guardian.hold(bus[1]) == b"H"
