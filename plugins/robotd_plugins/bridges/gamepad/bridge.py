"""The bridge `gamepad_teleop`: drives by lease while the dead-man's button is held; e-stop and arming on buttons."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Mapping

from robotd import Bridge, RuntimeLink, Topic
from robotd.authoring.bridge import Refused
from robotd.world.clock import ns
from robotd.world.messages import Gamepad, Mode, ModeChange
from robotd.world.topics import default_topic
from robotd_plugins.bridges.gamepad.config import GamepadTeleopConfig
from robotd_plugins.bridges.gamepad.hand import command, pressed, standstill

log = logging.getLogger("robotd")

BY = "gamepad"
LOOK_S = 0.02


class GamepadTeleop(Bridge[GamepadTeleopConfig]):
    """Looks at the pad fifty times a second.

    Letting the dead-man's button go stops at once; a pad that is gone or silent stops when its lease ends at the
    latest. The robot then stays in MANUAL until `resume`. What was refused while the button is held is not tried again
    before it was let go: a robot that is armed meanwhile does not start under a thumb.
    """

    def __init__(self, config: GamepadTeleopConfig) -> None:
        super().__init__(config)
        self._counts: Mapping[str, int] | None = None
        self._drives = False
        self._refused = False
        self._renew_ns = 0

    async def run(self, runtime: RuntimeLink) -> None:
        topic = Topic(self.config.topic, Gamepad)
        if topic.name not in {known.name for known in runtime.topics()}:
            log.error("gamepad_teleop: no device publishes %r: add `gamepad: {}` to `devices`", topic.name)
        while True:
            self.look(runtime, runtime.newest(topic))
            await asyncio.sleep(LOOK_S)

    def look(self, runtime: RuntimeLink, pad: Gamepad | None) -> None:
        """One look: buttons first, then driving. `pad`: its newest state, or None where it is gone."""
        now_ns = runtime.clock.now_ns()
        if pad is None or now_ns - pad.stamp_ns > ns(self.config.within_s):
            self._let_go(runtime, "the pad is silent")
            return
        if self._counts is not None:
            self._buttons(runtime, pressed(self._counts, pad))
        self._counts = dict(pad.presses)
        if not pad.deadman:
            self._refused = False
            self._let_go(runtime, "the dead-man's button was let go")
        elif not self._refused:
            self._drive(runtime, pad, now_ns)

    def _drive(self, runtime: RuntimeLink, pad: Gamepad, now_ns: int) -> None:
        if self._drives and now_ns < self._renew_ns:
            return
        if not self._ask(lambda: runtime.teleop(BY, command(pad, self.config, runtime.robot), self.config.lease_s)):
            self._refused, self._drives = True, False
            return
        if not self._drives:
            log.info("gamepad: drives by hand")
        self._drives = True
        self._renew_ns = now_ns + ns(self.config.lease_s / 3.0)

    def _let_go(self, runtime: RuntimeLink, why: str) -> None:
        if self._drives:
            self._drives = False
            self._ask(lambda: runtime.teleop(BY, standstill(runtime.robot), self.config.lease_s))
            log.info("gamepad: stands, %s", why)

    def _buttons(self, runtime: RuntimeLink, names: frozenset[str]) -> None:
        config = self.config
        if config.estop_button in names:
            self._ask(lambda: runtime.estop(BY, "button"))
            return  # whatever else was pressed with it does not count
        if config.reset_button in names:
            self._ask(lambda: runtime.reset_estop(BY))
        if config.arm_button in names:
            mode = runtime.newest(default_topic(ModeChange))
            is_off = not isinstance(mode, ModeChange) or mode.mode in (Mode.DISARMED, Mode.ESTOP)
            self._ask(lambda: runtime.arm(BY) if is_off else runtime.disarm(BY))
        if config.resume_button in names and not self._drives:
            self._ask(lambda: runtime.resume(BY))

    def _ask(self, request: Callable[[], None]) -> bool:
        try:
            request()
        except Refused as refused:
            log.info("gamepad: refused: %s", refused)
            return False
        return True
