"""The bridge `dashboard`: looks at the runtime for those who watch the page, and passes on what they ask."""

from __future__ import annotations

import asyncio
import logging
import socket
import time
from collections.abc import Callable
from typing import Any

from robotd import Bridge, CameraFrame, LidarScan, RuntimeLink, Topic
from robotd.world.messages import Message, ModeChange
from robotd.world.topics import default_topic
from robotd_plugins.bridges.dashboard.asking import Ask, carry_out, in_words
from robotd_plugins.bridges.dashboard.config import DashboardConfig
from robotd_plugins.bridges.dashboard.encoder import PictureEncoder
from robotd_plugins.bridges.dashboard.gate import Gate
from robotd_plugins.bridges.dashboard.messages import dumps, event_text, hello
from robotd_plugins.bridges.dashboard.news import (
    Channel,
    DrawingsChannel,
    PictureChannel,
    ScanChannel,
    StatusChannel,
)
from robotd_plugins.bridges.dashboard.viewer import EVENTS, EventLog, Viewer

log = logging.getLogger("robotd")

LOOK_S = 0.05
"""How often the bridge looks for news, while anybody watches."""
SILENT_S = 15.0
"""A page that said nothing for so long is gone (wall time: pages do not live in virtual time)."""
RETRY_S = 2.0
MODE: Topic[Message] = default_topic(ModeChange)


