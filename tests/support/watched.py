"""A small robot with its page: drives ahead, has a lidar and a camera, and is watched over real sockets."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import replace
from typing import Any

import aiohttp
import numpy as np
from small_robot import OFF, QUICK, FakeBase, FakeLidar, ScriptConfig, _Scripted, behaviour

from robotd import Behaviour, CameraFrame, Drive, LidarScan, RuntimeLink, Sensor, View, every
from robotd.authoring.config import NoConfig
from robotd.authoring.explain import Explanation, ImageBox, Line, Scalar, Text
from robotd.engine.loops import real_loop
from robotd.engine.parts import BridgePart, DevicePart, Parts
from robotd.engine.runtime import Runtime
from robotd.world.messages import Message
from robotd_plugins.bridges.dashboard import Dashboard, DashboardConfig

WITHIN_S = 20.0


class FakeCamera(_Scripted, Sensor[ScriptConfig, CameraFrame]):
    """640 x 480, blue to the left and red to the right."""

    def message(self, now_ns: int) -> Message:
        bgr = np.zeros((480, 640, 3), dtype=np.uint8)
        bgr[:, :320, 0] = 200
        bgr[:, 320:, 2] = 200
        return CameraFrame(now_ns, bgr, self._count)


class Sees(View):
    scan: LidarScan = every(within_s=0.5)


class Ahead(Behaviour[NoConfig, Sees]):
    """Drives ahead and says so."""

    def step(self, seen: Sees) -> Drive:
        return Drive(0.25)

    def explain(self) -> Explanation:
        return (
            Text("state", "AHEAD"),
            Scalar("gap", 1.5, "m"),
            Line("aim", (0.0, 0.0), (1.0, 0.2)),
            ImageBox("sign 0.91", (100.0, 80.0, 200.0, 180.0)),
        )


def watched_robot(**more: Any) -> Parts:
    devices = (
        DevicePart("base", FakeBase, NoConfig()),
        DevicePart("lidar", FakeLidar, ScriptConfig()),
        DevicePart("camera", FakeCamera, ScriptConfig(hz=15.0)),
    )
    parts = Parts(replace(QUICK, name="tester"), devices, (), (behaviour(Ahead),), guard=OFF, arm_at_start=True)
    return replace(parts, **more)


Scenario = Callable[[Dashboard, Runtime], Awaitable[None]]


def watch(
    scenario: Scenario,
    parts: Parts | None = None,
    *,
    loop_factory: Callable[[], asyncio.AbstractEventLoop] = real_loop,
    virtual: bool = False,
    **config: Any,
) -> Runtime:
    """Run a robot with its page until `scenario` returns; raises what it raises. Further keywords: of the page."""
    built = parts if parts is not None else watched_robot()

    async def main() -> Runtime:
        found: asyncio.Future[Dashboard] = asyncio.get_running_loop().create_future()

        class Caught(Dashboard):
            async def run(self, runtime: RuntimeLink) -> None:
                if not found.done():
                    found.set_result(self)
                await super().run(runtime)

        page = BridgePart("dashboard", Caught, DashboardConfig(**{"port": 0, **config}))
        runtime = Runtime(replace(built, bridges=(page,)), virtual=virtual)
        running = asyncio.create_task(runtime.run())
        try:
            await scenario(await found, runtime)
        finally:
            runtime.stop()
            await running
        return runtime

    with asyncio.Runner(loop_factory=loop_factory) as runner:
        return runner.run(main())


class Page:
    """A viewer in Python: answers beats as the page does, unless told not to, and keeps what it was told."""

    def __init__(self, wire: aiohttp.ClientWebSocketResponse, *, draws: bool = True) -> None:
        self.wire = wire
        self.draws = draws
        self.told: list[dict[str, Any] | bytes] = []
        self._next = 100

    async def next(self) -> dict[str, Any] | bytes:
        """The next message. Raises ConnectionError where the robot hung up."""
        message = await self.wire.receive(WITHIN_S)
        if message.type is aiohttp.WSMsgType.BINARY:
            self.told.append(message.data)
            return bytes(message.data)
        if message.type is not aiohttp.WSMsgType.TEXT:
            raise ConnectionError(f"{message.type.name} {self.wire.close_code}")
        told: dict[str, Any] = json.loads(message.data)
        self.told.append(told)
        if told["kind"] == "beat" and self.draws:
            await self.wire.send_json({"do": "beat", "n": told["n"]})
        return told

    async def until(self, wanted: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """The next JSON message that is wanted."""
        while True:
            told = await self.next()
            if isinstance(told, dict) and wanted(told):
                return told

    async def kind(self, kind: str) -> dict[str, Any]:
        return await self.until(lambda told: told["kind"] == kind)

    async def status(self, wanted: Callable[[dict[str, Any]], bool] = lambda told: True) -> dict[str, Any]:
        return await self.until(lambda told: told["kind"] == "status" and wanted(told))

    async def binary(self, first_byte: int) -> bytes:
        while True:
            told = await self.next()
            if isinstance(told, bytes) and told[0] == first_byte:
                return told

    async def ask(self, do: str, **more: Any) -> dict[str, Any]:
        """The answer to a request."""
        self._next += 1
        asked = self._next
        await self.wire.send_json({"do": do, "id": asked, **more})
        return await self.until(lambda told: told["kind"] in ("answer", "pong") and told["id"] == asked)


@asynccontextmanager
async def opened(dashboard: Dashboard, *, draws: bool = True, **headers: str) -> AsyncIterator[Page]:
    """One viewer's connection; `headers` with underscores for dashes."""
    await dashboard.serving.wait()
    sent = {name.replace("_", "-"): value for name, value in headers.items()}
    async with (
        aiohttp.ClientSession() as session,
        session.ws_connect(f"{dashboard.url}live", headers=sent, max_msg_size=0) as wire,
    ):
        yield Page(wire, draws=draws)
