"""Bumper: a switch on a serial line that writes `1` when it is pressed and `0` when not, and its simulated twin."""

import asyncio
import os
import termios
import tty
from typing import ClassVar

from pydantic import Field
from robotd import Config, Sensor
from robotd.authoring.device import DeviceUnavailable
from robotd.world.messages import Contact

STATES = {b"0": False, b"1": True}


class BumperConfig(Config):
    """Where it is."""

    port: str = "/dev/ttyACM0"
    """The serial port, always at 115200 baud."""


class BumperParser:
    """Bytes in, states of the switch out; knows nothing of ports. Pieces may be cut anywhere."""

    def __init__(self) -> None:
        self._rest = b""
        self.wrong = 0
        """Lines so far that say neither 0 nor 1."""

    def feed(self, data: bytes) -> list[bool]:
        """The states that `data` completes, oldest first."""
        *lines, rest = (self._rest + data).split(b"\n")
        self._rest = rest[-16:]
        states = [STATES.get(line.strip()) for line in lines]
        self.wrong += states.count(None)
        return [state for state in states if state is not None]


class Bumper(Sensor[BumperConfig, Contact]):
    """Publishes each state in the turn of the event loop in which its last byte arrived."""

    sim_twin: ClassVar[str] = "timed_bumper"
    _descriptor: int | None = None

    async def open(self) -> None:
        try:
            self._descriptor = os.open(self.config.port, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY)
        except OSError as error:
            raise DeviceUnavailable(f"{self.context.name}: {self.config.port}: {error.strerror}") from error
        if os.isatty(self._descriptor):
            tty.setraw(self._descriptor)
            settings = termios.tcgetattr(self._descriptor)
            settings[4] = settings[5] = termios.B115200
            termios.tcsetattr(self._descriptor, termios.TCSANOW, settings)
        asyncio.get_running_loop().add_reader(self._descriptor, self._read, self._descriptor, BumperParser())

    async def close(self) -> None:
        if self._descriptor is not None:
            asyncio.get_running_loop().remove_reader(self._descriptor)
            os.close(self._descriptor)
            self._descriptor = None

    def _read(self, descriptor: int, parser: BumperParser) -> None:
        try:
            data = os.read(descriptor, 4096)
        except BlockingIOError:
            return
        except OSError as error:
            data, why = b"", error.strerror or str(error)
        else:
            why = "end of file"
        if not data:
            # the runtime closes and reopens; until then nothing may call this again
            asyncio.get_running_loop().remove_reader(descriptor)
            self.lost(why)
            return
        wrong = parser.wrong
        for closed in parser.feed(data):
            self.publish(Contact(self.context.clock.now_ns(), closed, self.context.name))
        if parser.wrong > wrong:
            self.context.link.fault("unreadable line")


class TimedBumperConfig(Config):
    """A bumper that is pressed now and then."""

    rate_hz: float = Field(default=10.0, ge=1.0, le=100.0)
    """States a second."""
    every_s: float = Field(default=3.0, gt=0.0)
    """Seconds from one press to the next; the first is after that long."""
    for_s: float = Field(default=0.5, ge=0.0)
    """How long each lasts, in seconds."""


class TimedBumper(Sensor[TimedBumperConfig, Contact]):
    """The twin that `--sim` puts in its place: pressed by the clock."""

    _timer: asyncio.TimerHandle | None = None
    _count = 0

    @classmethod
    def publish_period_s(cls, config: TimedBumperConfig) -> float:
        return 1.0 / config.rate_hz

    async def open(self) -> None:
        self._count = 0
        self._beat()

    async def close(self) -> None:
        if self._timer is not None:
            self._timer.cancel()

    def _beat(self) -> None:
        self._timer = asyncio.get_running_loop().call_later(1.0 / self.config.rate_hz, self._beat)
        # in whole beats, since sums of seconds are not exact
        period, length = (
            round(self.config.every_s * self.config.rate_hz),
            round(self.config.for_s * self.config.rate_hz),
        )
        closed = self._count >= period and self._count % max(1, period) < length
        self._count += 1
        self.publish(Contact(self.context.clock.now_ns(), closed, self.context.name))
