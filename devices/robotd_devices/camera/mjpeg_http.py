"""Our own client of MJPEG cameras over HTTP, on asyncio: it drains the connection, so that no old picture waits."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import fcntl
import re
import struct
import termios
from collections.abc import Callable, Mapping
from typing import NamedTuple
from urllib.parse import SplitResult, quote, unquote, urljoin, urlsplit

from robotd.authoring.device import DeviceMisconfigured, DeviceUnavailable
from robotd.world.clock import Clock
from robotd_devices.camera.mjpeg_parts import BrokenStream, Dechunker, Part, PartSplitter
from robotd_devices.camera.mjpeg_slot import JpegSlot

OPEN_WITHIN_S = 5.0
_MOST_HEAD_BYTES = 32 << 10
_AT_ONCE = 256 << 10
_MOST_READS = 64
"""So often at most a picture is held back for a newer one, should the camera be faster than we are."""
_COUNT = struct.Struct("@i")
_QUERY = "/%:@!$&'()*+,;=~-._?"
_REDIRECTS = frozenset((301, 302, 303, 307, 308))


class NotMjpeg(Exception):
    """The address gives something else, which OpenCV may be able to read; the message is its type."""


class Head(NamedTuple):
    """The first lines of an answer; names of headers in small letters."""

    status: int
    headers: Mapping[str, str]

    @property
    def boundary(self) -> str | None:
        """The boundary between parts, or None where the answer has no parts. Empty where it is not named."""
        kind = self.headers.get("content-type", "")
        if not kind.lower().startswith("multipart/"):
            return None
        found = re.search(r"boundary\s*=\s*(\"[^\"]*\"|[^;\s]+)", kind, re.IGNORECASE)
        return found.group(1).strip('"') if found else ""


def parse_head(data: bytes) -> Head:
    """An answer's status and headers (RFC 9112). Raises BrokenStream."""
    first, *lines = data.decode("latin-1").splitlines()
    match = re.match(r"(?:HTTP/1\.[01]|ICY) (\d{3})(?: |$)", first)
    if match is None:
        raise BrokenStream(f"{first[:40]!r} is no answer of HTTP/1")
    pairs = (line.partition(":") for line in lines if ":" in line)
    return Head(int(match.group(1)), {name.strip().lower(): value.strip() for name, _, value in pairs})


def request(url: SplitResult) -> bytes:
    """What is sent for an address; a user and password in it become basic authentication (RFC 7617)."""
    host = f"[{url.hostname}]" if ":" in (url.hostname or "") else url.hostname or ""
    path = quote(url.path or "/", safe="/%:@!$&'()*+,;=~-._") + (
        f"?{quote(url.query, safe=_QUERY)}" if url.query else ""
    )
    lines = [
        f"GET {path} HTTP/1.1",
        f"Host: {host}:{url.port}" if url.port is not None else f"Host: {host}",
        "User-Agent: robotd",
        "Accept: multipart/x-mixed-replace, */*",
        "Connection: close",
    ]
    if url.username is not None:
        pair = f"{unquote(url.username)}:{unquote(url.password or '')}"
        lines.append(f"Authorization: Basic {base64.b64encode(pair.encode()).decode()}")
    return ("\r\n".join(lines) + "\r\n\r\n").encode("ascii")


