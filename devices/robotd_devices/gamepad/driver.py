"""A gamepad as a sensor: its state whenever it changes, and at a steady beat in between."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Mapping

from pydantic import Field

from robotd.authoring.config import Config
from robotd.authoring.device import DeviceContext, DeviceError, Sensor
from robotd.world.clock import ns
from robotd.world.messages import Gamepad
from robotd_devices.gamepad.input_events import EVENT, STICK, USUAL, AxisRange, PadState, position
from robotd_devices.gamepad.node import ask_axes, open_node

_AT_ONCE = 64 * EVENT.size


class GamepadConfig(Config):
    """Parameters of a gamepad. Names of axes and buttons are the kernel's, without BTN_ and ABS_, in small letters."""

    path: str = "/dev/input/by-id/*-event-joystick"
    """Path of the input device, or a pattern of which the first match is taken."""
    rate_hz: float = Field(default=20.0, ge=5.0, le=200.0)
    """How often the state is said while nothing changes."""
    deadman: str = "tl"
    """Button that must be held to drive: the left shoulder."""
    dead_zone: float = Field(default=0.08, ge=0.0, le=0.9)
    """Share of an axis about its middle that counts as the middle."""
    reversed_axes: tuple[str, ...] = ()
    """Axes to turn round, for a pad that does not count to the right and towards the person."""
    idle_s: float = Field(default=10.0, ge=0.0, le=600.0)
    """A dead-man's button with no event for so long counts as released: a radio pad may be out of reach; 0: never."""


class EvdevGamepad(Sensor[GamepadConfig, Gamepad]):
    """Reads `/dev/input/event*`. What it publishes is stamped with its own moment.

    Faults that it counts: `events dropped` (the kernel's queue ran over: everything counts as released), `no event`
    (the dead-man's button was held for `idle_s` without one). Lost where the pad is unplugged.
    """

    sim_twin = "sim_gamepad"

    def __init__(self, config: GamepadConfig, context: DeviceContext | None = None) -> None:
        super().__init__(config, context)
        self._fd: int | None = None
        self._state = PadState()
        self._ranges: Mapping[str, AxisRange] = {}
        self._beat: asyncio.TimerHandle | None = None
        self._heard_ns = 0
        self._is_idle = False

    @classmethod
    def publish_period_s(cls, config: GamepadConfig) -> float | None:
        return 1.0 / config.rate_hz

    async def open(self) -> None:
        try:
            self._fd = open_node(self.config.path)
            self._ranges = ask_axes(self._fd)
        except DeviceError as error:
            raise type(error)(f"{self.context.name}: {error}") from error
        self._state.restart({name: axis.value for name, axis in self._ranges.items()})
        self._heard_ns, self._is_idle = self.context.clock.now_ns(), False
        asyncio.get_running_loop().add_reader(self._fd, self._read)
        self._say()

    async def close(self) -> None:
        self._still()
        fd, self._fd = self._fd, None
        if fd is not None:
            os.close(fd)

    # ------------------------------------------------------------------------------------------- parts

    def _read(self) -> None:
        assert self._fd is not None
        try:
            data = os.read(self._fd, _AT_ONCE)
            if not data:
                self._gone("its events ended")
                return
            reports = self._state.feed(data)
            if self._state.must_ask:
                self.context.link.fault("events dropped", "the program was too slow: press the dead-man's button anew")
                self._state.asked({name: axis.value for name, axis in ask_axes(self._fd).items()})
        except BlockingIOError:
            return
        except OSError as error:
            self._gone(f"unplugged, or switched off ({error.strerror})")
            return
        self._heard_ns, self._is_idle = self.context.clock.now_ns(), False
        if reports:
            self._say()

    def _say(self) -> None:
        """Publish, and again after a period in which nothing else does."""
        if self._beat is not None:
            self._beat.cancel()
        self._beat = asyncio.get_running_loop().call_later(1.0 / self.config.rate_hz, self._say)
        now_ns, state, config = self.context.clock.now_ns(), self._state, self.config
        held = config.deadman in state.held
        if held and config.idle_s > 0.0 and now_ns - self._heard_ns >= ns(config.idle_s) and not self._is_idle:
            self._is_idle = True
            self.context.link.fault("no event", f"for {config.idle_s:g} s with the dead-man's button held")
            state.held.clear()  # it must be pressed anew
            held = False
        self.publish(
            Gamepad(
                now_ns,
                axes=tuple((name, self._position(name, value)) for name, value in sorted(state.values.items())),
                buttons=tuple(sorted(state.held)),
                presses=tuple(sorted(state.presses.items())),
                deadman=held,
            )
        )

    def _position(self, name: str, value: int) -> float:
        axis = self._ranges.get(name) or USUAL.get(name, STICK)
        place = position(name, value, axis, self.config.dead_zone)
        return -place if name in self.config.reversed_axes else place

    def _gone(self, reason: str) -> None:
        self._still()
        self.lost(reason)

    def _still(self) -> None:
        if self._beat is not None:
            self._beat.cancel()
            self._beat = None
        if self._fd is not None:
            asyncio.get_running_loop().remove_reader(self._fd)
