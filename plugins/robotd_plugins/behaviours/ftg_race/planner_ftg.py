"""Follow-the-gap: the seed's steps on patches (`SeedGap`), or exact free space and a fan of paths (`PlannerFTG`)."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from robotd.authoring.explain import Explanation, Histogram, Line, Path, Polygon, Scalar
from robotd.world.geometry import compose
from robotd.world.messages import Float64s
from robotd_plugins.behaviours.ftg_race import gap
from robotd_plugins.behaviours.ftg_race.body import Body, swept_free_m
from robotd_plugins.behaviours.ftg_race.commanding import GRAVITY_MPS2, SpeedPolicy, SteeringSmoother, steering_rad
from robotd_plugins.behaviours.ftg_race.config import FtgRaceConfig
from robotd_plugins.behaviours.ftg_race.free_space import HALF, STEP_RAD, FreeSpace
from robotd_plugins.behaviours.ftg_race.planning_types import FREE, HIT, MISSING, Command, Motion, Scan
from robotd_plugins.behaviours.ftg_race.race_line import Fan, RaceLimits

_LEAST_FREE_M = 0.05
"""With less in front of it the car counts as blocked."""
_BLEND_PM = 0.3
"""Paths whose first bend differs by less from the best one's may have their say."""
_NEAR_SHARE = 0.3
"""Of how fast those may be entered, in the speed; so that it does not jump from one path of the fan to the next."""
_OVER_FROM, _OVER_TO = 0.02, 0.17
"""So much too fast, as a share, grip goes to braking first: from the planned share of it to the lesser one."""
_TURN_SHARE, _BRAKE_TURN_SHARE = 0.923, 0.68
"""Of the grip, for steering; of it while much too fast."""
_OWN_TURN_SHARE = 0.87
"""Of it for steering along the fan, whose first bends change from scan to scan."""
_BRAKE_YAW = 2.5
"""The nose of a braking car turns in by itself: it is held back by so much more."""
_CIRCLE_SHARE = 0.972
_TIGHT_PM, _OTHER_PM = 0.5, 0.15
"""The margin of the fan covers the corners of the outline in gentler bends than this, and arcs that are no more unlike
the chosen one; beyond, the outline is followed along the arc that is really steered."""
_PROMPT_S = 0.03
_NOISY_M, _NOISE_CAUTION_PM = 0.04, 12.0
"""Ranges may err by so much; for what is more, so much of the grip a metre is not planned with."""
_SLOW_MPS = 1.0
_HAIR_M = 0.005
_LEAST_MARGIN_M = 0.015
_INSIDE_M = 0.08
"""Farther inside its outline a slow car takes what it sees for real."""
_CREEP_MPS = 0.6
_AT_STOP, _AT_STOP_MPS = 0.8, 0.15
_DEEP, _DEEP_MPS = 0.4, 1.5
_NEAR_M = 0.03
"""Clearance of the real outline on the way that is steered."""


