"""Two wheels on a RoboClaw: its own speed control and encoders, its battery, and its time limit on silence."""

from __future__ import annotations

import math
from typing import ClassVar, Literal

from pydantic import Field

from robotd.authoring.device import DeviceUnavailable, Watchdog
from robotd.world.clock import NS_PER_S
from robotd.world.kinematics import Differential
from robotd.world.messages import Battery, Drive, Message, Odometry
from robotd_devices.motor import roboclaw_packets as packets
from robotd_devices.motor.roboclaw_packets import Answer, RoboClawReader
from robotd_devices.motor.serial_motor import SerialMotor, SerialMotorConfig
from robotd_devices.motor.serial_motor_odometry import CountOdometry

_PATIENCE_NS = (50_000_000, 200_000_000)
"""For how long an answer is waited for: at least, and at most where answers come late."""
_FED_NS = 150_000_000
_SELDOM_S = 1.0
_LONGEST_TIMEOUT_MS = 500


class RoboClawConfig(SerialMotorConfig):
    """Parameters of a RoboClaw that drives a differential base."""

    port: str = Field(default="/dev/serial/by-id/usb-*oboclaw*", min_length=1)
    """Serial port by its stable name, or a pattern that fits one; the default is the controller's own USB."""
    baud: int = Field(default=38_400, ge=2_400, le=1_000_000)
    """Speed of the line; over USB it does not matter."""
    address: int = Field(default=0x80, ge=0x80, le=0x87)
    """Address of the controller."""
    counts_per_turn: float = Field(default=1000.0, gt=0.0, le=1e6)
    """Encoder counts (all four edges) of one turn of a wheel, gearbox included."""
    top_speed_mps: float = Field(default=1.0, gt=0.0, le=10.0)
    """The wheels' fastest rim speed: a faster command is slowed down as a whole, so that its curve stays the same."""
    left: Literal["m1", "m2"] = "m1"
    """Which motor is the left one."""
    left_reversed: bool = False
    """The left motor turns backwards for positive speeds; its encoder must agree with its motor."""
    right_reversed: bool = False
    """The same for the right one."""
    timeout_ms: int = Field(default=300, ge=100, le=_LONGEST_TIMEOUT_MS, multiple_of=100)
    """The controller stops the motors after this long without a byte; written at each opening."""
    poll_hz: float = Field(default=20.0, ge=2.0, le=50.0)
    """How often the encoders are read, and the odometry published."""
    read_status: bool = True
    """Ask for its faults; off for firmware older than 4.1.34, which answers with two bytes instead of four."""


