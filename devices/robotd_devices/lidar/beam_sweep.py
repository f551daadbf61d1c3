"""Joins beams of any spinning lidar into one `LidarScan` a revolution: true angles, true times, gaps kept apart."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robotd.world.messages import Float32s, Float64s, LidarScan
from robotd.world.robot import Mount

_HALF_TURN_DEG = 180.0
_TURN_DEG = 360.0

#: A wider gap cannot be told from a step back, nor from a gap of a turn more.
LONGEST_GAP_DEG = 270.0


class Beams(NamedTuple):
    """Beams in the order in which they were measured, all arrays (n,).

    head_deg: where the head stood, clockwise from the mark; it advances evenly, and revolutions are told apart by it.
    beam_deg: where the beam went, clockwise; differs from the head on triangulating lidars. metres: 0 = no return,
    `nan` = lost. quality: or None where the format has none.
    """

    head_deg: Float64s
    beam_deg: Float64s
    metres: Float32s
    quality: NDArray[np.uint8] | None = None


class BeamSweep:
    """Collects beams and gives a scan with those that end a revolution.

    A revolution begins and ends where the head passes the device angle `seam_deg`; with 180 (the default) that is
    behind the lidar. Beams stay in the order in which they were measured, and are measured `beam_ns` apart: beam i at
    start_ns + (stamp_ns - start_ns) * i / (n - 1), so `LidarScan.beam_ns` is None.

    Ranges: metres; no return is `inf`, as is more than `range_max_m`; lost beams are there with `nan`; a value below
    `range_min_m` stays as it is (touching). A revolution without one return (covered, blinded, behind glass) says
    nothing about free space: all `nan`, unless `trust_empty`.

    Times: the device measures evenly and its bytes are only ever late, so each scan is laid under the earliest of its
    marks (beam, when it was measured by its arrival). No scan begins before `after_ns`, the end of the last one.
    """

    def __init__(
        self,
        *,
        beam_ns: float,
        range_min_m: float,
        range_max_m: float,
        inverted: bool = False,
        seam_deg: float = 180.0,
        trust_empty: bool = False,
        mount: Mount | None = None,
        after_ns: int = 0,
    ) -> None:
        self.beam_ns = beam_ns
        self._range_min_m = range_min_m
        self._range_max_m = range_max_m
        self._sign = 1.0 if inverted else -1.0
        self._seam_deg = seam_deg
        self._trust_empty = trust_empty
        self._mount = mount if mount is not None else Mount()
        self._stamp_ns = after_ns
        self.reset()

    #: Share of the last scan's beams that had no return, and that were lost.
    empty_share = 0.0
    lost_share = 0.0

    def after_seam(self, head_deg: float) -> float:
        """How far the head is behind the seam, degrees in [0, 360)."""
        return (head_deg - self._seam_deg) % _TURN_DEG

    def reset(self) -> None:
        """Forget the open revolution and wait for the next seam: half a revolution is not published."""
        self._whole = False
        self._last_at: float | None = None
        self._begin()

    def _begin(self) -> None:
        self._runs: list[Beams] = []
        self._beams = 0
        self._marks: list[tuple[int, int]] = []

    def add(self, beams: Beams, marks: Sequence[tuple[int, int]], then_deg: float) -> LidarScan | None:
        """Take the next beams (less than a turn of them); the scan that they end, if they do.

        marks: (index in these beams, instant in ns) of beams whose time is known; the index may lie outside.
        then_deg: where the head stands behind the last beam, so that a revolution that ends there is not kept back.
        """
        n = len(beams.head_deg)
        at = np.empty(n + 2)
        at[1:-1] = self.after_seam(0.0) + beams.head_deg
        at[1:-1] %= _TURN_DEG
        at[-1] = self.after_seam(then_deg)
        at[0] = at[1] if self._last_at is None else self._last_at
        if at[1] - at[0] > _HALF_TURN_DEG:
            # the head is guessed behind a gap, and was guessed just over the seam
            behind = np.flatnonzero(at[2:] - at[1:-1] < -_HALF_TURN_DEG)
            at[1 : behind[0] + 2 if len(behind) else None] = at[0]
        seams = np.flatnonzero(at[1:] - at[:-1] < -_HALF_TURN_DEG)
        self._last_at = float(at[-1])
        if not len(seams):
            self._extend(beams, marks, self._beams)
            return None
        if len(seams) > 1:
            # more than a turn at once cannot be told apart
            self.reset()
            return None
        cut = int(seams[0])
        first = self._beams
        self._extend(_part(beams, slice(0, cut)), marks, first)
        scan = self._scan() if self._whole and self._marks and self._beams > 1 else None
        self._begin()
        self._whole = True
        self._extend(_part(beams, slice(cut, None)), marks, -cut)
        return scan

    def gap(self, to_deg: float, step_deg: float) -> LidarScan | None:
        """Beams up to (not including) a head angle were lost; the scan that ended meanwhile, if one did.

        An angle that lies within a quarter of a turn behind the head is no gap but a little doubt about the head.
        """
        if self._last_at is None:
            return None
        turned = (self.after_seam(to_deg) - self._last_at) % _TURN_DEG
        count = round(turned / step_deg) if step_deg > 0.0 else 0
        if count <= 0 or turned > LONGEST_GAP_DEG:
            return None
        from_deg = self._last_at + self._seam_deg
        head: Float64s = (from_deg + turned / count * np.arange(count, dtype=np.float64)) % _TURN_DEG
        return self.add(Beams(head, head, np.full(count, np.nan, dtype=np.float32)), (), to_deg)

    def _extend(self, beams: Beams, marks: Sequence[tuple[int, int]], first: int) -> None:
        self._marks += [(first + index, at_ns) for index, at_ns in marks]
        if len(beams.head_deg):
            self._runs.append(beams)
            self._beams += len(beams.head_deg)

    def _scan(self) -> LidarScan:
        n, runs = self._beams, self._runs
        clockwise = np.concatenate([run.beam_deg for run in runs]) % _TURN_DEG
        clockwise -= _TURN_DEG * (clockwise >= _HALF_TURN_DEG)
        clockwise *= self._sign * math.radians(1.0)
        angles = clockwise.astype(np.float32)
        ranges = np.concatenate([run.metres for run in runs])
        empty = ranges == 0.0
        lost_count, empty_count = int(np.count_nonzero(np.isnan(ranges))), int(np.count_nonzero(empty))
        self.lost_share = lost_count / n
        self.empty_share = empty_count / max(1, n - lost_count)
        ranges[empty | (ranges > self._range_max_m)] = np.inf
        if not self._trust_empty and lost_count + empty_count == n:
            ranges[:] = np.nan
        intensities = None
        if any(run.quality is not None for run in runs):
            intensities = np.concatenate(
                [np.zeros(len(run.metres), np.uint8) if run.quality is None else run.quality for run in runs]
            )
        early_ns = min([at_ns - beam * self.beam_ns for beam, at_ns in self._marks])
        start_ns = max(int(early_ns), self._stamp_ns + 1)
        self._stamp_ns = max(start_ns + int((n - 1) * self.beam_ns), start_ns + n)
        mount = self._mount
        return LidarScan(
            self._stamp_ns,
            ranges,
            angles,
            start_ns=start_ns,
            range_min_m=self._range_min_m,
            range_max_m=self._range_max_m,
            x_m=mount.x_m,
            y_m=mount.y_m,
            yaw_rad=mount.yaw_rad,
            intensities=intensities,
        )


def _part(beams: Beams, part: slice) -> Beams:
    quality = beams.quality
    return Beams(
        beams.head_deg[part], beams.beam_deg[part], beams.metres[part], None if quality is None else quality[part]
    )
