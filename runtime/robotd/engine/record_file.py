"""The recording as a file: MCAP, written beside the drive by one thread, read back in the order of writing.

Every entry lies on the channel `robotd/KIND/TOPIC`, encoded by `robotd.engine.codec`; beside it, thinned to at most
`viewer_hz`, a JSON copy on `/TOPIC` for people's viewers. The metadata record `robotd` holds the header. A chunk spans
at most a second, so that a file that was cut off lacks no more than that. The MCAP field `sequence` has 32 bits, and
so an entry's sequence wraps there.
"""

from __future__ import annotations

import dataclasses
import importlib.metadata
import json
import logging
import os
import platform
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from robotd.engine.codec import RecordError, class_name, encode, to_viewer_json, viewer_schema
from robotd.engine.record_reader import DROPPED, ENCODING, METADATA, Entry, RecordEnd, Recording, read_record
from robotd.world.clock import NS_PER_S

log = logging.getLogger(__name__)

__all__ = [
    "DROPPED",
    "ENCODING",
    "Entry",
    "RecordEnd",
    "RecordWriter",
    "Recording",
    "cpu_class",
    "platform_header",
    "read_record",
]

_VIEWER = "viewer"
_CHUNK_NS = NS_PER_S
_NAP_S = 0.05

# --------------------------------------------------------------------------------------------- header


def cpu_class() -> str:
    """What decides the last bit of vectorised arithmetic: machine, model, and which wide instructions there are."""
    model, flags = platform.processor(), set[str]()
    try:
        for line in Path("/proc/cpuinfo").read_text("ascii", "replace").splitlines():
            key, _, value = line.partition(":")
            if key.strip() in ("model name", "Model"):
                model = value.strip()
            elif key.strip() in ("flags", "Features"):
                flags = set(value.split())
                break
    except OSError:
        # not Linux: machine and model must do
        flags = set()
    wide = sorted(flags & {"avx2", "avx512f", "fma", "asimd", "asimddp", "sve", "neon"})
    disabled = os.environ.get("NPY_DISABLE_CPU_FEATURES", "")
    return " ".join(filter(None, (platform.machine(), model, *wide, disabled and f"without {disabled}")))


def _version() -> str:
    try:
        return importlib.metadata.version("robotd")
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def platform_header() -> dict[str, str]:
    """The part of a header that says on what it was made: robotd, python, numpy, cpu, libc."""
    return {
        "robotd": _version(),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "cpu": cpu_class(),
        "libc": " ".join(filter(None, platform.libc_ver())) or platform.platform(),
    }


# --------------------------------------------------------------------------------------------- writing


class _File:
    """The one file below the writer: unbuffered, so that after a failure nothing is left to flush."""

    def __init__(self, path: Path) -> None:
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o644)
        self._at = 0

    def write(self, data: bytes) -> int:
        view = memoryview(data)
        while view:
            written = os.write(self._fd, view)
            self._at += written
            view = view[written:]
        return len(data)

    def tell(self) -> int:
        return self._at

    def flush(self) -> None:
        pass

    def close(self) -> None:
        fd, self._fd = self._fd, -1
        if fd >= 0:
            os.close(fd)


@dataclass(frozen=True, slots=True)
class _Item:
    kind: str
    topic: str
    sequence: int
    now_ns: int
    payload: object
    size: int


@dataclass(slots=True)
class _Gap:
    first: _Item
    last: int
    count: int
    reason: str

    def marker(self) -> _Item:
        told = {
            "count": self.count,
            "first_sequence": self.first.sequence,
            "last_sequence": self.last,
            "reason": self.reason,
        }
        return _Item(DROPPED, "", self.first.sequence, self.first.now_ns, told, 0)


