"""The simulated lidar: exact ranges of the world, then the faults of a real one."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from pydantic import Field

from robotd.authoring.config import Config
from robotd.authoring.device import DeviceContext, Sensor
from robotd.world.clock import ns
from robotd.world.messages import Float32s, Float64s, LidarScan
from robotd_devices.ports.ticker import Ticker
from robotd_devices.sim.rays import cast
from robotd_devices.sim.world import FlatWorld, flat_world

HEIGHT_M = 0.1
"""Of the beams' plane where the mount does not tell."""


class SimLidarConfig(Config):
    """A simulated planar lidar; the defaults are those of an LD19 (4,500 samples a second)."""

    rate_hz: float = Field(default=10.0, gt=0.0, le=100.0)
    """Sweeps a second."""
    beams: int = Field(default=450, ge=1, le=20_000)
    """Samples a sweep."""
    fov_rad: float = Field(default=math.tau, gt=0.0, le=math.tau)
    """Field of view, centred on the lidar's x axis; a full turn has no beam twice."""
    range_min_m: float = Field(default=0.02, ge=0.0)
    """Nearer than this means touching; such ranges are still published."""
    range_max_m: float = Field(default=12.0, gt=0.0)
    """Beyond this there is nothing: `inf`."""
    noise_m: float = Field(default=0.008, ge=0.0, le=1.0)
    """Standard deviation of a range, the part that does not grow with it."""
    noise_share: float = Field(default=0.003, ge=0.0, le=0.5)
    """Standard deviation of a range as a share of it; added in squares."""
    dropout: float = Field(default=0.01, ge=0.0, le=1.0)
    """Share of beams that are not measured: `nan`."""
    moving_sweep: bool = True
    """Each beam from the pose at its own instant; false: all from the pose at the sweep's end."""


def beam_angles_rad(beams: int, fov_rad: float) -> Float32s:
    """Bearings of the beams in the lidar's own frame, float32 (beams,), rising; a single beam looks ahead."""
    if beams == 1:
        return np.zeros(1, dtype=np.float32)
    if fov_rad >= math.tau - 1e-9:
        return (-math.pi + np.arange(beams) * (math.tau / beams)).astype(np.float32)
    return np.linspace(-fov_rad / 2.0, fov_rad / 2.0, beams).astype(np.float32)


class SimLidar(Sensor[SimLidarConfig, LidarScan]):
    """Publishes at the end of each sweep, stamped then; `start_ns` is the end of the sweep before.

    Beam i was measured at start + (end - start) i / (n - 1), as `LidarScan` says. The beams' plane is level: the
    mount's height says which cards and which part of a person it cuts, roll and pitch take no part.
    """

    sim_twin: ClassVar[str | None] = "sim_lidar"

    def __init__(self, config: SimLidarConfig, context: DeviceContext | None = None) -> None:
        super().__init__(config, context)
        self._world: FlatWorld | None = None
        self._rng = np.random.default_rng(0)
        self._angles_rad = beam_angles_rad(config.beams, config.fov_rad)
        # the float32 angle that is published is the angle that is cast
        self._exact_rad: Float64s = self._angles_rad.astype(np.float64)
        self._ticker = Ticker(1.0 / config.rate_hz, self._sweep)
        self._shares: Float64s = np.arange(config.beams) / max(1, config.beams - 1)
        self._lead_ns = ns(1.0 / config.rate_hz) * (self._shares - 1.0)

    @classmethod
    def publish_period_s(cls, config: SimLidarConfig) -> float | None:
        return 1.0 / config.rate_hz

    async def open(self) -> None:
        self._world = flat_world(self.context)
        self._rng = self._world.generator(self.context.name)
        self._ticker.start()

    async def close(self) -> None:
        self._ticker.stop()
        self._world = None

    def true_ranges_m(self, world: FlatWorld, end_ns: int) -> Float64s:
        """Ranges without any fault for a sweep that ends at `end_ns`, float64 (beams,), inf where there is nothing."""
        mount = self.context.mount
        if self.config.moving_sweep:
            poses = world.poses(end_ns + self._lead_ns.astype(np.int64))
        else:
            poses = world.poses(np.array([end_ns]))
        yaw_rad = poses[:, 2]
        cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
        origins_m = poses[:, :2] + np.stack(
            (cos * mount.x_m - sin * mount.y_m, sin * mount.x_m + cos * mount.y_m), axis=1
        )
        bearings_rad = self._exact_rad + (yaw_rad + mount.yaw_rad)
        origin_m = origins_m if len(origins_m) > 1 else origins_m[0]
        return self.cast(world, end_ns, origin_m, bearings_rad)

    def cast(self, world: FlatWorld, end_ns: int, origins_m: Float64s, bearings_rad: Float64s) -> Float64s:
        """Exact ranges (beams,) from origins (beams, 2), or (2,) for one, along bearings (beams,), all in map."""
        mount = self.context.mount
        things = world.seen(self._start_ns(end_ns), end_ns, mount.z_m if mount.z_m > 0.0 else HEIGHT_M)
        return cast(origins_m, bearings_rad, things.segments_m, things.circles_m, things.moves_m, self._shares)

    def _start_ns(self, end_ns: int) -> int:
        return end_ns - self._ticker.period_ns if self.config.moving_sweep else end_ns

    def _sweep(self) -> None:
        if self._world is None:
            return
        end_ns = self.context.clock.now_ns()
        exact_m = self.true_ranges_m(self._world, end_ns)
        mount = self.context.mount
        self.publish(
            LidarScan(
                stamp_ns=end_ns,
                ranges_m=self._with_faults(exact_m),
                angles_rad=self._angles_rad,
                start_ns=end_ns - self._ticker.period_ns,
                range_min_m=self.config.range_min_m,
                range_max_m=self.config.range_max_m,
                x_m=mount.x_m,
                y_m=mount.y_m,
                yaw_rad=mount.yaw_rad,
            )
        )

    def _with_faults(self, exact_m: Float64s) -> Float32s:
        config = self.config
        ranges_m = exact_m
        if config.noise_m > 0.0 or config.noise_share > 0.0:
            std_m = np.hypot(config.noise_m, config.noise_share * np.where(np.isfinite(exact_m), exact_m, 0.0))
            ranges_m = np.maximum(exact_m + std_m * self._rng.standard_normal(len(exact_m)), 0.0)
        ranges_m = np.where(exact_m > config.range_max_m, math.inf, ranges_m)
        if config.dropout > 0.0:
            ranges_m = np.where(self._rng.random(len(exact_m)) < config.dropout, math.nan, ranges_m)
        return ranges_m.astype(np.float32)
