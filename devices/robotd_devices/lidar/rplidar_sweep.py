"""From an RPLIDAR's capsules or nodes to beams: decoded once a revolution, laid between neighbours, gaps filled."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robotd.world.messages import Float32s, Float64s, LidarScan
from robotd_devices.lidar import rplidar_hq as hq
from robotd_devices.lidar.beam_sweep import LONGEST_GAP_DEG, Beams, BeamSweep
from robotd_devices.lidar.rplidar_capsules import TURN_Q6, ULTRA, Capsule, CapsuleFormat
from robotd_devices.lidar.rplidar_nodes import NODE_BYTES, NodeRun
from robotd_devices.lidar.rplidar_samples import decode_samples

_TURN_Q16 = float(1 << 16)
#: Slamtec's own estimate: a sample was taken one and a half sample times before it leaves the device.
_DELAY_SAMPLES = 1.5

#: Nodes are looked at for the seam in pieces of at most this many, so that no turn is missed in a backlog.
_PIECE_NODES = 32
#: Fewer nodes do not tell how far apart nodes lie.
_ENOUGH_NODES = 20

_NODE = np.dtype([("head", "u1"), ("angle", "<u2"), ("distance", "<u2")])
_HQ_NODE = np.dtype([("angle", "<u2"), ("distance", "<u4"), ("quality", "u1"), ("flag", "u1")])


class CapsuleSweep:
    """Keeps capsules undecoded until the head passes the seam, then decodes them all in one call.

    A capsule is laid between its own angle and that of the next one; before a gap, as wide as the one before it.
    """

    def __init__(self, form: CapsuleFormat, sweep: BeamSweep, byte_ns: float) -> None:
        self._form = form
        self._sweep = sweep
        self._wire_ns = round(form.size * byte_ns + _DELAY_SAMPLES * sweep.beam_ns)
        self._run: list[Capsule] = []
        self._gap_q6 = 0
        self._after_deg = 0.0
        """How far the newest capsule begins behind the seam."""
        self._old = False
        """The capsule before was one that had been there already."""

    def add(self, capsule: Capsule) -> list[LidarScan]:
        """Take the next capsule; the scans that it ends."""
        done: list[LidarScan | None] = []
        run = self._run
        if capsule.first:
            self._sweep.reset()
            run.clear()
            self._gap_q6 = 0
        elif run and self._is_old(capsule):
            self._old = True
            return []
        elif run and (self._old or not capsule.chained):
            last = run[-1]
            done.append(self._decode(len(run), (last.start_q6 + self._gap_q6) % TURN_Q6, b""))
            self._lost(capsule, last, done)
            run.clear()
        self._old = False
        run.append(capsule)
        before_deg, self._after_deg = self._after_deg, self._sweep.after_seam(capsule.start_q6 / 64.0)
        if len(run) > 1:
            self._gap_q6 = (capsule.start_q6 - run[-2].start_q6) % TURN_Q6
            if self._after_deg < before_deg - 180.0:
                done.append(self._decode(len(run) - 1, capsule.start_q6, capsule.data))
                del run[:-1]
        return [scan for scan in done if scan is not None] if done else []

    def _is_old(self, capsule: Capsule) -> bool:
        """Whether a capsule begins where others have been already: bytes came twice."""
        ahead_q6 = (capsule.start_q6 - self._run[-1].start_q6) % TURN_Q6
        return (ahead_q6 == 0 or ahead_q6 > LONGEST_GAP_DEG * 64) and not self._is_late(capsule, self._run[-1])

    def _is_late(self, capsule: Capsule, last: Capsule) -> bool:
        """Whether so much time passed between two capsules that it is not clear how many turns were lost."""
        form, beam_ns = self._form, self._sweep.beam_ns
        turn_ns = TURN_Q6 / self._gap_q6 * form.samples * beam_ns if self._gap_q6 else 0.0
        return capsule.arrival_ns - last.arrival_ns - form.samples * beam_ns > LONGEST_GAP_DEG / 360.0 * turn_ns

    def _lost(self, capsule: Capsule, last: Capsule, done: list[LidarScan | None]) -> None:
        if self._is_late(capsule, last):
            self._sweep.reset()
        else:
            done.append(self._sweep.gap(capsule.start_q6 / 64.0, self._gap_q6 / self._form.samples / 64.0))

    def _decode(self, count: int, then_q6: int, behind: bytes) -> LidarScan | None:
        """Hand over the first capsules of the run; `then_q6`: where the one behind them begins."""
        form, run = self._form, self._run[:count]
        if not self._gap_q6:
            return None
        bounds = np.array([*(capsule.start_q6 for capsule in run), then_q6], dtype=np.int64)
        gaps = (bounds[1:] - bounds[:-1]) % TURN_Q6
        samples = decode_samples(form, b"".join([capsule.data for capsule in run]), bounds[:-1], gaps, behind)
        quality = samples.quality
        metres = (samples.distance_q2.ravel() * 0.00025).astype(np.float32)
        if form is ULTRA and not behind:
            metres[-2:] = np.nan  # these two are coded against the capsule behind
        beams = Beams(
            samples.head_q16.ravel() / _TURN_Q16,
            samples.angle_q6.ravel() / 64.0,
            metres,
            None if quality is None else quality.ravel(),
        )
        marks = [(form.samples * (i + 1) - 1, c.arrival_ns - self._wire_ns) for i, c in enumerate(run)]
        return self._sweep.add(beams, marks, then_q6 / 64.0)


@dataclass(frozen=True, slots=True)
class NodeForm:
    """Nodes of one kind. size: bytes of one; angle_at: where its angle stands, u16, `per_degree` steps a degree.

    packet_bytes: what is sent in one piece. decode: bytes of nodes to degrees, metres and qualities, (n,) each.
    """

    size: int
    angle_at: int
    per_degree: float
    packet_bytes: int
    decode: Callable[[bytes], tuple[Float64s, Float32s, NDArray[np.uint8]]]

    def angle_deg(self, data: bytes, node: int) -> float:
        """The angle of one node; -1 for the last."""
        at = node * self.size + self.angle_at if node >= 0 else len(data) - self.size + self.angle_at
        return int.from_bytes(data[at : at + 2], "little") / self.per_degree


def _standard(data: bytes) -> tuple[Float64s, Float32s, NDArray[np.uint8]]:
    nodes = np.frombuffer(data, dtype=_NODE)
    metres = (nodes["distance"] * 0.00025).astype(np.float32)
    return (nodes["angle"] >> 1) / 64.0, metres, (nodes["head"] >> 2).astype(np.uint8)


def _hq(data: bytes) -> tuple[Float64s, Float32s, NDArray[np.uint8]]:
    nodes = np.frombuffer(data, dtype=_HQ_NODE)
    metres = (nodes["distance"] * 0.00025).astype(np.float32)
    return nodes["angle"] * (90.0 / 16_384.0), metres, nodes["quality"].copy()


STANDARD_NODES = NodeForm(NODE_BYTES, 1, 128.0, NODE_BYTES, _standard)
HQ_NODES = NodeForm(hq.NODE_BYTES, 0, 16_384.0 / 90.0, hq.PACKET_BYTES, _hq)


class NodeSweep:
    """Keeps the nodes of a standard or HQ scan until their angle passes the seam, then decodes them in one call."""

    def __init__(self, sweep: BeamSweep, byte_ns: float, step_deg: float, form: NodeForm = STANDARD_NODES) -> None:
        self._form = form
        self._sweep = sweep
        self._delay_ns = round(form.packet_bytes * byte_ns + _DELAY_SAMPLES * sweep.beam_ns)
        self._step_deg = step_deg
        self._data: list[bytes] = []
        self._marks: list[tuple[int, int]] = []
        self._count = 0
        self._head_deg: float | None = None
        """Where the head stood before the kept nodes: the furthest that an angle has shown."""
        self._last_deg = 0.0
        """The same of the kept nodes, seen at the end of each run only."""
        self._last_ns = 0

    def add(self, run: NodeRun) -> list[LidarScan]:
        """Take the next nodes; the scans that they end."""
        done: list[LidarScan | None] = []
        if run.missing:
            done.append(self._decode())
            self._lost(run, done)
        if self._head_deg is None:
            self._head_deg = self._last_deg = self._form.angle_deg(run.data, 0)
        size = self._form.size
        behind = len(run.data) // size
        for at in range(0, len(run.data), _PIECE_NODES * size):
            piece = run.data[at : at + _PIECE_NODES * size]
            behind -= len(piece) // size
            self._keep(piece, run.arrival_ns - round(behind * self._sweep.beam_ns), done)
        return [scan for scan in done if scan is not None]

    def _keep(self, piece: bytes, arrival_ns: int, done: list[LidarScan | None]) -> None:
        self._data.append(piece)
        self._count += len(piece) // self._form.size
        self._marks.append((self._count - 1, arrival_ns - self._delay_ns))
        self._last_ns = arrival_ns
        before, angle_deg = self._last_deg, self._form.angle_deg(piece, -1)
        if _between(angle_deg, before) > 0.0:
            self._last_deg = angle_deg
            after = self._sweep.after_seam
            if after(angle_deg) < after(before) - 180.0:
                done.append(self._decode())

    def _lost(self, run: NodeRun, done: list[LidarScan | None]) -> None:
        if self._head_deg is None:
            return
        sweep, first_deg = self._sweep, self._form.angle_deg(run.data, 0)
        first_ns = run.arrival_ns - (len(run.data) // self._form.size) * sweep.beam_ns
        if first_ns - self._last_ns > LONGEST_GAP_DEG / self._step_deg * sweep.beam_ns:
            sweep.reset()
            self._head_deg = None
        else:
            done.append(sweep.gap(first_deg, self._step_deg))
            if _between(first_deg, self._head_deg) > 0.0:
                self._head_deg = self._last_deg = first_deg

    def _decode(self) -> LidarScan | None:
        if not self._data or self._head_deg is None:
            return None
        angle_deg, metres, quality = self._form.decode(b"".join(self._data))
        marks, self._marks = self._marks, []
        self._data, self._count = [], 0
        # the head only goes forward, though beams to near and to far points lag behind it by different angles
        steps = (np.diff(angle_deg, prepend=self._head_deg) + 180.0) % 360.0 - 180.0
        turned = np.maximum.accumulate(np.maximum(np.cumsum(steps), 0.0))
        if len(metres) > _ENOUGH_NODES:
            self._step_deg += 0.1 * (float(turned[-1] - turned[0]) / (len(metres) - 1) - self._step_deg)
        head_deg = (self._head_deg + turned) % 360.0
        self._head_deg = self._last_deg = float(head_deg[-1])
        beams = Beams(head_deg, angle_deg, metres, quality)
        return self._sweep.add(beams, marks, (self._head_deg + self._step_deg) % 360.0)


def _between(angle_deg: float, before_deg: float) -> float:
    """From one angle to another, in [-180, 180) degrees."""
    return (angle_deg - before_deg + 180.0) % 360.0 - 180.0