class RecordWriter:
    """Writes one recording.

    header: what a reader should know (merged config, speed, ...); JSON values. `platform_header()` is added.
    synchronous: encode and write in the caller's turn and drop nothing, for virtual time; the same run then gives the
        same bytes. Otherwise `write` costs a few microseconds and never waits: one thread encodes and writes, and what
        its bounded queue cannot take is counted and marked.
    on_failure: called once, on the writing thread, where the disk fails; the recording has then stopped.

    Raises OSError where the file cannot be made. Later failures are logged once and never raised.
    """

    def __init__(
        self,
        path: Path | str,
        header: Mapping[str, Any],
        *,
        synchronous: bool,
        viewer_hz: float = 10.0,
        queue_entries: int = 4096,
        queue_bytes: int = 64_000_000,
        on_failure: Callable[[OSError], None] | None = None,
    ) -> None:
        from mcap.writer import CompressionType, Writer

        self.path = Path(path)
        self.synchronous = synchronous
        self.written = 0
        """Entries that were handed to the file, markers included."""
        self.dropped = 0
        """Entries that are missing in the file."""
        self.failure: OSError | None = None
        self._on_failure = on_failure
        self._viewer_ns = round(NS_PER_S / viewer_hz) if viewer_hz > 0.0 else None
        self._limits = (queue_entries, queue_bytes)
        self._queue: deque[_Item] = deque()
        self._in_bytes = 0
        self._out_bytes = 0
        self._gap: _Gap | None = None
        self._channels: dict[tuple[str, str], int] = {}
        self._seen_ns: dict[str, int] = {}
        self._chunk_ns: int | None = None
        self._chunk_wall_s = 0.0
        self._refused: set[str] = set()
        self._closed = False
        self._wake = threading.Event()
        self._file = _File(self.path)
        stream: Any = self._file
        self._writer: Any = Writer(stream, chunk_size=4_000_000, compression=CompressionType.LZ4)
        try:
            self._begin(header)
        except OSError:
            self._file.close()
            raise
        self._thread: threading.Thread | None = None
        if not synchronous:
            self._thread = threading.Thread(target=self._work, name="robotd-recorder", daemon=True)
            self._thread.start()

    def _begin(self, header: Mapping[str, Any]) -> None:
        self._writer.start(profile="robotd", library=f"robotd {_version()}")
        told: dict[str, Any] = {**platform_header(), **header}
        if not self.synchronous:
            told.setdefault("started", time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()))
        self._writer.add_metadata(METADATA, {key: json.dumps(told[key], default=str) for key in told})

    def write(self, kind: str, sequence: int, now_ns: int, payload: object, topic: str = "") -> None:
        """Record one input. `payload`: bytes as they are, anything else through the codec; it must not change later.

        Call it from one thread only. Never raises; after `close` or a failure it does nothing.
        """
        if self._closed or self.failure is not None:
            return
        if self.synchronous:
            self._store_guarded(_Item(kind, topic, sequence, now_ns, payload, 0))
            return
        queue, (most, most_bytes) = self._queue, self._limits
        item = _Item(kind, topic, sequence, now_ns, payload, _size(payload))
        waiting, waiting_bytes = len(queue), self._in_bytes - self._out_bytes + item.size
        # after a drop the queue must come down to a half first, so that a long jam is one gap
        room = 1 if self._gap is None else 2
        if waiting and (room * waiting >= most or room * waiting_bytes > most_bytes):
            self._drop(item, "queue full")
            return
        if self._gap is not None:
            queue.append(self._gap.marker())
            self._gap = None
        self._in_bytes += item.size
        queue.append(item)
        if 2 * waiting >= most or 2 * waiting_bytes > most_bytes:
            self._wake.set()

    def _drop(self, item: _Item, reason: str) -> None:
        self.dropped += 1
        if self._gap is None:
            log.warning("recording: %s, entries are being dropped from turn %d on", reason, item.sequence)
            self._gap = _Gap(item, item.sequence, 1, reason)
        else:
            self._gap.count += 1
            self._gap.last = item.sequence
        self._wake.set()

    def close(self, timeout_s: float = 2.0) -> bool:
        """Write what waits and finish the file, in at most `timeout_s`; True where that was done.

        Blocks: on a loop call it after halting the motors, or in a worker. A second call does nothing.
        """
        if self._closed:
            return self.failure is None
        if self._gap is not None and self.failure is None:
            self._queue.append(self._gap.marker())
        self._closed = True
        if self._thread is None:
            self._finish()
        else:
            self._wake.set()
            self._thread.join(timeout_s)
            if self._thread.is_alive():
                log.error("recording: %s is not finished after %.3g s, left as it is", self.path, timeout_s)
                return False
        return self.failure is None

    # ----------------------------------------------------------------------- from here on: the writing thread

    def _work(self) -> None:
        while self.failure is None:
            self._wake.wait(_NAP_S)
            self._wake.clear()
            closing = self._closed
            while self._queue and self.failure is None:
                item = self._queue.popleft()
                self._store_guarded(item)
                self._out_bytes += item.size
                # lets the loop's thread in between two entries
                time.sleep(0)
            if closing and not self._queue:
                break
            if self._chunk_ns is not None and time.monotonic() - self._chunk_wall_s > 1.0:
                self._guarded(self._flush)
        self._finish()

    def _finish(self) -> None:
        if self.failure is None:
            self._guarded(self._writer.finish)
        self._queue.clear()
        self._file.close()

    def _guarded(self, act: Callable[[], None]) -> None:
        """Runs a write; a failing disk ends the recording with one line."""
        try:
            act()
        except OSError as error:
            self.failure = error
            self._queue.clear()
            self._file.close()
            log.error("recording: stopped after %d entries, %s: %s", self.written, self.path, error)
            if self._on_failure is not None:
                self._on_failure(error)

    def _store_guarded(self, item: _Item) -> None:
        try:
            data = item.payload if isinstance(item.payload, bytes) else encode(item.payload)
        except RecordError as error:
            self.dropped += 1
            name = f"{item.kind}/{item.topic}"
            if name not in self._refused:
                self._refused.add(name)
                log.error("recording: %s cannot be kept: %s", name, error)
            item = _Gap(item, item.sequence, 1, str(error)).marker()
            data = encode(item.payload)
        self._guarded(lambda: self._store(item, data))

    def _store(self, item: _Item, data: bytes) -> None:
        if self._chunk_ns is not None and item.now_ns - self._chunk_ns >= _CHUNK_NS:
            self._flush()
        if self._chunk_ns is None:
            self._chunk_ns = item.now_ns
            self._chunk_wall_s = time.monotonic()
        channel = self._channel(item.kind, item.topic, item.payload)
        stamp_ns = getattr(item.payload, "stamp_ns", item.now_ns)
        self._writer.add_message(channel, item.now_ns, data, max(0, stamp_ns), item.sequence & 0xFFFFFFFF)
        self.written += 1
        if self._viewer_ns is not None and dataclasses.is_dataclass(item.payload):
            name = item.topic or item.kind
            if item.now_ns - self._seen_ns.get(name, -self._viewer_ns) >= self._viewer_ns:
                self._seen_ns[name] = item.now_ns
                copy = to_viewer_json(item.payload).encode("ascii")
                channel = self._channel(_VIEWER, name, item.payload)
                self._writer.add_message(channel, item.now_ns, copy, max(0, stamp_ns), item.sequence & 0xFFFFFFFF)

    def _flush(self) -> None:
        self._writer.flush()
        self._chunk_ns = None

    def _channel(self, kind: str, topic: str, payload: object) -> int:
        channel = self._channels.get((kind, topic))
        if channel is None:
            cls = type(payload)
            told = {"kind": kind, "topic": topic, "class": class_name(cls)}
            if kind == _VIEWER:
                text = json.dumps(viewer_schema(cls)).encode("ascii")
                schema = self._writer.register_schema(f"robotd.{cls.__name__}", "jsonschema", text)
                channel = self._writer.register_channel(f"/{topic}", "json", schema, told)
            else:
                schema = self._writer.register_schema(class_name(cls), "", b"")
                channel = self._writer.register_channel(f"robotd/{kind}/{topic}", ENCODING, schema, told)
            self._channels[kind, topic] = channel
        return channel


_SIZED: dict[type, tuple[str, ...]] = {}


def _size(payload: object) -> int:
    """About how many bytes an entry keeps alive while it waits: those of its own arrays."""
    if isinstance(payload, bytes | bytearray):
        return len(payload)
    cls = type(payload)
    names = _SIZED.get(cls)
    if names is None:
        names = tuple(f.name for f in dataclasses.fields(cls)) if dataclasses.is_dataclass(cls) else ()
        _SIZED[cls] = names
    size = 200
    for name in names:
        size += getattr(getattr(payload, name), "nbytes", 0)
    return size
