"""What there is to see on a running robot, one class a channel: its newest version, and the message that tells it."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Generic

from typing_extensions import TypeVar

from robotd import CameraFrame, LidarScan, RuntimeLink, Topic
from robotd.authoring.explain import Explanation
from robotd.world.clock import ns
from robotd_plugins.bridges.dashboard.encoder import PictureEncoder
from robotd_plugins.bridges.dashboard.messages import drawings_message, picture_message, scan_message, status_message
from robotd_plugins.bridges.dashboard.viewer import Payload

log = logging.getLogger("robotd")

VersionT = TypeVar("VersionT")

STATUS_NS = 200_000_000
TENTH_NS = 95_000_000
"""A little under 0.1 s, so that a lidar of 10 Hz loses no scan to the grid on which the bridge looks."""

READY_NS = 500_000_000
"""For so long after its encoding a picture is worth sending though a newer frame exists."""


class Channel(Generic[VersionT]):
    """One kind of news. A message is built once for each version, however many pages want it, and only if one does."""

    def __init__(self, name: str, period_ns: int, runtime: RuntimeLink) -> None:
        self.name = name
        self.period_ns = period_ns
        self.runtime = runtime
        self._made: tuple[VersionT, Payload] | None = None

    def newest(self, now_ns: int) -> VersionT | None:
        """The newest version, None where there is nothing to tell. Asked only while a page wants to know."""
        raise NotImplementedError

    def build(self, version: VersionT) -> Payload:
        """The message that tells this version."""
        raise NotImplementedError

    def message(self, version: VersionT) -> Payload:
        """The message of a version, built at most once."""
        if self._made is None or self._made[0] != version:
            self._made = (version, self.build(version))
        return self._made[1]


class StatusChannel(Channel[int]):
    """Mode, sentence, behaviours, streams, command; a version an instant."""

    def __init__(self, runtime: RuntimeLink) -> None:
        super().__init__("status", STATUS_NS, runtime)

    def newest(self, now_ns: int) -> int:
        return now_ns

    def build(self, version: int) -> str:
        return status_message(self.runtime.status())


class DrawingsChannel(Channel[int]):
    """What each plugin explains; a version each time that one of them says something new."""

    def __init__(self, runtime: RuntimeLink) -> None:
        super().__init__("drawings", TENTH_NS, runtime)
        self._version = 0
        self._drawn: Mapping[str, Explanation] = {}

    def newest(self, now_ns: int) -> int:
        drawn = self.runtime.explanations()
        before = self._drawn
        if drawn.keys() != before.keys() or any(drawn[name] is not before[name] for name in drawn):
            self._drawn = drawn
            self._version += 1
        return self._version

    def build(self, version: int) -> str:
        return drawings_message(self._drawn)


class ScanChannel(Channel[LidarScan]):
    """One lidar. `index`: its place in the hello's `scans`."""

    def __init__(self, runtime: RuntimeLink, topic: Topic[LidarScan], index: int) -> None:
        super().__init__(f"scan {topic.name}", TENTH_NS, runtime)
        self._topic = topic
        self._index = index

    def newest(self, now_ns: int) -> LidarScan | None:
        return self.runtime.newest(self._topic)

    def build(self, version: LidarScan) -> bytes:
        return scan_message(self._index, version)


class PictureChannel(Channel[CameraFrame]):
    """One camera. A version is a frame whose JPEG is ready; asking for it is what has the newest frame encoded."""

    def __init__(
        self, runtime: RuntimeLink, topic: Topic[CameraFrame], index: int, frame_hz: float, encoder: PictureEncoder
    ) -> None:
        super().__init__(f"picture {topic.name}", 0, runtime)
        self.topic = topic
        self._index = index
        self._frame_ns = ns(0.95 / frame_hz)
        self._encoder = encoder
        self._taken: tuple[CameraFrame, int] | None = None
        self._ready: tuple[CameraFrame, int, bytes] | None = None
        self._fault = ""

    def newest(self, now_ns: int) -> CameraFrame | None:
        frame, taken = self.runtime.newest(self.topic), self._taken
        is_due = taken is None or (frame is not taken[0] and now_ns - taken[1] >= self._frame_ns)
        if frame is not None and is_due and self._encoder.submit(frame, self._encoded):
            self._taken = (frame, now_ns)
        # while the next one is encoded the last one is told, unless it is as old as the last visitor
        ready = self._ready
        return ready[0] if ready is not None and (ready[0] is frame or now_ns - ready[1] < READY_NS) else None

    def build(self, version: CameraFrame) -> bytes:
        assert self._ready is not None
        height_px, width_px = version.bgr.shape[:2]
        return picture_message(self._index, width_px, height_px, version.stamp_ns, self._ready[2])

    def _encoded(self, frame: CameraFrame, result: bytes | str) -> None:
        if isinstance(result, str):
            if result != self._fault:
                log.error("page: no picture of %s: %s", self.topic.name, result)
            self._fault = result
            return
        self._fault = ""
        self._ready = (frame, self.runtime.clock.now_ns(), result)
