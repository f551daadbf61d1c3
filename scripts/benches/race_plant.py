"""The race plant: one car on one track, closed loop, without the runtime, for thousands of laps.

The dynamics are those of `sim_race_car`; what is simpler here is the lidar (sphere tracing in the occupancy picture's
distance transform instead of exact walls) and the scheduling (the planner is called `latency_s` after each scan). The
whole footprint is held against the distance transform in every physics step; a step that is known to be free because
the clearance before it was larger than what the car can have moved since is not looked at again.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from benches.race_tracks import Track
from robotd.world.kinematics import advance
from robotd.world.messages import LidarScan, Odometry, Steer
from robotd_devices.sim.single_track import GRAVITY_MPS2, RaceCar, RaceTrack

NS = 1_000_000_000
TICKS_HZ = 50
"""A driver with `ticks = True` is called so often between scans, with the newest one, as the runtime does."""
Floats = NDArray[np.float64]


class Ground:
    """The distance transform of a track: how far to the nearest occupied cell, ranges, clearance of a footprint."""

    def __init__(self, track: Track) -> None:
        from scipy.ndimage import distance_transform_edt

        self.track = track
        self.changes = 0
        """So often something was put on the track."""
        occupied = np.pad(track.occupied, 1, constant_values=True)
        self._cells = distance_transform_edt(~occupied).astype(np.float32)
        self._flat = self._cells.ravel()
        self._columns = occupied.shape[1]
        self._low = (track.origin_m[0] - track.resolution_m, track.origin_m[1] - track.resolution_m)
        self._per_m = 1.0 / track.resolution_m

    def add_box(self, x_m: float, y_m: float, half_m: float) -> None:
        """A square obstacle from now on."""
        self.add_boxes([(x_m, y_m)], half_m)

    def add_boxes(self, at_m: Iterable[tuple[float, float]], half_m: float) -> None:
        """Square obstacles from now on, their sides along the map's axes."""
        from scipy.ndimage import distance_transform_edt

        free = self._cells > 0.0
        for x_m, y_m in at_m:
            c0, c1 = (int((x_m + s * half_m - self._low[0]) * self._per_m) for s in (-1, 1))
            r0, r1 = (int((y_m + s * half_m - self._low[1]) * self._per_m) for s in (-1, 1))
            free[max(r0, 0) : r1 + 1, max(c0, 0) : c1 + 1] = False
        self._cells = distance_transform_edt(free).astype(np.float32)
        self._flat = self._cells.ravel()
        self.changes += 1

    def ranges_m(self, x_m: Floats | float, y_m: Floats | float, bearing_rad: Floats, most_m: float) -> Floats:
        """Range of each ray (n,), inf beyond `most_m`. Steps are the distance less one cell, so no wall is jumped."""
        cos = np.cos(bearing_rad).astype(np.float32)
        sin = np.sin(bearing_rad).astype(np.float32)
        n = len(cos)
        x = np.empty(n, dtype=np.float32)
        y = np.empty(n, dtype=np.float32)
        x[:] = (np.asarray(x_m) - self._low[0]) * self._per_m
        y[:] = (np.asarray(y_m) - self._low[1]) * self._per_m
        most = np.float32(most_m * self._per_m)
        out = np.full(n, np.inf, dtype=np.float32)
        way = np.zeros(n, dtype=np.float32)
        ray = np.arange(n)
        flat, columns = self._flat, self._columns
        for _ in range(400):
            d = flat.take(y.astype(np.int32) * columns + x.astype(np.int32), mode="clip")
            done = (d < 0.5) | (way > most)
            if done.any():
                out[ray[done]] = way[done]
                keep = ~done
                if not keep.any():
                    break
                ray, x, y, way, cos, sin, d = (a[keep] for a in (ray, x, y, way, cos, sin, d))
            step = np.maximum(d - np.float32(1.0), np.float32(0.4))
            way += step
            x += step * cos
            y += step * sin
        metres = out.astype(np.float64) / self._per_m
        return np.where(metres > most_m, np.inf, metres)

    def distance_m(self, x_m: float, y_m: float) -> float:
        """At most the distance from a point to the nearest occupied cell's edge (one point)."""
        c, r = int((x_m - self._low[0]) * self._per_m), int((y_m - self._low[1]) * self._per_m)
        if not (0 <= r < self._cells.shape[0] and 0 <= c < self._columns):
            return 0.0
        return (float(self._cells[r, c]) - 1.21) / self._per_m

    def clearance_m(self, points_m: Floats) -> float:
        """Least distance of points (n, 2) to the middles of occupied cells less half a cell, linear between cells."""
        u = (points_m[:, 0] - self._low[0]) * self._per_m - 0.5
        v = (points_m[:, 1] - self._low[1]) * self._per_m - 0.5
        c, r = u.astype(np.int32), v.astype(np.int32)
        fu, fv = u - c, v - r
        at = r * self._columns + c
        flat = self._flat
        d00, d01 = flat.take(at, mode="clip"), flat.take(at + 1, mode="clip")
        d10, d11 = flat.take(at + self._columns, mode="clip"), flat.take(at + self._columns + 1, mode="clip")
        d = (1 - fv) * ((1 - fu) * d00 + fu * d01) + fv * ((1 - fu) * d10 + fu * d11)
        return (float(d.min()) - 0.5) / self._per_m


