"""Joins beams of any spinning lidar into one `LidarScan` a revolution: true angles, true times, gaps kept apart."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robotd.world.messages import Float32s, Float64s, LidarScan
from robotd.world.robot import Mount
from robotd_devices.lidar.scan_maker import ScanMaker

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


class BeamSweep(ScanMaker):
    """Collects beams and gives a scan with those that end a revolution.

    A revolution begins and ends where the head passes the device angle `seam_deg`; with 180 (the default) that is
    behind the lidar. Beams stay in the order in which they were measured, and are measured `beam_ns` apart. Ranges and
    times are those of every `ScanMaker`.
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
        super().__init__(
            range_min_m=range_min_m,
            range_max_m=range_max_m,
            inverted=inverted,
            trust_empty=trust_empty,
            mount=mount,
            after_ns=after_ns,
        )
        self.beam_ns = beam_ns
        self._seam_deg = seam_deg
        self.reset()

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
        self._marks += [(first + index, instant) for index, instant in marks]
        if len(beams.head_deg):
            self._runs.append(beams)
            self._beams += len(beams.head_deg)

    def _scan(self) -> LidarScan:
        runs = self._runs
        intensities = None
        if any(run.quality is not None for run in runs):
            intensities = np.concatenate(
                [np.zeros(len(run.metres), np.uint8) if run.quality is None else run.quality for run in runs]
            )
        beam_deg = np.concatenate([run.beam_deg for run in runs])
        ranges = np.concatenate([run.metres for run in runs])
        return self.make(beam_deg, ranges, intensities, self._marks, self.beam_ns)


def _part(beams: Beams, part: slice) -> Beams:
    quality = beams.quality
    return Beams(
        beams.head_deg[part], beams.beam_deg[part], beams.metres[part], None if quality is None else quality[part]
    )