class MjpegStream:
    """One connection. Pictures go into `slot`; `on_fault(name, detail)` and everything else belongs on the loop.

    shown: the address as people may see it, without a password.
    """

    def __init__(
        self, url: str, shown: str, slot: JpegSlot, clock: Clock, on_fault: Callable[[str, str], None]
    ) -> None:
        self._url = url
        self._shown = shown
        self._slot = slot
        self._clock = clock
        self._on_fault = on_fault
        self._writer: asyncio.StreamWriter | None = None
        self._pump: asyncio.Task[None] | None = None

    async def open(self) -> None:
        """Connect and wait for the answer's head; one redirect is followed.

        Raises DeviceUnavailable with the mend, DeviceMisconfigured for an impossible address, and NotMjpeg.
        """
        try:
            async with asyncio.timeout(OPEN_WITHIN_S):
                reader, head = await self._ask(self._url)
                if head.status in _REDIRECTS and "location" in head.headers:
                    self._hang_up()
                    reader, head = await self._ask(_redirected(self._url, head.headers["location"]))
        except TimeoutError:
            self._hang_up()
            raise DeviceUnavailable(
                f"`source`: {self._shown} does not answer within {OPEN_WITHIN_S:g} s: is the camera on, the network up?"
            ) from None
        except (OSError, BrokenStream, asyncio.IncompleteReadError, asyncio.LimitOverrunError) as error:
            self._hang_up()
            raise DeviceUnavailable(f"`source`: no stream from {self._shown}: {_words(error)}") from error
        splitter = PartSplitter(self._check(head))
        chunked = "chunked" in head.headers.get("transfer-encoding", "").lower()
        self._pump = asyncio.create_task(self._read(reader, splitter, Dechunker() if chunked else None))

    def stop(self) -> None:
        """Hang up at once; the slot ends."""
        if self._pump is not None:
            self._pump.cancel()
        self._hang_up()
        self._slot.end("closed")

    # ------------------------------------------------------------------------------------------- parts

    async def _ask(self, text: str) -> tuple[asyncio.StreamReader, Head]:
        try:
            url = urlsplit(text)
            port = url.port
            asked = request(url)
        except (ValueError, UnicodeError) as error:
            raise DeviceMisconfigured(f"`source`: {self._shown} is no address: {error}") from None
        if url.scheme not in ("http", "https") or not url.hostname:
            raise DeviceMisconfigured(f"`source`: {self._shown} is no address of HTTP")
        secure = url.scheme == "https"
        reader, self._writer = await asyncio.open_connection(
            url.hostname, port or (443 if secure else 80), ssl=secure or None, limit=_MOST_HEAD_BYTES
        )
        self._writer.write(asked)
        head = b""
        while not head.endswith((b"\n\r\n", b"\n\n")):
            head += await reader.readuntil(b"\n")
            if len(head) > _MOST_HEAD_BYTES:
                raise BrokenStream("the head of its answer does not end")
        return reader, parse_head(head)

    def _check(self, head: Head) -> str:
        """The boundary of an answer that is a stream; raises for all others."""
        boundary = head.boundary
        kind = head.headers.get("content-type", "").partition(";")[0].strip().lower() or "no type"
        if head.status == 200 and boundary is not None:
            return boundary
        self._hang_up()
        if head.status == 401:
            if head.headers.get("www-authenticate", "").lower().startswith("digest"):
                why = "it wants digest authentication, which is OpenCV's to do: set `reader: opencv`"
            else:
                why = "it wants a name and a password: write http://NAME:PASSWORD@..."
        elif head.status != 200:
            why = f"it answers with status {head.status}: are address and path right?"
        elif kind in ("text/html", "image/jpeg"):
            what = "a web page" if kind == "text/html" else "one picture"
            why = f"it answers with {what}: give the address of the stream itself, often /stream, /video or :81/stream"
        else:
            raise NotMjpeg(kind)
        raise DeviceUnavailable(f"`source`: no stream from {self._shown}: {why}")

    async def _read(self, reader: asyncio.StreamReader, splitter: PartSplitter, chunks: Dechunker | None) -> None:
        reason, reads = "the stream ended", 0
        newest: Part | None = None
        try:
            while not splitter.is_over and not (chunks is not None and chunks.is_over):
                data = await reader.read(_AT_ONCE)
                if not data:
                    break
                now_ns = self._clock.now_ns()
                if chunks is not None:
                    data = chunks.feed(data)
                for part in splitter.feed(data, now_ns):
                    newest = part
                    self._slot.count()
                for fault in splitter.faults:
                    self._on_fault(fault, "in the stream")
                splitter.faults.clear()
                # the loop was away and a newer picture waits behind this one, which is old: not to be stamped as new
                reads += 1
                if newest is not None and (self._waiting() < len(newest.jpeg) or reads > _MOST_READS):
                    self._slot.put(newest.jpeg, newest.began_ns)
                    newest, reads = None, 0
        except (OSError, BrokenStream) as error:
            reason = _words(error)
        self._hang_up()
        self._slot.end(f"no picture came any more: {reason}")

    def _waiting(self) -> int:
        """Bytes that the kernel holds for us."""
        if self._writer is None:
            return 0
        found = fcntl.ioctl(self._writer.get_extra_info("socket"), termios.FIONREAD, bytes(_COUNT.size))
        return int(_COUNT.unpack(found)[0])

    def _hang_up(self) -> None:
        writer, self._writer = self._writer, None
        if writer is not None:
            with contextlib.suppress(OSError):
                writer.transport.abort()


def _redirected(url: str, location: str) -> str:
    """Where a redirect leads; user and password go along to the same host only."""
    target = urljoin(url, location)
    old, new = urlsplit(url), urlsplit(target)
    if old.username is not None and new.username is None and (old.hostname, old.scheme) == (new.hostname, new.scheme):
        return new._replace(netloc=f"{old.netloc.rpartition('@')[0]}@{new.netloc}").geturl()
    return target


def _words(error: Exception) -> str:
    if isinstance(error, asyncio.IncompleteReadError):
        return "it hung up before it answered"
    if isinstance(error, asyncio.LimitOverrunError):
        return "the head of its answer does not end"
    if isinstance(error, OSError):
        return f"{error.strerror or error}: is the camera on, and are address and port right?"
    return str(error)
