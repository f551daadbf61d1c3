"""Hosts fake chips on a Unix socket, so that several processes reach the same bus: the runtime, its guardian, a test.

In a test, a thread:

    with I2cHost(FakeI2cBus([Pca9685Fake()]), tmp_path / "i2c") as host: ...; host.bus.fail("nack")

As a program of its own, by default a JetBot's motor chip:

    python -m robotd_devices.ports.i2c_host --socket ./i2c

Words on standard input, each answered with `ok`: `fail nack|stuck|arbitration [times]`, `heal`, `power` (the chips lose
their supply for a moment), `quit`.
"""

from __future__ import annotations

import argparse
import importlib
import os
import socketserver
import sys
import threading
from pathlib import Path
from types import TracebackType
from typing import ClassVar

from robotd_devices.ports.i2c_fake import BUS_FAULTS, FakeI2cBus
from robotd_devices.ports.i2c_socket import ANSWER, REQUEST, first_index, pack_log, receive

_LONGEST_PATH = 100
_FIRST_FAKE = "robotd_devices.motor.pca9685_fake:Pca9685Fake"


class _Connection(socketserver.BaseRequestHandler):
    bus: ClassVar[FakeI2cBus]

    def handle(self) -> None:
        while True:
            try:
                kind, address, register, size = REQUEST.unpack(receive(self.request, REQUEST.size))
                data = b"" if kind == b"R" else receive(self.request, size)
                self.request.sendall(self._answer(kind, address, register, size, data))
            except OSError:
                return  # the client went away

    def _answer(self, kind: bytes, address: int, register: int, size: int, data: bytes) -> bytes:
        answer = b""
        try:
            if kind == b"R":
                answer = self.bus.read(address, register, size)
            elif kind == b"W":
                self.bus.write(address, register, data)
            else:
                answer = pack_log(self.bus.log[first_index(data) :])
        except OSError as error:
            return ANSWER.pack(error.errno or 0, 0)
        return ANSWER.pack(0, len(answer)) + answer


class _Server(socketserver.ThreadingUnixStreamServer):
    daemon_threads = True
    # a connection ends with its client, not with the host
    block_on_close = False


class I2cHost:
    """One fake bus behind one socket. Raises ValueError for a path that is too long for a socket's address."""

    def __init__(self, bus: FakeI2cBus, path: str | os.PathLike[str]) -> None:
        self.bus = bus
        self.path = Path(path)
        if len(os.fsencode(self.path)) > _LONGEST_PATH:
            raise ValueError(f"{self.path} is too long for a socket: at most {_LONGEST_PATH} bytes, try a relative one")
        self._server: _Server | None = None
        self._thread: threading.Thread | None = None

    def __enter__(self) -> I2cHost:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def start(self) -> None:
        """Listen from now on. A socket that a dead host left behind is replaced."""
        self.path.unlink(missing_ok=True)
        handler = type("Connection", (_Connection,), {"bus": self.bus})
        self._server = _Server(str(self.path), handler)
        self._thread = threading.Thread(
            target=self._server.serve_forever, args=(0.02,), name=f"i2c {self.path.name}", daemon=True
        )
        self._thread.start()

    def stop(self) -> None:
        """Listen no longer; the socket disappears."""
        if self._server is not None and self._thread is not None:
            self._server.shutdown()
            self._thread.join()
            self._server.server_close()
            self._server = None
        self.path.unlink(missing_ok=True)


def main(arguments: list[str] | None = None) -> int:
    """Host fake chips until standard input ends or says `quit`. Returns an exit code."""
    parser = argparse.ArgumentParser(prog="python -m robotd_devices.ports.i2c_host", description=main.__doc__)
    parser.add_argument("--socket", required=True, help="path of the socket")
    parser.add_argument("--fake", action="append", help=f"module:class of a chip, may be repeated ({_FIRST_FAKE})")
    parser.add_argument("--bit-hz", type=int, default=0, help="clock of the bus, for its real pace (100000)")
    chosen = parser.parse_args(arguments)
    chips = []
    for fake in chosen.fake or [_FIRST_FAKE]:
        module, _, name = str(fake).partition(":")
        chips.append(getattr(importlib.import_module(module), name)())
    with I2cHost(FakeI2cBus(chips, bit_hz=chosen.bit_hz), chosen.socket) as host:
        _say("ok")
        for line in sys.stdin:
            words = line.split()
            if words == ["quit"]:
                break
            _say(_obey(host.bus, words))
    return 0


def _obey(bus: FakeI2cBus, words: list[str]) -> str:
    """Carry out one line; returns what to answer."""
    match words:
        case ["heal"]:
            bus.heal()
        case ["power"]:
            bus.power_cycle()
        case ["fail", fault, *times] if fault in BUS_FAULTS and all(t.isdigit() for t in times) and len(times) < 2:
            bus.fail(fault, times=int(times[0]) if times else None)
        case _:
            known = f"fail {'|'.join(BUS_FAULTS)} [times], heal, power, quit"
            return f"unknown words {' '.join(words)!r}; known: {known}"
    return "ok"


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    raise SystemExit(main())