class PlannerFTG:
    """The race planner: free space about the car where it will be, the fan, the quickest path.

    A scan is mirrored where more room lies to the right, and the command back, so that left and right are alike bit
    for bit; the car's motion since the beams were sent, and until a command acts, is taken out first.
    """

    def __init__(self, config: FtgRaceConfig, body: Body, policy: SpeedPolicy) -> None:
        self._config, self._body, self._policy = config, body, policy
        grip = config.mu * GRAVITY_MPS2
        self._grip_mps2 = grip
        self._limits = RaceLimits(
            config.v_max_mps, config.lateral_share * grip, min(0.68 * grip, config.accel_mps2),
            min(config.brake_share * grip, config.brake_mps2), min(config.corner_brake_share * grip, config.brake_mps2),
            _CIRCLE_SHARE * grip,
        )  # fmt: skip
        self._slip_rad_per_mps2 = config.rear_slip_rad / grip
        self._understeer_rad_per_mps2 = config.understeer_rad / grip
        self._fan = Fan(body.least_radius_m, config.reach_m, config.curvatures, config.bends_m)
        self._space = FreeSpace()
        self._outline = body.wider(_NEAR_M)
        self._beside_m = (body.front_m - body.rear_m) / 2.0
        self._profile: Float64s = np.zeros(2 * HALF + 1)
        self.frame = (0.0, 0.0, 0.0)
        self._chosen = (0, 0.0)
        self._speeds = (0.0, 0.0)
        self._is_mirrored = False
        self._bearing_rad = self._to_left = np.zeros(0)

    def plan(self, scan: Scan) -> Command:
        if self._bearing_rad is not scan.bearing_rad:
            self._bearing_rad, self._to_left = scan.bearing_rad, np.sign(scan.bearing_rad)
        self._is_mirrored = bool(scan.ranges_m @ self._to_left < 0.0)
        if not self._is_mirrored:
            return self._plan(scan)
        return self._plan(scan.mirrored()).mirrored()

    def _plan(self, scan: Scan) -> Command:
        config, motion = self._config, scan.motion
        v = motion.speed_mps
        x, y = self.points(scan)
        is_hit = scan.state != FREE
        half = self._body.half_width_m
        margin = config.safety_margin_m
        side = _least(np.abs(y)[np.abs(x) < self._beside_m]) - half - _HAIR_M
        # nothing is inside a car: what a slow one sees within its outline shows by how much the ranges err
        least = -_INSIDE_M if v < _SLOW_MPS else _LEAST_MARGIN_M
        near = half + max(side, least) if side < margin else None
        profile = self._space.profile(x, y, is_hit, half + margin, config.reach_m, scan.step_rad, near)
        free = self._fan.free_m(profile)
        longest = float(free.max())
        # deep inside its margin the car does not speed up
        most = config.v_max_mps if side > _DEEP * margin else min(config.v_max_mps, max(v, _DEEP_MPS))
        if longest <= config.stop_distance_m and side < margin and v < _SLOW_MPS:
            # no way out of the margin is free: a slow car gives it up as far as it must, a fast one brakes
            profile = self._space.profile(x, y, is_hit, half + max(side, least), config.reach_m, scan.step_rad)
            free = self._fan.free_m(profile)
            longest = float(free.max())
            most = _CREEP_MPS
        self._outline = self._body.wider(min(max(side, 0.0), _NEAR_M))
        if least < side < 0.0:
            self._outline = replace(self._body, half_width_m=half + side)
        short = config.stop_distance_m + max(v, 0.0) * motion.period_s
        over = min(config.compare_m, max(config.compare_share * (longest - config.stop_distance_m), 0.3))
        limits = self._limits_after(motion.age_s + motion.period_s, scan.noise_m)
        times, entry2 = self._fan.times_s(free, v, limits, over, short)
        k1 = self._fan.k1_pm
        times += config.keep_s * np.abs(k1 - motion.curvature_pm)
        best = int(times.argmin())
        self._profile, self._chosen = profile, (best, float(free[best]))
        curvature, near2 = self._blended(times, best, entry2)
        wanted = min(math.sqrt(float(entry2[best]) + _NEAR_SHARE * (near2 - float(entry2[best]))), most)
        curvature = self.within_grip(curvature, v, wanted, _OWN_TURN_SHARE)
        swept = float(free[best])
        if abs(curvature) > _TIGHT_PM or abs(curvature - k1[best]) > _OTHER_PM:
            swept = min(swept, self.outline_free_m(x, y, curvature, v))
        wanted = min(wanted, self._policy.stoppable_mps(swept + config.stop_distance_m, v, motion.period_s))
        self._speeds = (wanted, swept)
        if longest <= config.stop_distance_m or swept < _LEAST_FREE_M:
            return Command(0.0, steering_rad(curvature, 0.0, self._body, 0.0), curvature, longest, is_blocked=True)
        angle = self.steered_rad(curvature, motion, wanted)
        if abs(angle) > _AT_STOP * self._body.max_steering_rad and v > _SLOW_MPS:
            # the wheels are near their stop: speeding up lifts the front, and little is left to make up for it
            wanted = min(wanted, v + _AT_STOP_MPS)
        return Command(wanted, angle, curvature, float(free[best]))

    def points(self, scan: Scan) -> tuple[Float64s, Float64s]:
        """Returns (n,) about the middle of the car where it will be when the command acts, x along its course.

        The course differs from the heading: the middle lies ahead of the axle that rolls, and the tyres of that axle
        drift outwards under load.
        """
        config, motion = self._config, scan.motion
        v, w = motion.speed_mps, motion.yaw_rate_radps
        slip = self._body.middle_m * w / max(abs(v), 1.0) - self._slip_rad_per_mps2 * v * w
        ahead_s = config.actuation_s
        # what touches is as near as the lidar can tell, and not at the lidar itself
        ranges = np.maximum(scan.ranges_m, config.range_min_m)
        x = ranges * scan.unit[0]
        y = ranges * scan.unit[1]
        x += scan.x_m - self._body.middle_m
        y += scan.y_m
        if motion.sweep_s > 0.0:
            # each beam from where the car was then, to where it was at the sweep's end
            late = (1.0 - scan.share) * motion.sweep_s
            x, y = _moved(x, y, v * late, 0.5 * w * v * late * late + v * slip * late, w * late)
        # where it has gone since, and where it will be when the command acts, along its course there
        turn = w * ahead_s
        ahead = _least(x[(np.abs(y) < self._body.half_width_m) & (x > 0.0)])
        # it does not get beyond a wall by being late
        way = min(v * ahead_s, max(ahead - self._beside_m - motion.moved[0], 0.0))
        x0, y0, yaw0 = compose(motion.moved, (way * (1.0 - turn * turn / 6.0), way * (turn / 2.0 + slip), turn + slip))
        middle = self._body.middle_m
        x0, y0 = x0 - middle * (1.0 - math.cos(motion.moved[2])), y0 + middle * math.sin(motion.moved[2])
        x, y = _moved(x, y, x0, y0, yaw0)
        self.frame = (x0, y0, yaw0)
        return x, y

    def _limits_after(self, delay_s: float, noise_m: float) -> RaceLimits:
        """The limits that a command is planned with which is as old as this at its end: it will be a little wrong.

        And so it will where ranges err by much: the way that is found then changes from scan to scan.
        """
        late_s, noisy_m = max(delay_s - _PROMPT_S, 0.0), max(noise_m - _NOISY_M, 0.0)
        if late_s == 0.0 and noisy_m == 0.0:
            return self._limits
        share = max(1.0 - self._config.caution_ps * late_s - _NOISE_CAUTION_PM * noisy_m, 0.3)
        full = self._limits
        return replace(
            full, lateral_mps2=share * full.lateral_mps2, brake_mps2=share * full.brake_mps2,
            corner_brake_mps2=share * full.corner_brake_mps2,
        )  # fmt: skip

    def _blended(self, times: Float64s, best: int, entry2: Float64s) -> tuple[float, float]:
        """The mean first bend of the paths that are nearly as quick as the best one and begin nearly alike, and the
        mean square of the speeds to enter them with.
        """
        near = self._fan.alike(best, _BLEND_PM)
        weight = np.exp((times[best] - times.take(near)) * (1.0 / self._config.blend_s))
        weight *= 1.0 / np.add.reduce(weight)
        return float(weight @ self._fan.k1_pm.take(near)), float(weight @ entry2.take(near))

    def within_grip(self, curvature: float, v: float, wanted: float, turn_share: float = _TURN_SHARE) -> float:
        """No more curvature than the tyres hold at this speed; while it is too fast, less, so that it can brake."""
        if v < _SLOW_MPS:
            return curvature
        share = _too_fast(v, wanted)
        most = (turn_share + share * (_BRAKE_TURN_SHARE - turn_share)) * self._grip_mps2 / (v * v)
        return min(max(curvature, -most), most)

    def steered_rad(self, curvature: float, motion: Motion, wanted: float) -> float:
        """Angle of the front wheels for a curvature: understeer, the load that the motor moves, too much yaw."""
        v, w = motion.speed_mps, motion.yaw_rate_radps
        angle = steering_rad(curvature, v, self._body, self._understeer_rad_per_mps2)
        if v > _SLOW_MPS:
            turning = curvature * v
            # speeding up takes load off the front wheels: they are turned farther. Brakes turn the nose in, see below
            along = self._policy.along_mps2(wanted, v, max(abs(turning), abs(w)) * v)
            grip2 = self._grip_mps2 * self._grip_mps2
            # and only as far as it turns already: the tyres of a car that turns in carry little yet
            turns = min(turning, max(w, 0.0)) if turning > 0.0 else max(turning, min(w, 0.0))
            angle += self._config.load_shift_rad * max(along, 0.0) * turns * v / grip2
            # against too much yaw only: what is missing comes by itself once the tyres have answered
            too_much = max(w - max(turning, 0.0), 0.0) + min(w - min(turning, 0.0), 0.0)
            angle -= self._config.yaw_gain_s * (1.0 + _BRAKE_YAW * _too_fast(v, wanted)) * too_much
        return angle

    def outline_free_m(self, x: Float64s, y: Float64s, curvature: float, v: float) -> float:
        """How far the real outline goes on the arc that is steered; only as far as it matters at this speed."""
        far = 0.6 + max(v, 0.0) * 0.1 + v * v / (2.0 * self._limits.brake_mps2)
        reach = far + self._body.front_m
        near = np.flatnonzero(x * x + y * y < reach * reach)
        if not len(near):
            return far
        return swept_free_m(x[near] + self._body.middle_m, y[near], curvature, self._outline, far)

    def explain(self) -> Explanation:
        best, free = self._chosen
        sign = -1.0 if self._is_mirrored else 1.0
        x0, y0, turn = self.frame
        cos, sin = math.cos(turn), math.sin(turn)
        middle = self._body.middle_m

        def base(points: list[tuple[float, float]]) -> tuple[tuple[float, float], ...]:
            return tuple((middle + x0 + cos * x - sin * y, sign * (y0 + sin * x + cos * y)) for x, y in points)

        at = np.arange(-HALF, HALF + 1, 8)
        rim = self._profile[::8]
        outline = list(zip((rim * np.cos(at * STEP_RAD)).tolist(), (rim * np.sin(at * STEP_RAD)).tolist(), strict=True))
        shown = self._profile if sign > 0.0 else self._profile[::-1]
        return (
            Histogram("free distance", shown.astype(np.float32), -HALF * STEP_RAD, STEP_RAD),
            Polygon("free space", base(outline)),
            Path("chosen path", base(self._fan.points_m(best, free))),
            Scalar("free", free, "m"),
            Scalar("speed limit", self._speeds[0], "m/s"),
            Scalar("arc clearance", self._speeds[1], "m"),
        )


