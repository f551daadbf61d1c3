"""The ESP32 of a TT-02D car as its serial line sees it: modes, time limits, the latch of KILL, and the creep trap."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar

from robotd_devices.motor import mc
from robotd_devices.motor.mc import Kind, McFrame, McParser
from robotd_devices.ports.breakable import Breakable

_MS = 1_000_000
NEVER_MS = 0xFFFF


class McFake(Breakable):
    """Obeys DRIVE in auto mode while the heartbeat and the command are fresh; else it stands.

    `creeps`: a fresh DRIVE with speed 0 or less drives at `mc.CREEP_MM_S`, as some builds of the firmware do.
    STATUS and IMU_STATUS every 10 ms, ACK where it is asked for and for every PING. `log`: frames with their times.
    """

    breaks: ClassVar[Mapping[str, str]] = MappingProxyType({"controller silent": "is_mute"})

    def __init__(self, *, creeps: bool = True, long_status: bool = True) -> None:
        self.creeps = creeps
        self.is_mute = False
        """The controller hangs: it sends nothing more, but its wheels go on by its own limits."""
        self.log: list[tuple[int, McFrame]] = []
        self._long_status = long_status
        self._killed = False
        self.power_on(0)

    def power_on(self, now_ns: int) -> None:
        """The cable went in; the controller has its own supply and keeps its state, KILL too."""
        self._parser = McParser()
        self._out = b""
        self._next_ns = now_ns
        if not hasattr(self, "auto"):
            self.restart(now_ns)

    def restart(self, now_ns: int) -> None:
        """Its reset button."""
        self.auto = False
        self._killed = False
        self._heart_ns: int | None = None
        self._drive_ns: int | None = None
        self._steer_cdeg = self._speed_mm_s = self._seq = 0
        self._ttl_ns = 0

    def feed(self, data: bytes, now_ns: int) -> None:
        for frame in self._parser.feed(data):
            self.log.append((now_ns, frame))
            self._take(frame, now_ns)

    def _take(self, frame: McFrame, now_ns: int) -> None:
        if frame.kind == Kind.DRIVE and len(frame.payload) == 8:
            steer, speed, ttl_ms, _ = struct.unpack("<hhHH", frame.payload)
            self._steer_cdeg = max(-mc.STEER_CDEG, min(mc.STEER_CDEG, steer))
            self._speed_mm_s = max(0, min(mc.SPEED_MM_S, speed))
            self._ttl_ns = max(mc.TTL_MS[0], min(mc.TTL_MS[1], ttl_ms)) * _MS
            self._seq, self._drive_ns = frame.seq, now_ns
        elif frame.kind == Kind.KILL and not frame.payload:
            self._killed = True
        elif frame.kind == Kind.MODE_SET and frame.payload in (b"\x00", b"\x01"):
            self.auto = frame.payload == b"\x01"
        elif frame.kind == Kind.PING and not frame.payload:
            self._heart_ns = now_ns
        else:
            return
        if frame.flags & mc.ACK_REQUEST or frame.kind == Kind.PING:
            self._out += mc.encode(McFrame(Kind.ACK, b"", frame.seq))

    def is_fresh(self, now_ns: int) -> bool:
        """Whether it obeys the last DRIVE now."""
        return self.auto and not self._killed and self._alive(now_ns) and self._in_time(now_ns)

    def speed_mm_s(self, now_ns: int) -> int:
        """What the motor is told now."""
        if not self.is_fresh(now_ns):
            return 0
        return self._speed_mm_s or (mc.CREEP_MM_S if self.creeps else 0)

    def steer_cdeg(self, now_ns: int) -> int:
        """Where the front wheels are told to stand now."""
        return self._steer_cdeg if self.is_fresh(now_ns) else 0

    @property
    def is_killed(self) -> bool:
        """KILL is latched."""
        return self._killed

    def tick(self, now_ns: int) -> bytes:
        while self._next_ns <= now_ns:
            self._out += self._report(self._next_ns)
            self._next_ns += 10 * _MS
        out, self._out = self._out, b""
        return b"" if self.is_mute else out

    def _alive(self, now_ns: int) -> bool:
        return self._heart_ns is not None and now_ns - self._heart_ns <= mc.HEARTBEAT_MS * _MS

    def _in_time(self, now_ns: int) -> bool:
        return self._drive_ns is not None and now_ns - self._drive_ns <= self._ttl_ns

    def _report(self, now_ns: int) -> bytes:
        faults = 0
        if self._killed:
            faults |= mc.KILL_LATCHED
        if self.auto and self._heart_ns is not None and not self._alive(now_ns):
            faults |= mc.HEARTBEAT_LOST
        if self.auto and self._drive_ns is not None and not self._in_time(now_ns):
            faults |= mc.TTL_EXPIRED
        if not self.auto and self._in_time(now_ns):
            faults |= mc.NOT_AUTO
        age_ms = NEVER_MS if self._drive_ns is None else min(NEVER_MS - 1, max(0, now_ns - self._drive_ns) // _MS)
        speed, steer = self.speed_mm_s(now_ns), self.steer_cdeg(now_ns)
        status = struct.pack("<BBHhhH", self._seq & 0xFF, self.auto, faults, speed, steer, age_ms)
        if self._long_status:
            status += bytes(4)
        # turns like a car of 257 mm wheelbase: about 0.39 degrees a second for each mm/s at 10 degrees
        yaw_ddps = round(speed * steer / 2_570)
        imu = struct.pack("<hhHhHBB", 0, speed, 3000, yaw_ddps, 1, 0x03, 0)
        return mc.encode(McFrame(Kind.STATUS, status)) + mc.encode(McFrame(Kind.IMU, imu))
