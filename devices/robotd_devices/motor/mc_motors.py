"""Motor and steering of a TT-02D car behind its ESP32: the MC protocol with its time limits, heartbeat and trap."""

from __future__ import annotations

import math
from typing import ClassVar, Literal

from pydantic import Field

from robotd.authoring.device import Watchdog
from robotd.world.clock import NS_PER_S
from robotd.world.kinematics import Ackermann
from robotd.world.messages import Drive, Imu, Message, Odometry, Steer
from robotd_devices.motor import mc
from robotd_devices.motor.mc import ImuStatus, Kind, McFrame, McParser, Status
from robotd_devices.motor.serial_motor import SerialMotor, SerialMotorConfig


class McConfig(SerialMotorConfig):
    """Parameters of the ESP32 link. The defaults are those of seed 004's car."""

    port: str = Field(default="/dev/ttyAMA0", min_length=1)
    """Serial port by its stable name; the default is a Raspberry Pi's own UART, which keeps its name."""
    baud: int = Field(default=921_600, ge=9_600, le=4_000_000)
    """Speed of the line."""
    silent_s: float = Field(default=0.3, ge=0.1, le=10.0)
    """Without a good frame for this long the port is closed and opened anew."""
    ttl_ms: int = Field(default=100, ge=30, le=mc.HEARTBEAT_MS)
    """For how long the controller obeys a command that nothing renews."""
    heartbeat_hz: float = Field(default=20.0, ge=10.0, le=50.0)
    """How often it is told that this program lives; it stops the car after 0.2 s without."""
    top_speed_mps: float = Field(default=2.0, gt=0.0, le=mc.SPEED_MM_S / 1000.0)
    """Faster commands are written as this; the car's own computer has 2, its controller 5."""
    still_mps: float = Field(default=0.02, gt=0.0, le=0.5)
    """A command that is slower is a stop: speed 0 itself does not stop this car."""
    steering_reversed: bool = False
    """The controller's positive angles are to the right."""
    yaw_reversed: bool = False
    """Its gyroscope counts clockwise."""
    odometry: Literal["imu", "status", "off"] = "imu"
    """What the odometry is made of: its estimate of the speed and its gyroscope, its state, or nothing."""
    kill_on_estop: bool = False
    """An e-stop also sends KILL, which only a restart of the controller ends."""


class McMotors(SerialMotor[McConfig, Steer]):
    """Drives the car. Reverse does not exist: a command with a negative speed stops.

    The stop is MODE_SET(0), and no DRIVE after it: with a fresh heartbeat some builds of the firmware make 0.22 m/s of
    a DRIVE with speed 0 (`mc.CREEP_MM_S`). Auto mode is switched on with the first command behind a stop, and with each
    until the controller says that it is on. Faults that it counts: `bad frame`, `cannot reverse`, and the controller's
    own `kill latched`, `heartbeat timed out`, `command timed out`.
    """

    sim_twin = "sim_car"
    emits: ClassVar[tuple[type[Message], ...]] = (Odometry, Imu)
    watchdog = Watchdog("firmware", mc.HEARTBEAT_MS)
    delimiter = mc.DELIMITER

    @property
    def polls_hz(self) -> float:
        return self.config.heartbeat_hz

    @classmethod
    def publish_period_s(cls, config: McConfig) -> float | None:
        return None if config.odometry == "off" else 0.05

    def prepare(self) -> None:
        self._car = self.body(Ackermann, "wheelbase_m: 0.257, track_m: 0.16, max_steering_rad: 0.436")
        self._parser = McParser()
        self._seq = 0
        self._is_auto = self._has_answered = self._kills = False
        self._sign = -1 if self.config.steering_reversed else 1

    async def begin(self) -> None:
        await self.answer(
            mc.ping(self._next_seq()),
            lambda: self._has_answered,
            every_s=0.05,
            hint="is the ESP32 powered, are its TX and RX crossed, and is the console off on this UART?",
        )

    def poll(self, now_ns: int) -> None:
        self.ask(mc.ping(self._next_seq()))

    # ------------------------------------------------------------------------------------- to the motors

    def stop_bytes(self) -> bytes:
        return mc.STOP

    def halt(self) -> None:
        self._is_auto = False
        if self._line is not None:
            self._line.stop(mc.kill() if self._kills else b"")

    def estop(self) -> None:
        """The stop of an e-stop: with `kill_on_estop` it is followed by KILL, which the controller latches.

        So are the stops that repeat it, until the next command: somebody has armed the robot again by then.
        """
        self._kills = self.config.kill_on_estop
        self.halt()

    def frame(self, command: Steer) -> bytes | None:
        self._kills = False
        if command.speed_mps < self.config.still_mps:
            if command.speed_mps <= -self.config.still_mps:
                self.context.link.fault("cannot reverse", f"{command.speed_mps:.2f} m/s was asked for: stopped")
            return None
        speed_mm_s = round(1000.0 * min(command.speed_mps, self.config.top_speed_mps))
        steer_cdeg = self._sign * round(100.0 * math.degrees(command.steering_rad))
        steer_cdeg = max(-mc.STEER_CDEG, min(mc.STEER_CDEG, steer_cdeg))
        drive = mc.drive(steer_cdeg, speed_mm_s, self.config.ttl_ms, self._next_seq())
        # with a heartbeat of its own, so that it holds from now on
        return drive if self._is_auto else mc.mode_set(True) + mc.ping(self._next_seq()) + drive

    def _next_seq(self) -> int:
        self._seq = (self._seq + 1) & 0xFFFF
        return self._seq

    # ----------------------------------------------------------------------------------- from the sensors

    def received(self, data: bytes, now_ns: int) -> None:
        for frame in self._parser.feed(data):
            self._has_answered = True
            self.heard(now_ns)
            self._take(frame, now_ns)
        if self._parser.faults:
            self._parser.faults = 0
            self.context.link.fault("bad frame", "noise on the line, or the wrong baud")

    def _take(self, frame: McFrame, now_ns: int) -> None:
        if frame.kind == Kind.STATUS and (status := mc.status_of(frame)) is not None:
            self._is_auto = bool(status.auto)
            # after each stop the last command is still in time, which the controller then reports: no fault
            self.faults_now(status.fault_names - {mc.WITHOUT_AUTO})
            if self.config.odometry == "status":
                self._tell(status.speed_mm_s, self._yaw_of(status), now_ns)
        elif frame.kind == Kind.IMU and (imu := mc.imu_of(frame)) is not None and imu.is_valid:
            self._measured(imu, now_ns)

    def _measured(self, imu: ImuStatus, now_ns: int) -> None:
        wz_radps = math.radians(imu.yaw_ddps / 10.0) * (-1.0 if self.config.yaw_reversed else 1.0)
        stamp_ns = now_ns - round(imu.age_ms * 1e-3 * NS_PER_S)
        self.publish_newer(Imu(stamp_ns, wz_radps=wz_radps, ax_mps2=imu.accel_mm_s2 / 1000.0))
        if self.config.odometry == "imu":
            self._tell(imu.speed_mm_s, wz_radps, now_ns)

    def _yaw_of(self, status: Status) -> float:
        steering_rad = self._sign * math.radians(status.steer_cdeg / 100.0)
        return self._car.body(Steer(status.speed_mm_s / 1000.0, steering_rad)).wz_radps

    def _tell(self, speed_mm_s: int, wz_radps: float, now_ns: int) -> None:
        self.publish_newer(self.pose.speed(Drive(speed_mm_s / 1000.0, wz_radps), now_ns))
