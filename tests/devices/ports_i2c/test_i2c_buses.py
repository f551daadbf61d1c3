"""Buses of three kinds that must be one: in memory, behind a socket, and through smbus2's own messages."""

from __future__ import annotations

import errno
import os
import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import smbus2

from robotd.authoring.device import DeviceMisconfigured, DeviceUnavailable
from robotd_devices.motor.pca9685_fake import Pca9685Fake
from robotd_devices.ports import i2c_bus, i2c_host, i2c_smbus
from robotd_devices.ports.i2c_bus import EREMOTEIO, I2cBus, I2cWrite
from robotd_devices.ports.i2c_fake import FakeI2cBus, SmbusStub, Transaction
from robotd_devices.ports.i2c_host import I2cHost
from robotd_devices.ports.i2c_smbus import SmbusBus
from robotd_devices.ports.i2c_socket import SocketBus, pack_log, unpack_log

KINDS = ("memory", "socket", "smbus")


@pytest.fixture
def fake() -> FakeI2cBus:
    return FakeI2cBus([Pca9685Fake(0x60), Pca9685Fake(0x41)])


@pytest.fixture
def bus(request: pytest.FixtureRequest, fake: FakeI2cBus, tmp_path: Path) -> Iterator[I2cBus]:
    if request.param == "memory":
        yield fake
    elif request.param == "smbus":
        yield SmbusBus("", SmbusStub(fake))
    else:
        with I2cHost(fake, tmp_path / "i2c"):
            client = i2c_bus.open_bus(f"unix:{tmp_path}/i2c")
            assert isinstance(client, SocketBus)
            yield client
            client.close()


@pytest.mark.parametrize("bus", KINDS, indirect=True)
def test_reads_what_it_wrote_in_whole_blocks(bus: I2cBus, fake: FakeI2cBus) -> None:
    bus.write(0x60, 0x00, b"\x21")
    block = bytes(value & 0x1F for value in range(64))
    bus.write(0x60, 0x06, block)  # longer than SMBus's 32 bytes
    assert bus.read(0x60, 0x06, 64) == block
    assert bus.read(0x41, 0x00, 1) == b"\x11"
    assert fake.writes == [I2cWrite(0x60, 0x00, b"\x21"), I2cWrite(0x60, 0x06, block)]
    # each of these was one transaction
    assert [(entry.address, len(entry.data), entry.read_count) for entry in fake.log] == [
        (0x60, 2, 0),
        (0x60, 65, 0),
        (0x60, 1, 64),
        (0x41, 1, 1),
    ]
    assert [entry.now_ns for entry in fake.log] == sorted(entry.now_ns for entry in fake.log)


@pytest.mark.parametrize("bus", KINDS, indirect=True)
@pytest.mark.parametrize(
    ("fault", "number"), [("nack", EREMOTEIO), ("stuck", errno.ETIMEDOUT), ("arbitration", errno.EAGAIN)]
)
def test_faults_have_the_numbers_of_linux(bus: I2cBus, fake: FakeI2cBus, fault: Any, number: int) -> None:
    fake.fail(fault, address=0x60, times=2)
    for call in (lambda: bus.write(0x60, 0x00, b"\x01"), lambda: bus.read(0x60, 0x00, 1)):
        with pytest.raises(OSError) as raised:
            call()
        assert raised.value.errno == number
        assert bus.read(0x41, 0x00, 1) == b"\x11"
    assert bus.read(0x60, 0x00, 1) == b"\x11"
    assert [entry.error for entry in fake.log if entry.error] == [number] * 2
    assert fake.writes == []
    fake.fail(fault)
    with pytest.raises(OSError):
        bus.read(0x41, 0x00, 1)
    fake.heal()
    assert bus.read(0x41, 0x00, 1) == b"\x11"


@pytest.mark.parametrize("bus", KINDS, indirect=True)
def test_nobody_at_an_address(bus: I2cBus) -> None:
    with pytest.raises(OSError) as raised:
        bus.read(0x29, 0x00, 1)
    assert raised.value.errno in i2c_bus.NO_ANSWER


def test_power_cycle_resets_every_chip(fake: FakeI2cBus) -> None:
    fake.write(0x60, 0x00, b"\x21")
    fake.power_cycle()
    assert fake.read(0x60, 0x00, 1) == b"\x11"


def test_log_survives_the_wire() -> None:
    entries = [Transaction(2**63, 0x60, b"\xfd\x10", 0, 0), Transaction(7, 0x77, b"", 300, EREMOTEIO)]
    assert unpack_log(pack_log(entries)) == entries


