"""From the bytes of an RPLIDAR's scan to `LidarScan`s, whatever the format: parser and sweep behind one call."""

from __future__ import annotations

import math
from collections.abc import Iterator

from robotd.world.messages import LidarScan
from robotd_devices.lidar.beam_sweep import BeamSweep
from robotd_devices.lidar.rplidar_capsules import FORMATS, CapsuleParser
from robotd_devices.lidar.rplidar_hq import HQ, HqParser
from robotd_devices.lidar.rplidar_nodes import NodeParser
from robotd_devices.lidar.rplidar_sweep import HQ_NODES, CapsuleSweep, NodeSweep


class RplidarReader:
    """Reads one scan from its start on.

    answer: type of the stream, as its descriptor says: 0x81 (nodes), 0x83 (HQ) or one of `FORMATS`. sweep: where beams
    go. byte_ns: time of a byte on the wire. rotation_hz: revolutions a second that are expected.
    """

    def __init__(self, answer: int, sweep: BeamSweep, byte_ns: float, rotation_hz: float) -> None:
        self.sweep = sweep
        self._packets_then = 0
        form = FORMATS.get(answer)
        step_deg = 360e-9 * rotation_hz * sweep.beam_ns
        self._turn_nodes = math.ceil(2.0 * 360.0 / step_deg)
        self._parser: CapsuleParser | NodeParser | HqParser
        if answer == HQ:
            self._parser = HqParser(byte_ns, sweep.beam_ns)
            self._nodes = NodeSweep(sweep, byte_ns, step_deg, HQ_NODES)
        elif form is None:
            self._parser = NodeParser(byte_ns, sweep.beam_ns, step_deg)
            self._nodes = NodeSweep(sweep, byte_ns, step_deg)
        else:
            self._parser = CapsuleParser(form, byte_ns, sweep.beam_ns)
            self._capsules = CapsuleSweep(form, sweep, byte_ns)

    @property
    def not_turning(self) -> bool:
        """Whether measurements come whose angles do not advance."""
        return self._parser.trouble == "not turning" or self._parser.packets - self._packets_then > self._turn_nodes

    def feed(self, data: bytes, now_ns: int) -> Iterator[LidarScan]:
        """Take bytes that were read at `now_ns`; the scans that they complete, one by one.

        Between two of them the sweep's shares are those of the one just given.
        """
        parser = self._parser
        if isinstance(parser, CapsuleParser):
            for capsule in parser.feed(data, now_ns):
                for scan in self._capsules.add(capsule):
                    self._packets_then, parser.trouble = parser.packets, ""
                    yield scan
        else:
            for run in parser.feed(data, now_ns):
                for scan in self._nodes.add(run):
                    self._packets_then, parser.trouble = parser.packets, ""
                    yield scan

    def take_faults(self) -> list[str]:
        """Names of what went wrong since the last call."""
        parser = self._parser
        if not parser.faults:
            return []
        faults, parser.faults = parser.faults, []
        return faults
