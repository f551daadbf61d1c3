"""How a mount's roll, pitch and yaw turn the vectors of a sensor into those of base."""

from __future__ import annotations

import math

import numpy as np

from robotd.world.messages import Float64s
from robotd.world.robot import Mount


def sensor_base(mount: Mount) -> Float64s:
    """Rotation (3, 3) of a sensor seen in base: `sensor_base(mount) @ v` is a vector v of the sensor's frame in base.

    Roll about x first, then pitch about y (positive: nose down), then yaw about z, all counter-clockwise (REP-103).
    """
    (cr, sr), (cp, sp), (cy, sy) = (
        (math.cos(angle), math.sin(angle)) for angle in (mount.roll_rad, mount.pitch_rad, mount.yaw_rad)
    )
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ],
        dtype=np.float64,
    )