class SeedGap:
    """The seed's steps 1 to 8, with its parameters; limits are per second and a stop passes all limiters."""

    def __init__(self, config: FtgRaceConfig, body: Body, policy: SpeedPolicy, smoother: SteeringSmoother) -> None:
        self._config, self._body, self._policy, self._smoother = config, body, policy, smoother
        self._half_m = body.half_width_m + config.safety_margin_m
        self._ranges: Float64s = np.zeros(1)
        self._first_rad, self._step_rad = 0.0, config.angle_step_rad
        self._target_rad: float | None = None
        self._target_m = 0.0

    def plan(self, scan: Scan) -> Command:
        config = self._config
        blocked = (scan.state == MISSING) if config.beyond_range_is_free else (scan.state != HIT)
        seen = np.where(blocked, 0.0, scan.ranges_m)
        front = gap.front_min_m(scan.bearing_rad, np.where(scan.state == FREE, np.inf, seen), config.front_sector_rad)
        if math.isinf(front):
            front = scan.range_max_m
        step = scan.step_rad
        # a bin that was not seen is no obstacle at the lidar: it blocks itself and paints nothing
        ranges = gap.inflated(np.where(blocked, np.inf, seen), self._half_m, step)
        ranges = gap.extended(ranges, config.disparity_threshold_m, self._half_m, step)
        ranges = gap.bubbled(np.where(blocked, 0.0, ranges), config.bubble_radius_m, step)
        self._ranges, self._first_rad, self._step_rad = ranges, float(scan.bearing_rad[0]), step
        middle = int(np.abs(scan.bearing_rad).argmin())
        kept = None if self._target_rad is None else middle + round(self._target_rad / step)
        chosen = gap.best_gap(gap.gaps(ranges, config.free_threshold_m), middle, kept)
        if chosen is None or front < config.stop_distance_m:
            self._target_rad, self._target_m = None, 0.0
            return Command(0.0, self._smoother.steering_rad, 0.0, max(front, 0.0), is_blocked=True)
        target = gap.aim(ranges, chosen, config.centre_pull, kept, round(config.target_keep_rad / step))
        self._target_rad, self._target_m = float(scan.bearing_rad[target]), float(ranges[target])
        angle = self._smoother.step(self._target_rad, scan.motion.period_s)
        speed = self._policy.by_gains(self._target_m, front, angle)
        return Command(speed, angle, math.tan(angle) / self._body.wheelbase_m, front)

    def explain(self) -> Explanation:
        bins = Histogram("free distance", self._ranges.astype(np.float32), self._first_rad, self._step_rad)
        if self._target_rad is None:
            return (bins,)
        end = (self._target_m * math.cos(self._target_rad), self._target_m * math.sin(self._target_rad))
        return bins, Line("aim", (0.0, 0.0), end), Scalar("aim distance", self._target_m, "m")


