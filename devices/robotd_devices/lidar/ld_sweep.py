"""Joins the packets of an LDROBOT lidar into one `LidarScan` a revolution: true angles, true times, gaps kept apart."""

from __future__ import annotations

import math

import numpy as np

from robotd.world.messages import LidarScan
from robotd.world.robot import Mount
from robotd_devices.lidar.ld_packets import PACKET_BYTES, POINTS, TURN_CDEG, LdPacket
from robotd_devices.lidar.scan_maker import ScanMaker

_POINT = np.dtype([("mm", "<u2"), ("intensity", "u1")])
_STEPS = POINTS - 1
_HALF_TURN = TURN_CDEG // 2


class LdSweep(ScanMaker):
    """Collects packets and gives a scan at the packet that ends a revolution.

    A revolution begins and ends at the device angle `seam_deg`; with 180 (the default) that is behind the lidar, the
    bearings of one scan run from +pi to -pi without a jump, and what lies ahead was seen in one go. Beams stay in the
    order in which they were measured, so bearings fall (clockwise lidar) or, upside down, rise. Ranges and times are
    those of every `ScanMaker`; beams of lost packets are there with `nan`.

    The packet's arrival less its 47 bytes on the wire is when its last point was measured.
    """

    def __init__(
        self,
        *,
        byte_ns: int = 43_403,
        range_min_m: float = 0.02,
        range_max_m: float = 12.0,
        inverted: bool = False,
        seam_deg: float = 180.0,
        trust_empty: bool = False,
        mount: Mount | None = None,
    ) -> None:
        super().__init__(
            range_min_m=range_min_m, range_max_m=range_max_m, inverted=inverted, trust_empty=trust_empty, mount=mount
        )
        self._wire_ns = PACKET_BYTES * byte_ns
        self._seam_cdeg = round(seam_deg * 100) % TURN_CDEG
        self._reset()

    def _reset(self) -> None:
        """Forget the open revolution and wait for the next seam: half a revolution is not published."""
        self._whole = False
        self._end_cdeg = 0
        self._begin()

    def _begin(self) -> None:
        # one entry a segment: first angle after the seam, step, beams, points (empty for a gap)
        self._starts: list[float] = []
        self._steps: list[float] = []
        self._counts: list[int] = []
        self._points: list[bytes] = []
        # one entry a packet: index of its last beam, when that was measured by its arrival
        self._marks: list[tuple[int, int]] = []
        self._beams = 0
        self._last_at = 0.0
        self._turned_cdeg = 0
        self._speed_sum = 0

    def add(self, packet: LdPacket) -> LidarScan | None:
        """Take the next packet; the scan that it ends, if it does."""
        step = packet.span_cdeg / _STEPS
        at = (packet.start_cdeg - self._seam_cdeg) % TURN_CDEG
        done: LidarScan | None = None
        if not packet.chained:
            self._reset()
        else:
            gap = (packet.start_cdeg - self._end_cdeg) % TURN_CDEG
            if 2 * gap > 3 * step and gap < TURN_CDEG - 3 * step:
                beams = round(gap / step) - 1
                between = gap / (beams + 1)
                before = (self._end_cdeg - self._seam_cdeg) % TURN_CDEG + between
                done = self._append(before % TURN_CDEG, between, beams, b"", packet)
        self._end_cdeg = packet.end_cdeg
        ended = self._append(float(at), step, POINTS, packet.points, packet)
        self._turned_cdeg += packet.span_cdeg
        self._speed_sum += packet.speed_dps
        self._marks.append((self._beams - 1, packet.arrival_ns - self._wire_ns))
        return done if ended is None else ended

    def _append(self, at: float, step: float, beams: int, points: bytes, packet: LdPacket) -> LidarScan | None:
        """Add a run of beams; where it crosses the seam its first part ends the open revolution."""
        done = None
        if at < self._last_at - _HALF_TURN:
            done = self._finish()
        if at + (beams - 1) * step >= TURN_CDEG:
            first = math.ceil((TURN_CDEG - at) / step)
            self._extend(at, step, first, points[: 3 * first])
            if points:
                # the packet belongs to both revolutions: its last beam lies behind the end of this one
                self._marks.append((self._beams - 1 + beams - first, packet.arrival_ns - self._wire_ns))
            done = self._finish() or done
            at, beams, points = at + first * step - TURN_CDEG, beams - first, points[3 * first :]
        self._extend(at, step, beams, points)
        return done

    def _extend(self, at: float, step: float, beams: int, points: bytes) -> None:
        self._starts.append(at)
        self._steps.append(step)
        self._counts.append(beams)
        self._points.append(points)
        self._beams += beams
        self._last_at = at + (beams - 1) * step

    def _finish(self) -> LidarScan | None:
        """Close the open revolution and begin the next; None for one whose beginning was not seen."""
        scan = self._scan() if self._whole and self._speed_sum else None
        self._begin()
        self._whole = True
        return scan

    def _scan(self) -> LidarScan:
        n = self._beams
        counts = np.array(self._counts)
        first_beams = np.cumsum(counts) - counts
        steps = np.array(self._steps)
        turned = np.repeat(np.array(self._starts) - first_beams * steps, counts) + np.arange(n) * np.repeat(
            steps, counts
        )
        ranges = np.full(n, np.nan, dtype=np.float32)
        intensities = np.zeros(n, dtype=np.uint8)
        measured = np.repeat([bool(points) for points in self._points], counts)
        points = np.frombuffer(b"".join(self._points), dtype=_POINT)
        ranges[measured] = points["mm"] * np.float32(0.001)
        intensities[measured] = points["intensity"]
        # twelve points a packet at one rate; the mean over a revolution is finer than the device's 1 deg/s
        beam_ns = self._turned_cdeg * 1e7 / (self._speed_sum * _STEPS)
        return self.make((turned + self._seam_cdeg) * 0.01, ranges, intensities, self._marks, beam_ns)
