"""The world's grid, the base's wheels, contact, and that one seed gives one run."""

from __future__ import annotations

import asyncio
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robotd.authoring.device import DeviceContext, DeviceMisconfigured
from robotd.world.clock import ManualClock, ns
from robotd.world.kinematics import Ackermann, Differential, Mecanum, advance
from robotd.world.messages import Drive, Steer
from robotd.world.robot import Robot
from robotd_devices.sim import (
    Card,
    FlatWorld,
    FlatWorldConfig,
    FloorLine,
    Person,
    SimBase,
    SimBaseConfig,
    SimBattery,
    SimBatteryConfig,
    SimBumper,
    SimBumperConfig,
    SimCamera,
    SimCameraConfig,
    SimImu,
    SimImuConfig,
    SimLidar,
    SimLidarConfig,
    walk_along,
    world_from_segments,
)
from robotd_devices.sim.maps import map_from_segments
from robotd_devices.sim.touch import Outline
from robotd_devices.sim.wheels import Wheels, WheelSettings

PERFECT = SimBaseConfig(
    lag_s=0.0, motor_error=0.0, wheel_error=0.0, track_error=0.0, slip_std=0.0, dead_band_mps=0.0, encoder_ticks=0
)
OPEN = map_from_segments()
STEP_NS = 5_000_000


def base(config: SimBaseConfig = PERFECT) -> dict[str, tuple[type[Any], Any]]:
    return {"base": (SimBase, config)}


def told(drive: Drive) -> Any:
    return lambda rig: rig.open["base"].apply(drive)


# ------------------------------------------------------------------------------- kinematics and true motion


@pytest.mark.parametrize(
    ("drive", "wheels"),
    [
        (Drive(1.0, 0.0, 0.0), (20.0, 20.0, 20.0, 20.0)),
        (Drive(0.0, 0.0, 1.0), (-20.0, 20.0, 20.0, -20.0)),
        (Drive(0.0, 1.0, 0.0), (-4.0, 4.0, -4.0, 4.0)),
    ],
)
def test_mecanum_wheels_of_the_known_vectors_move_the_body_as_told(
    drive: Drive, wheels: tuple[float, float, float, float]
) -> None:
    kinematics = Mecanum(wheelbase_m=0.2, track_m=0.2, wheel_radius_m=0.05)
    assert kinematics.wheel_speeds(drive) == pytest.approx(wheels)
    moving = Wheels(kinematics, PERFECT, np.random.default_rng(0), STEP_NS)
    moving.command(drive)
    true = moving.step()
    assert (true.vx_mps, true.vy_mps, true.wz_radps) == pytest.approx((drive.vx_mps, drive.vy_mps, drive.wz_radps))


def test_a_quarter_turn_ends_where_the_known_vector_says(rig: Any) -> None:
    run = rig(base(), world_map=OPEN).run(1.0, [(0.0, told(Drive(1.0, math.pi / 2.0)))])
    assert run.world.pose() == pytest.approx((0.63662, 0.63662, math.pi / 2.0), abs=1e-5)


@pytest.mark.parametrize(("vx", "wz"), [(0.2, 1.0), (0.5, -2.0), (-0.3, 0.7)])
def test_a_full_circle_closes(rig: Any, vx: float, wz: float) -> None:
    turn_s = round(math.tau / abs(wz) / 0.005) * 0.005
    wz = math.copysign(math.tau / turn_s, wz)
    run = rig(base(), world_map=OPEN).run(turn_s, [(0.0, told(Drive(vx, wz)))])
    assert run.world.pose() == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    end = run.messages["base"][-1]
    assert math.hypot(end.x_m, end.y_m) <= abs(vx) * 0.02 + 1e-9


@settings(deadline=None, max_examples=30)
@given(st.floats(-1.0, 1.0), st.floats(-3.0, 3.0), st.integers(1, 300))
def test_steps_of_the_grid_add_up_to_one_exact_arc(vx: float, wz: float, steps: int) -> None:
    clock = ManualClock()
    world = FlatWorld(FlatWorldConfig(), DeviceContext("world", clock), OPEN)
    wheels = Wheels(Differential(0.12), PERFECT, np.random.default_rng(0), world.step_ns)
    wheels.command(Drive(vx, wz))
    world.attach(wheels)
    clock.set_ns(steps * STEP_NS)
    found, exact = world.pose(), advance(0.0, 0.0, 0.0, Drive(vx, wz), steps * 0.005)
    assert found[:2] == pytest.approx(exact[:2], abs=1e-9)
    assert math.remainder(found[2] - exact[2], math.tau) == pytest.approx(0.0, abs=1e-9)
    assert wheels.odometry == pytest.approx(exact, abs=1e-9) or abs(abs(exact[2]) - math.pi) < 1e-6


