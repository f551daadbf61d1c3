"""Where the car has gone since a scan, by dead reckoning from what its wheels told."""

from __future__ import annotations

from collections import deque

from robotd.world.clock import NS_PER_S
from robotd.world.kinematics import advance
from robotd.world.messages import Drive

_KEPT = 32


class WaySince:
    """Speeds and yaw rates as they came, each held until the next.

    slip_rad_per_mps2: the rear axle drifts outwards by this angle for each m/s^2 of lateral acceleration.
    """

    def __init__(self, slip_rad_per_mps2: float = 0.0) -> None:
        self._slip_rad_per_mps2 = slip_rad_per_mps2
        self._told: deque[tuple[int, float, float]] = deque(maxlen=_KEPT)

    def add(self, now_ns: int, speed_mps: float, yaw_rate_radps: float) -> None:
        """What is true from now on."""
        self._told.append((now_ns, speed_mps, yaw_rate_radps))

    def since(self, then_ns: int, now_ns: int) -> tuple[float, float, float]:
        """Base at `now_ns` seen in base at `then_ns`; before the first that was told it went as then."""
        pose = (0.0, 0.0, 0.0)
        if not self._told or now_ns <= then_ns:
            return pose
        until_ns = now_ns
        pieces = []
        for at_ns, v, w in reversed(self._told):
            from_ns = max(at_ns, then_ns)
            if from_ns < until_ns:
                pieces.append((v, w, (until_ns - from_ns) / NS_PER_S))
                until_ns = from_ns
            if at_ns <= then_ns:
                break
        if until_ns > then_ns:
            _, v, w = self._told[0]
            pieces.append((v, w, (until_ns - then_ns) / NS_PER_S))
        for v, w, passed_s in reversed(pieces):
            pose = advance(*pose, Drive(v, w, -self._slip_rad_per_mps2 * v * v * w), passed_s)
        return pose