def _moved(
    x: Float64s, y: Float64s, dx: float | Float64s, dy: float | Float64s, turn: float | Float64s
) -> tuple[Float64s, Float64s]:
    """Points seen from a place that lies (dx, dy) on and is turned."""
    cos, sin = (math.cos(turn), math.sin(turn)) if isinstance(turn, float) else (np.cos(turn), np.sin(turn))
    x, y = x - dx, y - dy
    return cos * x + sin * y, cos * y - sin * x


def _least(values: Float64s) -> float:
    """The least of some values; inf of none."""
    return float(values.min()) if len(values) else math.inf


def _too_fast(v: float, wanted: float) -> float:
    """0 to 1: how much of the grip goes to braking first."""
    over = v / max(wanted, 0.3) - 1.0
    return min(max((over - _OVER_FROM) / (_OVER_TO - _OVER_FROM), 0.0), 1.0)


def planner_of(
    config: FtgRaceConfig, body: Body, policy: SpeedPolicy, smoother: SteeringSmoother
) -> PlannerFTG | SeedGap:
    """The follow-the-gap planner of the config's method."""
    if config.method == "patches":
        return SeedGap(config, body, policy, smoother)
    return PlannerFTG(config, body, policy)


def still(motion: Motion) -> bool:
    """Whether the car stands."""
    return abs(motion.speed_mps) < 0.08