def test_the_lag_is_of_first_order(rig: Any) -> None:
    config = PERFECT.model_copy(update={"lag_s": 0.1})
    speeds: list[float] = []

    def look(run: Any) -> None:
        run.world.advance()
        speeds.append(run.world.velocity.vx_mps)

    rig(base(config), world_map=OPEN).run(0.2, [(0.0, told(Drive(1.0))), (0.1, look)])
    assert speeds[0] == pytest.approx(1.0 - math.exp(-1.0), abs=1e-9)


def test_halt_stops_within_the_lag_and_standing_is_exact(rig: Any) -> None:
    config = PERFECT.model_copy(update={"lag_s": 0.05})
    run = rig(base(config), world_map=OPEN).run(
        3.0, [(0.0, told(Drive(0.5))), (1.0, lambda rig: rig.open["base"].halt())]
    )
    stopped = [m for m in run.messages["base"] if m.stamp_ns > ns(2.0)]
    assert {m.vx_mps for m in stopped} == {0.0}
    assert len({m.x_m for m in stopped}) == 1


def test_odometry_comes_at_its_rate_stamped_with_now(rig: Any) -> None:
    run = rig(base(), world_map=OPEN).run(1.0)
    stamps = [m.stamp_ns for m in run.messages["base"]]
    assert stamps == [n * 20_000_000 for n in range(1, len(stamps) + 1)]
    assert len(stamps) in (49, 50)


def test_real_wheels_make_the_odometry_drift_by_a_few_percent(rig: Any) -> None:
    drifts = []
    for seed in range(6):
        run = rig(base(SimBaseConfig()), world_map=OPEN, seed=seed).run(20.0, [(0.0, told(Drive(0.2)))])
        true, measured = run.world.pose(), run.messages["base"][-1]
        drifts.append(math.hypot(true[0] - measured.x_m, true[1] - measured.y_m))
    assert min(drifts) > 0.005
    assert max(drifts) < 3.0


def test_motor_error_is_seen_by_the_encoders_and_not_by_the_command(rig: Any) -> None:
    config = PERFECT.model_copy(update={"motor_error": 0.1})
    run = rig(base(config), world_map=OPEN, seed=3).run(2.0, [(0.0, told(Drive(0.3)))])
    end = run.messages["base"][-1]
    assert abs(end.wz_radps) > 1e-3, "the base curves though told to go straight"
    assert run.world.poses(np.array([end.stamp_ns]))[0, 2] == pytest.approx(end.yaw_rad, abs=1e-12)


# ---------------------------------------------------------------------------------------------- contact

ROBOT = Robot(footprint_m=((0.1, 0.05), (0.1, -0.05), (-0.1, -0.05), (-0.1, 0.05)))


@pytest.mark.parametrize(
    ("world_map", "gap_m"),
    [
        (map_from_segments([(1.0, -1.0, 1.0, 1.0)]), 0.9),
        (map_from_segments(circles_m=[(1.0, 0.0, 0.2)]), 0.7),
        (map_from_segments([(0.7, 0.0, 2.0, 0.0)]), 0.6),
    ],
    ids=["wall", "post", "wall end on"],
)
def test_contact_stops_the_base_where_the_outline_meets_the_thing(rig: Any, world_map: Any, gap_m: float) -> None:
    run = rig(base(), robot=ROBOT, world_map=world_map).run(4.0, [(0.0, told(Drive(0.5)))])
    x_m, y_m, yaw_rad = run.world.pose()
    assert gap_m - 0.0025 <= x_m < gap_m
    assert (y_m, yaw_rad) == (0.0, 0.0)
    assert run.world.blocked
    assert run.world.collisions == 1
    assert run.messages["base"][-1].x_m > x_m + 0.5, "wheels that spin still count"


def test_the_way_back_is_free_and_a_second_contact_counts(rig: Any) -> None:
    wall = map_from_segments([(0.5, -1.0, 0.5, 1.0)])
    there, back = told(Drive(0.5)), told(Drive(-0.5))
    run = rig(base(), robot=ROBOT, world_map=wall).run(4.0, [(0.0, there), (1.5, back), (2.0, there)])
    assert run.world.collisions == 2