class Dashboard(Bridge[DashboardConfig]):
    """Serves the page until cancelled. Without viewers it looks at nothing and encodes nothing.

    `url` is where the page is once `serving` is set.
    """

    def __init__(self, config: DashboardConfig) -> None:
        super().__init__(config)
        self.url = ""
        self.serving = asyncio.Event()
        self._viewers: dict[Viewer, Callable[[], None]] = {}
        self._somebody = asyncio.Event()
        self._numbers = 0
        self._events = EventLog()
        self._encoder = PictureEncoder(config.frame_width, config.jpeg_quality)
        self._mode: Message | None = None
        self._runtime: RuntimeLink
        self._scans: list[str] = []
        self._cameras: list[str] = []
        self._channels: list[Channel[Any]] = []

    @classmethod
    def load(cls, config: DashboardConfig) -> None:
        from robotd_plugins.bridges.dashboard import server

        server.static_files()

    async def run(self, runtime: RuntimeLink) -> None:
        self._runtime = runtime
        topics = runtime.topics()
        self._scans = [topic.name for topic in topics if issubclass(topic.type, LidarScan)]
        self._cameras = [topic.name for topic in topics if issubclass(topic.type, CameraFrame)]
        self._channels = [
            StatusChannel(runtime),
            *(ScanChannel(runtime, Topic(name, LidarScan), index) for index, name in enumerate(self._scans)),
            *(
                PictureChannel(runtime, Topic(name, CameraFrame), index, self.config.frame_hz, self._encoder)
                for index, name in enumerate(self._cameras)
            ),
            DrawingsChannel(runtime),
        ]
        try:
            async with asyncio.TaskGroup() as group:
                group.create_task(self._serve(), name="page server")
                group.create_task(self._look_for_viewers(), name="page looks")
                group.create_task(self._keep_events(), name="page events")
        finally:
            self._encoder.close()

    # ----------------------------------------------------------------------------------------- serving

    async def _serve(self) -> None:
        from robotd_plugins.bridges.dashboard.server import PageServer

        config, own = self.config, socket.gethostname().lower()
        names = {name.lower() for name in config.names} | (set() if config.loopback else {own, f"{own}.local"})
        token = config.token.get_secret_value() if config.token is not None else None
        server = PageServer(self, Gate(config.loopback, frozenset(names), token))
        try:
            await server.start()
            port = await self._listen(server.listen)
            host = own if config.host in ("0.0.0.0", "::") else config.host
            self.url = f"http://{f'[{host}]' if ':' in host else host}:{port}/"
            log.info("page: %s", self.url)
            self.serving.set()
            await asyncio.Event().wait()
        finally:
            for hang_up in list(self._viewers.values()):
                hang_up()
            await server.close()

    async def _listen(self, listen: Callable[[str, int], Any]) -> int:
        host, port, said = self.config.host, self.config.port, ""
        while True:
            try:
                return int(await listen("127.0.0.1" if host == "localhost" else host, port))
            except OSError as error:
                why = error.strerror or str(error)
                if why != said:
                    log.error(
                        "page: cannot listen on %s port %d (%s): set bridges.dashboard.port (0: any free one) or host, "
                        "or end the program that holds it; the robot drives on, the page is tried again every %g s",
                        *(host, port, why, RETRY_S),
                    )
                said = why
                await asyncio.sleep(RETRY_S)

    # ----------------------------------------------------------------------------------------- viewers

    @property
    def is_full(self) -> bool:
        """Whether one more page is turned away."""
        return len(self._viewers) >= self.config.viewers_max

    def join(self, address: str, hang_up: Callable[[], None]) -> Viewer:
        """A page opened its connection; `hang_up` ends it at once."""
        self._numbers += 1
        viewer = Viewer(self._numbers, address, time.monotonic(), self._cameras[0] if self._cameras else None)
        viewer.answer(hello(self._runtime.robot, self._scans, self._cameras, viewer.number))
        self._viewers[viewer] = hang_up
        self._somebody.set()
        log.info("%s opened from %s", viewer.name, address)
        return viewer

    def leave(self, viewer: Viewer) -> None:
        """Its connection is closed."""
        if self._viewers.pop(viewer, None) is not None:
            log.info("%s closed", viewer.name)
        if not self._viewers:
            self._somebody.clear()

    def asked(self, viewer: Viewer, ask: Ask) -> None:
        """One message of a page; what it is answered goes out with its next send."""
        match ask.do:
            case "beat":
                viewer.drew(ask.n)
            case "ping":
                viewer.answer(dumps({"kind": "pong", "id": ask.id}))
            case "look":
                viewer.camera = ask.camera if ask.camera in self._cameras else None
            case _:
                self._request(viewer, ask)

    def _request(self, viewer: Viewer, ask: Ask) -> None:
        refused = carry_out(ask, self._runtime, viewer.name)
        said = f"{viewer.name}: {in_words(ask)}" + (f" refused: {refused}" if refused else "")
        log.info("%s", said)
        self._events.add(self._runtime.clock.now_ns(), "refused" if refused else "request", said)
        viewer.answer(dumps({"kind": "answer", "id": ask.id, "do": ask.do, "ok": not refused, "reason": refused}))
        self._hurry()
        self._look()

    # ----------------------------------------------------------------------------------------- looking

    async def _keep_events(self) -> None:
        async for event in self._runtime.events():
            self._events.add(event.stamp_ns, type(event).__name__, event_text(event))

    async def _look_for_viewers(self) -> None:
        while True:
            await self._somebody.wait()
            self._look()
            self._hang_up_on_the_silent(time.monotonic())
            await asyncio.sleep(LOOK_S)

    def _look(self) -> None:
        """Gives every page that keeps up what is news to it."""
        now_ns = self._runtime.clock.now_ns()
        mode = self._runtime.newest(MODE)
        if mode is not self._mode:
            self._mode = mode
            self._hurry()
        for viewer in self._viewers:
            if not viewer.keeps_up:
                continue
            for channel in self._channels:
                if isinstance(channel, PictureChannel) and channel.topic.name != viewer.camera:
                    continue
                if viewer.is_due(channel.name, now_ns, channel.period_ns):
                    version = channel.newest(now_ns)
                    if version is not None and viewer.lacks(channel.name, version):
                        viewer.give(channel.name, version, now_ns, channel.message(version))
            if self._events.last and viewer.lacks(EVENTS, self._events.last):
                viewer.give(EVENTS, self._events.last, now_ns, self._events.message(viewer.events_told))

    def _hurry(self) -> None:
        """What just changed does not wait for the status's own period."""
        for viewer in self._viewers:
            viewer.forget("status")

    def _hang_up_on_the_silent(self, now_s: float) -> None:
        for viewer, hang_up in list(self._viewers.items()):
            if now_s - viewer.heard_s > SILENT_S:
                log.info("%s said nothing for %g s", viewer.name, SILENT_S)
                hang_up()
                self.leave(viewer)