@dataclass(frozen=True, slots=True)
class Conditions:
    """What a run is driven under."""

    rate_hz: float = 40.0
    latency_s: float = 0.0
    noise_m: float = 0.01
    dropout: float = 0.0
    mu: float | None = None
    beams: int = 1081
    fov_rad: float = math.radians(270.0)
    range_max_m: float = 30.0
    sweep: bool = False
    """Each beam from its own instant of the sweep; otherwise all at once."""
    lidar_x_m: float | None = None
    """In base; default: over the centre of mass."""
    step_s: float = 0.005
    linear_tyres: bool = False
    """As the published simulators have them; for comparison with their numbers only."""
    seed: int = 0


class Driver(Protocol):
    """What drives: a scan and what the wheels tell, at an instant, to a command."""

    def __call__(self, scan: LidarScan, odometry: Odometry, now_ns: int) -> Steer | None: ...


@dataclass(slots=True)
class Run:
    """What came of a run."""

    laps_s: list[float] = field(default_factory=list)
    crashed: str = ""
    stuck: str = ""
    clearance_m: float = math.inf
    over_grip_share: float = 0.0
    most_grip_share: float = 0.0
    steer_rate_radps: float = 0.0
    mean_mps: float = 0.0
    top_mps: float = 0.0
    progress_m: float = 0.0
    seconds: float = 0.0
    path: list[tuple[float, float, float]] = field(default_factory=list)
    """x, y, speed of the centre of the body, once a scan."""


