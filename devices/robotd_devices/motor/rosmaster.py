"""A mecanum base on Yahboom's Rosmaster board (X3, X3 Plus): velocities down; speeds, battery and IMU up."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from robotd.authoring.device import Watchdog
from robotd.world.clock import ns
from robotd.world.kinematics import Mecanum, saturate
from robotd.world.messages import Battery, Drive, Imu, Message, Odometry
from robotd_devices.battery.low import LowBattery
from robotd_devices.motor import rosmaster_packets as packets
from robotd_devices.motor.rosmaster_packets import Report, RosmasterParser
from robotd_devices.motor.rosmaster_wheels import WheelWatch
from robotd_devices.motor.serial_motor import SerialMotor, SerialMotorConfig

_CARS = {"x3": 1, "x3_plus": 2}
_BATTERY_EVERY_S = 0.5
_LOW_AFTER_S = 5.0


class RosmasterConfig(SerialMotorConfig):
    """Parameters of a Rosmaster board. The defaults fit an X3."""

    port: str = Field(default="/dev/serial/by-id/usb-1a86_USB*", min_length=1)
    """Serial port by its stable name, or a pattern that fits one; the default is the board's CH340."""
    car: Literal["x3", "x3_plus"] = "x3"
    """Which car the board moves."""
    vx_limit_mps: float = Field(default=1.0, gt=0.0, le=3.0)
    """The firmware's own limits: a faster command is slowed down as a whole, so that its direction stays the same."""
    vy_limit_mps: float = Field(default=1.0, gt=0.0, le=3.0)
    """The same to the side."""
    wz_limit_radps: float = Field(default=5.0, gt=0.0, le=20.0)
    """The same turning."""
    vx_reversed: bool = False
    """The board's x points backwards."""
    vy_reversed: bool = False
    """The board's y points to the right."""
    wz_reversed: bool = False
    """The board counts turns clockwise."""
    imu: bool = True
    """Publish what its inertial sensor measures."""
    low_v: float = Field(default=10.5, ge=0.0, le=30.0)
    """Below this for 5 s the battery is low; 10.5 V are 3.5 V a cell of the kit's three; 0: never."""
    slip_s: float = Field(default=0.2, ge=0.0, le=5.0)
    """For so long one wheel may turn otherwise than the other three say, then the base stops; 0: for ever."""


class Rosmaster(SerialMotor[RosmasterConfig, Drive]):
    """Drives a mecanum base and publishes the speeds that the board makes of its encoders, added up.

    Nothing stops the motors when the program falls silent: the board drives on (`watchdog` is none).
    Faults that it counts: `bad packet`, `wheels disagree`. Lost, and so stopped until somebody arms the robot again,
    also where one wheel is stuck or slips for `slip_s`.
    """

    sim_twin = "sim_base"
    emits: ClassVar[tuple[type[Message], ...]] = (Odometry, Battery, Imu)
    watchdog = Watchdog("none")
    gap_s = packets.GAP_S
    again_s = 0.005
    # no delimiter exists: zeros that end the longest command of ours, and begin none
    delimiter = bytes(packets.LONGEST)

    @classmethod
    def publish_period_s(cls, config: RosmasterConfig) -> float:
        return 0.04

    def prepare(self) -> None:
        self.body(Mecanum, "wheelbase_m: 0.16, track_m: 0.17, wheel_radius_m: 0.0325")
        self._parser = RosmasterParser()
        self._has_answered = False
        config = self.config
        self._low = LowBattery(config.low_v, ns(_LOW_AFTER_S))
        self._wheels = WheelWatch(ns(config.slip_s)) if config.slip_s else None
        self._car = _CARS[config.car]
        self._x, self._y, self._z = (
            -1.0 if reversed_ else 1.0 for reversed_ in (config.vx_reversed, config.vy_reversed, config.wz_reversed)
        )

    async def begin(self) -> None:
        await self.answer(
            packets.auto_report(True),
            lambda: self._has_answered,
            every_s=0.1,
            hint="is the board's switch on, and is this its port and not the lidar's?",
        )

    # ------------------------------------------------------------------------------------- to the motors

    def stop_bytes(self) -> bytes:
        return self.delimiter + packets.motion(_CARS[self.config.car], 0.0, 0.0, 0.0)

    def frame(self, command: Drive) -> bytes:
        config = self.config
        drive = saturate(command, config.vx_limit_mps, config.vy_limit_mps, config.wz_limit_radps)
        return packets.motion(
            self._car, self._x * drive.vx_mps, self._y * drive.vy_mps, self._z * drive.wz_radps
        )  # fmt: skip

    # ----------------------------------------------------------------------------------- from the sensors

    def received(self, data: bytes, now_ns: int) -> None:
        for report in self._parser.feed(data):
            self.heard(now_ns)
            self._take(report, now_ns)
        if self._parser.faults:
            self._parser.faults = 0
            self.context.link.fault("bad packet", "noise on the line, or the wrong baud")

    def _take(self, report: Report, now_ns: int) -> None:
        if report.kind == packets.SPEED:
            self._has_answered = True
            speed = packets.speed_of(report.data)
            drive = Drive(self._x * speed.vx_mps, self._z * speed.wz_radps, self._y * speed.vy_mps)
            self.publish_newer(self.pose.speed(drive, now_ns))
            low = self._low.take(speed.voltage_v, now_ns)
            self.publish_newer(Battery(now_ns, speed.voltage_v, low=low), _BATTERY_EVERY_S)
        elif report.kind in (packets.MPU, packets.ICM) and self.config.imu:
            self.publish_newer(Imu(now_ns, *packets.imu_of(report)))
        elif report.kind == packets.ENCODERS and self._wheels is not None:
            share = self._wheels.disagree(packets.encoders_of(report.data), now_ns)
            if share is not None:
                self._wheels = None
                self._stuck(share)

    def _stuck(self, share: float) -> None:
        self.context.link.fault("wheels disagree", f"by {share:.0%} of the fastest one")
        self._gone(
            f"one wheel turns otherwise than the other three say, by {share:.0%} for {self.config.slip_s:g} s: is it "
            "stuck, off the ground, or its encoder's plug out? `slip_s: 0` takes no notice"
        )
