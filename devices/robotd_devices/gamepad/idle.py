"""The gamepad of a simulated robot: one that nobody touches."""

from __future__ import annotations

import asyncio
from typing import ClassVar

from robotd.authoring.config import NoConfig
from robotd.authoring.device import DeviceContext, Sensor
from robotd.world.messages import Gamepad

PERIOD_S = 0.05


class IdleGamepad(Sensor[NoConfig, Gamepad]):
    """Says at a steady beat that no axis is moved and no button held. Drive a simulated robot from its page."""

    sim_twin: ClassVar[str | None] = "sim_gamepad"

    def __init__(self, config: NoConfig, context: DeviceContext | None = None) -> None:
        super().__init__(config, context)
        self._beat: asyncio.TimerHandle | None = None

    @classmethod
    def publish_period_s(cls, config: NoConfig) -> float | None:
        return PERIOD_S

    async def open(self) -> None:
        self._say()

    async def close(self) -> None:
        if self._beat is not None:
            self._beat.cancel()
            self._beat = None

    def _say(self) -> None:
        self._beat = asyncio.get_running_loop().call_later(PERIOD_S, self._say)
        self.publish(Gamepad(self.context.clock.now_ns()))