class RoboClaw(SerialMotor[RoboClawConfig, Drive]):
    """Drives two wheels by the controller's speed control, which must be tuned (Motion Studio) with its encoders.

    One question is open at a time, and none while the robot moves on a command that nobody renews: any byte feeds the
    controller's time limit. Behind a question without an answer the time limit is asked for: its answer says that the
    late one has gone by, so that no count is taken for a later one. Faults that it counts: `no answer`, `stray bytes`,
    `encoder jumped`, and the controller's own by name. Lost where the time limit is not the one that was written: the
    controller was switched off and on behind its adapter.
    """

    sim_twin = "sim_base"
    emits: ClassVar[tuple[type[Message], ...]] = (Odometry, Battery)
    watchdog = Watchdog("firmware", _LONGEST_TIMEOUT_MS)
    # no delimiter exists: zeros that end the longest command of ours; the stop after a pause meets a fresh reader
    delimiter = bytes(packets.LONGEST - 1)
    again_s = 0.015

    @property
    def polls_hz(self) -> float:
        return self.config.poll_hz

    @classmethod
    def publish_period_s(cls, config: RoboClawConfig) -> float:
        return 1.0 / config.poll_hz

    def prepare(self) -> None:
        config = self.config
        self._base = self.body(Differential, "track_m: 0.3, wheel_radius_m: 0.05")
        self._per_m = config.counts_per_turn / (math.tau * self._base.wheel_radius_m)
        self._reader = RoboClawReader(config.address)
        self._odometry = CountOdometry(self.pose, self._base, 1.0 / self._per_m, 1.5 * config.top_speed_mps + 0.5)
        self._signs = (-1 if config.left_reversed else 1, -1 if config.right_reversed else 1)
        self._version = ""
        self._timeout_tenths: int | None = None
        self._count_1: int | None = None
        self._asked_ns = 0
        self._patience_ns = _PATIENCE_NS[0]
        self._fed_ns = self._seldom_ns = 0
        self._due: list[int] = []
        self._current_a = math.nan
        self._is_moving = False

    async def begin(self) -> None:
        config = self.config
        hint = (
            f"is it powered, in packet serial mode, and is `address: 0x{config.address:02X}` its own? "
            "Both are set in Motion Studio"
        )
        await self.answer(
            packets.question(config.address, packets.VERSION), lambda: bool(self._version), every_s=0.1, hint=hint
        )
        tenths = config.timeout_ms // 100
        setting = packets.set_timeout(config.address, tenths)
        # the question stands behind the setting, so its answer is that of the controller with the setting on
        await self.answer(
            setting + packets.question(config.address, packets.GET_TIMEOUT),
            lambda: self._timeout_tenths is not None,
            every_s=0.1,
            hint=hint,
        )
        if self._timeout_tenths != tenths:
            raise DeviceUnavailable(
                f"{self.context.name}: the controller did not take its time limit: {config.timeout_ms} ms were "
                f"written, {100 * (self._timeout_tenths or 0)} ms are read back"
            )

    # ------------------------------------------------------------------------------------- to the motors

    def stop_bytes(self) -> bytes:
        return self.delimiter + packets.duty(self.config.address, 0, 0)

    def halt(self) -> None:
        self._is_moving = False
        super().halt()

    def frame(self, command: Drive) -> bytes:
        self._fed_ns = self.context.clock.now_ns()
        left_mps, right_mps = self._base.rim_speeds(command)
        over = max(1.0, max(abs(left_mps), abs(right_mps)) / self.config.top_speed_mps)
        left, right = (
            sign * round(rim_mps / over * self._per_m)
            for sign, rim_mps in zip(self._signs, (left_mps, right_mps), strict=True)
        )
        self._is_moving = bool(left or right)
        if not self._is_moving:
            return packets.duty(self.config.address, 0, 0)
        m1, m2 = (left, right) if self.config.left == "m1" else (right, left)
        return packets.speed(self.config.address, m1, m2)

    # ----------------------------------------------------------------------------------------- questions

    def ask(self, frame: bytes) -> bool:
        if not super().ask(frame):
            return False
        self._reader.asked(frame[-1])
        self._asked_ns = self.context.clock.now_ns()
        return True

    def poll(self, now_ns: int) -> None:
        if self._reader.open is not None:
            if now_ns - self._asked_ns < self._patience_ns:
                return
            self._no_answer(self._reader.open)
        if self._is_moving and now_ns - self._fed_ns > _FED_NS:
            return  # nobody renews the command: let the controller's time limit run out
        if not self._due:
            self._due = [packets.ENCODER_1, packets.ENCODER_2]
            if now_ns - self._seldom_ns >= _SELDOM_S * NS_PER_S:
                self._seldom_ns = now_ns
                self._due += [packets.GET_TIMEOUT, packets.CURRENTS, packets.BATTERY]
                self._due += [packets.STATUS] * self.config.read_status
        self._ask_next()

    def _no_answer(self, command: int) -> None:
        self.context.link.fault("no answer", f"a question was not answered within {self._patience_ns / 1e6:.0f} ms")
        self._patience_ns = min(2 * self._patience_ns, _PATIENCE_NS[1])
        self._reader.give_up()
        self._count_1 = None
        rest = [due for due in self._due if due not in (packets.GET_TIMEOUT, packets.ENCODER_2)]
        self._due = [packets.GET_TIMEOUT, *rest]

    def _ask_next(self) -> None:
        if self._due and self.ask(packets.question(self.config.address, self._due[0])):
            del self._due[0]

    def received(self, data: bytes, now_ns: int) -> None:
        before = self._reader.acknowledged
        answer = self._reader.feed(data)
        if answer is not None or self._reader.acknowledged > before:
            self.heard(now_ns)
        if self._reader.faults:
            self._reader.faults = 0
            self.context.link.fault("stray bytes", "noise on the line, or the wrong baud")
        if answer is not None:
            took_ns = now_ns - self._asked_ns
            self._patience_ns = min(max(2 * took_ns, self._patience_ns * 7 // 8, _PATIENCE_NS[0]), _PATIENCE_NS[1])
            self._take(answer, now_ns)
            self._ask_next()  # both encoders are read as close together as the line allows

    def _take(self, answer: Answer, now_ns: int) -> None:
        command, data = answer
        if command == packets.VERSION:
            self._version = data.rstrip(b"\n\0").decode("ascii", "replace")
        elif command == packets.GET_TIMEOUT:
            if self._timeout_tenths is not None and data[0] != self._timeout_tenths:
                self._gone("the controller has forgotten its time limit: was it switched off and on?")
            self._timeout_tenths = data[0]
        elif command == packets.ENCODER_1:
            self._count_1 = packets.count_of(data)
        elif command == packets.ENCODER_2 and self._count_1 is not None:
            self._counted(self._count_1, packets.count_of(data), now_ns)
            self._count_1 = None
        elif command == packets.CURRENTS:
            self._current_a = sum(int.from_bytes(data[i : i + 2], "big", signed=True) for i in (0, 2)) / 100
        elif command == packets.BATTERY:
            self.publish_newer(Battery(now_ns, int.from_bytes(data, "big") / 10, self._current_a))
        elif command == packets.STATUS:
            self.faults_now(packets.fault_names(int.from_bytes(data, "big")))

    def _counted(self, count_1: int, count_2: int, now_ns: int) -> None:
        left, right = (count_1, count_2) if self.config.left == "m1" else (count_2, count_1)
        jumps = self._odometry.jumps
        odometry = self._odometry.counts(self._signs[0] * left, self._signs[1] * right, now_ns)
        if odometry is not None:
            self.publish_newer(odometry)
        elif self._odometry.jumps > jumps:
            self.context.link.fault("encoder jumped", "a counter was reset, or a wheel cannot have turned so far")