def test_stub_has_the_methods_of_smbus2(fake: FakeI2cBus) -> None:
    stub = SmbusStub(fake)
    stub.write_byte_data(0x60, 0x00, 0x21)
    stub.write_i2c_block_data(0x60, 0x06, [1, 2, 3, 4])
    assert stub.read_i2c_block_data(0x60, 0x06, 4) == [1, 2, 3, 4]
    stub.write_word_data(0x60, 0x08, 0x0605)
    assert stub.read_word_data(0x60, 0x08) == 0x0605
    stub.write_byte(0x60, 0x06)
    assert stub.read_byte(0x60) == 1
    assert stub.read_byte(0x60) == 2  # the pointer went on
    stub.write_quick(0x60)
    with pytest.raises(OSError) as raised:
        stub.write_quick(0x13)
    assert raised.value.errno == EREMOTEIO
    stub.close()
    assert all(hasattr(smbus2.SMBus, name) for name in vars(SmbusStub) if not name.startswith("_"))


def test_several_clients_share_one_bus(fake: FakeI2cBus, tmp_path: Path) -> None:
    with I2cHost(fake, tmp_path / "i2c"):
        clients = [SocketBus(str(tmp_path / "i2c")) for _ in range(4)]

        def write(client: SocketBus) -> None:
            for value in range(50):
                client.write(0x60, 0x02, bytes((value,)))
                client.read(0x60, 0x02, 1)

        threads = [threading.Thread(target=write, args=(client,)) for client in clients]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(10.0)
        assert len(fake.log) == 400
        assert len(clients[0].log(390)) == 10
        for client in clients:
            client.close()


def test_host_that_goes_away_is_a_lost_bus(fake: FakeI2cBus, tmp_path: Path) -> None:
    ours, theirs = socket.socketpair()
    client = SocketBus.__new__(SocketBus)
    client._socket = ours
    theirs.close()
    with pytest.raises(OSError) as raised:
        client.read(0x60, 0x00, 1)
    assert "the bus went away" in i2c_bus.explain(raised.value, "/tmp/i2c", 0x60)
    ours.close()


@pytest.mark.parametrize(
    ("make", "error", "words"),
    [
        (lambda path: None, DeviceUnavailable, "does not exist: is `bus` right, and the bus switched on"),
        (lambda path: _dead_socket(path), DeviceUnavailable, "nobody listens on this socket: start the fake bus"),
        (lambda path: path.write_text(""), DeviceMisconfigured, "i2c is no I2C bus: correct `bus`"),
    ],
    ids=["absent", "dead socket", "plain file"],
)
def test_opening_says_why_not(
    tmp_path: Path, make: Callable[[Path], object], error: type[Exception], words: str
) -> None:
    make(tmp_path / "i2c")
    with pytest.raises(error, match=words):
        i2c_bus.open_bus(str(tmp_path / "i2c"))


def _dead_socket(path: Path) -> None:
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(str(path))
    listener.close()


def test_no_permission(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(path: str) -> I2cBus:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    monkeypatch.setattr(i2c_smbus, "SmbusBus", refuse)
    with pytest.raises(DeviceUnavailable, match=r"I2C bus /dev/i2c-1: no permission: `sudo usermod -aG i2c"):
        i2c_bus.open_bus(1)


@pytest.mark.parametrize(
    ("bus", "path"), [(1, "/dev/i2c-1"), ("7", "/dev/i2c-7"), ("/dev/i2c-2", "/dev/i2c-2"), ("unix:/run/x", "/run/x")]
)
def test_path_of_a_bus(bus: int | str, path: str) -> None:
    assert i2c_bus.bus_path(bus) == path


def test_path_too_long_for_a_socket_is_refused(fake: FakeI2cBus, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="too long for a socket"):
        I2cHost(fake, tmp_path / ("x" * 100))


def test_host_replaces_a_socket_left_behind_and_removes_its_own(fake: FakeI2cBus, tmp_path: Path) -> None:
    _dead_socket(tmp_path / "i2c")
    with I2cHost(fake, tmp_path / "i2c"):
        client = SocketBus(str(tmp_path / "i2c"))
        assert client.read(0x60, 0x00, 1) == b"\x11"
        client.close()
    assert not (tmp_path / "i2c").exists()


@pytest.mark.parametrize(
    ("words", "answer"),
    [
        ("fail nack", "ok"),
        ("fail stuck 2", "ok"),
        ("heal", "ok"),
        ("power", "ok"),
        ("fail", "unknown words 'fail'"),
        ("fail often", "unknown words 'fail often'"),
        ("fail nack x", "unknown words"),
        ("", "unknown words ''"),
    ],
)
def test_words_to_the_host(fake: FakeI2cBus, words: str, answer: str) -> None:
    assert i2c_host._obey(fake, words.split()).startswith(answer)


def test_pace_of_a_real_bus() -> None:
    slow = FakeI2cBus([Pca9685Fake()], bit_hz=100_000)
    slow.write(0x60, 0x06, bytes(14))
    slow.write(0x60, 0x06, bytes(14))
    # sixteen bytes of nine bits
    assert slow.log[1].now_ns - slow.log[0].now_ns >= 1_440_000
