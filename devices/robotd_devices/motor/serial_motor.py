"""What drivers of motor controllers on a serial line share: opening, silence, stops, the stop as data."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import ClassVar, Generic

from pydantic import Field
from typing_extensions import TypeVar

from robotd.authoring.config import Config
from robotd.authoring.device import (
    Actuator,
    CommandT,
    DeviceContext,
    DeviceMisconfigured,
    DeviceUnavailable,
    SerialStop,
    StopLine,
)
from robotd.world.clock import NS_PER_S
from robotd.world.kinematics import Ackermann, Differential, Mecanum
from robotd.world.messages import Message
from robotd_devices.motor.serial_motor_line import MakePort, MotorLine
from robotd_devices.motor.serial_motor_odometry import PoseSum
from robotd_devices.ports.serial_port import Backend, SerialSettings, load_backend, serial_port

_NO_TIME_S = 1e-6
"""A wait that is shorter than the loop's own steps would be no wait, again and again."""
_ASK_AGAIN_S = 0.005
"""Until a question that a stop was in the way of is tried again."""


class SerialMotorConfig(Config):
    """Parameters that every motor controller on a serial line has; each driver sets its own defaults."""

    port: str = Field(min_length=1)
    """Serial port by its stable name, or a pattern that fits one."""
    baud: int = Field(default=115_200, ge=1_200, le=4_000_000)
    """Speed of the line."""
    backend: Backend = "pyserial"
    """What reads the port: pyserial (pyserial-asyncio), serialx (where it is installed) or raw (no library)."""
    silent_s: float = Field(default=0.5, ge=0.1, le=10.0)
    """Without a good packet for this long the port is closed and opened anew."""
    answer_s: float = Field(default=2.0, ge=0.1, le=10.0)
    """How long the controller may take to answer after opening."""


SerialConfigT = TypeVar("SerialConfigT", bound=SerialMotorConfig, default=SerialMotorConfig)
BodyT = TypeVar("BodyT", Differential, Mecanum, Ackermann)