def test_turning_on_the_spot_into_a_wall_is_a_contact(rig: Any) -> None:
    wall = map_from_segments([(-1.0, 0.08, 1.0, 0.08)])
    run = rig(base(), robot=ROBOT, world_map=wall).run(2.0, [(0.0, told(Drive(0.0, 1.0)))])
    assert run.world.collisions == 1
    corner_rad = math.asin(0.08 / math.hypot(0.1, 0.05)) - math.atan2(0.05, 0.1)
    assert run.world.pose()[2] == pytest.approx(corner_rad, abs=0.006)


@settings(deadline=None, max_examples=150)
@given(st.integers(0, 2**32 - 1))
def test_clearance_never_promises_too_much(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ends = rng.uniform(-1, 1, (6, 2))
    world_map = map_from_segments(
        np.hstack((ends, ends + rng.normal(0, 0.4, (6, 2)))), circles_m=[(*rng.uniform(-1, 1, 2), 0.05)]
    )
    outline = Outline(ROBOT.footprint_m, world_map)
    x_m, y_m = rng.uniform(-1, 1, 2).tolist()
    free_m = outline.clearance_m(x_m, y_m)
    if free_m > 0.0:
        way_rad, yaw_rad = rng.uniform(-math.pi, math.pi, 2).tolist()
        there = (x_m + 0.999 * free_m * math.cos(way_rad), y_m + 0.999 * free_m * math.sin(way_rad))
        assert not outline.touches(*there, yaw_rad)


@settings(deadline=None, max_examples=150)
@given(st.integers(0, 2**32 - 1))
def test_touching_agrees_with_a_slow_look_along_every_wall(seed: int) -> None:
    rng = np.random.default_rng(seed)
    start = rng.uniform(-0.3, 0.3, 2)
    end = start + rng.normal(0, 0.3, 2)
    outline = Outline(ROBOT.footprint_m, map_from_segments([(*start, *end)]))
    x_m, y_m, yaw_rad = *rng.uniform(-0.2, 0.2, 2), rng.uniform(-3, 3)
    along = start + np.linspace(0.0, 1.0, 4001)[:, None] * (end - start) - (x_m, y_m)
    fore = along @ (math.cos(yaw_rad), math.sin(yaw_rad))
    left = along @ (-math.sin(yaw_rad), math.cos(yaw_rad))
    depth = np.maximum(np.abs(fore) - 0.1, np.abs(left) - 0.05).min()
    if abs(depth) > 2e-4:
        assert outline.touches(x_m, y_m, yaw_rad) == (depth < 0.0)


# ------------------------------------------------------------------------------------- past, order, seed


def test_the_past_is_remembered_for_a_second_and_the_present_goes_on(rig: Any) -> None:
    asked: list[Any] = []

    def ask(run: Any) -> None:
        now = ns(12.3471)
        asked.append(run.world.poses(np.array([now - ns(0.9), now - ns(0.1), now])))

    rig(base(), world_map=OPEN).run(12.5, [(0.0, told(Drive(0.25))), (12.3471, ask)])
    assert asked[0][:, 0] == pytest.approx(0.25 * np.array([11.4471, 12.2471, 12.3471]), abs=1e-9)


def everything() -> dict[str, tuple[type[Any], Any]]:
    return {
        "imu": (SimImu, SimImuConfig()),
        "bumper": (SimBumper, SimBumperConfig()),
        "battery": (SimBattery, SimBatteryConfig(rate_hz=10.0)),
        "base": (SimBase, SimBaseConfig()),
        "lidar": (SimLidar, SimLidarConfig(beams=90)),
        "camera": (SimCamera, SimCameraConfig(width_px=80, height_px=60, frame_loss=0.2)),
    }


def mounted() -> Robot:
    from robotd.world.robot import Mount

    return Robot(mounts={"camera": Mount(x_m=0.06, z_m=0.11, pitch_rad=0.35), "lidar": Mount(z_m=0.1)})


def bytes_of(run: Any) -> dict[str, list[Any]]:
    return {
        **{
            name: [repr(m) for m in run.messages[name]]
            for name in ("base", "imu", "bumper", "battery")
            if name in run.messages
        },
        "lidar": [m.ranges_m.tobytes() for m in run.messages["lidar"]],
        "camera": [(m.stamp_ns, m.sequence, m.bgr.tobytes()) for m in run.messages["camera"]],
    }


def weave(run_rig: Any, devices: dict[str, Any], seed: int) -> Any:
    script = [(0.0, told(Drive(0.2, 0.3))), (0.4, told(Drive(0.1, -1.0))), (0.9, told(Drive(0.3)))]
    world_map = map_from_segments(
        [(2.0, -1.0, 2.0, 1.0)],
        lines=[FloorLine(np.array([(-1.0, 0.0), (3.0, 0.0)]))],
        cards=[Card(1.0, 0.3, 3.0, text="L")],
        people=[Person(walk_along([(1.5, -1.0), (1.5, 1.0)], 1.0))],
    )
    return run_rig(devices, robot=mounted(), seed=seed, world_map=world_map).run(1.5, script)


def test_one_seed_is_one_run_bit_for_bit_whatever_order_devices_stand_in(rig: Any) -> None:
    first = bytes_of(weave(rig, everything(), 7))
    assert bytes_of(weave(rig, everything(), 7)) == first
    turned = dict(reversed(everything().items()))
    assert bytes_of(weave(rig, turned, 7)) == first
    other = bytes_of(weave(rig, everything(), 8))
    # nothing is touched, and so the bumper has nothing to tell
    assert all(other[name] != first[name] for name in first if name != "bumper")


def test_a_device_more_changes_nothing_for_the_others(rig: Any) -> None:
    few = {name: entry for name, entry in everything().items() if name != "camera"}
    alone, together = weave(rig, few, 5), weave(rig, everything(), 5)
    assert [m.ranges_m.tobytes() for m in alone.messages["lidar"]] == [
        m.ranges_m.tobytes() for m in together.messages["lidar"]
    ]


# ---------------------------------------------------------------------------------------------- refusals


@pytest.mark.parametrize("cls", [SimBase, SimLidar, SimCamera])
def test_a_twin_without_its_world_says_what_to_write(cls: Any) -> None:
    device = cls(cls.config_type(), DeviceContext("thing"))
    with pytest.raises(DeviceMisconfigured, match=r"thing: .*needs the world `flat_world`.*--sim"):
        asyncio.run(device.open())


def test_a_car_is_refused_in_words(rig: Any) -> None:
    car = Robot(kinematics=Ackermann(0.25, 0.2, 0.4))
    with pytest.raises(DeviceMisconfigured, match="a car is simulated by sim_car"):
        rig(base(), robot=car, world_map=OPEN).run(0.1)


def test_a_steering_command_is_not_mistaken_for_a_drive() -> None:
    with pytest.raises(TypeError, match="takes Drive, not Steer"):
        SimBase(PERFECT).apply(Steer(1.0))  # type: ignore[arg-type]


def test_two_bases_in_one_world_are_refused(rig: Any) -> None:
    with pytest.raises(DeviceMisconfigured, match="moves one base"):
        rig({**base(), "second": (SimBase, PERFECT)}, world_map=OPEN).run(0.1)


def test_a_start_inside_a_wall_is_refused() -> None:
    with pytest.raises(DeviceMisconfigured, match="touches a wall or post at `start`"):
        asyncio.run(world_from_segments([(0.05, -1.0, 0.05, 1.0)]).open())


def test_an_unknown_map_is_refused_with_the_shipped_ones() -> None:
    with pytest.raises(DeviceMisconfigured, match="line_loop, line_track"):
        asyncio.run(FlatWorld(FlatWorldConfig(map="no_such_map")).open())


def test_a_closed_base_leaves_the_robot_standing_and_may_come_back(rig: Any) -> None:
    seen: list[float] = []

    async def cycle(run: Any) -> None:
        await run.open["base"].close()
        before = run.world.pose()
        await asyncio.sleep(0.5)
        seen.append(run.world.pose()[0] - before[0])
        await run.open["base"].open()
        run.open["base"].apply(Drive(0.5))
        await asyncio.sleep(0.1)
        seen.append(run.world.pose()[0] - before[0])

    tasks: list[Any] = []
    rig(base(), world_map=OPEN).run(
        3.0, [(0.0, told(Drive(0.5))), (1.0, lambda run: tasks.append(asyncio.ensure_future(cycle(run))))]
    )
    assert seen == pytest.approx([0.0, 0.05], abs=1e-9)


def test_wheel_settings_refuse_what_cannot_be() -> None:
    with pytest.raises(ValueError, match="greater than or equal to 0"):
        WheelSettings(lag_s=-0.1)
