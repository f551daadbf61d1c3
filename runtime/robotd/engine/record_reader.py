"""A recording read back: its header, its entries in the order of writing, and where and why it ends."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from robotd.engine.codec import RecordError

DROPPED = "dropped"
"""Kind of the entry that stands where others are missing; its payload is a dict with count, first_sequence,
last_sequence and reason. What follows cannot be compared with a replay."""

ENCODING = "robotd"
"""Message encoding of the channels that hold entries."""

METADATA = "robotd"
"""Name of the metadata record that holds the header."""


@dataclass(frozen=True, slots=True)
class Entry:
    """One recorded input. `payload`: bytes for `codec.decode`, or as they were given."""

    kind: str
    topic: str
    sequence: int
    now_ns: int
    payload: bytes


@dataclass(frozen=True, slots=True)
class RecordEnd:
    """Where a recording ends. `offset`: bytes that could be read; `reason`: empty where the end is the intended one."""

    offset: int
    entries: int
    last_ns: int
    reason: str = ""

    @property
    def is_complete(self) -> bool:
        """Whether the writer closed the file."""
        return not self.reason


class _Exact:
    """A file whose short reads are an end: a cut record must not look like a shorter one."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self._size = os.fstat(file.fileno()).st_size

    def read(self, count: int) -> bytes:
        # asked before reading: a damaged length must not ask for all the memory there is
        data = self._file.read(count) if count <= self._size - self._file.tell() else b""
        if len(data) < count:
            raise EOFError("the file is cut off")
        return data

    def tell(self) -> int:
        return self._file.tell()


class Recording:
    """A recording on disk: `header`, then its entries by iteration, as often as wanted; `end` is known after one.

    A file that was cut off or damaged gives its entries up to there, and `end.reason` says why it ends.
    Raises RecordError where the file is no recording at all, OSError where it cannot be opened.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self.end = RecordEnd(0, 0, 0, "not read yet")
        self.header: dict[str, Any] = {}
        for record in self._records():
            if type(record).__name__ == "Metadata" and record.name == METADATA:
                try:
                    self.header = {key: json.loads(value) for key, value in record.metadata.items()}
                except ValueError as error:
                    raise RecordError(f"{self.path}: the header is damaged: {error}") from error
                return
        raise RecordError(f"{self.path}: byte 0: no recording of robotd ({self.end.reason or 'it has no header'})")

    def __iter__(self) -> Iterator[Entry]:
        told: dict[int, Mapping[str, str]] = {}
        entries, last_ns = 0, 0
        for record in self._records():
            match type(record).__name__:
                case "Channel" if record.message_encoding == ENCODING:
                    told[record.id] = record.metadata
                case "Message" if record.channel_id in told:
                    entries, last_ns = entries + 1, record.log_time
                    names = told[record.channel_id]
                    yield Entry(
                        names.get("kind", ""), names.get("topic", ""), record.sequence, record.log_time, record.data
                    )
        self.end = dataclasses.replace(self.end, entries=entries, last_ns=last_ns)

    def _records(self) -> Iterator[Any]:
        """MCAP records in file order; a chunk counts only whole. Sets `end` when it is exhausted."""
        from mcap.records import Chunk
        from mcap.stream_reader import StreamReader, breakup_chunk

        with self.path.open("rb") as file:
            stream: Any = _Exact(file)
            reader = StreamReader(stream, emit_chunks=True, record_size_limit=None)
            good, reason = 0, ""
            records = iter(reader.records)
            while True:
                try:
                    record = next(records, None)
                    inside = breakup_chunk(record, validate_crc=True) if isinstance(record, Chunk) else [record]
                except Exception as error:
                    # the library and its decompressors raise many kinds over damaged bytes; each means: ends here
                    what = error if isinstance(error, EOFError) else f"damaged: {type(error).__name__}: {error}"
                    reason = f"byte {good}: {what}"
                    break
                if record is None:
                    break
                good = file.tell()
                yield from inside
        self.end = RecordEnd(good, 0, 0, reason)


def read_record(path: Path | str) -> Recording:
    """Opens a recording: `for entry in read_record(path): ...`, in the order of writing. See `Recording`."""
    return Recording(path)
