"""Rules of the guard as rows: what may pass, what is limited, and what is never limited."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotd.safety.guard import Guard, Guarded, Sensed
from robotd.safety.settings import ContactAllowance, GuardConfig, SlowZone, StopZone, Zones
from robotd.world.kinematics import Ackermann, Differential
from robotd.world.messages import Command, Drive, LidarScan, Steer
from robotd.world.robot import Limits, Robot

ROBOT = Robot(
    kinematics=Differential(track_m=0.12),
    footprint_m=((0.10, 0.08), (0.10, -0.08), (-0.10, -0.08), (-0.10, 0.08)),
    limits=Limits(vx_mps=0.5, wz_radps=2.0, accel_mps2=1.0, decel_mps2=1.0, angular_accel_radps2=8.0),
)
FULL = np.linspace(-math.pi, math.pi, 360, endpoint=False).astype(np.float32)


def scan(
    hits: dict[float, float] | None = None, angles: np.ndarray = FULL, nan_deg: tuple[float, float] | None = None
) -> LidarScan:
    """Nothing within range but `hits` (bearing in degrees: metres); `nan_deg`: an unmeasured sector."""
    ranges = np.full(angles.shape, np.inf, dtype=np.float32)
    for bearing_deg, range_m in (hits or {}).items():
        ranges[np.abs(angles - math.radians(bearing_deg)) < math.radians(1.1)] = range_m
    if nan_deg is not None:
        inside = (angles >= math.radians(nan_deg[0])) & (angles <= math.radians(nan_deg[1]))
        ranges[inside] = np.nan
    return LidarScan(0, ranges, angles)


def limit(
    command: Command,
    seen: LidarScan | None = None,
    *,
    config: GuardConfig | None = None,
    robot: Robot = ROBOT,
    previous: Command | None = None,
    by: str = "test",
    dt_s: float = 0.1,
    stale: str = "",
) -> Guarded:
    guard = Guard(robot, config or GuardConfig())
    sensed: list[Sensed] = [guard.sense("lidar_scan", seen if seen is not None else scan())]
    # Ramps have their own rows: elsewhere the robot is already at the speed that it wants.
    return guard.limit(command, by=by, previous=previous or command, dt_s=dt_s, sensed=sensed, stale=stale)


def speed(guarded: Guarded) -> float:
    assert isinstance(guarded.command, Drive)
    return guarded.command.vx_mps


FORWARD = Drive(0.3)
BACK = Drive(-0.3)
SPIN = Drive(0.0, 1.5)


@pytest.mark.parametrize(
    ("what", "command", "seen", "factor_low", "factor_high"),
    [
        ("free ahead", FORWARD, scan(), 1.0, 1.0),
        ("wall touches the nose", FORWARD, scan({0.0: 0.12}), 0.0, 0.0),
        ("the same wall, driving away", BACK, scan({0.0: 0.12}), 1.0, 1.0),
        ("wall inside the braking way", FORWARD, scan({0.0: 0.17}), 0.05, 0.95),
        ("wall in the slow zone", FORWARD, scan({0.0: 0.24}), 0.3, 0.6),
        ("wall far ahead", FORWARD, scan({0.0: 1.5}), 1.0, 1.0),
        ("post beside the robot, driving past", FORWARD, scan({90.0: 0.20}), 1.0, 1.0),
        ("post behind, driving ahead", FORWARD, scan({179.0: 0.13}), 1.0, 1.0),
        ("post behind, driving back", BACK, scan({179.0: 0.13}), 0.0, 0.0),
        ("corner would swing into a post", SPIN, scan({50.0: 0.121}), 0.0, 0.2),
        ("spin in the open", SPIN, scan({0.0: 2.0}), 1.0, 1.0),
    ],
)
def test_zones_limit_only_what_comes_nearer(
    what: str, command: Drive, seen: LidarScan, factor_low: float, factor_high: float
) -> None:
    out = limit(command, seen).command
    assert isinstance(out, Drive)
    size = math.hypot(out.vx_mps, out.wz_radps) / math.hypot(command.vx_mps, command.wz_radps)
    assert factor_low - 1e-9 <= size <= factor_high + 1e-9, (what, size)


@pytest.mark.parametrize(
    ("what", "angles_deg", "nan_deg", "command", "stopped"),
    [
        ("front lidar, driving ahead", (-100, 100), None, FORWARD, False),
        ("front lidar, backing up blind", (-100, 100), None, BACK, True),
        ("front lidar, spinning sweeps the unseen rear", (-100, 100), None, SPIN, True),
        ("one dead beam is no blindness", (-180, 179), (-1, 1), FORWARD, False),
        ("a dead front sector is", (-180, 179), (-40, 40), FORWARD, True),
        ("a dead front sector does not hold the way back", (-180, 179), (-40, 40), BACK, False),
    ],
)
def test_unseen_directions_are_blind_for_that_motion_only(
    what: str, angles_deg: tuple[int, int], nan_deg: tuple[float, float] | None, command: Drive, stopped: bool
) -> None:
    angles = np.deg2rad(np.arange(angles_deg[0], angles_deg[1] + 1)).astype(np.float32)
    out = limit(command, scan(angles=angles, nan_deg=nan_deg))
    assert (out.command == Drive()) is stopped, (what, out)
    if stopped:
        assert "blind" in out.limited_by
        assert "lidar_scan" in out.reason


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("field", ["vx_mps", "vy_mps", "wz_radps"])
def test_a_command_that_is_not_finite_stops(bad: float, field: str) -> None:
    out = limit(Drive(**{field: bad}), previous=Drive(0.2))
    assert out.command == Drive()
    assert out.limited_by == ("not finite",)


def test_a_stale_scan_stops_and_names_its_source() -> None:
    out = limit(FORWARD, stale="lidar_scan")
    assert out.command == Drive()
    assert "lidar_scan" in out.reason


def test_zones_off_needs_a_reason_and_then_lets_pass() -> None:
    config = GuardConfig(zones=Zones(off="track without obstacles"))
    assert limit(FORWARD, scan({0.0: 0.11}), config=config).command == FORWARD
    with pytest.raises(ValueError, match="one of the two"):
        Zones()
    with pytest.raises(ValueError, match="remove"):
        Zones(off="because", stop=None, slow=SlowZone())


def test_contact_is_allowed_by_name_at_a_creep() -> None:
    config = GuardConfig(
        zones=Zones(stop=StopZone(), slow=SlowZone()), contact=ContactAllowance(behaviours=("dock",), creep_mps=0.04)
    )
    wall = scan({0.0: 0.12})
    assert speed(limit(FORWARD, wall, config=config, by="dock")) == pytest.approx(0.04)
    assert speed(limit(FORWARD, wall, config=config, by="other")) == 0.0


def test_touching_below_the_minimum_range_counts() -> None:
    near = scan({0.0: 0.01})
    assert limit(FORWARD, replace(near, range_min_m=0.05)).command == Drive()
    assert limit(BACK, replace(near, range_min_m=0.05)).command == BACK


def test_range_keeps_the_curvature() -> None:
    out = limit(Drive(1.0, 2.0), previous=Drive(0.5, 1.0)).command
    assert isinstance(out, Drive)
    assert out.vx_mps == pytest.approx(0.5)
    assert out.wz_radps / out.vx_mps == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("previous", "wanted", "dt_s", "vx"),
    [
        (Drive(0.0), Drive(0.3), 0.1, 0.1),
        (Drive(0.3), Drive(0.1), 0.1, 0.2),
        (Drive(0.3), Drive(), 0.001, 0.0),  # a plain stop is never delayed
        (Drive(0.0), Drive(0.3), 5.0, 0.1),  # a loop that was held up earns no extra ramp
        (Drive(0.0), Drive(0.3), 0.0, 0.0),
    ],
)
def test_acceleration_is_limited_and_a_stop_is_not(previous: Drive, wanted: Drive, dt_s: float, vx: float) -> None:
    assert speed(limit(wanted, previous=previous, dt_s=dt_s)) == pytest.approx(vx)


def test_a_car_clamps_steering_first_and_keeps_it() -> None:
    car = Robot(
        kinematics=Ackermann(wheelbase_m=0.25, track_m=0.2, max_steering_rad=0.4),
        footprint_m=((0.35, 0.12), (0.35, -0.12), (-0.1, -0.12), (-0.1, 0.12)),
        limits=Limits(vx_mps=2.0, accel_mps2=4.0, decel_mps2=4.0, angular_accel_radps2=100.0, wz_radps=100.0),
    )
    out = limit(Steer(1.0, 0.9), robot=car).command
    assert out == Steer(pytest.approx(1.0), 0.4)
    stopped = limit(Steer(1.0, 0.1), scan({0.0: 0.37}), robot=car).command
    assert stopped == Steer(0.0, 0.1)


commands = st.builds(Drive, vx_mps=st.floats(-2, 2), wz_radps=st.floats(-8, 8), vy_mps=st.just(0.0))


@given(commands, commands, st.floats(0, 1), st.dictionaries(st.floats(-180, 179), st.floats(0.0, 3.0), max_size=4))
def test_the_result_is_finite_within_limits_and_never_more_than_asked(
    wanted: Drive, previous: Drive, dt_s: float, hits: dict[float, float]
) -> None:
    previous = Drive(max(-0.5, min(0.5, previous.vx_mps)), max(-2.0, min(2.0, previous.wz_radps)))
    out = limit(wanted, scan(hits), previous=previous, dt_s=dt_s).command
    assert isinstance(out, Drive)
    assert math.isfinite(out.vx_mps) and math.isfinite(out.wz_radps)
    assert abs(out.vx_mps) <= 0.5 + 1e-9 and abs(out.wz_radps) <= 2.0 + 1e-9
    assert abs(out.vx_mps) <= max(abs(wanted.vx_mps), abs(previous.vx_mps)) + 1e-9


@given(st.floats(-0.5, 0.5), st.floats(-2, 2), st.dictionaries(st.floats(-180, 179), st.floats(0.1, 1.0), max_size=4))
def test_a_mirrored_world_gives_the_mirrored_command(vx: float, wz: float, hits: dict[float, float]) -> None:
    angles = np.deg2rad(np.arange(-179.5, 180.0)).astype(np.float32)
    plain = limit(Drive(vx, wz), scan(hits, angles)).command
    mirrored = limit(Drive(vx, -wz), scan({-b: r for b, r in hits.items()}, angles)).command
    assert isinstance(plain, Drive) and isinstance(mirrored, Drive)
    assert mirrored.vx_mps == pytest.approx(plain.vx_mps, abs=1e-9)
    assert mirrored.wz_radps == pytest.approx(-plain.wz_radps, abs=1e-9)
