"""An RPLIDAR of any model as its serial line sees it, in a world that a function describes."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from robotd.world.messages import Float64s
from robotd_devices.lidar import rplidar_hq as hq
from robotd_devices.lidar import rplidar_samples as samples
from robotd_devices.lidar import rplidar_wire as wire
from robotd_devices.lidar.answers import encode_descriptor
from robotd_devices.lidar.ld19_fake import BoxRoom, RangeOf
from robotd_devices.lidar.rplidar_capsules import DENSE, EXPRESS, FORMATS, TURN_Q6, ULTRA, CapsuleFormat, seal
from robotd_devices.lidar.rplidar_fake_models import MODELS, STANDARD
from robotd_devices.lidar.rplidar_models import ScanMode
from robotd_devices.lidar.rplidar_nodes import NODE_BYTES
from robotd_devices.lidar.xor_fold import xor_fold
from robotd_devices.ports.breakable import Breakable

__all__ = ["MODELS", "RplidarFake"]

_BANNER = b"RP LIDAR System.\r\nFirmware Ver %d.%02d, HW Ver %d\r\nModel: %02x\r\n"
_QUALITY_NODE, _QUALITY_ULTRA = 47, 200
#: A sample leaves the device one and a half sample times after it was taken, as the vendor's SDK assumes.
_DELAY_SAMPLES = 1.5
#: A head that turns unevenly: share by which its speed swings, and how often a second.
_SWING, _SWING_HZ = 0.2, 0.9
#: Where the quarter of the view lies that sends nothing back, clockwise from the mark.
_BLANK_DEG = (40.0, 130.0)
_CODE = 0x0102


class RplidarFake(Breakable):
    """Answers requests and scans as one of `MODELS`.

    The world is `range_of` (see `Ld19Fake`); distances beyond `range_max_m` are sent as 0. Its head stands at
    `first_deg` when its power comes. It sends samples while its motor runs: by DTR (runs unless `set_dtr(True)`), by
    PWM, by speed, or always. Set at any time: `health` (a reset clears it unless `stubborn`), `mute` (sends nothing at
    all), `stalled` (the head stands still, samples go on), `refuses` (its motor turns but it does not scan), `uneven`
    (its speed swings), `flagless` (no mark of a new turn), `blank` (a quarter of the view returns nothing), `blind`
    (nothing does); `brown_out` restarts it.
    """

    breaks: ClassVar[Mapping[str, str]] = MappingProxyType(
        {
            "head stalls": "stalled",
            "bytes stop": "mute",
            "still scanning": "scan_by_itself",
            "health warning": "warn",
            "health error": "protect",
            "health error stays": "protect_for_good",
            "brown-out": "brown_out",
            "uneven turning": "uneven",
            "no start of turn": "flagless",
            "no return": "blank",
            "nothing returns": "blind",
        }
    )

    def __init__(
        self,
        model: str = "a1",
        range_of: RangeOf | None = None,
        *,
        rotation_hz: float = 10.0,
        range_max_m: float = 12.0,
        first_deg: float = 0.0,
        spin_up_s: float = 0.0,
    ) -> None:
        self.model = MODELS[model]
        self.range_of: RangeOf = range_of if range_of is not None else BoxRoom()
        self.rotation_hz = rotation_hz
        self.health = wire.Health(0, 0)
        self.stubborn = self.mute = self.stalled = self.refuses = False
        self.uneven = self.flagless = self.blank = self.blind = False
        self.requests: list[int] = []
        """Commands received since power-on."""
        self.heard: list[tuple[int, int]] = []
        """Every command ever received, with its time in nanoseconds."""
        self._range_max_m = range_max_m
        self._first_deg = first_deg
        self._spin_up_ns = round(spin_up_s * 1e9)
        self._dtr = False
        self.power_on(0)

    def power_on(self, now_ns: int) -> None:
        self._on_ns = now_ns
        self.requests.clear()
        self._heard = b""
        self._pwm = 0
        self._boot(now_ns)
        self._out = b""

    def _boot(self, now_ns: int) -> None:
        self.scanning: ScanMode | None = None
        info = self.model.info
        self._out = _BANNER % (info.firmware >> 8, info.firmware & 0xFF, info.hardware, info.model)
        self._motor_ns: int | None = now_ns if self._drives() else None

    def brown_out(self, now_ns: int) -> None:
        """Its supply fell for a moment: it boots, says so, and scans no more."""
        self._pwm = 0
        self._boot(now_ns)

    def warn(self, now_ns: int) -> None:
        """It is not quite well."""
        self.health = wire.Health(1, _CODE)

    def protect(self, now_ns: int) -> None:
        """It shuts itself down."""
        self.health = wire.Health(2, _CODE)
        self.scanning = None

    def protect_for_good(self, now_ns: int) -> None:
        """The same, and a reset does not help."""
        self.stubborn = True
        self.protect(now_ns)

    def scan_by_itself(self, now_ns: int) -> None:
        """An earlier program left it scanning."""
        self._pwm = wire.DEFAULT_PWM
        self._motor(now_ns)
        self._scan(self.model.typical, now_ns)

    def measures(self, data: bytes, baud: int) -> bool:
        """Bytes at another speed than its own; whether it takes that speed over, for which it needs firmware 1.30."""
        info = self.model.info
        if wire.MEASURE_ME not in data or (info.firmware < 0x011E and info.family < 4):
            return False
        self._out = struct.pack("<I", baud)
        return True

    def set_dtr(self, on: bool, now_ns: int) -> None:
        """The adapter's DTR line: raised, it stops the motor of an A1."""
        self._dtr = on
        self._motor(now_ns)

    @property
    def turning(self) -> bool:
        """Whether the motor is driven."""
        return self._motor_ns is not None

    def _drives(self) -> bool:
        motor = self.model.motor
        return motor == "none" or (motor == "dtr" and not self._dtr) or (motor in ("pwm", "rpm") and self._pwm > 0)

    def _motor(self, now_ns: int) -> None:
        if self._drives() and self._motor_ns is None:
            self._motor_ns = now_ns + self._spin_up_ns
            self._restart(now_ns)
        elif not self._drives():
            self._motor_ns = None

    # ------------------------------------------------------------------------------------------- requests

    def feed(self, data: bytes, now_ns: int) -> None:
        self._heard += data
        while True:
            at = self._heard.find(b"\xa5")
            if at < 0:
                self._heard = b""
                return
            heard = self._heard = self._heard[at:]
            if len(heard) < 2:
                return
            end = 2
            if heard[1] & 0x80:
                if len(heard) < 3:
                    return
                end = 4 + heard[2]
                if len(heard) < end:
                    return  # like the device: an incomplete request is waited for
                if xor_fold(heard[: end - 1], 1) != heard[end - 1]:
                    self._heard = heard[1:]
                    continue
            self._heard = heard[end:]
            self._obey(heard[1], heard[3 : end - 1], now_ns)

    def _obey(self, command: int, payload: bytes, now_ns: int) -> None:
        self.requests.append(command)
        self.heard.append((now_ns, command))
        if command == wire.STOP:
            self.scanning = None
        elif command == wire.RESET:
            if not self.stubborn:
                self.health = wire.Health(0, 0)
            self._boot(now_ns)
        elif command in (wire.SCAN, wire.FORCE_SCAN, wire.EXPRESS_SCAN):
            number = payload[0] if command == wire.EXPRESS_SCAN and payload else 0
            if command == wire.EXPRESS_SCAN and number == 0:
                number = 1  # mode 0 of this command is the legacy express scan
            self._scan(number, now_ns)
        elif command in (wire.SET_PWM, wire.SET_RPM):
            if self.model.motor == ("pwm" if command == wire.SET_PWM else "rpm"):
                self._pwm = int.from_bytes(payload[:2], "little")
                self._motor(now_ns)
        elif command == wire.GET_INFO:
            self._answer(wire.INFO, wire.encode_info(self.model.info))
        elif command == wire.GET_HEALTH:
            self._answer(wire.HEALTH, struct.pack("<BH", *self.health))
        elif command == wire.GET_SAMPLE_RATE:
            rates = [round(mode.sample_us) for mode in self.model.modes[:2]]
            self._answer(wire.SAMPLE_RATE, struct.pack("<HH", rates[0], rates[-1]))
        elif command == wire.GET_BOARD_FLAG and self.model.motor in ("dtr", "pwm"):
            self._answer(wire.BOARD_FLAG, struct.pack("<I", self.model.motor == "pwm"))
        elif command == wire.GET_CONF:
            value = self._conf(payload)
            if value is not None:
                self._answer(wire.CONF, payload[:4] + value)

    def _answer(self, kind: int, data: bytes) -> None:
        self._out += encode_descriptor(len(data), kind) + data

    def _conf(self, payload: bytes) -> bytes | None:
        model = self.model
        if model.info.family < 4 and model.info.firmware < 0x0118:
            return None
        entry = int.from_bytes(payload[:4], "little")
        number = int.from_bytes(payload[4:6], "little")
        general = {
            wire.MODE_COUNT: struct.pack("<H", len(model.modes)),
            wire.MODE_TYPICAL: struct.pack("<H", model.typical),
            0x01: struct.pack("<HH", round(60 * self.rotation_hz), wire.DEFAULT_PWM),
            0x04: struct.pack("<H", 300),
            0x05: struct.pack("<H", 1200),
        }
        if entry in general:
            return general[entry]
        if number >= len(model.modes):
            return None
        mode = model.modes[number]
        return {
            wire.MODE_US_PER_SAMPLE: struct.pack("<I", round(mode.sample_us * 256)),
            wire.MODE_MAX_DISTANCE: struct.pack("<I", round(mode.max_distance_m * 256)),
            wire.MODE_ANSWER: struct.pack("<B", mode.answer),
            wire.MODE_NAME: mode.name.encode() + b"\0",
        }.get(entry)

    # --------------------------------------------------------------------------------------- measurements

    def _scan(self, number: int, now_ns: int) -> None:
        if self.refuses or self.health.status == 2 or number >= len(self.model.modes):
            return
        self.scanning = mode = self.model.modes[number]
        size = {hq.HQ: hq.PACKET_BYTES, STANDARD: NODE_BYTES}.get(mode.answer) or FORMATS[mode.answer].size
        self._out += encode_descriptor(size, mode.answer, stream=True)
        self._restart(now_ns)

    def _restart(self, now_ns: int) -> None:
        """Samples are counted from here."""
        self.scan_ns = max(now_ns, self._motor_ns or 0)
        """When sample 0 of the running scan was taken; sample i follows i sample times later."""
        self._sampled = 0
        self._angle_before = -1

    @property
    def sample_ns(self) -> float:
        """Time between samples of the running scan."""
        return self.scanning.sample_us * 1e3 if self.scanning is not None else 0.0

    def head_deg(self, sample: int) -> float:
        """Where the head stands at a sample of the running scan, clockwise from the mark, not wrapped."""
        if self.stalled:
            return self._first_deg
        turning_s = (self.scan_ns - self._on_ns + sample * self.sample_ns) / 1e9
        if self.uneven:  # its speed is the derivative of this: a fifth more, a fifth less
            swing = 2.0 * math.pi * _SWING_HZ
            turning_s += _SWING / swing * math.sin(swing * turning_s)
        return self._first_deg + 360.0 * self.rotation_hz * turning_s

    def tick(self, now_ns: int) -> bytes:
        mode = self.scanning
        if mode is not None and self._motor_ns is not None:
            due = math.floor((now_ns - self.scan_ns) / self.sample_ns - _DELAY_SAMPLES) + 1
            form = FORMATS.get(mode.answer)
            if mode.answer == hq.HQ:
                while self._sampled + hq.NODES <= due:
                    self._out += self._hq_packet()
            elif form is None:
                if due > self._sampled:
                    self._out += self._nodes(due - self._sampled)
            else:
                while self._sampled + form.samples <= due:
                    self._out += self.next_capsule(form)
        out, self._out = self._out, b""
        return b"" if self.mute else out

    def _distance_m(self, beam_deg: Float64s) -> Float64s:
        distance_m = self.range_of(-np.radians(beam_deg))
        seen = np.isfinite(distance_m) & (distance_m <= self._range_max_m) & (not self.blind)
        if self.blank:
            at_deg = beam_deg % 360.0
            seen &= (at_deg < _BLANK_DEG[0]) | (at_deg >= _BLANK_DEG[1])
        return np.where(seen, distance_m, 0.0)

    def _lag_deg(self, head_deg: Float64s, rounds: int) -> Float64s:
        """By how much each beam lags: it depends on the distance, which depends on where the beam goes."""
        lag = np.full_like(head_deg, 7.0)
        for _ in range(rounds):
            lag = samples.lag_deg(self._distance_m(head_deg - lag))
        return lag

    def _nodes(self, count: int) -> bytes:
        first = self._sampled
        self._sampled += count
        head = self.head_deg(first) + (self.head_deg(first + 1) - self.head_deg(first)) * np.arange(
            count, dtype=np.float64
        )
        lag = self._lag_deg(head, 3) if self.model.lags else np.zeros(count)
        angle = np.rint((head - lag) * 64.0).astype(np.int64) % TURN_Q6
        q2 = np.rint(self._distance_m(angle / 64.0) * 4000.0)
        whole_turns = np.floor((head - lag) / 360.0).astype(np.int64)
        starts = np.diff(whole_turns, prepend=self._angle_before) > 0
        self._angle_before = int(whole_turns.max())
        starts &= not self.flagless
        nodes = np.empty(count, dtype=[("head", "u1"), ("angle", "<u2"), ("distance", "<u2")])
        nodes["head"] = np.where(q2 > 0.0, _QUALITY_NODE << 2, 0) | np.where(starts, 1, 2)
        nodes["angle"] = angle << 1 | 1
        nodes["distance"] = q2
        return nodes.tobytes()

    def _hq_packet(self) -> bytes:
        first = self._sampled
        self._sampled += hq.NODES
        head = np.array([self.head_deg(first + i) for i in range(hq.NODES)])
        steps = np.rint(head * (16_384.0 / 90.0)).astype(np.int64)
        nodes = np.zeros(hq.NODES, dtype=[("angle", "<u2"), ("distance", "<u4"), ("quality", "u1"), ("flag", "u1")])
        nodes["angle"] = steps & 0xFFFF
        beam_deg = ((steps & 0xFFFF) * (90.0 / 16_384.0)).astype(np.float64)
        nodes["distance"] = np.rint(self._distance_m(beam_deg) * 4000.0)
        nodes["quality"] = np.where(nodes["distance"] > 0, _QUALITY_ULTRA, 0)
        turns = steps >> 16
        before = self._angle_before if self._angle_before >= 0 else turns[0]
        nodes["flag"] = np.where((np.diff(turns, prepend=before) > 0) & (not self.flagless), 1, 2)
        self._angle_before = int(turns.max())
        return hq.seal(self._sampled * 31, nodes.tobytes())

    def next_capsule(self, form: CapsuleFormat) -> bytes:
        """The next capsule, whatever the time."""
        first = self._sampled
        self._sampled += form.samples
        start, then = (round(self.head_deg(k) * 64.0) % TURN_Q6 for k in (first, first + form.samples))
        after = (then + round((self.head_deg(1) - self.head_deg(0)) * 64.0)) % TURN_Q6
        # measured exactly where the capsules' own angles say, so that a reader can be held to the last digit
        head = samples.head_q16(form, np.array([start]), np.array([(then - start) % TURN_Q6]))[0] / 65536.0
        if form is EXPRESS:
            lag_q3 = np.rint(self._lag_deg(head, 3) * 8.0).astype(np.int64) if self.model.lags else np.zeros(32, int)
            beam = np.floor((head - lag_q3 / 8.0) * 64.0) / 64.0
            data = samples.encode_express(np.rint(self._distance_m(beam) * 1000.0) * 4, lag_q3)
        elif form is ULTRA:
            heads = np.append(head, after / 64.0)
            mm = np.rint(self._distance_m(heads - self._lag_deg(heads, 6)) * 1000.0)
            data = samples.encode_ultra(mm[:-1], int(mm[-1]))
        elif form is DENSE:
            data = samples.encode_dense(np.rint(self._distance_m(np.floor(head * 64.0) / 64.0) * 1000.0))
        else:
            q2 = np.rint(self._distance_m(np.floor(head * 64.0) / 64.0) * 4000.0)
            data = samples.encode_ultra_dense(q2, np.where(q2 > 0.0, _QUALITY_ULTRA, 0))
        middle = b"" if form.angle_at == 2 else struct.pack("<IH", self._sampled * 31 & 0xFFFFFFFF, 0)
        return seal(form, start, data, first=first == 0, middle=middle)
