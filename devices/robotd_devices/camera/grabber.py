"""A live camera's thread: reads as fast as pictures come, keeps the newest, and never lets the loop wait or queue."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

from robotd.authoring.device import DeviceError, DeviceLost, DeviceUnavailable
from robotd.world.clock import NS_PER_S, Clock
from robotd.world.messages import Bytes2D
from robotd_devices.camera.checks import FrameCheck
from robotd_devices.camera.mjpeg_slot import JpegSlot
from robotd_devices.camera.shape import Shape
from robotd_devices.ports.device_thread import DeviceThread, Newest

_POS_MSEC = 0
"""OpenCV's CAP_PROP_POS_MSEC; of a V4L2 camera it is the driver's stamp of the last picture, on the monotonic clock."""


class Capture(Protocol):
    """What is used of `cv2.VideoCapture`; `grab` waits for a picture. All calls come from one thread."""

    def grab(self) -> bool: ...
    def retrieve(self) -> tuple[bool, Any]: ...
    def get(self, propId: int, /) -> float: ...
    def release(self) -> None: ...


class Grabbed(NamedTuple):
    """A picture, the middle of its exposure, and its number; numbers that are missing were overwritten or dropped."""

    bgr: Bytes2D
    stamp_ns: int
    sequence: int


@dataclass(frozen=True, slots=True)
class Timing:
    """How stamps are made: the capture's own where `driver_stamps` and believable, else the arrival; less latency.

    The capture's own are a V4L2 driver's and our MJPEG client's. Believable is what lies within the last second.
    """

    clock: Clock
    latency_ns: int
    driver_stamps: bool = False

    def stamp_ns(self, capture: Capture) -> int:
        """The middle of the exposure of the picture that was just grabbed."""
        now_ns = self.clock.now_ns()
        if self.driver_stamps:
            driver_ns = round(capture.get(_POS_MSEC) * 1e6)
            if driver_ns > 0 and 0 <= now_ns - driver_ns < NS_PER_S:
                return driver_ns - self.latency_ns
        return now_ns - self.latency_ns


class Grabber:
    """Opens, reads and releases one capture, all on one daemon thread, since every call of it may hang.

    The callbacks run on the loop: `on_picture` with the newest picture whenever the loop comes round and there is a new
    one; `on_fault(name, detail)`; `on_lost(reason)` once. None is called after `close`.
    """

    def __init__(
        self,
        name: str,
        open_capture: Callable[[], Capture],
        shape: Shape,
        timing: Timing,
        check: FrameCheck,
        *,
        on_picture: Callable[[Grabbed], None],
        on_fault: Callable[[str, str], None],
        on_lost: Callable[[str], None],
    ) -> None:
        self._open_capture = open_capture
        self._shape = shape
        self._timing = timing
        self._check = check
        self._thread = DeviceThread(f"camera {name}", self._run, on_fault=on_fault, on_lost=on_lost)
        self._newest = Newest[Grabbed](self._thread, on_picture)

    @property
    def is_alive(self) -> bool:
        """Whether the thread still runs, or hangs."""
        return self._thread.is_alive

    @property
    def overwritten(self) -> int:
        """Pictures that the loop was too slow for."""
        return self._newest.overwritten

    async def open(self) -> None:
        """Start the thread, wait until the capture is open. Raises DeviceError; safe to cancel."""
        await self._thread.open()

    async def close(self) -> bool:
        """Let go; False where the thread hangs: it will end by itself or never."""
        return await self._thread.close()

    # ------------------------------------------------------------------------------------- on the thread

    def _run(self) -> None:
        capture: Capture | None = None
        try:
            capture = self._open_capture()
            self._thread.ready()
            self._read(capture)
        except DeviceError as error:
            self._thread.fail(error)
        except Exception as error:
            self._thread.fail(DeviceUnavailable(f"{type(error).__name__}: {error}"))
        finally:
            if capture is not None:
                capture.release()

    def _read(self, capture: Capture) -> None:
        sequence = 0
        while not self._thread.closing.is_set():
            if not capture.grab():
                raise DeviceLost("no picture came any more: is its cable in, and its supply strong enough?")
            stamp_ns = self._timing.stamp_ns(capture)
            sequence = capture.number if isinstance(capture, JpegSlot) else sequence + 1
            found, raw = capture.retrieve()
            if not found or raw is None:
                self._thread.fault("picture dropped", "it could not be decoded")
                continue
            try:
                picture = Grabbed(self._shape.apply(raw), stamp_ns, sequence)
            except ValueError as error:
                self._thread.fault("picture dropped", str(error))
                continue
            verdict = self._check.judge(raw, self._timing.clock.now_ns())
            for fault in verdict.faults:
                self._thread.fault(*fault)
            if verdict.lost:
                raise DeviceLost(verdict.lost)
            if verdict.publish:
                self._newest.put(picture)
