"""A motor controller on a serial line that has no watchdog, its driver, and what both kinds of line heard, with times.

The protocol is as plain as can be: a line feed before and after each frame, `D` with a number and a speed, `S` to stop.
"""

from __future__ import annotations

import time
from typing import NamedTuple

from robotd.authoring.config import Config
from robotd.authoring.device import Actuator, DeviceContext, SerialStop, Watchdog
from robotd.world.messages import Drive
from robotd_devices.ports.i2c_fake import FakeI2cBus
from robotd_devices.ports.serial_port import SerialPort, SerialSettings, serial_port

BAUD = 115_200
STOP_FRAME = b"\n\nS\n"


class LineMotorsConfig(Config):
    """Where the controller is."""

    path: str


class LineMotors(Actuator[LineMotorsConfig, Drive]):
    """Numbers its commands; keeps at most one that the kernel has not taken."""

    watchdog = Watchdog("none")

    def __init__(self, config: LineMotorsConfig, context: DeviceContext | None = None) -> None:
        super().__init__(config, context)
        self._port: SerialPort | None = None
        self._number = 0

    async def open(self) -> None:
        self._port = serial_port(SerialSettings(self.config.path, BAUD), "raw", lambda data: None, self.lost)
        await self._port.open()
        self._port.write(STOP_FRAME, first=True)

    async def close(self) -> None:
        if self._port is not None:
            self._port.write(STOP_FRAME, first=True)
            await self._port.drain(0.05)
            self._port.abort()

    def apply(self, command: Drive) -> None:
        if self._port is not None and not self._port.unsent:
            self._number += 1
            self._port.write(b"\nD %d %.3f\n" % (self._number, command.vx_mps))

    def halt(self) -> None:
        if self._port is not None:
            self._port.write(STOP_FRAME, first=True)

    def stop_line(self) -> SerialStop:
        return SerialStop(self.config.path, STOP_FRAME)


class Heard(NamedTuple):
    """One frame as the motors' side got it. `number`: of a command, where the protocol has one."""

    now_ns: int
    is_stop: bool
    number: int = 0


class LineFake:
    """The controller: does what the last frame says until the next one."""

    def __init__(self) -> None:
        self.heard: list[Heard] = []
        self.garbled = 0
        """Frames that were cut in two or run together."""
        self._rest = b""

    def power_on(self, now_ns: int) -> None:
        self._rest = b""

    def feed(self, data: bytes, now_ns: int) -> None:
        *frames, self._rest = (self._rest + data).split(b"\n")
        for frame in frames:
            match frame.split():
                case []:
                    pass
                case [b"S"]:
                    self.heard.append(Heard(now_ns, True))
                case [b"D", number, speed] if number.isdigit() and speed.count(b".") == 1:
                    self.heard.append(Heard(now_ns, False, int(number)))
                case _:
                    self.garbled += 1

    def tick(self, now_ns: int) -> bytes:
        return b""


def heard_on(bus: FakeI2cBus, first: int) -> list[Heard]:
    """What a JetBot's chip was told from entry `first` of the log on: stops, and levels of outputs."""
    found = []
    for entry in bus.log[first:]:
        if entry.error or len(entry.data) < 2:
            continue
        register = entry.data[0]
        if entry.data == b"\xfd\x10":
            found.append(Heard(entry.now_ns, True))
        elif 0x06 <= register <= 0x45:
            found.append(Heard(entry.now_ns, False))
    return found


def wait_for(holds: object, within_s: float, what: str) -> None:
    """Look every half millisecond until something holds. Raises TimeoutError naming what did not."""
    assert callable(holds)
    until_s = time.monotonic() + within_s
    while not holds():
        if time.monotonic() > until_s:
            raise TimeoutError(f"waited {within_s:g} s for {what}")
        time.sleep(0.0005)
