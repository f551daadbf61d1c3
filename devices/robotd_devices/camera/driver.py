"""The camera as a device: newest picture first from a live source, picture after picture from a folder or a video."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial
from pathlib import Path

from robotd.authoring.device import DeviceContext, DeviceError, DeviceUnavailable, Sensor
from robotd.world.clock import ns
from robotd.world.messages import CameraFrame
from robotd_devices.camera.captures import open_live
from robotd_devices.camera.checks import CheckSettings, FrameCheck
from robotd_devices.camera.config import LIVE, CameraConfig, kind_of, shown
from robotd_devices.camera.grabber import Capture, Grabbed, Grabber, Timing
from robotd_devices.camera.mjpeg_http import MjpegStream, NotMjpeg
from robotd_devices.camera.mjpeg_slot import JpegSlot
from robotd_devices.camera.pictures import Folder, Picture, Pictures, Player, Video
from robotd_devices.camera.shape import Shape

_MOST_HANGING = 2


def _itself(slot: JpegSlot) -> Capture:
    return slot


def _settings(config: CameraConfig, is_mjpeg: bool) -> CheckSettings:
    """What to look for, by what the source can do.

    Video codecs leave parts of a still scene, and whole pictures, as they are: of such streams repeats say nothing.
    JPEGs have no older pictures in them.
    """
    is_url = kind_of(config.source) == "url"
    return CheckSettings(
        frozen_ns=0 if is_url and not is_mjpeg else ns(config.frozen_s),
        black_below=config.black_below,
        black_pictures=config.black_pictures,
        torn=config.torn,
        partial=not is_url,
    )


class Camera(Sensor[CameraConfig, CameraFrame]):
    """Pictures from whatever `source` names.

    A live source is read by a thread as fast as it gives pictures; only the newest is kept, so that a slow program
    skips pictures and never sees old ones. Faults that it counts: `picture dropped`, `torn picture`, `repeated
    picture`, `black picture`, `picture too large`, `part that is no picture` (a stream), `unreadable picture` (a file,
    by name), `picture not ready in time`. Lost where a read fails, nothing comes for `silent_s`, the very same picture
    came for `frozen_s`, or a folder or video without `loop` is at its end; it then stays at its end.

    open_capture: what opens a live source, on the grabber's thread; a fake's in tests.
    """

    sim_twin = "sim_camera"

    def __init__(
        self,
        config: CameraConfig,
        context: DeviceContext | None = None,
        *,
        open_capture: Callable[[], Capture] | None = None,
    ) -> None:
        super().__init__(config, context)
        # a board's pipeline turns by itself
        turn = 0 if kind_of(config.source) == "board" else config.rotate_deg
        self._shape = Shape(config.width_px, config.height_px, turn)
        self._is_http = config.is_http and open_capture is None
        self._open_capture = open_capture if open_capture is not None else partial(open_live, config, self._shape)
        self._name = shown(config.source)
        self._stream: MjpegStream | None = None
        self._grabber: Grabber | None = None
        self._hanging: list[Grabber] = []
        self._player: Player | None = None
        self._pictures: Pictures | None = None
        self._watch: asyncio.TimerHandle | None = None
        self._heard = False
        self._at_end = ""

    @classmethod
    def load(cls, config: CameraConfig) -> None:
        import cv2  # noqa: F401  # the import is the work

    @classmethod
    def publish_period_s(cls, config: CameraConfig) -> float | None:
        return 1.0 / config.rate_hz

    async def open(self) -> None:
        if self._at_end:
            raise DeviceUnavailable(f"{self.context.name}: {self._at_end}")
        try:
            if kind_of(self.config.source) in LIVE:
                await self._open_live()
            else:
                await self._open_files()
        except DeviceError as error:
            raise type(error)(f"{self.context.name}: {error}") from error

    async def close(self) -> None:
        if self._watch is not None:
            self._watch.cancel()
            self._watch = None
        player, self._player = self._player, None
        if player is not None:
            player.stop()
        stream, self._stream = self._stream, None
        if stream is not None:
            stream.stop()
        grabber, self._grabber = self._grabber, None
        if grabber is not None and not await grabber.close():
            self._hanging.append(grabber)

    # -------------------------------------------------------------------------------------------- live

    async def _open_live(self) -> None:
        self._hanging = [grabber for grabber in self._hanging if grabber.is_alive]
        if len(self._hanging) >= _MOST_HANGING:
            raise DeviceUnavailable(
                f"{self._name} hangs: {_MOST_HANGING} reads of it never returned; pull the camera out and plug it in"
            )
        slot = await self._open_stream() if self._is_http else None
        kind = kind_of(self.config.source)
        self._grabber = Grabber(
            self.context.name,
            self._open_capture if slot is None else partial(_itself, slot),
            self._shape,
            Timing(self.context.clock, ns(self.config.latency), slot is not None or kind == "v4l2"),
            FrameCheck(_settings(self.config, is_mjpeg=slot is not None)),
            on_picture=self._grabbed,
            on_fault=self.context.link.fault,
            on_lost=self._gone,
        )
        await self._grabber.open()
        self._heard = False
        self._watch = asyncio.get_running_loop().call_later(self.config.silent_s, self._listen)

    async def _open_stream(self) -> JpegSlot | None:
        """Where pictures of an MJPEG stream come; None where the address gives something else, for OpenCV."""
        slot = JpegSlot()
        self._stream = MjpegStream(
            str(self.config.source), self._name, slot, self.context.clock, self.context.link.fault
        )
        try:
            await self._stream.open()
        except NotMjpeg:
            self._stream = None
            return None
        return slot

    def _grabbed(self, picture: Grabbed) -> None:
        self._heard = True
        # a clock that a test sets by hand may stand still meanwhile
        stamp_ns = min(picture.stamp_ns, self.context.clock.now_ns())
        self.publish(CameraFrame(stamp_ns, picture.bgr, picture.sequence, self._name))

    def _listen(self) -> None:
        """Once every `silent_s`: did a picture come since the last time?"""
        if self._heard:
            self._heard = False
            self._watch = asyncio.get_running_loop().call_later(self.config.silent_s, self._listen)
            return
        self._gone(f"no picture for {self.config.silent_s:g} s: does the camera hang, or another program use it?")

    def _gone(self, reason: str) -> None:
        if self._watch is not None:
            self._watch.cancel()
            self._watch = None
        self.lost(f"{self._name}: {reason}")

    # ------------------------------------------------------------------------------------------- files

    async def _open_files(self) -> None:
        pictures = await asyncio.get_running_loop().run_in_executor(None, self._find)
        self._pictures = pictures
        self._player = Player(
            pictures,
            1.0 / self.config.rate_hz,
            on_picture=self._show,
            on_late=partial(self.context.link.fault, "picture not ready in time"),
            on_end=self._ended,
        )
        await self._player.start()

    def _find(self) -> Pictures:
        path, loop = Path(str(self.config.source)), self.config.loop
        if kind_of(self.config.source) == "folder":
            return Folder(path, self._shape, loop)
        return Video(path, self._shape, loop)

    def _show(self, picture: Picture) -> None:
        self._name_skipped()
        stamp_ns = self.context.clock.now_ns() - ns(self.config.latency)
        self.publish(CameraFrame(stamp_ns, picture.bgr, picture.sequence, picture.name))

    def _name_skipped(self) -> None:
        if self._pictures is not None and self._pictures.skipped:
            skipped = self._pictures.skipped[:]
            del self._pictures.skipped[: len(skipped)]
            for what in skipped:
                self.context.link.fault("unreadable picture", what)

    def _ended(self, error: DeviceError | None) -> None:
        self._name_skipped()
        if self._player is not None:
            self._player.stop()
            self._player = None
        if error is None:
            self._at_end = f"{self._name} is at its end; `loop: true` begins again"
        self.lost(self._at_end if error is None else str(error))
