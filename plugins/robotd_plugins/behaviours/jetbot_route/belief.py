"""Where the robot is on the map: the last node, the edge after it, progress along it, and how far odometry is off."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

_PLACE_STD_M = 0.025
_SCALE_STD_MIN = 0.02
_BAND_SHARE = 0.45


@dataclass(frozen=True, slots=True)
class Belief:
    """A place on a route; it changes only by `towards`, `arrived` and `left`.

    node: the last one that was reached. next_node: where the edge leads, with its length edge_m in metres of the map;
    None at the end of the route. from_m: reading of the robot's odometer over the last node at which its place was
    seen. counted_m: metres of the map from there to `node` (more than 0 where nodes were only counted).
    scale: metres of the map for one metre of the odometer, and scale_std how unsure that is.
    """

    node: str
    next_node: str | None = None
    edge_m: float = math.nan
    from_m: float = 0.0
    counted_m: float = 0.0
    scale: float = 1.0
    scale_std: float = 0.1

    @property
    def expected_m(self) -> float:
        """Odometer reading at which the next node is expected; nan at the end of the route."""
        return self.from_m + (self.counted_m + self.edge_m) / self.scale

    @property
    def unsure_m(self) -> float:
        """Standard deviation of where the next node is, in metres of the map."""
        return self.scale_std * (self.counted_m + self.edge_m)

    def half_window_m(self, tolerance_m: float) -> float:
        """How far from `expected_m` the next node may be found: never so far that its neighbours come into question."""
        window_m = tolerance_m + 2.0 * self.unsure_m
        return min(window_m, max(_BAND_SHARE * self.edge_m, tolerance_m)) / self.scale

    def progress_m(self, travelled_m: float) -> float:
        """Metres of the map from `node` on."""
        return (travelled_m - self.from_m) * self.scale - self.counted_m

    def towards(self, next_node: str, edge_m: float) -> Belief:
        """The edge that is driven now."""
        return replace(self, next_node=next_node, edge_m=edge_m)

    def counted(self) -> Belief:
        """The next node was passed where odometry puts it; nothing was seen of it."""
        assert self.next_node is not None
        return replace(
            self, node=self.next_node, next_node=None, counted_m=self.counted_m + self.edge_m, edge_m=math.nan
        )

    def arrived(self, at_m: float) -> Belief:
        """The next node was seen and the odometer read `at_m` over it: the place is exact again, the scale learns."""
        assert self.next_node is not None
        way_m, read_m = self.counted_m + self.edge_m, at_m - self.from_m
        scale, std = self.scale, self.scale_std
        if read_m > 0.0:
            noise = math.sqrt(2.0) * _PLACE_STD_M / way_m
            gain = std**2 / (std**2 + noise**2)
            scale += gain * (way_m / read_m - scale)
            std = max(std * math.sqrt(1.0 - gain), _SCALE_STD_MIN)
        return Belief(self.next_node, None, math.nan, at_m, 0.0, scale, std)

    def left(self, travelled_m: float) -> Belief:
        """The robot turned on the spot over `node`, and leaves it now."""
        return replace(self, from_m=travelled_m, counted_m=0.0)
