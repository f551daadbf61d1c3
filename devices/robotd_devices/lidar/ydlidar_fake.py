"""A YDLIDAR of the triangle family as its serial line sees it, in a world that a function describes."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from robotd.world.messages import Float64s
from robotd_devices.lidar.answers import encode_descriptor
from robotd_devices.lidar.ld19_fake import BoxRoom, RangeOf
from robotd_devices.lidar.ydlidar_models import MODELS, encode_samples, lens_deg
from robotd_devices.lidar.ydlidar_packets import TURN_Q6, YdPacket, encode
from robotd_devices.lidar.ydlidar_talk import FORCE_STOP, GET_HEALTH, GET_INFO, HEALTH, INFO, RESET, SCAN, STOP
from robotd_devices.ports.breakable import Breakable

_PACKET_SAMPLES = 40


class YdlidarFake(Breakable):
    """Scans as one of `MODELS`: from power-on, or on request where the model is commanded.

    The world is `range_of` (see `Ld19Fake`); distances beyond `range_max_m` are sent as 0. A turn begins with a packet
    of one sample where the head passes 0. Set at any time: `mute` (sends nothing at all), `stalled` (the head stands
    still), `status` (health: 0 well, 1 warning, 2 error, which a reset
    clears unless `stubborn`).
    """

    breaks: ClassVar[Mapping[str, str]] = MappingProxyType(
        {
            "head stalls": "stalled",
            "bytes stop": "mute",
            "still scanning": "scan_by_itself",
            "health warning": "warn",
            "health error": "fail",
        }
    )

    def __init__(
        self,
        model: str = "x4",
        range_of: RangeOf | None = None,
        *,
        rotation_hz: float = 7.0,
        range_max_m: float = 8.0,
        first_deg: float = 0.0,
    ) -> None:
        self.model = MODELS[model]
        self.range_of: RangeOf = range_of if range_of is not None else BoxRoom()
        self.rotation_hz = rotation_hz
        self.mute = self.stalled = self.stubborn = False
        self.status = 0
        self.requests: list[int] = []
        """Commands received since power-on."""
        self._range_max_m = range_max_m
        self._first_deg = first_deg
        # an adapter without modem lines feeds the motor all the time
        self._dtr = True
        self.power_on(0)

    def power_on(self, now_ns: int) -> None:
        self.requests.clear()
        self._heard = self._out = b""
        self._scan(now_ns, not self.model.commanded)

    def _scan(self, now_ns: int, on: bool) -> None:
        self.scanning = on
        self.scan_ns = now_ns
        """When sample 0 of the running scan was taken; sample i follows i sample times later."""
        self._sampled = 0
        self._turns = -1

    def warn(self, now_ns: int) -> None:
        """It is not quite well."""
        self.status = 1

    def fail(self, now_ns: int) -> None:
        """It reports an error."""
        self.status = 2

    def scan_by_itself(self, now_ns: int) -> None:
        """An earlier program left it scanning."""
        self._dtr = True
        self._scan(now_ns, True)

    def set_dtr(self, on: bool, now_ns: int) -> None:
        """The adapter's DTR line: raised, the motor of a commanded model turns."""
        if self._dtr != on:
            self._dtr = on
            self._scan(now_ns, self.scanning)

    @property
    def turning(self) -> bool:
        """Whether the motor is driven."""
        return self._dtr or not self.model.commanded

    def feed(self, data: bytes, now_ns: int) -> None:
        if not self.model.commanded:
            return
        self._heard += data
        while True:
            at = self._heard.find(b"\xa5")
            if at < 0 or len(self._heard) < at + 2:
                self._heard = self._heard[at:] if at >= 0 else b""
                return
            command = self._heard[at + 1]
            self._heard = self._heard[at + 2 :]
            self.requests.append(command)
            if command in (STOP, FORCE_STOP, RESET):
                self._scan(now_ns, False)
                if command == RESET and not self.stubborn:
                    self.status = 0
            elif command == SCAN:
                self._out += encode_descriptor(5, 0x81, stream=True)
                self._scan(now_ns, True)
            elif command == GET_INFO:
                info = struct.pack("<BHB16s", 6, 0x0104, 1, bytes(range(16)))
                self._out += encode_descriptor(len(info), INFO) + info
            elif command == GET_HEALTH:
                self._out += encode_descriptor(3, HEALTH) + struct.pack("<BH", self.status, 0)

    @property
    def sample_ns(self) -> float:
        """Time between samples."""
        return 1e9 / self.model.rate_hz

    def head_deg(self, sample: int) -> float:
        """Where the head stands at a sample of the running scan, clockwise from the mark, not wrapped."""
        turned = 0.0 if self.stalled else 360.0 * self.rotation_hz * sample / self.model.rate_hz
        return self._first_deg + turned

    def tick(self, now_ns: int) -> bytes:
        if self.scanning and self.turning:
            due = math.floor((now_ns - self.scan_ns) / self.sample_ns) + 1
            while self._sampled + self._next_count() <= due:
                self._out += encode(self.next_packet(), self.model.sample_bytes)
        out, self._out = self._out, b""
        return b"" if self.mute else out

    def _next_count(self) -> int:
        """Samples of the next packet: one where a turn begins, and none of the turn behind."""
        first = self.head_deg(self._sampled)
        if math.floor(first / 360.0) != self._turns:
            return 1
        if self.stalled:
            return _PACKET_SAMPLES
        left = (self._turns + 1) * 360.0 - first
        return min(_PACKET_SAMPLES, max(1, math.ceil(left * self.model.rate_hz / (360.0 * self.rotation_hz) - 1e-9)))

    def next_packet(self) -> YdPacket:
        """The next packet, whatever the time."""
        count, first = self._next_count(), self._sampled
        turns = math.floor(self.head_deg(first) / 360.0)
        begins = turns != self._turns and self._turns >= 0
        self._turns = turns
        self._sampled += count
        first_q6 = round(self.head_deg(first) * 64.0) % TURN_Q6
        span_q6 = (round(self.head_deg(first + count - 1) * 64.0) - round(self.head_deg(first) * 64.0)) % TURN_Q6
        # measured exactly where the packet's own angles say, so that a reader can be held to the last digit
        head = (first_q6 + span_q6 / max(1, count - 1) * np.arange(count, dtype=np.float64)) / 64.0
        data = encode_samples(self.model, self._millimetres(head))
        speed_dhz = round(self.rotation_hz * 10.0) if begins else 0
        return YdPacket(first_q6, span_q6, count, data, begins, speed_dhz)

    def _millimetres(self, head_deg: Float64s) -> Float64s:
        """Where each beam goes depends on the distance, which depends on where it goes."""
        unit = self.model.unit_mm
        mm = np.full_like(head_deg, 1000.0)
        for _ in range(6):
            distance_m = self.range_of(-np.radians(head_deg + lens_deg(self.model, mm)))
            seen = np.isfinite(distance_m) & (distance_m <= self._range_max_m)
            mm = np.where(seen, np.rint(np.where(seen, distance_m, 0.0) * 1000.0 / unit) * unit, 0.0)
        return mm
