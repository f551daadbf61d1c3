"""A car on a VESC: its motor by electrical speed, its steering by the controller's servo output (F1TENTH and kin)."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field, model_validator

from robotd.authoring.device import Watchdog
from robotd.world.clock import ns
from robotd.world.kinematics import Ackermann
from robotd.world.messages import Battery, Drive, Message, Odometry, Steer
from robotd_devices.battery.low import LowBattery
from robotd_devices.motor import vesc_packets as packets
from robotd_devices.motor.serial_motor import SerialMotor, SerialMotorConfig
from robotd_devices.motor.serial_motor_odometry import wrapped
from robotd_devices.motor.vesc_packets import Values, VescParser

_COUNTS_TO_ERPM = 10.0
"""A metre is as many tachometer counts as a metre a second is eRPM, over this: six counts a turn, sixty seconds."""
_BATTERY_EVERY_S = 0.5
_LOW_AFTER_S = 5.0


class VescConfig(SerialMotorConfig):
    """Parameters of a VESC in a car. The defaults are those of an F1TENTH car."""

    port: str = Field(default="/dev/serial/by-id/usb-STMicroelectronics_ChibiOS_RT_Virtual_COM_Port*", min_length=1)
    """Serial port by its stable name, or a pattern that fits one; the default is the controller's own USB."""
    erpm_per_mps: float = Field(default=4614.0, gt=0.0, le=100_000.0)
    """Electrical revolutions a minute at 1 m/s."""
    erpm_offset: float = Field(default=0.0, ge=-10_000.0, le=10_000.0)
    """Added to them."""
    speed_reversed: bool = False
    """The motor's positive sense drives the car backwards."""
    servo_per_rad: float = Field(default=-1.2135, ge=-10.0, le=10.0)
    """What a radian of the front wheels to the left adds to the servo's position; its sign is the steering's."""
    servo_centre: float = Field(default=0.5304, ge=0.0, le=1.0)
    """The servo's position straight ahead."""
    servo_min: float = Field(default=0.15, ge=0.0, le=1.0)
    """The servo is never put below this."""
    servo_max: float = Field(default=0.85, ge=0.0, le=1.0)
    """The servo is never put above this."""
    top_speed_mps: float = Field(default=5.0, gt=0.0, le=30.0)
    """Faster commands are written as this."""
    still_mps: float = Field(default=0.03, gt=0.0, le=1.0)
    """For a slower command the motor is stopped rather than held at a speed."""
    brake_a: float = Field(default=0.0, ge=0.0, le=100.0)
    """Braking current of a stop; 0 lets the motor go, so that the car rolls out."""
    low_v: float = Field(default=0.0, ge=0.0, le=100.0)
    """Below this for 5 s the battery is low, say 3.5 V a cell; 0: never."""
    poll_hz: float = Field(default=50.0, ge=5.0, le=100.0)
    """How often its values are asked for, and the odometry published."""

    @model_validator(mode="after")
    def _servo_has_room(self) -> VescConfig:
        if not self.servo_min < self.servo_centre < self.servo_max or self.servo_per_rad == 0.0:
            raise ValueError("servo_centre must lie between servo_min and servo_max, and servo_per_rad must not be 0")
        return self


class Vesc(SerialMotor[VescConfig, Steer]):
    """Drives a car and publishes its odometry (tachometer, and the steering that was written) and its battery.

    The firmware's own time limit (App settings, Timeout, 1000 ms as delivered) is the watchdog; whether yours is set
    only a trial on a stand tells. Faults that it counts: `bad packet`, and the controller's own by name. Lost, and so
    stopped until somebody arms the robot again, also where it reports one: by itself it would drive on after it.
    """

    sim_twin = "sim_car"
    emits: ClassVar[tuple[type[Message], ...]] = (Odometry, Battery)
    watchdog = Watchdog("firmware", packets.TIMEOUT_MS)
    # no delimiter exists: nine zeros end the longest packet of ours, and begin none
    delimiter = bytes(9)

    @property
    def polls_hz(self) -> float:
        return self.config.poll_hz

    @classmethod
    def publish_period_s(cls, config: VescConfig) -> float:
        return 1.0 / config.poll_hz

    def prepare(self) -> None:
        self._car = self.body(Ackermann, "wheelbase_m: 0.325, track_m: 0.27, max_steering_rad: 0.42")
        self._parser = VescParser()
        self._has_answered = False
        self._counts: int | None = None
        self._low = LowBattery(self.config.low_v, ns(_LOW_AFTER_S))
        self._steering_rad = 0.0
        self._sign = -1 if self.config.speed_reversed else 1

    async def begin(self) -> None:
        await self.answer(
            packets.ask_version(),
            lambda: self._has_answered,
            every_s=0.1,
            hint="is it powered, and is UART or USB its control app (App settings, General)?",
        )

    def poll(self, now_ns: int) -> None:
        self.ask(packets.ask_values())

    # ------------------------------------------------------------------------------------- to the motors

    def stop_bytes(self) -> bytes:
        return self.delimiter + self._release()

    def _release(self) -> bytes:
        return packets.set_brake(self.config.brake_a) if self.config.brake_a else packets.set_current(0.0)

    def frame(self, command: Steer) -> bytes:
        config = self.config
        servo = config.servo_centre + config.servo_per_rad * command.steering_rad
        servo = min(max(servo, config.servo_min), config.servo_max)
        self._steering_rad = (servo - config.servo_centre) / config.servo_per_rad
        speed_mps = min(max(command.speed_mps, -config.top_speed_mps), config.top_speed_mps)
        if abs(speed_mps) < config.still_mps:
            return self._release() + packets.set_servo(servo)
        erpm = self._sign * round(speed_mps * config.erpm_per_mps + config.erpm_offset)
        return packets.set_rpm(erpm) + packets.set_servo(servo)

    # ----------------------------------------------------------------------------------- from the sensors

    def received(self, data: bytes, now_ns: int) -> None:
        for payload in self._parser.feed(data):
            self._has_answered = True
            self.heard(now_ns)
            values = packets.values_of(payload)
            if values is not None:
                self._measured(values, now_ns)
        if self._parser.faults:
            self._parser.faults = 0
            self.context.link.fault("bad packet", "noise on the line, or the wrong baud")

    def _measured(self, values: Values, now_ns: int) -> None:
        self.faults_now(values.fault_names)
        if values.fault_names:
            self._gone(f"the VESC reports {' and '.join(sorted(values.fault_names))}: VESC Tool says more about it")
            return
        low = self._low.take(values.voltage_v, now_ns)
        self.publish_newer(Battery(now_ns, values.voltage_v, values.battery_a, low=low), _BATTERY_EVERY_S)
        config, before = self.config, self._counts
        self._counts = values.tachometer
        if before is None:
            return
        way_m = self._sign * wrapped(values.tachometer - before) * _COUNTS_TO_ERPM / config.erpm_per_mps
        speed_mps = (self._sign * values.erpm - config.erpm_offset) / config.erpm_per_mps if values.erpm else 0.0
        way = self._car.body(Steer(way_m, self._steering_rad))
        speed = self._car.body(Steer(speed_mps, self._steering_rad))
        self.publish_newer(self.pose.way(way, Drive(speed.vx_mps, speed.wz_radps), now_ns))
