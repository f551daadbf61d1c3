"""A camera on the network, on loopback and asyncio: says byte for byte what a test tells it to."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from robotd_devices.ports.breakable import Breakable

HEAD = b"HTTP/1.1 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=frame\r\n\r\n"


def jpeg(number: int, size: tuple[int, int] = (48, 64)) -> bytes:
    """A noisy picture, as a sensor's is, whose mean brightness says its number (0 to 11)."""
    import cv2

    noise = np.random.default_rng(number).integers(-6, 7, (*size, 3))
    return cv2.imencode(".jpg", (noise + 20 + 20 * number).astype(np.uint8))[1].tobytes()


def number_of(picture: Any) -> int:
    return round((float(picture.mean()) - 20.0) / 20.0)


def part(body: bytes, length: int | None = None, boundary: bytes = b"frame") -> bytes:
    """One part of a stream; `length` for a wrong Content-Length."""
    told = len(body) if length is None else length
    return b"--%s\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n%s\r\n" % (boundary, told, body)


def chunked(data: bytes, size: int = 700) -> bytes:
    """The same bytes in HTTP's chunks."""
    pieces = (data[i : i + size] for i in range(0, len(data), size))
    return b"".join(b"%x\r\n%s\r\n" % (len(piece), piece) for piece in pieces)


class MjpegServer(Breakable):
    """`respond(request)` gives the first bytes of each answer; `send` adds to all that are open, `cut` hangs up.

    `show` sends a picture as the faults have it that were injected.
    """

    breaks: ClassVar[Mapping[str, str]] = MappingProxyType(
        {"torn picture": "cuts", "wrong length": "lies", "boundary in pieces": "drips"}
    )

    def __init__(self) -> None:
        self.cuts = self.lies = self.drips = False
        self.respond: Callable[[bytes], bytes] = lambda request: HEAD
        self.requests: list[bytes] = []
        self.port = 0
        self._open: list[asyncio.StreamWriter] = []
        self.asked = asyncio.Event()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}/video?size=small"

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            request = await reader.readuntil(b"\r\n\r\n")
            self.requests.append(request)
            writer.write(self.respond(request))
            await writer.drain()
        except (OSError, asyncio.IncompleteReadError):
            writer.close()
            return
        self._open.append(writer)
        self.asked.set()

    def send(self, data: bytes) -> None:
        for writer in self._open:
            if not writer.is_closing():
                writer.write(data)

    async def show(self, number: int) -> None:
        """A part with a picture: half of it, with a wrong length, or in many small writes, where it is to be."""
        body = jpeg(number)
        if self.cuts:
            body = body[: len(body) // 2]
        data = part(body, length=len(body) + 40 if self.lies else None)
        step = 7 if self.drips else len(data)
        for i in range(0, len(data), step):
            self.send(data[i : i + step])
            await asyncio.sleep(0)

    def cut(self) -> None:
        for writer in self._open:
            writer.close()
        self._open.clear()


@asynccontextmanager
async def served() -> AsyncIterator[MjpegServer]:
    made = MjpegServer()
    server = await asyncio.start_server(made._serve, "127.0.0.1", 0)
    made.port = server.sockets[0].getsockname()[1]
    try:
        yield made
    finally:
        made.cut()
        server.close()
        await server.wait_closed()
