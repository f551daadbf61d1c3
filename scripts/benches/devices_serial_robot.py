"""The robot of `devices_serial` twice in one event loop: through the whole runtime, and as a bare reader callback.

A sensor sends `S 17`, the behaviour asks for a speed that holds the 17, the motors are told `D 17`. Run as a program:

    python -m benches.devices_serial_robot BACKEND SENSOR MOTOR BARE_SENSOR BARE_MOTOR

It prints `ready` once it drives, and ends with standard input.
"""

from __future__ import annotations

import asyncio
import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from robotd.authoring.behaviour import Behaviour
from robotd.authoring.config import Config, NoConfig
from robotd.authoring.device import Actuator, DeviceContext, Sensor, SerialStop
from robotd.authoring.view import View, every
from robotd.engine.loops import real_loop
from robotd.engine.parts import BehaviourPart, DevicePart, Parts
from robotd.engine.runtime import Runtime
from robotd.safety.settings import GuardConfig, Zones
from robotd.world.messages import Drive, Message
from robotd.world.robot import Limits, Robot
from robotd_devices.motor.serial_motor_line import MotorLine
from robotd_devices.ports import serial_line
from robotd_devices.ports.serial_port import Backend, SerialPort, SerialSettings, serial_port

BAUD = 115_200
NUMBERS = 1000
"""Numbers go round after so many."""
STOP = b"\n\nX\n"


class Numbers:
    """The sensor's protocol without input or output: a line for each reading, `S` and its number."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> Iterator[int]:
        """The readings that these bytes complete."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            if line.startswith(b"S ") and line[2:].isdigit():
                yield int(line[2:])


def frame(number: int) -> bytes:
    """The motors' command."""
    return b"\nD %d\n" % number


@dataclass(frozen=True, slots=True)
class Reading(Message):
    """What the sensor measured."""

    number: int


class LineConfig(Config):
    """Where a device is, and what reads it."""

    path: str
    backend: Backend


class NumberSensor(Sensor[LineConfig, Reading]):
    """Publishes each reading in the turn in which its bytes arrived."""

    _port: SerialPort | None = None

    async def open(self) -> None:
        self._numbers = Numbers()
        settings = SerialSettings(self.config.path, BAUD)
        self._port = serial_port(settings, self.config.backend, self._data, self.lost)
        await self._port.open()

    async def close(self) -> None:
        if self._port is not None:
            self._port.abort()

    def _data(self, data: bytes) -> None:
        for number in self._numbers.feed(data):
            self.publish(Reading(self.context.clock.now_ns(), number))


class NumberMotors(Actuator[LineConfig, Drive]):
    """Writes as the shipped motor drivers do, and has a stop line, so a guardian."""

    def __init__(self, config: LineConfig, context: DeviceContext | None = None) -> None:
        super().__init__(config, context)
        self._line: MotorLine | None = None

    async def open(self) -> None:
        port = serial_port(SerialSettings(self.config.path, BAUD), self.config.backend, lambda data: None, self.lost)
        self._line = MotorLine(port, STOP)
        await self._line.open()

    async def close(self) -> None:
        if self._line is not None:
            await self._line.close()

    def apply(self, command: Drive) -> None:
        if self._line is not None:
            self._line.put(frame(round(command.vx_mps * NUMBERS)))

    def halt(self) -> None:
        if self._line is not None:
            self._line.stop()

    def stop_line(self) -> SerialStop:
        return SerialStop(self.config.path, STOP)


class Sees(View):
    reading: Reading = every(within_s=0.5)


class Echo(Behaviour[NoConfig, Sees]):
    """A speed that holds the reading's number."""

    def step(self, seen: Sees) -> Drive:
        return Drive(seen.reading.number / NUMBERS)


def parts(backend: Backend, sensor: str, motor: str) -> Parts:
    """The robot, its guardian and its guard on; nothing limits what the behaviour asks for."""
    return Parts(
        Robot(limits=Limits(vx_mps=2.0, accel_mps2=1e6, decel_mps2=1e6)),
        (
            DevicePart("motors", NumberMotors, LineConfig(path=motor, backend=backend)),
            DevicePart("sensor", NumberSensor, LineConfig(path=sensor, backend=backend)),
        ),
        behaviours=(BehaviourPart("echo", Echo, NoConfig(), 1, start=True),),
        guard=GuardConfig(zones=Zones(off="wheels in the air")),
        arm_at_start=True,
    )


def bare(sensor_fd: int, motor_fd: int) -> Callable[[], None]:
    """A reader callback that parses, formats and writes, and knows nothing else."""
    numbers = Numbers()

    def readable() -> None:
        for number in numbers.feed(os.read(sensor_fd, 4095)):
            os.write(motor_fd, frame(number))

    return readable


async def _run(backend: Backend, sensor: str, motor: str, bare_sensor: str, bare_motor: str) -> None:
    loop = asyncio.get_running_loop()
    sensor_fd, motor_fd = (serial_line.open_line(SerialSettings(path, BAUD)) for path in (bare_sensor, bare_motor))
    loop.add_reader(sensor_fd, bare(sensor_fd, motor_fd))
    runtime = Runtime(parts(backend, sensor, motor))

    def started(running: Runtime) -> None:
        loop.add_reader(sys.stdin.fileno(), running.stop)
        running.core.on_armed.append(lambda: print("ready", flush=True))

    try:
        await runtime.run(started)
    finally:
        loop.remove_reader(sys.stdin.fileno())
        loop.remove_reader(sensor_fd)
        os.close(sensor_fd)
        os.close(motor_fd)


if __name__ == "__main__":
    chosen, *paths = sys.argv[1:]
    if chosen not in ("pyserial", "serialx", "raw") or len(paths) != 4:
        raise SystemExit(__doc__)
    with asyncio.Runner(loop_factory=real_loop) as runner:
        runner.run(_run(chosen, *paths))  # type: ignore[arg-type]
