"""The shipped maps can be driven: a follower that knows the truth stays on the tape with realistic wheels."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from robotd.world.messages import Drive
from robotd_devices.sim import SimBase, SimBaseConfig, SimLidar, SimLidarConfig

AHEAD_M = 0.12


class Follower:
    """Steers to a point of the course `AHEAD_M` farther on than the nearest one; never looks back along the tape."""

    def __init__(self, course_m: Any, start_m: tuple[float, float]) -> None:
        reach = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(course_m, axis=0).T))))
        self.along_m = np.arange(0.0, reach[-1], 0.005)
        self.course_m = np.stack([np.interp(self.along_m, reach, course_m[:, k]) for k in (0, 1)], axis=1)
        half = self.course_m[: len(self.course_m) // 2]
        self.at = int(np.hypot(half[:, 0] - start_m[0], half[:, 1] - start_m[1]).argmin())
        self.worst_m = 0.0

    def steer(self, rig: Any) -> None:
        x_m, y_m, yaw_rad = rig.world.pose()
        window = self.course_m[self.at : self.at + 60]
        gaps = np.hypot(window[:, 0] - x_m, window[:, 1] - y_m)
        self.at += int(gaps.argmin())
        self.worst_m = max(self.worst_m, float(gaps.min()))
        if self.at >= len(self.course_m) - 2:
            rig.open["base"].halt()
            return
        goal = self.course_m[min(self.at + round(AHEAD_M / 0.005), len(self.course_m) - 1)] - (x_m, y_m)
        off_rad = math.remainder(math.atan2(goal[1], goal[0]) - yaw_rad, math.tau)
        rig.open["base"].apply(Drive(0.3, 2.0 * 0.3 * math.sin(off_rad) / math.hypot(*goal)))


@pytest.mark.parametrize(("name", "seconds"), [("line_track", 25.0), ("line_loop", 26.0)])
def test_the_course_can_be_driven_and_the_room_keeps_its_distance(rig: Any, name: str, seconds: float) -> None:
    from robotd_devices.sim import load_map

    world_map = load_map(name)
    course_m = world_map.lines[0].points_m
    if name == "line_loop":
        course_m = np.vstack((course_m, course_m[1:]))
    follower = Follower(course_m, world_map.start[:2])
    devices = {"base": (SimBase, SimBaseConfig()), "lidar": (SimLidar, SimLidarConfig(dropout=0.0))}
    run = rig(devices, map=name, seed=2)
    run.run(seconds, [(n * 0.05, follower.steer) for n in range(round(seconds / 0.05))])
    assert run.world.collisions == 0
    assert follower.worst_m < 0.025, "never a whole tape's half width off"
    assert min(float(scan.ranges_m.min()) for scan in run.messages["lidar"]) > 0.6
    if name == "line_track":
        assert run.world.pose()[:2] == pytest.approx((0.0, 2.2), abs=0.05)
        assert run.world.velocity.vx_mps == 0.0
    else:
        assert follower.at * 0.005 > 7.0, "more than a whole lap"
