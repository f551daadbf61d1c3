"""What every spinning lidar checks of a whole scan before it publishes it."""

from __future__ import annotations

from typing import Any

from robotd.authoring.device import Sensor
from robotd.world.messages import LidarScan
from robotd_devices.lidar.scan_maker import ScanMaker

_OFF_SPEED = 0.3


def deliver(sensor: Sensor[Any, LidarScan], scan: LidarScan, maker: ScanMaker, rotation_hz: float, now_ns: int) -> None:
    """Publish a scan, unless the program stalled and it is older than a revolution; count what is odd about it."""
    fault = sensor.context.link.fault
    turn_s = (scan.stamp_ns - scan.start_ns) / 1e9
    if maker.lost_share > 0.0:
        fault("lost packets", f"{maker.lost_share:.0%} of a scan not measured")
    if maker.empty_share == 1.0:
        fault("no return anywhere", "covered, blinded or in the open")
    if abs(1.0 / turn_s - rotation_hz) > _OFF_SPEED * rotation_hz:
        fault("rotation off", f"{1.0 / turn_s:.1f} Hz, the config says {rotation_hz:g}")
    if now_ns - scan.stamp_ns > 1e9 * turn_s:
        fault("old scan dropped", f"{(now_ns - scan.stamp_ns) / 1e9:.3f} s old: the program stalled")
        return
    sensor.publish(scan)
