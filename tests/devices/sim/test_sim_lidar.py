"""The lidar twin: exact where faults are off, and each fault as its value says."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from robotd.world.geometry import scan_points_base
from robotd.world.messages import STOP, Drive
from robotd.world.robot import Mount, Robot
from robotd_devices.sim import SimBase, SimBaseConfig, SimLidar, SimLidarConfig
from robotd_devices.sim.lidar import beam_angles_rad
from robotd_devices.sim.maps import map_from_segments

ROOM = map_from_segments(
    [(-2.0, -1.5, 3.0, -1.5), (3.0, -1.5, 3.0, 2.0), (3.0, 2.0, -2.0, 2.0), (-2.0, 2.0, -2.0, -1.5)],
    circles_m=[(1.0, 1.0, 0.1)],
)
EXACT: dict[str, Any] = {"noise_m": 0.0, "noise_share": 0.0, "dropout": 0.0}
PERFECT = SimBaseConfig(
    lag_s=0.0, motor_error=0.0, wheel_error=0.0, track_error=0.0, slip_std=0.0, dead_band_mps=0.0, encoder_ticks=0
)
MOUNT = Mount(x_m=0.05, y_m=-0.02, z_m=0.1, yaw_rad=0.4)


def scans(rig: Any, values: dict[str, Any], drive: Drive = STOP, seconds: float = 1.05, seed: int = 0) -> Any:
    devices = {"base": (SimBase, PERFECT), "lidar": (SimLidar, SimLidarConfig(**values))}
    run = rig(devices, robot=Robot(mounts={"lidar": MOUNT}), world_map=ROOM, seed=seed)
    run.run(seconds, [(0.0, lambda rig: rig.open["base"].apply(drive))])
    return run.messages["lidar"]


@pytest.mark.parametrize(("beams", "fov_rad"), [(1, 1.0), (360, math.tau), (1081, math.radians(270)), (7, 0.5)])
def test_beams_span_the_field_and_none_is_twice(beams: int, fov_rad: float) -> None:
    angles = beam_angles_rad(beams, fov_rad)
    assert angles.dtype == np.float32
    assert len(angles) == beams
    if beams > 1:
        gap = np.diff(angles)
        assert gap == pytest.approx(
            np.full(beams - 1, fov_rad / (beams if fov_rad == math.tau else beams - 1)), abs=1e-6
        )
        assert angles[-1] - angles[0] < math.tau


def test_a_standing_lidar_measures_the_room_to_a_millimetre(rig: Any) -> None:
    scan = scans(rig, {**EXACT, "beams": 720})[-1]
    points = scan_points_base(scan)
    walls = np.stack((points[:, 0] + 2.0, 3.0 - points[:, 0], points[:, 1] + 1.5, 2.0 - points[:, 1]), axis=1).min(
        axis=1
    )
    post = np.abs(np.hypot(points[:, 0] - 1.0, points[:, 1] - 1.0) - 0.1)
    assert len(points) == 720
    assert np.minimum(np.abs(walls), post).max() < 1e-3
    assert (post < 1e-3).sum() > 10
    assert (scan.x_m, scan.y_m, scan.yaw_rad) == (0.05, -0.02, 0.4)


@pytest.mark.parametrize("drive", [Drive(0.4), Drive(0.0, 2.0), Drive(0.3, -1.5)])
def test_each_beam_of_a_moving_sweep_is_from_its_own_instant(rig: Any, drive: Drive) -> None:
    from robotd.world.kinematics import advance

    scan = scans(rig, {**EXACT, "beams": 400}, drive)[-1]
    share = np.arange(400) / 399
    when_s = (scan.start_ns + share * (scan.stamp_ns - scan.start_ns)) / 1e9
    worst = 0.0
    for at_s, bearing, reach in zip(when_s, scan.angles_rad, scan.ranges_m, strict=True):
        x, y, yaw = advance(0.0, 0.0, 0.0, drive, at_s)
        lx, ly = x + math.cos(yaw) * 0.05 + math.sin(yaw) * 0.02, y + math.sin(yaw) * 0.05 - math.cos(yaw) * 0.02
        px, py = lx + reach * math.cos(bearing + yaw + 0.4), ly + reach * math.sin(bearing + yaw + 0.4)
        wall = min(abs(px + 2.0), abs(3.0 - px), abs(py + 1.5), abs(2.0 - py))
        worst = max(worst, min(wall, abs(math.hypot(px - 1.0, py - 1.0) - 0.1)))
    assert worst < 1e-3


def test_a_sweep_from_one_pose_differs_while_turning(rig: Any) -> None:
    moving = scans(rig, {**EXACT}, Drive(0.0, 2.0))[-1]
    frozen = scans(rig, {**EXACT, "moving_sweep": False}, Drive(0.0, 2.0))[-1]
    gap = np.abs(moving.ranges_m - frozen.ranges_m)
    assert gap[0] > 0.01
    assert gap[-1] < 1e-6


def test_sweeps_follow_each_other_without_a_gap(rig: Any) -> None:
    found = scans(rig, {"rate_hz": 10.0})
    assert [scan.stamp_ns for scan in found] == [100_000_000 * n for n in range(1, 11)]
    assert all(scan.start_ns == scan.stamp_ns - 100_000_000 for scan in found)
    assert SimLidar.publish_period_s(SimLidarConfig(rate_hz=10.0)) == 0.1


def test_beyond_the_range_is_nothing_and_below_it_is_touching(rig: Any) -> None:
    far = scans(rig, {**EXACT, "range_max_m": 1.7})[-1]
    assert np.isinf(far.ranges_m).any()
    assert far.ranges_m[np.isfinite(far.ranges_m)].max() <= 1.7
    near = scans(rig, {**EXACT, "range_min_m": 1.7})[-1]
    assert (near.ranges_m < near.range_min_m).any()


def test_noise_and_dropout_have_the_size_that_was_asked_for(rig: Any) -> None:
    exact = scans(rig, {**EXACT, "beams": 4000}, seconds=0.35)
    noisy = scans(rig, {"noise_m": 0.01, "noise_share": 0.0, "dropout": 0.05, "beams": 4000}, seconds=0.35)
    error = np.concatenate([a.ranges_m - b.ranges_m for a, b in zip(noisy, exact, strict=True)])
    assert np.isnan(error).mean() == pytest.approx(0.05, abs=0.01)
    assert np.nanstd(error) == pytest.approx(0.01, rel=0.05)
    assert abs(np.nanmean(error)) < 5e-4
    growing = scans(rig, {"noise_m": 0.0, "noise_share": 0.02, "dropout": 0.0, "beams": 4000}, seconds=0.35)
    share = np.concatenate([(a.ranges_m - b.ranges_m) / b.ranges_m for a, b in zip(growing, exact, strict=True)])
    assert share.std() == pytest.approx(0.02, rel=0.05)