class Race:
    """One car on one track."""

    def __init__(self, ground: Ground, car: RaceCar, conditions: Conditions) -> None:
        self.ground, self.car, self.conditions = ground, car, conditions
        self.at_m = 0.0
        """Where base is, along x of the map."""
        self.progress_m = 0.0
        """Driven along the middle line, at the step before."""
        self._rng = np.random.default_rng(conditions.seed)
        shares = np.linspace(-0.5, 0.5, conditions.beams)
        self._angles = (shares * conditions.fov_rad).astype(np.float32)
        self._exact = self._angles.astype(np.float64)
        self.lidar_x_m = car.rear_m if conditions.lidar_x_m is None else conditions.lidar_x_m
        self._mid_x = car.wheelbase_m / 2.0
        self._outline = _outline(car)
        self._radius = math.hypot(car.length_m, car.width_m) / 2.0
        self.mu = car.mu if conditions.mu is None else conditions.mu
        # a lap is counted on the middle line, the nearest point of which is followed
        middle = ground.track.middle_m
        ring = np.vstack((middle, middle[:1]))
        self._way = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(ring, axis=0).T))))
        self.length_m = float(self._way[-1])
        """Of a lap along the middle line."""
        self._middle = middle
        self._xs, self._ys = middle[:, 0].tolist(), middle[:, 1].tolist()

    def drive(
        self,
        driver: Driver,
        laps: int = 1,
        start: tuple[float, float, float] | None = None,
        limit_s: float = 1e9,
        stop_when: Callable[[float, RaceTrack], bool] | None = None,
        speed_mps: float = 0.0,
        on_step: Callable[[float, tuple[float, float, float], RaceTrack], None] | None = None,
    ) -> Run:
        """Drives until the laps are done, a contact, no progress for 10 s, or the limit. start: pose of base."""
        c, car, ground = self.conditions, self.car, self.ground
        step_s, step_ns = c.step_s, round(c.step_s * NS)
        track = RaceTrack(car, step_s, c.mu, not c.linear_tyres)
        track.vx_mps = speed_mps
        track.wanted = Steer(speed_mps)
        x, y, yaw = start if start is not None else ground.track.pose()
        run = Run()
        period, late = round(NS / c.rate_hz), round(c.latency_s * NS)
        queue: list[tuple[int, LidarScan]] = []
        now, next_scan = 0, 0
        at = self._nearest_anywhere(x, y)
        here, progress, best, best_at, lap_from = self._way[at], 0.0, 0.0, 0, 0
        free, changes = 0.0, ground.changes
        over = steps = 0
        ticks, newest = bool(getattr(driver, "ticks", False)), None
        tick_ns, next_tick = NS // TICKS_HZ, NS // TICKS_HZ
        grip = self.mu * GRAVITY_MPS2
        steer_was, turned, sum_v = 0.0, 0.0, 0.0
        poses = [(x, y, yaw)]
        keep = period // step_ns + 2
        length = self.length_m
        while now < limit_s * NS:
            while next_scan <= now:
                queue.append((next_scan + late, self._scan(poses, period, next_scan)))
                next_scan += period
            arrived = bool(queue) and queue[0][0] <= now
            ticked = ticks and next_tick <= now
            if ticked:
                next_tick += tick_ns
            if arrived:
                newest = queue.pop(0)[1]
            if newest is not None and (arrived or ticked):
                scan = newest
                told = Odometry(now, 0.0, 0.0, 0.0, track.vx_mps, 0.0, track.wz_radps)
                steer = driver(scan, told, now)
                track.command(steer if steer is not None else Steer(0.0, track.wanted.steering_rad))
                if arrived:
                    run.path.append((x, y, track.vx_mps))
            twist = track.step()
            x, y, yaw = advance(x, y, yaw, twist, step_s)
            now += step_ns
            self.at_m = x
            steps += 1
            poses.append((x, y, yaw))
            if len(poses) > 2 * keep:
                del poses[:-keep]
            if on_step is not None:
                on_step(now / NS, (x, y, yaw), track)
            if ground.changes != changes:
                free, changes = 0.0, ground.changes
            v = track.vx_mps
            lateral = abs(v * track.wz_radps)
            over += lateral > grip
            run.most_grip_share = max(run.most_grip_share, lateral / grip)
            turned += abs(track.steering_rad - steer_was)
            steer_was = track.steering_rad
            sum_v += abs(v)
            run.top_mps = max(run.top_mps, v)
            free -= (math.hypot(twist.vx_mps, twist.vy_mps) + abs(twist.wz_radps) * 2.0 * self._radius) * step_s
            if free <= 0.02 or free < run.clearance_m:
                free = self.clearance_m(x, y, yaw)
                run.clearance_m = min(run.clearance_m, free)
                if free <= 0.0:
                    run.crashed = f"contact at {x:.2f}, {y:.2f} after {now / NS:.2f} s, {v:.2f} m/s"
                    break
            # progress along the middle
            at = self._nearest(at, x, y)
            gain = (self._way[at] - here + length / 2.0) % length - length / 2.0
            here = self._way[at]
            progress += gain
            self.progress_m = progress
            if progress > best + 0.05:
                best, best_at = progress, now
            elif now - best_at > 10 * NS:
                run.stuck = f"no progress at {x:.2f}, {y:.2f} after {now / NS:.2f} s"
                break
            if progress >= (len(run.laps_s) + 1) * length:
                run.laps_s.append((now - lap_from) / NS)
                lap_from = now
                if len(run.laps_s) == laps:
                    break
            if stop_when is not None and stop_when(now / NS, track):
                break
        run.seconds = now / NS
        run.progress_m = progress
        run.over_grip_share = over / max(steps, 1)
        run.steer_rate_radps = turned / max(run.seconds, 1e-9)
        run.mean_mps = sum_v / max(steps, 1)
        return run

    def _scan(self, poses: list[tuple[float, float, float]], period: int, stamp: int) -> LidarScan:
        c = self.conditions
        if c.sweep and len(poses) > 2:
            past = np.array(poses[-(period // round(c.step_s * NS) + 1) :])
            share = np.linspace(0.0, len(past) - 1.0, c.beams)
            px, py, pyaw = (np.interp(share, np.arange(len(past)), past[:, k]) for k in range(3))
            if np.ptp(past[:, 2]) > math.pi:
                pyaw = np.interp(share, np.arange(len(past)), np.unwrap(past[:, 2]))
        else:
            px, py, pyaw = poses[-1]
        lx, ly = px + self.lidar_x_m * np.cos(pyaw), py + self.lidar_x_m * np.sin(pyaw)
        ranges = self.ground.ranges_m(lx, ly, self._exact + pyaw, c.range_max_m)
        if c.noise_m > 0.0:
            ranges = np.maximum(ranges + c.noise_m * self._rng.standard_normal(len(ranges)), 0.0)
        if c.dropout > 0.0:
            ranges[self._rng.random(len(ranges)) < c.dropout] = math.nan
        return LidarScan(
            stamp, ranges.astype(np.float32), self._angles, stamp - period if c.sweep else stamp, 0.0,
            c.range_max_m, self.lidar_x_m,
        )  # fmt: skip

    def clearance_m(self, x: float, y: float, yaw: float) -> float:
        """Of the whole outline at a pose of base; at most the true one."""
        cos, sin = math.cos(yaw), math.sin(yaw)
        mx, my = x + cos * self._mid_x, y + sin * self._mid_x
        wide = self.ground.distance_m(mx, my) - self._radius
        if wide > 0.25:
            return wide
        points = self._outline @ np.array([[cos, sin], [-sin, cos]]) + (mx, my)
        return self.ground.clearance_m(points)

    def _nearest(self, at: int, x: float, y: float) -> int:
        """The nearest point of the middle, walked to from the one before."""
        xs, ys, n = self._xs, self._ys, len(self._xs)
        best = (xs[at] - x) ** 2 + (ys[at] - y) ** 2
        for step in (1, -1):
            while True:
                to = (at + step) % n
                d = (xs[to] - x) ** 2 + (ys[to] - y) ** 2
                if d >= best:
                    break
                at, best = to, d
        return at

    def _nearest_anywhere(self, x: float, y: float) -> int:
        return int(np.hypot(self._middle[:, 0] - x, self._middle[:, 1] - y).argmin())


def _outline(car: RaceCar) -> Floats:
    """Points all round the body about its centre, at most 2.5 cm apart."""
    nx, ny = math.ceil(car.length_m / 0.025), math.ceil(car.width_m / 0.025)
    xs = np.linspace(-0.5, 0.5, nx + 1) * car.length_m
    ys = np.linspace(-0.5, 0.5, ny + 1) * car.width_m
    half_l, half_w = car.length_m / 2.0, car.width_m / 2.0
    return np.vstack(
        [np.stack((xs, np.full_like(xs, s * half_w)), axis=1) for s in (-1.0, 1.0)]
        + [np.stack((np.full_like(ys, s * half_l), ys), axis=1) for s in (-1.0, 1.0)]
    )
