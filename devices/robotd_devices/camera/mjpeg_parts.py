"""JPEGs out of a multipart stream: parsers of bytes without input or output.

Sources: RFC 2046 section 5.1 (multipart), RFC 9112 section 7.1 (chunks), ITU-T T.81 annex B (JPEG markers). A picture
is complete when its end marker has come, so that it need not wait for the boundary, which many cameras send only with
the next picture; `Content-Length` is not relied upon, since it is often missing and sometimes wrong.
"""

from __future__ import annotations

import re
from enum import Enum
from typing import NamedTuple

MOST_BYTES = 16 << 20
"""A longer picture is dropped."""
_MOST_HEAD_BYTES = 16 << 10
_SOI, _EOI = b"\xff\xd8", b"\xff\xd9"
_SOS = 0xDA
_MOST_SPACES = 8
_MOST_BEFORE_FIRST = 64 << 10
_MOST_SKIPPED = 64 << 20
_STANDALONE = frozenset((0x01, *range(0xD0, 0xD8)))


class BrokenStream(Exception):
    """Bytes that are no such stream; the message says what is wrong."""


class Part(NamedTuple):
    """One JPEG, and when its first bytes were fed."""

    jpeg: bytes
    began_ns: int


class _Place(Enum):
    BETWEEN = 0
    HEAD = 1
    MARKERS = 2
    DATA = 3


class PartSplitter:
    """The pictures of a `multipart/x-mixed-replace` body, however its bytes are cut.

    boundary: as the header names it; where the body begins with a line of `--something`, that line counts instead.
    `faults`: names of what went wrong since somebody emptied this: `torn picture` (the boundary came before its end, or
    its markers make no sense), `picture too large`, `part that is no picture`. `is_over`: the closing boundary came.
    """

    def __init__(self, boundary: str, most_bytes: int = MOST_BYTES) -> None:
        self.faults: list[str] = []
        self.is_over = False
        self._delimit(b"--" + boundary.strip().strip('"').encode("latin-1"))
        self._most_bytes = most_bytes
        self._place = _Place.BETWEEN
        self._is_first = self._is_line = True
        self._has_parts = False
        self._buffer = bytearray()
        self._at = 0
        self._skipped = 0
        self._began_ns = 0

    def feed(self, data: bytes, now_ns: int = 0) -> list[Part]:
        """Take bytes as they come. Raises BrokenStream where there are no parts."""
        self._buffer += data
        parts: list[Part] = []
        while not self.is_over and self._step(parts, now_ns):
            pass
        return parts

    def _step(self, parts: list[Part], now_ns: int) -> bool:
        """One step; False where more bytes are needed."""
        match self._place:
            case _Place.BETWEEN:
                return self._seek()
            case _Place.HEAD:
                return self._skip_head(now_ns)
            case _Place.MARKERS:
                return self._walk_markers()
            case _Place.DATA:
                return self._find_end(parts)

    # -------------------------------------------------------------------------------------- the places

    def _delimit(self, delimiter: bytes) -> None:
        """A boundary is a line of its own: three letters alone also stand in a picture now and then."""
        line = re.escape(delimiter) + rb"[ \t]{0,%d}(?:\r?\n|(?P<last>--))" % _MOST_SPACES
        self._name = delimiter.decode("latin-1")
        self._line, self._next_line = re.compile(line), re.compile(rb"\n" + line)
        self._keep = len(delimiter) + _MOST_SPACES + 3

    def _seek(self) -> bool:
        """To the line behind the next boundary."""
        buffer = self._buffer
        if self._is_first:
            while buffer.startswith((b"\r", b"\n")):
                del buffer[:1]
            end = buffer.find(b"\n", 0, _MOST_HEAD_BYTES)
            if end < 0 and len(buffer) < _MOST_HEAD_BYTES:
                return False
            line = bytes(buffer[: max(end, 0)]).rstrip()
            if line.startswith(b"--") and len(line) > 2:
                self._delimit(line)
            self._is_first = False
        found = (self._line.match(buffer) if self._is_line else None) or self._next_line.search(buffer)
        if found is None:
            self._drop(len(buffer) - self._keep)
            return False
        self.is_over = found["last"] is not None
        del buffer[: found.end()]
        self._skipped, self._has_parts = 0, True
        self._place = _Place.HEAD
        return True

    def _drop(self, count: int) -> None:
        if count <= 0:
            return
        del self._buffer[:count]
        self._is_line = False
        self._skipped += count
        if self._skipped > (_MOST_SKIPPED if self._has_parts else _MOST_BEFORE_FIRST):
            raise BrokenStream(f"no boundary {self._name!r} in {self._skipped} bytes")

    def _skip_head(self, now_ns: int) -> bool:
        """Past the part's own headers, none of which is needed."""
        end = self._buffer.find(b"\n", 0, _MOST_HEAD_BYTES)
        if end < 0:
            if len(self._buffer) >= _MOST_HEAD_BYTES:
                raise BrokenStream("a part whose headers do not end")
            return False
        line = bytes(self._buffer[:end]).strip()
        del self._buffer[: end + 1]
        if not line:
            self._place, self._at, self._began_ns = _Place.MARKERS, 0, now_ns
        return True

    def _walk_markers(self) -> bool:
        """From the picture's begin to its compressed data, past thumbnails that have end markers of their own."""
        buffer = self._buffer
        if self._at == 0:
            if len(buffer) < 2:
                return False
            if buffer[:2] != _SOI:
                return self._give_up("part that is no picture")
            self._at = 2
        while len(buffer) >= self._at + 4:
            if buffer[self._at] != 0xFF:
                return self._give_up("torn picture")
            marker = buffer[self._at + 1]
            if marker == 0xFF:
                self._at += 1
            elif marker in _STANDALONE:
                self._at += 2
            elif marker == 0x00 or marker in (_EOI[1], _SOI[1]):
                return self._give_up("torn picture")
            else:
                self._at += 2 + int.from_bytes(buffer[self._at + 2 : self._at + 4], "big")
                # a length that is wrong must not carry us over the next picture
                if self._next_line.search(buffer, 0, self._at) is not None:
                    return self._give_up("torn picture")
                if marker == _SOS:
                    self._place = _Place.DATA
                    return True
            if self._at > self._most_bytes:
                return self._give_up("picture too large")
        if self._next_line.search(buffer, 0, self._at) is not None:
            return self._give_up("torn picture")
        return False

    def _find_end(self, parts: list[Part]) -> bool:
        """To the end marker, or to the boundary where that comes first."""
        buffer = self._buffer
        end, boundary = buffer.find(_EOI, self._at), self._next_line.search(buffer, self._at)
        if end < 0 and boundary is None:
            if len(buffer) > self._most_bytes + self._keep:
                return self._give_up("picture too large")
            self._at = max(self._at, len(buffer) - self._keep)
            return False
        if boundary is not None and (end < 0 or boundary.start() < end):
            return self._give_up("torn picture" if boundary.start() <= self._most_bytes else "picture too large")
        if end + 2 > self._most_bytes:
            return self._give_up("picture too large")
        parts.append(Part(bytes(buffer[: end + 2]), self._began_ns))
        del buffer[: end + 2]
        self._place, self._is_line = _Place.BETWEEN, True
        return True

    def _give_up(self, fault: str) -> bool:
        """Go on at the next boundary, also one inside of what was taken for the picture."""
        self.faults.append(fault)
        self._place, self._is_line = _Place.BETWEEN, False
        return True


