"""A VESC as its serial line sees it: a motor that reaches its speed at once, a servo, a time limit, a tachometer."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar

from robotd_devices.motor import vesc_packets as vesc
from robotd_devices.motor.vesc_packets import Values, VescParser
from robotd_devices.ports.breakable import Breakable

_MS = 1_000_000
_OVER_CURRENT = 4


class VescFake(Breakable):
    """`times_out`: releases the motor `timeout_ms` after the last command, as it does where the setting is left on.

    A question does not feed the time limit. `fault`: the code that it reports; with one the motor is let go.
    """

    breaks: ClassVar[Mapping[str, str]] = MappingProxyType(
        {"controller silent": "is_mute", "over-current": "draw_too_much"}
    )

    def __init__(self, *, times_out: bool = True, timeout_ms: int = vesc.TIMEOUT_MS) -> None:
        self.is_mute = False
        self.fault = 0
        self.voltage_v = 11.1
        self.servo = 0.5
        self.brake_a = 0.0
        self._times_out = times_out
        self._timeout_ns = timeout_ms * _MS
        self._erpm = 0
        self._counts = 0.0
        self._fed_ns = self._now_ns = 0
        self.power_on(0)

    def power_on(self, now_ns: int) -> None:
        """The cable went in; the controller hangs on its battery and goes on."""
        self._parser = VescParser()
        self._out = b""

    def draw_too_much(self, now_ns: int) -> None:
        """It lets the motor go and reports why."""
        self.fault = _OVER_CURRENT

    def erpm(self, now_ns: int) -> int:
        """Electrical revolutions a minute that the motor makes now."""
        if self.fault or (self._times_out and now_ns - self._fed_ns > self._timeout_ns):
            return 0
        return self._erpm

    def feed(self, data: bytes, now_ns: int) -> None:
        for payload in self._parser.feed(data):
            self._turn(now_ns)
            self._take(payload, now_ns)

    def tick(self, now_ns: int) -> bytes:
        self._turn(now_ns)
        out, self._out = self._out, b""
        return b"" if self.is_mute else out

    def _turn(self, now_ns: int) -> None:
        # six counts a revolution, sixty seconds a minute
        self._counts += self.erpm(now_ns) / 10.0 * max(0, now_ns - self._now_ns) / 1e9
        self._now_ns = max(self._now_ns, now_ns)

    def _take(self, payload: bytes, now_ns: int) -> None:
        command = payload[0]
        if command == vesc.FW_VERSION:
            self._out += vesc.encode(bytes((vesc.FW_VERSION, 5, 3)) + b"410\0")
        elif command == vesc.GET_VALUES:
            erpm = self.erpm(now_ns)
            self._out += vesc.encode(
                vesc.values_payload(
                    Values(31.5, 40.0, 2.0, 1.5, erpm / 20_000, erpm, self.voltage_v, round(self._counts), self.fault)
                )
            )
        elif command == vesc.SET_SERVO:
            self.servo = struct.unpack(">h", payload[1:3])[0] / 1000
        elif command in (vesc.SET_CURRENT, vesc.SET_BRAKE, vesc.SET_RPM):
            value = struct.unpack(">i", payload[1:5])[0]
            self._erpm = value if command == vesc.SET_RPM else 0
            self.brake_a = value / 1000 if command == vesc.SET_BRAKE else 0.0
            self._fed_ns = now_ns
        elif command == vesc.ALIVE:
            self._fed_ns = now_ns
