"""The simulated race car: takes `Steer`, moves the world's robot with tyres that can slide, tells its motion."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

from pydantic import Field

from robotd.authoring.config import Config
from robotd.authoring.device import Actuator, DeviceContext, DeviceMisconfigured
from robotd.world.clock import NS_PER_S
from robotd.world.kinematics import Ackermann, advance
from robotd.world.messages import Drive, Message, Odometry, Steer
from robotd_devices.ports.ticker import Ticker
from robotd_devices.sim.single_track import F1TENTH, TT02D, RaceCar, RaceTrack
from robotd_devices.sim.world import FlatWorld, flat_world

CARS: dict[str, RaceCar] = {"f1tenth": F1TENTH, "tt02d": TT02D}
_SAME_M = 0.02


class SimRaceCarConfig(Config):
    """A race car by name; see `robotd_devices.sim.single_track`."""

    car: Literal["f1tenth", "tt02d"] = "f1tenth"
    """Mass, tyres, servo and motor."""
    mu: float | None = Field(default=None, gt=0.05, le=2.0)
    """Friction of this floor; null: the car's own."""
    odometry_hz: float = Field(default=50.0, ge=1.0, le=200.0)
    """How often the odometry is published."""
    speed_std: float = Field(default=0.01, ge=0.0, le=0.5)
    """Noise of the speed that is told, as a share of it, standard deviation."""
    yaw_std_radps: float = Field(default=0.01, ge=0.0, le=1.0)
    """Noise of the yaw rate that is told, as of a gyroscope, standard deviation."""


class _Odometer:
    """The car on the world's grid, and its pose by what wheels and gyroscope tell."""

    def __init__(self, track: RaceTrack, step_s: float) -> None:
        self.track = track
        self._step_s = step_s
        self.pose: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def step(self) -> Drive:
        drive = self.track.step()
        self.pose = advance(*self.pose, Drive(drive.vx_mps, drive.wz_radps), self._step_s)
        return drive


class SimRaceCar(Actuator[SimRaceCarConfig, Steer]):
    """A car at speed. Its odometry knows no side slip and starts at 0, 0, 0; `halt` stops and holds the front wheels.

    The wheelbase is that of `robot:`, which must be the car's. Raises DeviceMisconfigured for another one, and for
    kinematics other than ackermann.
    """

    sim_twin: ClassVar[str | None] = "sim_race_car"
    emits: ClassVar[tuple[type[Message], ...]] = (Odometry,)

    def __init__(self, config: SimRaceCarConfig, context: DeviceContext | None = None) -> None:
        super().__init__(config, context)
        self._world: FlatWorld | None = None
        self._body: _Odometer | None = None
        self._ticker = Ticker(1.0 / config.odometry_hz, self._tell)

    @classmethod
    def publish_period_s(cls, config: SimRaceCarConfig) -> float | None:
        return 1.0 / config.odometry_hz

    async def open(self) -> None:
        world = flat_world(self.context)
        car, kinematics = CARS[self.config.car], self.context.robot.kinematics
        if not isinstance(kinematics, Ackermann) or abs(kinematics.wheelbase_m - car.wheelbase_m) > _SAME_M:
            raise DeviceMisconfigured(
                f"{self.context.name}: sim_race_car simulates a car with a wheelbase of {car.wheelbase_m:.3f} m: "
                f"write `robot: {{kinematics: {{type: ackermann, wheelbase_m: {car.wheelbase_m:.3f}, ...}}}}`, or take "
                "sim_car for another one"
            )
        step_s = world.step_ns / NS_PER_S
        body = _Odometer(RaceTrack(car, step_s, self.config.mu), step_s)
        world.attach(body)
        self._rng = world.generator(self.context.name)
        self._world, self._body = world, body
        self._ticker.start()

    async def close(self) -> None:
        self._ticker.stop()
        if self._world is not None and self._body is not None:
            self._world.detach(self._body)
        self._world = self._body = None

    def apply(self, command: Steer) -> None:
        # a wrongly wired base's command must not pass as a Steer whose fields happen to be absent
        taken: Any = command
        if not isinstance(taken, Steer):
            raise TypeError(f"{self.context.name} takes Steer, not {type(taken).__name__}")
        if self._world is not None and self._body is not None:
            self._world.advance()
            self._body.track.command(command)

    def halt(self) -> None:
        if self._body is not None:
            self.apply(Steer(0.0, self._body.track.wanted.steering_rad))

    def _tell(self) -> None:
        if self._world is None or self._body is None:
            return
        self._world.advance()
        track = self._body.track
        speed = track.vx_mps * (1.0 + self.config.speed_std * float(self._rng.standard_normal()))
        yaw_rate = track.wz_radps + self.config.yaw_std_radps * float(self._rng.standard_normal())
        self.publish(Odometry(self.context.clock.now_ns(), *self._body.pose, speed, 0.0, yaw_rate))