class Dechunker:
    """The body of a `Transfer-Encoding: chunked` answer. `is_over`: its last chunk came."""

    def __init__(self) -> None:
        self.is_over = False
        self._buffer = bytearray()
        self._left = 0
        self._in_chunk = False

    def feed(self, data: bytes) -> bytes:
        """Take bytes as they come; returns those of the body. Raises BrokenStream."""
        self._buffer += data
        out = bytearray()
        while not self.is_over:
            if self._left:
                taken = self._buffer[: self._left]
                out += taken
                del self._buffer[: len(taken)]
                self._left -= len(taken)
                if self._left:
                    break
            end = self._buffer.find(b"\n", 0, _MOST_HEAD_BYTES)
            if end < 0:
                if len(self._buffer) >= _MOST_HEAD_BYTES:
                    raise BrokenStream("a chunk without its length")
                break
            line = bytes(self._buffer[:end]).partition(b";")[0].strip()
            del self._buffer[: end + 1]
            if self._in_chunk and not line:
                self._in_chunk = False  # the line end behind a chunk
                continue
            if not line or len(line) > 8 or any(byte not in b"0123456789abcdefABCDEF" for byte in line):
                raise BrokenStream(f"{line[:20]!r} is no length of a chunk")
            self._left, self._in_chunk = int(line, 16), True
            self.is_over = self._left == 0
        return bytes(out)
