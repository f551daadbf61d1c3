"""Pictures that wait for us: a folder or a video file, read one after the other, and played at a steady pace."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from robotd.authoring.device import DeviceError, DeviceUnavailable
from robotd.world.messages import Bytes2D
from robotd_devices.camera.shape import Shape
from robotd_devices.ports.ticker import Ticker

SUFFIXES = (".jpg", ".jpeg", ".png", ".bmp", ".ppm", ".webp")


class Picture(NamedTuple):
    """A picture, its number in the source (from 1, on and on when the source begins again), and its name."""

    bgr: Bytes2D
    sequence: int
    name: str


class Pictures(Protocol):
    """A source that is read when we like. Blocking; used by one thread at a time."""

    skipped: list[str]
    """Names of pictures that could not be read since somebody emptied this."""

    def next(self) -> Picture | None:
        """The next picture, None at the end. Raises DeviceUnavailable where there is none at all."""
        ...

    def close(self) -> None: ...


class Folder:
    """The pictures of a folder by name. The list is made once; files that came later are not seen."""

    def __init__(self, path: Path, shape: Shape, loop: bool) -> None:
        self.skipped: list[str] = []
        self._path = path
        self._files = sorted(file for file in path.iterdir() if file.suffix.lower() in SUFFIXES)
        if not self._files:
            raise DeviceUnavailable(f"`source`: {path} holds no pictures; put some there ({', '.join(SUFFIXES)})")
        self._shape = shape
        self._loop = loop
        self._sequence = 0

    def next(self) -> Picture | None:
        for _ in self._files:
            if self._sequence >= len(self._files) and not self._loop:
                return None
            file = self._files[self._sequence % len(self._files)]
            self._sequence += 1
            try:
                return Picture(self._shape.apply(_decode(file)), self._sequence, file.name)
            except (OSError, ValueError) as error:
                self.skipped.append(f"{file.name}: {error}")
        raise DeviceUnavailable(
            f"`source`: none of the {len(self._files)} pictures in {self._path} can be read: {self.skipped[-1]}"
        )

    def close(self) -> None:
        """Nothing is open between two pictures."""


def _decode(file: Path) -> Any:
    import cv2

    data = np.frombuffer(file.read_bytes(), dtype=np.uint8)
    try:
        # grey, 16 bits and alpha become 8 bits of three channels
        picture = cv2.imdecode(data, cv2.IMREAD_COLOR) if data.size else None
    except cv2.error:
        picture = None
    if picture is None:
        raise ValueError("no picture that OpenCV can decode")
    return picture


class Video:
    """The pictures of a video file. Its own pace and sound are not used."""

    def __init__(self, path: Path, shape: Shape, loop: bool) -> None:
        import cv2

        if not path.is_file():
            raise DeviceUnavailable(
                f"`source`: {path} does not exist: correct the path; a relative one counts from the folder in which "
                "robotd was started"
            )
        self.skipped: list[str] = []
        self._path = path
        self._shape = shape
        self._loop = loop
        self._sequence = 0
        self._read_some = False
        self._capture: Any = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)

    def next(self) -> Picture | None:
        while True:
            found, raw = self._capture.read()
            if found:
                self._sequence += 1
                self._read_some = True
                return Picture(self._shape.apply(raw), self._sequence, self._path.name)
            if not self._read_some:
                raise DeviceUnavailable(f"`source`: {self._path} is no video that OpenCV can read")
            if not self._loop:
                return None
            self._read_some = False
            # not every format can be wound back
            self._capture.open(str(self._path))

    def close(self) -> None:
        self._capture.release()


class Player:
    """Gives a source's pictures to `on_picture` on the loop, one a period.

    Each picture is read and decoded in a worker while the one before is shown, so the loop never waits; on virtual
    time, which stands still meanwhile, every picture comes at its exact instant and in the same order. A picture that
    is not ready in time comes with a later beat (`on_late`). `on_end(error)`: the source ended (None), or failed.
    """

    def __init__(
        self,
        pictures: Pictures,
        period_s: float,
        *,
        on_picture: Callable[[Picture], None],
        on_late: Callable[[], None],
        on_end: Callable[[DeviceError | None], None],
    ) -> None:
        self._pictures = pictures
        self._on_picture = on_picture
        self._on_late = on_late
        self._on_end = on_end
        self._next: asyncio.Future[Picture | None] | None = None
        self._ticker = Ticker(period_s, self._beat)

    async def start(self) -> None:
        """Read the first picture, then begin. Raises DeviceError."""
        self._fetch()
        assert self._next is not None
        await asyncio.wait((self._next,))
        self._next.result()
        self._ticker.start()

    def stop(self) -> None:
        """No picture after this one; the source is closed when its worker is done."""
        self._ticker.stop()
        if self._next is None or self._next.done():
            self._pictures.close()
        else:
            self._next.add_done_callback(self._close_late)
        self._next = None

    def _close_late(self, fetched: asyncio.Future[Picture | None]) -> None:
        if not fetched.cancelled():
            fetched.exception()  # nobody wants it any more
        self._pictures.close()

    def _fetch(self) -> None:
        self._next = asyncio.get_running_loop().run_in_executor(None, self._read)

    def _read(self) -> Picture | None:
        """In a worker."""
        try:
            return self._pictures.next()
        except DeviceError:
            raise
        except Exception as error:
            raise DeviceUnavailable(f"{type(error).__name__}: {error}") from error

    def _beat(self) -> None:
        fetched = self._next
        if fetched is None or not fetched.done():
            self._on_late()
            return
        try:
            picture = fetched.result()
        except DeviceError as error:
            self._on_end(error)
            return
        if picture is None:
            self._on_end(None)
            return
        self._fetch()
        self._on_picture(picture)
