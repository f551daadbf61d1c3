"""What the behaviour sees in one step."""

from __future__ import annotations

from robotd import LidarScan, Odometry, View, every, latest, needed
from robotd_plugins.toolkit.line_seen import LineSeen


class Sees(View):
    """Each look at the line, with the odometry of that moment; the lidar's word where the robot has one."""

    line: LineSeen = every(within_s=0.25)
    odometry: Odometry = needed(within_s=0.1)
    scan: LidarScan | None = latest(within_s=0.25)
