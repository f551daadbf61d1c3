"""Limits below the arbiter, fed straight from the sensors; not a participant, so it cannot be outranked.

A command passes in this order: finite, range (direction kept), acceleration (direction kept), zones. Zones look at the
raw scans with the robot's outline: the motion is followed along its own arc, and is scaled so that the robot can
stop before anything comes nearer than the margin. Only motion that *reduces* a clearance is limited: moving away is
always allowed. A direction that no beam has seen is blind for motion into it only.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from robotd.safety.settings import GuardConfig
from robotd.world.geometry import convex_hull, half_planes
from robotd.world.kinematics import Ackermann, saturate, steer_to_drive
from robotd.world.messages import STOP, Command, Drive, Float32s, Float64s, LidarScan, Steer
from robotd.world.robot import Robot

POSES = 16
"""How many poses along the motion are checked; the free distance is rounded down to the pose before."""
BINS = 72
"""Bearing bins of 5 degrees in which a beam counts as having seen its direction (one bin of spread each side)."""
RECEDES_M = 1e-3
"""A clearance must shrink by this much before the motion counts as an approach."""
STILL = 1e-6
"""What moves slower than this, in m/s and rad/s, stands still."""
LONGEST_DT_S = 0.1
"""An acceleration ramp never takes credit for more time than this, however long the loop was held up."""

Points: TypeAlias = Float64s


class Guarded(NamedTuple):
    """What may be written. `limited_by` names each limit that acted; `reason` says why where the robot must stand."""

    command: Command
    limited_by: tuple[str, ...] = ()
    reason: str = ""


class Sensed(NamedTuple):
    """What one scan says near the robot: points in base (2, n) within reach, and which bearings were seen."""

    topic: str
    points: Points
    seen: NDArray[np.bool_] | None
    """bool (BINS,) by bearing from the lidar, or None where all were seen."""
    x_m: float
    y_m: float


@dataclass(slots=True)
class _Coverage:
    """Bins of one grid of bearings, and unit vectors (2, n), kept while the sensor hands over the same array."""

    angles_rad: Float32s
    yaw_rad: float
    bins: NDArray[np.intp]
    full: NDArray[np.bool_] | None
    directions: Float64s | None = None


class Guard:
    """The limits of one robot, compiled once. `limit` is a pure function of its arguments."""

    def __init__(self, robot: Robot, config: GuardConfig) -> None:
        self.robot = robot
        self.config = config
        self._hull = convex_hull(robot.footprint_m)
        self._normals, self._offsets = half_planes(self._hull)
        self._outline = np.concatenate((self._hull, (self._hull + np.roll(self._hull, -1, axis=0)) / 2.0))
        limits = robot.limits
        self._top_mps = math.hypot(limits.vx_mps, limits.vy_mps) + limits.wz_radps * robot.radius_m
        stop = config.zones.stop
        slow = config.zones.slow
        self.sources: tuple[str, ...] = ()
        if stop is not None:
            self.sources = tuple(dict.fromkeys(stop.sources + (slow.sources if slow else ())))
        self._stop_m = stop.margin_m if stop else 0.0
        self._slow_m = slow.margin_m if slow else 0.0
        self._zones_are_off = config.zones.off is not None
        self._widest_m = max(self._stop_m, self._slow_m)
        self._reach_m = self._braking_m(self._top_mps) + self._widest_m + 0.05
        self._coverage: dict[str, _Coverage] = {}
        self._motion: tuple[Drive, _Motion] | None = None

    # ------------------------------------------------------------------------------------------ sensing

    def sense(self, topic: str, scan: LidarScan) -> Sensed:
        """What the zones need of one scan; once a scan, however many commands are checked against it."""
        reach = self.robot.radius_m + self._reach_m + math.hypot(scan.x_m, scan.y_m)
        coverage = self._coverage_of(topic, scan)
        near = np.flatnonzero(scan.ranges_m < reach)
        if near.size:
            ranges = scan.ranges_m[near].astype(np.float64)
            points = _directions(coverage, scan, near)
            if ranges.min() < scan.range_min_m:
                ranges = self._touching(points, ranges, scan)
            points *= ranges
            points[0] += scan.x_m
            points[1] += scan.y_m
        else:
            points = np.empty((2, 0))
        return Sensed(topic, points, _seen(coverage, scan), scan.x_m, scan.y_m)

    def _touching(self, directions: Points, ranges: Float64s, scan: LidarScan) -> Float64s:
        """Ranges in which "below the minimum" became "at the outline": something touches the robot there."""
        facing = self._normals.T @ directions
        to_edge = (self._offsets - (scan.x_m * self._normals[0] + scan.y_m * self._normals[1]))[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            way = np.where(facing > 1e-9, to_edge / facing, np.inf).min(axis=0)
        return np.where(ranges < scan.range_min_m, np.maximum(way, 0.0), ranges)

    def _coverage_of(self, topic: str, scan: LidarScan) -> _Coverage:
        coverage = self._coverage.get(topic)
        if coverage is None or coverage.angles_rad is not scan.angles_rad or coverage.yaw_rad != scan.yaw_rad:
            bins = _bin(scan.angles_rad + np.float32(scan.yaw_rad))
            coverage = self._coverage[topic] = _Coverage(scan.angles_rad, scan.yaw_rad, bins, _spread(bins))
        elif coverage.directions is None:  # the same bearings again: worth a table
            coverage.directions = _unit_vectors(scan.angles_rad, scan.yaw_rad)
        return coverage

    # ----------------------------------------------------------------------------------------- limiting

    def limit(
        self,
        command: Command,
        *,
        by: str,
        previous: Command,
        dt_s: float,
        sensed: Sequence[Sensed],
        stale: str = "",
    ) -> Guarded:
        """The command that may be written.

        previous: what was written before, dt_s earlier. sensed: one entry for each zone source that is fresh.
        stale: the name of a zone source that is missing or too old, or empty. Raises nothing.
        """
        drive = self._as_drive(command)
        if drive is None:
            return Guarded(_stop_like(previous), ("not finite",), f"{by} proposed a command that is not finite")
        limited: tuple[str, ...] = ()
        steering: float | None = None
        if isinstance(command, Steer):
            drive, steering = self._steered(drive, command.steering_rad)
            if steering != command.steering_rad:
                limited += ("steering",)
        limits = self.robot.limits
        if steering is None:
            ranged = saturate(drive, limits.vx_mps, limits.vy_mps, limits.wz_radps)
        else:  # a car's turning is limited by its wheels
            ranged = saturate(drive, limits.vx_mps, math.inf, math.inf)
        if ranged is not drive:
            limited += ("range",)
        ramped = self._ramp(ranged, self._as_drive(previous) or STOP, dt_s)
        if ramped is not ranged:
            limited += ("acceleration",)
        still = abs(ramped.vx_mps) < STILL and abs(ramped.vy_mps) < STILL and abs(ramped.wz_radps) < STILL
        why = ""
        if still:
            ramped = STOP
        elif not self._zones_are_off:
            if stale:
                return Guarded(_stop_like(command), (*limited, "stale"), f"the stop zone has no fresh {stale}")
            factor, name, reason = self._zones(ramped, by, sensed)
            if factor < 1.0:
                ramped = Drive(ramped.vx_mps * factor, ramped.wz_radps * factor, ramped.vy_mps * factor)
                limited += (name,)
            why = reason if factor == 0.0 else ""
        return Guarded(ramped if steering is None else Steer(ramped.vx_mps, steering), limited, why)

    def _steered(self, drive: Drive, steering_rad: float) -> tuple[Drive, float]:
        """Body velocity and angle of front wheels that turn no further than they can."""
        kinematics = self.robot.kinematics
        if not isinstance(kinematics, Ackermann):
            return drive, steering_rad
        most = kinematics.max_steering_rad
        if abs(steering_rad) > most:
            steering_rad = math.copysign(most, steering_rad)
        return steer_to_drive(Steer(drive.vx_mps, steering_rad), kinematics.wheelbase_m), steering_rad

    def _as_drive(self, command: Command) -> Drive | None:
        """The command as a body velocity, or None where a number in it is not finite."""
        if not command.is_finite:
            return None
        if isinstance(command, Drive):
            return command
        kinematics = self.robot.kinematics
        wheelbase = kinematics.wheelbase_m if isinstance(kinematics, Ackermann) else 1.0
        return steer_to_drive(command, wheelbase)

    def _ramp(self, wanted: Drive, previous: Drive, dt_s: float) -> Drive:
        """`wanted`, approached no faster than the accelerations allow; a plain stop is never delayed."""
        if not (wanted.vx_mps or wanted.vy_mps or wanted.wz_radps):
            return wanted
        dx, dy = wanted.vx_mps - previous.vx_mps, wanted.vy_mps - previous.vy_mps
        dw = wanted.wz_radps - previous.wz_radps
        limits = self.robot.limits
        dt = min(max(dt_s, 0.0), LONGEST_DT_S)
        faster = wanted.vx_mps * dx + wanted.vy_mps * dy > 0.0
        linear, angular = math.hypot(dx, dy), abs(dw)
        most_linear = (limits.accel_mps2 if faster else limits.decel_mps2) * dt
        most_angular = limits.angular_accel_radps2 * dt
        factor = 1.0
        if linear > most_linear:
            factor = most_linear / linear
        if angular > most_angular:
            factor = min(factor, most_angular / angular)
        if factor == 1.0:
            return wanted
        return Drive(previous.vx_mps + factor * dx, previous.wz_radps + factor * dw, previous.vy_mps + factor * dy)

    # -------------------------------------------------------------------------------------------- zones

    def _zones(self, drive: Drive, by: str, sensed: Sequence[Sensed]) -> tuple[float, str, str]:
        """Factor on the whole motion, the zone that set it, and why in words."""
        if all(source.seen is None and not source.points.shape[1] for source in sensed):
            return 1.0, "", ""  # seen all round, and nothing within reach
        motion = self._follow(drive)
        blind = _blind_bearing(motion, sensed)
        if blind is not None:
            words = f"motion towards {math.degrees(blind):.0f} degrees is blind: no beam of {_names(sensed)} sees there"
            return 0.0, "blind", words
        factor, name, reason = 1.0, "", ""
        for source in sensed:
            if not source.points.shape[1]:
                continue
            clearance = motion.clearance(source.points)
            if clearance.min() >= self._widest_m:
                continue
            now = clearance[0]
            approaching = now - RECEDES_M
            stop_hit = (clearance < np.minimum(self._stop_m, approaching)).any(axis=1)
            if stop_hit.any():
                free_m = motion.distance_m(int(stop_hit.argmax()) - 1)
                allowed = self._stoppable_mps(free_m) / motion.top_mps
                contact = self.config.contact
                if contact is not None and by in contact.behaviours:
                    allowed = max(allowed, contact.creep_mps / motion.top_mps)
                if allowed < factor:
                    factor, name = allowed, "stop zone"
                    reason = _stop_reason(source, clearance)
            slow = self.config.zones.slow
            if slow is not None and (clearance < np.minimum(self._slow_m, approaching)).any():
                allowed = slow.speed_mps / motion.top_mps
                if allowed < factor:
                    factor, name, reason = allowed, "slow zone", ""
        return factor, name, reason

    def _follow(self, drive: Drive) -> _Motion:
        if self._motion is None or self._motion[0] != drive:
            speeds = np.hypot(
                drive.vx_mps - drive.wz_radps * self._hull[:, 1], drive.vy_mps + drive.wz_radps * self._hull[:, 0]
            )
            top = float(speeds.max())
            ahead = max(self._braking_m(top) + self._slow_m / 2.0, 0.1)
            self._motion = (drive, _Motion(drive, top, ahead, self._normals, self._offsets, self._outline))
        return self._motion[1]

    def _braking_m(self, speed_mps: float) -> float:
        """Way until standstill: latency, then the brakes."""
        return speed_mps * self.config.latency_s + speed_mps * speed_mps / (2.0 * self.robot.limits.decel_mps2)

    def _stoppable_mps(self, free_m: float) -> float:
        """The speed from which the robot stops within `free_m`: the inverse of `_braking_m`."""
        if free_m <= 0.0:
            return 0.0
        lag = self.robot.limits.decel_mps2 * self.config.latency_s
        return math.sqrt(lag * lag + 2.0 * self.robot.limits.decel_mps2 * free_m) - lag


class _Motion:
    """One body velocity followed over `ahead_m` of the fastest corner's way, as poses 0..POSES of the outline."""

    __slots__ = ("_ahead_m", "_edges", "_normals", "_offsets", "_outline", "_path", "_swept", "top_mps")

    def __init__(
        self, drive: Drive, top_mps: float, ahead_m: float, normals: Float64s, offsets: Float64s, outline: Float64s
    ) -> None:
        self.top_mps = top_mps
        self._ahead_m = ahead_m
        time_s = np.linspace(0.0, ahead_m / top_mps, POSES + 1)
        turn = drive.wz_radps * time_s
        if abs(drive.wz_radps) * time_s[-1] < 1e-6:
            s, c = time_s, 0.5 * turn * time_s
        else:
            s, c = np.sin(turn) / drive.wz_radps, (1.0 - np.cos(turn)) / drive.wz_radps
        self._path = (s * drive.vx_mps - c * drive.vy_mps, c * drive.vx_mps + s * drive.vy_mps, turn)
        x, y = self._path[0][:, None], self._path[1][:, None]
        cos, sin = np.cos(turn)[:, None], np.sin(turn)[:, None]
        # The outline's edges, turned and moved along the path: points then need one product, not a transform a pose.
        nx, ny = cos * normals[0] - sin * normals[1], sin * normals[0] + cos * normals[1]
        self._edges = normals.shape[1]
        self._normals = np.stack((nx.ravel(), ny.ravel()), axis=1)
        self._offsets = (offsets + nx * x + ny * y).reshape(-1, 1)
        self._outline = (outline, normals, offsets)
        self._swept: Float64s | None = None

    def clearance(self, points: Points) -> Float64s:
        """Distance of each point (2, n) to the outline at each pose, (POSES + 1, n), negative inside."""
        signed = self._normals @ points
        signed -= self._offsets
        return signed.reshape(POSES + 1, self._edges, -1).max(axis=1)  # type: ignore[no-any-return]

    def distance_m(self, pose: int) -> float:
        """Way of the fastest corner until a pose; zero for the first and before."""
        return max(pose, 0) * self._ahead_m / POSES

    def swept(self) -> Float64s:
        """Points of the outline (k, 2) that the motion carries out of the place where the robot stands."""
        if self._swept is None:
            outline, normals, offsets = self._outline
            x, y, turn = (part[[POSES // 2, POSES]] for part in self._path)
            cos, sin = np.cos(turn)[:, None], np.sin(turn)[:, None]
            at_x = (x[:, None] + cos * outline[:, 0] - sin * outline[:, 1]).ravel()
            at_y = (y[:, None] + sin * outline[:, 0] + cos * outline[:, 1]).ravel()
            points = np.stack((at_x, at_y), axis=1)
            outside = (points @ normals - offsets).max(axis=1) > 5e-3
            self._swept = points[outside]
        return self._swept


def _blind_bearing(motion: _Motion, sensed: Sequence[Sensed]) -> float | None:
    """A bearing into which the motion sweeps and which no source has seen, or None."""
    if any(source.seen is None for source in sensed):
        return None
    swept = motion.swept()
    unseen = np.ones(len(swept), dtype=np.bool_)
    for source in sensed:
        bearing = np.arctan2(swept[:, 1] - source.y_m, swept[:, 0] - source.x_m)
        assert source.seen is not None
        unseen &= ~source.seen[_bin(bearing)]
    if not unseen.any():
        return None
    worst = swept[int(unseen.argmax())]
    return math.atan2(float(worst[1]), float(worst[0]))


def _directions(coverage: _Coverage, scan: LidarScan, beams: NDArray[np.intp]) -> Float64s:
    """Unit vectors (2, n) of some beams in base."""
    if coverage.directions is not None:
        return coverage.directions[:, beams]
    return _unit_vectors(scan.angles_rad[beams], scan.yaw_rad)


def _unit_vectors(angles_rad: Float32s, yaw_rad: float) -> Float64s:
    bearing = angles_rad.astype(np.float64) + yaw_rad
    vectors = np.empty((2, len(bearing)))
    np.cos(bearing, out=vectors[0])
    np.sin(bearing, out=vectors[1])
    return vectors


def _seen(coverage: _Coverage, scan: LidarScan) -> NDArray[np.bool_] | None:
    """Bins that this scan saw; None where that is all of them."""
    if not math.isnan(np.add.reduce(scan.ranges_m)):  # only a beam that was not measured makes the sum nan
        return coverage.full
    return _spread(coverage.bins[~np.isnan(scan.ranges_m)])


def _bin(bearing_rad: NDArray[np.floating]) -> NDArray[np.intp]:
    bins: NDArray[np.intp] = np.floor(bearing_rad * (BINS / math.tau)).astype(np.intp) % BINS
    return bins


def _spread(bins: NDArray[np.intp]) -> NDArray[np.bool_] | None:
    """Bins with a beam and their neighbours; None where that is all of them."""
    hit = np.zeros(BINS + 2, dtype=np.bool_)  # with the last bin before the first, and the first behind the last
    hit[bins + 1] = True
    hit[0], hit[-1] = hit[-2], hit[1]
    seen: NDArray[np.bool_] = hit[:-2] | hit[1:-1] | hit[2:]
    return None if seen.all() else seen


def _stop_reason(source: Sensed, clearance: Float64s) -> str:
    nearest = int(clearance.min(axis=0).argmin())
    bearing = math.degrees(math.atan2(source.points[1, nearest], source.points[0, nearest]))
    away_m = max(float(clearance[0, nearest]), 0.0)
    return f"stop zone: something {away_m:.2f} m away at {bearing:.0f} degrees ({source.topic})"


def _names(sensed: Sequence[Sensed]) -> str:
    return ", ".join(source.topic for source in sensed)


def _stop_like(command: Command) -> Command:
    return Drive() if isinstance(command, Drive) else Steer(0.0, command.steering_rad)
