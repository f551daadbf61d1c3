"""The simulated base: takes `Drive`, moves the world's robot, publishes what its wheels tell."""

from __future__ import annotations

from typing import Any, ClassVar

from pydantic import Field

from robotd.authoring.device import Actuator, DeviceContext, DeviceMisconfigured
from robotd.world.messages import STOP, Drive, Message, Odometry
from robotd_devices.ports.ticker import Ticker
from robotd_devices.sim.wheels import Wheels, WheelSettings
from robotd_devices.sim.world import FlatWorld, flat_world


class SimBaseConfig(WheelSettings):
    """A simulated base; its kinematics are those of `robot:`."""

    odometry_hz: float = Field(default=50.0, ge=1.0, le=200.0)
    """How often the odometry is published."""


class SimBase(Actuator[SimBaseConfig, Drive]):
    """A differential or mecanum base. Odometry counts the wheels and so drifts from the truth; it starts at 0, 0, 0.

    A command reaches the motors at once; what they make of it is in `Wheels`. A wheel that spins against a wall still
    counts. Raises DeviceMisconfigured for a car, which `sim_car` simulates.
    """

    sim_twin: ClassVar[str | None] = "sim_base"
    emits: ClassVar[tuple[type[Message], ...]] = (Odometry,)

    def __init__(self, config: SimBaseConfig, context: DeviceContext | None = None) -> None:
        super().__init__(config, context)
        self._world: FlatWorld | None = None
        self._wheels: Wheels | None = None
        self._ticker = Ticker(1.0 / config.odometry_hz, self._tell)

    @classmethod
    def publish_period_s(cls, config: SimBaseConfig) -> float | None:
        return 1.0 / config.odometry_hz

    async def open(self) -> None:
        world = flat_world(self.context)
        try:
            rng = world.generator(self.context.name)
            wheels = Wheels(self.context.robot.kinematics, self.config, rng, world.step_ns)
        except ValueError as error:
            raise DeviceMisconfigured(f"{self.context.name}: {error} (robot.kinematics)") from error
        world.attach(wheels)
        self._world, self._wheels = world, wheels
        self._ticker.start()

    async def close(self) -> None:
        self._ticker.stop()
        if self._world is not None and self._wheels is not None:
            self._world.detach(self._wheels)
        self._world = self._wheels = None

    def apply(self, command: Drive) -> None:
        # a wrongly wired car's command must not pass as a Drive whose fields happen to be absent
        taken: Any = command
        if not isinstance(taken, Drive):
            raise TypeError(f"{self.context.name} takes Drive, not {type(taken).__name__}")
        if self._world is not None and self._wheels is not None:
            self._world.advance()
            self._wheels.command(command, self._world.supply)

    def halt(self) -> None:
        self.apply(STOP)

    def _tell(self) -> None:
        if self._world is None or self._wheels is None:
            return
        self._world.advance()
        told = self._wheels.report()
        x_m, y_m, yaw_rad = self._wheels.odometry
        now_ns = self.context.clock.now_ns()
        self.publish(Odometry(now_ns, x_m, y_m, yaw_rad, told.vx_mps, told.vy_mps, told.wz_radps))