class SerialMotor(Actuator[SerialConfigT, CommandT], Generic[SerialConfigT, CommandT]):
    """The shell around a protocol. A driver says what to write and takes what was read; it never touches the port.

    Faults counted here: `no finite command`, `line full` (a command replaced one that the line did not take).
    Lost where the port goes away, takes no bytes for 0.2 s, or no good packet comes for `silent_s`. From a loss on it
    obeys nothing until it is opened anew.

    make_port: what makes the port; a fake's in tests.
    """

    delimiter: ClassVar[bytes] = b""
    gap_s: ClassVar[float] = 0.0
    again_s: ClassVar[float] = 0.01

    def __init__(
        self, config: SerialConfigT, context: DeviceContext | None = None, *, make_port: MakePort = serial_port
    ) -> None:
        super().__init__(config, context)
        self._make_port = make_port
        self._line: MotorLine | None = None
        self._settings = SerialSettings(config.port, config.baud)
        self._beat: asyncio.TimerHandle | None = None
        self._heard_ns = 0
        self._answered: asyncio.Event | None = None
        self._why_lost = ""
        self.pose = PoseSum()
        """Where the base is, over reconnects."""
        self._newest_ns: dict[type[Message], int] = {}
        self._standing_faults: frozenset[str] = frozenset()

    @classmethod
    def load(cls, config: SerialConfigT) -> None:
        load_backend(config.backend)

    # ------------------------------------------------------------------------------ what a driver writes

    def stop_bytes(self) -> bytes:
        """The stop, always the same bytes, behind what ends a frame that was cut in two."""
        raise NotImplementedError(f"{type(self).__qualname__}.stop_bytes")

    def frame(self, command: CommandT) -> bytes | None:
        """The bytes of a finite command; None: the stop."""
        raise NotImplementedError(f"{type(self).__qualname__}.frame")

    def received(self, data: bytes, now_ns: int) -> None:
        """Bytes that were just read; publishes what they complete. Calls `heard` for each good packet."""
        raise NotImplementedError(f"{type(self).__qualname__}.received")

    def prepare(self) -> None:
        """Before each opening: forget what was half read, check the robot's body. Raises DeviceMisconfigured."""

    async def begin(self) -> None:
        """After opening and the stop: set the controller up. Raises DeviceError."""

    @property
    def polls_hz(self) -> float:
        """How often `poll` is called."""
        return 50.0

    def poll(self, now_ns: int) -> None:
        """Called `polls_hz` times a second while open: questions and heartbeats."""

    # ----------------------------------------------------------------------------------- what it can use

    @property
    def path(self) -> str:
        """The line's path."""
        return self._line.path if self._line is not None else self._settings.path

    def body(self, kind: type[BodyT], example: str) -> BodyT:
        """The robot's kinematics. Raises DeviceMisconfigured where they are of another kind."""
        body = self.context.robot.kinematics
        if not isinstance(body, kind):
            raise DeviceMisconfigured(
                f"{self.context.name}: this controller drives a {kind.__name__.lower()} base, robot.kinematics says "
                f"{type(body).__name__.lower()}; write `kinematics: {{type: {kind.__name__.lower()}, {example}}}`"
            )
        return body

    def heard(self, now_ns: int) -> None:
        """A good packet came."""
        self._heard_ns = now_ns
        if self._answered is not None:
            self._answered.set()

    def publish_newer(self, message: Message, every_s: float = 0.0) -> None:
        """Publish, unless the last of its type is not older than `every_s`: two reports that came in one piece."""
        if message.stamp_ns > self._newest_ns.get(type(message), -NS_PER_S) + every_s * NS_PER_S:
            self._newest_ns[type(message)] = message.stamp_ns
            self.publish(message)

    def ask(self, frame: bytes) -> bool:
        """Write a question, unless something is in its way."""
        return self._line is not None and self._line.ask(frame)

    def put(self, frame: bytes) -> None:
        """Write a command of the driver's own; it replaces one that waits."""
        if self._line is not None:
            self._line.put(frame)

    async def answer(self, question: bytes, answered: Callable[[], bool], *, every_s: float, hint: str) -> None:
        """Ask until `answered()`, for `answer_s` at most. Raises DeviceUnavailable with the hint."""
        loop = asyncio.get_running_loop()
        until_s = loop.time() + self.config.answer_s
        self._answered = event = asyncio.Event()
        try:
            while not answered():
                left_s = until_s - loop.time()
                if self._why_lost:
                    raise DeviceUnavailable(f"{self.context.name}: {self._why_lost}")
                if left_s < _NO_TIME_S:
                    raise DeviceUnavailable(
                        f"{self.context.name}: no answer on {self.path} at {self.config.baud} baud for "
                        f"{self.config.answer_s:g} s: {hint}"
                    )
                # a robot that stands repeats its stop, and may do so in step with the question: then ask soon after it
                wait_s = every_s if self.ask(question) else min(every_s, _ASK_AGAIN_S)
                event.clear()
                try:
                    async with asyncio.timeout(min(wait_s, left_s)):
                        while not (answered() or self._why_lost):
                            await event.wait()
                            event.clear()
                except TimeoutError:
                    continue
        finally:
            self._answered = None

    def faults_now(self, names: frozenset[str]) -> None:
        """What the controller complains of at present; each is counted when it begins."""
        for name in sorted(names - self._standing_faults):
            self.context.link.fault(name)
        self._standing_faults = names

    # -------------------------------------------------------------------------------- the actuator's part

    async def open(self) -> None:
        self.prepare()
        self._standing_faults = frozenset()
        self._why_lost = ""
        self.pose.start()
        port = self._make_port(self._settings, self.config.backend, self._data, self._gone)
        self._line = MotorLine(
            port,
            self.stop_bytes(),
            delimiter=self.delimiter,
            gap_s=self.gap_s,
            again_s=self.again_s,
            on_full=lambda: self.context.link.fault("line full", "the controller or its adapter takes no bytes"),
        )
        await self._line.open()
        await self.begin()
        self._heard_ns = self.context.clock.now_ns()
        self._next_s = asyncio.get_running_loop().time()
        self._tick()

    async def close(self) -> None:
        self._still()
        line, self._line = self._line, None
        if line is not None:
            await line.close()

    def apply(self, command: CommandT) -> None:
        if not isinstance(command, self.accepts):
            raise TypeError(f"{self.context.name} takes {self.accepts.__name__}, not {type(command).__name__}")
        if self._line is None or self._why_lost:
            return
        if not command.is_finite:
            self.context.link.fault("no finite command", repr(command))
            self.halt()
            return
        frame = self.frame(command)
        if frame is None:
            self.halt()
        else:
            self._line.put(frame)

    def halt(self) -> None:
        if self._line is not None:
            self._line.stop()

    def stop_line(self) -> StopLine | None:
        return SerialStop(self.path, self.stop_bytes())

    def _tick(self) -> None:
        loop = asyncio.get_running_loop()
        late_s = loop.time() - self._next_s
        self._next_s = max(self._next_s + 1.0 / self.polls_hz, loop.time())
        self._beat = loop.call_at(self._next_s, self._tick)
        now_ns = self.context.clock.now_ns()
        if late_s > 1.0 / self.polls_hz:
            self._heard_ns += round(late_s * NS_PER_S)  # held up: then it was this program that was silent
        silent_s = (now_ns - self._heard_ns) / NS_PER_S
        if self._line is not None and self._line.is_blocked():
            self._gone(f"{self.path} takes no bytes for 0.2 s: does its USB adapter hang? Unplug it, plug it in again")
        elif silent_s > self.config.silent_s:
            self._gone(
                f"the controller on {self.path} is silent for {silent_s:.1f} s: is it powered, and is "
                f"`baud: {self.config.baud}` right?"
            )
        else:
            self.poll(now_ns)

    def _data(self, data: bytes) -> None:
        self.received(data, self.context.clock.now_ns())

    def _gone(self, reason: str) -> None:
        """The line went away, or only its answers: then the stop still arrives."""
        self._still()
        self.halt()
        self._why_lost = reason
        if self._answered is not None:
            self._answered.set()
        self.lost(reason)

    def _still(self) -> None:
        if self._beat is not None:
            self._beat.cancel()
            self._beat = None
