"""An I2C bus behind a Unix socket: the client, and the frames that it and the host exchange.

A request is five bytes and then data: kind, address, register, size (big-endian, two bytes).

    kind  size     data            answer
    R     count    none            `count` bytes
    W     length   `length` bytes  nothing
    L     4        first index     the log from there on, each entry: time in ns (8 bytes), address, errno (2),
                   (4 bytes)       bytes read (2), bytes written (2), and what was written (see `Transaction`)

An answer is an errno (two bytes, 0 for success) and a size (four bytes), both big-endian, then data. Requests of all
connections are carried out one after the other, as on a real bus.
"""

from __future__ import annotations

import errno
import os
import socket
import struct
from collections.abc import Sequence

from robotd_devices.ports.i2c_fake import Transaction

REQUEST = struct.Struct(">cBBH")
ANSWER = struct.Struct(">HI")
_ENTRY = struct.Struct(">QBHHH")
_INDEX = struct.Struct(">I")

_ANSWER_WITHIN_S = 2.0


class SocketBus:
    """An `I2cBus` on the other side of a socket. Opening raises OSError where nobody listens at `path`."""

    def __init__(self, path: str) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            self._socket.settimeout(_ANSWER_WITHIN_S)
            self._socket.connect(path)
        except BaseException:
            self._socket.close()
            raise

    def read(self, address: int, register: int, count: int) -> bytes:
        return self._ask(REQUEST.pack(b"R", address, register, count))

    def write(self, address: int, register: int, data: bytes) -> None:
        self._ask(REQUEST.pack(b"W", address, register, len(data)) + data)

    def log(self, first: int = 0) -> list[Transaction]:
        """What went over the bus, by whomever, from entry `first` on; times are the host's monotonic clock."""
        return unpack_log(self._ask(REQUEST.pack(b"L", 0, 0, _INDEX.size) + _INDEX.pack(first)))

    def close(self) -> None:
        self._socket.close()

    def _ask(self, request: bytes) -> bytes:
        try:
            self._socket.sendall(request)
            number, size = ANSWER.unpack(receive(self._socket, ANSWER.size))
            data = receive(self._socket, size)
        except TimeoutError as error:
            # the answer may still come and be taken for another's: this connection is of no use any more
            self._socket.close()
            raise OSError(errno.ETIMEDOUT, os.strerror(errno.ETIMEDOUT)) from error
        if number:
            raise OSError(number, os.strerror(number))
        return data


def receive(connection: socket.socket, size: int) -> bytes:
    """Exactly `size` bytes. Raises ConnectionResetError where the other side closes before."""
    data = b""
    while len(data) < size:
        piece = connection.recv(size - len(data))
        if not piece:
            raise ConnectionResetError(errno.ECONNRESET, "the other side closed the socket")
        data += piece
    return data


def pack_log(entries: Sequence[Transaction]) -> bytes:
    """The answer to `L`."""
    return b"".join(_ENTRY.pack(e.now_ns, e.address, e.error, e.read_count, len(e.data)) + e.data for e in entries)


def unpack_log(data: bytes) -> list[Transaction]:
    """The entries in an answer to `L`."""
    entries: list[Transaction] = []
    at = 0
    while at < len(data):
        now_ns, address, error, count, size = _ENTRY.unpack_from(data, at)
        at += _ENTRY.size
        entries.append(Transaction(now_ns, address, data[at : at + size], count, error))
        at += size
    return entries


def first_index(data: bytes) -> int:
    """The index in a request `L`."""
    (first,) = _INDEX.unpack(data)
    return int(first)
