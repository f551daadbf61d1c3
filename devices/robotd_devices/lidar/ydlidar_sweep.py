"""From a YDLIDAR's packets to beams: decoded once a revolution, turned by the lens, gaps filled."""

from __future__ import annotations

import numpy as np

from robotd.world.messages import LidarScan
from robotd_devices.lidar.beam_sweep import LONGEST_GAP_DEG, Beams, BeamSweep
from robotd_devices.lidar.ydlidar_models import YdModel, decode_samples, lens_deg, metres
from robotd_devices.lidar.ydlidar_packets import HEADER_BYTES, TURN_Q6, YdPacket

#: Packets that stand right behind each other lie closer than this, degrees; a wider gap lost something unseen.
_CLOSE_DEG = 5.0


class YdSweep:
    """Keeps packets undecoded until the head passes the seam, then decodes them all in one call."""

    def __init__(self, model: YdModel, sweep: BeamSweep, byte_ns: float) -> None:
        self._model = model
        self._sweep = sweep
        self._byte_ns = byte_ns
        self._kept: list[YdPacket] = []
        self._step_deg = 0.0
        self._last: YdPacket | None = None

    def add(self, packet: YdPacket) -> list[LidarScan]:
        """Take the next packet; the scans that it ends."""
        done: list[LidarScan | None] = []
        last = self._last
        if packet.samples > 1:
            self._step_deg = packet.span_q6 / 64.0 / (packet.samples - 1)
        if last is not None:
            ahead_deg = (packet.first_q6 - last.last_q6) % TURN_Q6 / 64.0
            close = ahead_deg < _CLOSE_DEG or ahead_deg > 360.0 - _CLOSE_DEG
            if not (packet.chained and close):
                if ahead_deg > LONGEST_GAP_DEG and not self._is_late(packet, last):
                    return []  # where others have been already: bytes came twice
                done.append(self._decode())
                self._lost(packet, last, done)
        self._kept.append(packet)
        self._last = packet
        after = self._sweep.after_seam
        before_q6 = last.last_q6 if last is not None else packet.first_q6
        if after(packet.last_q6 / 64.0) < after(before_q6 / 64.0) - 180.0:
            done.append(self._decode())
        return [scan for scan in done if scan is not None]

    def _is_late(self, packet: YdPacket, last: YdPacket) -> bool:
        """Whether so much time passed between two packets that it is not clear how many turns were lost."""
        beam_ns, step_deg = self._sweep.beam_ns, self._step_deg
        elapsed_ns = packet.arrival_ns - last.arrival_ns - packet.samples * beam_ns
        return not step_deg or elapsed_ns > LONGEST_GAP_DEG / step_deg * beam_ns

    def _lost(self, packet: YdPacket, last: YdPacket, done: list[LidarScan | None]) -> None:
        if self._is_late(packet, last):
            self._sweep.reset()
        else:
            done.append(self._sweep.gap(packet.first_q6 / 64.0, self._step_deg))

    def _decode(self) -> LidarScan | None:
        kept, self._kept = self._kept, []
        if not kept:
            return None
        counts = np.array([packet.samples for packet in kept])
        first_beams = np.cumsum(counts) - counts
        steps = np.array([packet.span_q6 / max(1, packet.samples - 1) for packet in kept])
        index = np.arange(int(counts.sum())) - np.repeat(first_beams, counts)
        head_deg = (np.repeat([packet.first_q6 for packet in kept], counts) + index * np.repeat(steps, counts)) / 64.0
        mm, quality = decode_samples(self._model, b"".join(packet.data for packet in kept))
        beams = Beams(head_deg % 360.0, head_deg + lens_deg(self._model, mm), metres(mm), quality)
        marks = [
            (int(last), packet.arrival_ns - round((HEADER_BYTES + len(packet.data)) * self._byte_ns))
            for last, packet in zip(first_beams + counts - 1, kept, strict=True)
        ]
        return self._sweep.add(beams, marks, (kept[-1].last_q6 / 64.0 + self._step_deg) % 360.0)
