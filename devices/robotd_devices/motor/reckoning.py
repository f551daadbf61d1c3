"""Where a base without encoders ought to be: its commands through a lag, added up. A guess that names itself one."""

from __future__ import annotations

import math

from robotd.world.clock import NS_PER_S
from robotd.world.kinematics import Differential, advance
from robotd.world.messages import Odometry

_LONGEST_STEP_S = 0.02


class CommandedOdometry:
    """Dead reckoning from the rim speeds that were told, each reached with the time constant `lag_s`.

    Nothing is measured: slip, load, battery, a blocked wheel and a push are not seen. The frame starts at 0, 0, 0 and
    goes on over a reconnect.
    """

    def __init__(self, body: Differential, lag_s: float) -> None:
        self._body = body
        self._lag_s = lag_s
        self._pose = (0.0, 0.0, 0.0)
        self._now_ns = 0
        self._told = self._rims = (0.0, 0.0)

    def start(self, now_ns: int) -> None:
        """Stand still at the present pose from `now_ns` on."""
        self._now_ns = now_ns
        self._told = self._rims = (0.0, 0.0)

    def tell(self, rims_mps: tuple[float, float], now_ns: int) -> None:
        """The wheels were told these rim speeds (left, right) at `now_ns`."""
        self._go_on(now_ns)
        self._told = rims_mps

    def at(self, now_ns: int) -> Odometry:
        """Pose and velocity at `now_ns`, which never goes back."""
        self._go_on(now_ns)
        x_m, y_m, yaw_rad = self._pose
        drive = self._body.body(*self._rims)
        return Odometry(now_ns, x_m, y_m, yaw_rad, drive.vx_mps, drive.vy_mps, drive.wz_radps)

    def _go_on(self, now_ns: int) -> None:
        rest_s = (now_ns - self._now_ns) / NS_PER_S
        self._now_ns = max(self._now_ns, now_ns)
        while rest_s > 0.0 and (any(self._rims) or any(self._told)):
            step_s = min(rest_s, _LONGEST_STEP_S)
            rest_s -= step_s
            self._step(step_s)

    def _step(self, step_s: float) -> None:
        """Exact for the rims; the pose takes their mean over the step."""
        if self._lag_s > 0.0:
            keep = math.exp(-step_s / self._lag_s)
            share = self._lag_s / step_s * (1.0 - keep)
        else:
            keep = share = 0.0
        (left, right), (to_left, to_right) = self._rims, self._told
        mean = self._body.body(to_left + (left - to_left) * share, to_right + (right - to_right) * share)
        self._pose = advance(*self._pose, mean, step_s)
        self._rims = (_settle(to_left + (left - to_left) * keep), _settle(to_right + (right - to_right) * keep))


def _settle(rim_mps: float) -> float:
    """A wheel that is all but still is still."""
    return rim_mps if abs(rim_mps) > 1e-4 else 0.0
