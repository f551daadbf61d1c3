"""Makes a `LidarScan` of the beams of one revolution: bearings, what no return means, times laid under the arrivals."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robotd.world.messages import Float32s, Float64s, LidarScan
from robotd.world.robot import Mount

_HALF_TURN_DEG = 180.0
_TURN_DEG = 360.0


class ScanMaker:
    """What all spinning lidars make of a revolution.

    Ranges: metres; no return is `inf`, as is more than `range_max_m`; lost beams are there with `nan`; a value below
    `range_min_m` stays as it is (touching). A revolution without one return (covered, blinded, behind glass) says
    nothing about free space: all `nan`, unless `trust_empty`.

    Times: the device measures evenly and its bytes are only ever late, so each scan is laid under the earliest of its
    marks (beam, when it was measured by its arrival). No scan begins before `after_ns`, the end of the last one.
    Beam i was measured at start_ns + (stamp_ns - start_ns) * i / (n - 1), so `LidarScan.beam_ns` is None.
    """

    #: Share of the last scan's beams that had no return, of those that were measured, and share that was lost.
    empty_share = 0.0
    lost_share = 0.0

    def __init__(
        self,
        *,
        range_min_m: float,
        range_max_m: float,
        inverted: bool = False,
        trust_empty: bool = False,
        mount: Mount | None = None,
        after_ns: int = 0,
    ) -> None:
        self._range_min_m = range_min_m
        self._range_max_m = range_max_m
        self._sign = 1.0 if inverted else -1.0
        self._trust_empty = trust_empty
        self._mount = mount if mount is not None else Mount()
        self._stamp_ns = after_ns

    def make(
        self,
        beam_deg: Float64s,
        ranges_m: Float32s,
        intensities: NDArray[np.uint8] | None,
        marks: Sequence[tuple[int, int]],
        beam_ns: float,
    ) -> LidarScan:
        """A scan of n beams in the order in which they were measured, `beam_ns` apart.

        beam_deg: (n,) where each went, clockwise from the mark. ranges_m: (n,), 0 = no return, `nan` = lost; they
        become the scan's own. marks: one or more of (index of a beam, instant in ns at which it was measured).
        """
        n = len(ranges_m)
        clockwise = beam_deg % _TURN_DEG
        clockwise -= _TURN_DEG * (clockwise >= _HALF_TURN_DEG)
        clockwise *= self._sign * math.radians(1.0)
        empty = ranges_m == 0.0
        lost_count, empty_count = int(np.count_nonzero(np.isnan(ranges_m))), int(np.count_nonzero(empty))
        self.lost_share = lost_count / n
        self.empty_share = empty_count / max(1, n - lost_count)
        ranges_m[empty | (ranges_m > self._range_max_m)] = np.inf
        if not self._trust_empty and lost_count + empty_count == n:
            ranges_m[:] = np.nan
        early_ns = min([at_ns - beam * beam_ns for beam, at_ns in marks])
        start_ns = max(int(early_ns), self._stamp_ns + 1)
        stamp_ns = max(start_ns + int((n - 1) * beam_ns), start_ns + n)
        # several turns that came in one moment push each other into the future, but not those that follow
        last_beam, last_ns = marks[-1]
        self._stamp_ns = min(stamp_ns, last_ns + int((n - 1 - last_beam) * beam_ns))
        mount = self._mount
        return LidarScan(
            stamp_ns,
            ranges_m,
            clockwise.astype(np.float32),
            start_ns=start_ns,
            range_min_m=self._range_min_m,
            range_max_m=self._range_max_m,
            x_m=mount.x_m,
            y_m=mount.y_m,
            yaw_rad=mount.yaw_rad,
            intensities=intensities,
        )
