"""Two wheels on an Arduino with ros_arduino_bridge's firmware: speeds in encoder counts a frame, counts back."""

from __future__ import annotations

import math
from typing import ClassVar

from pydantic import Field

from robotd.authoring.device import Watchdog
from robotd.world.kinematics import Differential
from robotd.world.messages import Drive, Message, Odometry
from robotd_devices.motor import arduino_bridge_lines as lines
from robotd_devices.motor.serial_motor import SerialMotor, SerialMotorConfig
from robotd_devices.motor.serial_motor_odometry import CountOdometry


class ArduinoBridgeConfig(SerialMotorConfig):
    """Parameters of an Arduino that drives a differential base."""

    port: str = Field(default="/dev/serial/by-id/usb-Arduino*", min_length=1)
    """Serial port by its stable name, or a pattern that fits one."""
    baud: int = Field(default=57_600, ge=1_200, le=1_000_000)
    """Speed of the line."""
    answer_s: float = Field(default=4.0, ge=0.1, le=10.0)
    """How long the board may take to answer after opening, which resets it."""
    counts_per_turn: float = Field(default=1000.0, gt=0.0, le=1e6)
    """Encoder counts of one turn of a wheel, gearbox included (`encoder_resolution` times `gear_reduction`)."""
    frames_hz: float = Field(default=lines.FRAMES_HZ, ge=1.0, le=200.0)
    """The firmware's PID_RATE."""
    top_speed_mps: float = Field(default=0.5, gt=0.0, le=10.0)
    """The wheels' fastest rim speed: a faster command is slowed down as a whole, so that its curve stays the same."""
    left_reversed: bool = False
    """The left motor and its encoder count backwards."""
    right_reversed: bool = False
    """The same on the right."""
    gains: tuple[int, int, int, int] | None = None
    """Kp, Kd, Ki, Ko of the PID, written at each opening; none leaves the firmware's."""
    poll_hz: float = Field(default=20.0, ge=2.0, le=50.0)
    """How often the encoders are read, and the odometry published."""


class ArduinoBridge(SerialMotor[ArduinoBridgeConfig, Drive]):
    """Drives two wheels and publishes the odometry of their counts.

    A speed is a whole number of counts a frame: 1 of them is the slowest, and the step. The firmware stops the motors
    2 s after the last command. Faults that it counts: `garbled line`, `encoder jumped`.
    """

    sim_twin = "sim_base"
    emits: ClassVar[tuple[type[Message], ...]] = (Odometry,)
    watchdog = Watchdog("firmware", lines.AUTO_STOP_MS)
    delimiter = lines.END

    @property
    def polls_hz(self) -> float:
        return self.config.poll_hz

    @classmethod
    def publish_period_s(cls, config: ArduinoBridgeConfig) -> float:
        return 1.0 / config.poll_hz

    def prepare(self) -> None:
        config = self.config
        self._base = self.body(Differential, "track_m: 0.3, wheel_radius_m: 0.05")
        per_m = config.counts_per_turn / (math.tau * self._base.wheel_radius_m)
        self._per_frame = per_m / config.frames_hz
        self._odometry = CountOdometry(self.pose, self._base, 1.0 / per_m, 1.5 * config.top_speed_mps + 0.5)
        self._signs = (-1 if config.left_reversed else 1, -1 if config.right_reversed else 1)
        self._reader = lines.LineReader()
        self._has_answered = False

    async def begin(self) -> None:
        await self.answer(
            lines.encoders(),
            lambda: self._has_answered,
            every_s=0.2,
            hint="is this an Arduino with ros_arduino_bridge's firmware, built with USE_BASE?",
        )
        # the reset swallowed the first stop; where the board does not reset, this is one more
        self.halt()
        if self.config.gains is not None:
            self.put(lines.gains(*self.config.gains))

    def poll(self, now_ns: int) -> None:
        self.ask(lines.encoders())

    # ------------------------------------------------------------------------------------- to the motors

    def stop_bytes(self) -> bytes:
        return lines.STOP

    def frame(self, command: Drive) -> bytes:
        rims_mps = self._base.rim_speeds(command)
        over = max(1.0, max(map(abs, rims_mps)) / self.config.top_speed_mps)
        left, right = (
            sign * round(rim_mps / over * self._per_frame) for sign, rim_mps in zip(self._signs, rims_mps, strict=True)
        )
        return lines.motors(left, right)

    # ----------------------------------------------------------------------------------- from the sensors

    def received(self, data: bytes, now_ns: int) -> None:
        for line in self._reader.feed(data):
            counts = lines.counts_of(line)
            if counts is not None:
                self._has_answered = True
                self.heard(now_ns)
                self._counted(counts, now_ns)
            elif line == b"OK":
                self.heard(now_ns)
            elif line == b"Invalid Command":
                # the CR before a stop is an empty command, where nothing was cut
                self.heard(now_ns)
            elif line and self._has_answered:
                self.context.link.fault("garbled line", repr(line[:20]))

    def _counted(self, counts: tuple[int, int], now_ns: int) -> None:
        jumps = self._odometry.jumps
        odometry = self._odometry.counts(self._signs[0] * counts[0], self._signs[1] * counts[1], now_ns)
        if odometry is not None:
            self.publish_newer(odometry)
        elif self._odometry.jumps > jumps:
            self.context.link.fault("encoder jumped", "the board was reset, or a wheel cannot have turned so far")
