"""The LDROBOT LD19 (and LD06, STL-19P, STL-27L) on a serial port: one `LidarScan` a revolution."""

from __future__ import annotations

import asyncio

from pydantic import Field, model_validator

from robotd.authoring.device import DeviceContext, Sensor
from robotd.world.messages import LidarScan
from robotd_devices.lidar.delivery import deliver
from robotd_devices.lidar.ld_packets import LdParser
from robotd_devices.lidar.ld_sweep import LdSweep
from robotd_devices.lidar.serial_lidar import SerialLidarConfig
from robotd_devices.ports.serial_port import SerialPort, SerialSettings, load_backend, serial_port


class Ld19Config(SerialLidarConfig):
    """Parameters of an LD19 lidar."""

    baud: int = Field(default=230_400, ge=9_600, le=4_000_000)
    """Speed of the line; 230400 for LD06, LD19 and STL-19P, 921600 for STL-27L."""
    range_min_m: float = Field(default=0.02, ge=0.0, le=1.0)
    """Nearer than this something is touching, in metres."""
    range_max_m: float = Field(default=12.0, gt=0.0, le=100.0)
    """Farther than this is no return, in metres."""
    rotation_hz: float = Field(default=10.0, ge=2.0, le=20.0)
    """Revolutions a second; the LD19 turns at 10, an LD06 at what its PWM input says."""

    @model_validator(mode="after")
    def _some_range(self) -> Ld19Config:
        if self.range_min_m >= self.range_max_m:
            raise ValueError(f"range_min_m {self.range_min_m} must be below range_max_m {self.range_max_m}")
        return self


class Ld19(Sensor[Ld19Config, LidarScan]):
    """Reads an LD19; the lidar spins and sends by itself, nothing is written to it.

    Faults that it counts: `bad checksum`, `stray bytes`, `no packet behind a packet`, `speed and angles disagree`,
    `jump of the device's clock or speed`, `not turning`, `repeated packet`, `lost packets` (once a scan that has
    gaps), `no return anywhere` (a scan without one), `old scan dropped` (older than a revolution after a stall),
    `rotation off` (30 % from `rotation_hz`). Lost where the port goes away or no good packet comes for `silent_s`.
    """

    sim_twin = "sim_lidar"

    def __init__(self, config: Ld19Config, context: DeviceContext | None = None) -> None:
        super().__init__(config, context)
        self._settings = SerialSettings(config.port, config.baud)
        self._port: SerialPort | None = None
        self._watch: asyncio.TimerHandle | None = None
        self._bytes = 0
        self._heard = 0
        self._prepare()

    def _prepare(self) -> None:
        config, mount = self.config, self.context.mount
        self._parser = LdParser(self._settings.byte_ns)
        self._sweep = LdSweep(
            byte_ns=self._settings.byte_ns,
            range_min_m=config.range_min_m,
            range_max_m=config.range_max_m,
            inverted=config.is_inverted(mount),
            seam_deg=config.seam_deg,
            trust_empty=config.trust_empty,
            mount=mount,
        )

    @classmethod
    def load(cls, config: Ld19Config) -> None:
        load_backend(config.backend)

    @classmethod
    def publish_period_s(cls, config: Ld19Config) -> float:
        return 1.0 / config.rotation_hz

    async def open(self) -> None:
        self._prepare()
        port = serial_port(self._settings, self.config.backend, self.feed, self._gone)
        self._port = port
        await port.open()
        self._bytes = self._heard = 0
        self._watch = asyncio.get_running_loop().call_later(self.config.silent_s, self._listen)

    async def close(self) -> None:
        if self._watch is not None:
            self._watch.cancel()
            self._watch = None
        port, self._port = self._port, None
        if port is not None:
            port.abort()

    def feed(self, data: bytes) -> None:
        """Take bytes that were just read: parse, and publish the scans that they complete, in this very call."""
        now_ns = self.context.clock.now_ns()
        self._bytes += len(data)
        parser, sweep = self._parser, self._sweep
        for packet in parser.feed(data, now_ns):
            scan = sweep.add(packet)
            if scan is not None:
                deliver(self, scan, sweep, self.config.rotation_hz, now_ns)
        if parser.faults:
            faults = parser.faults[:]
            parser.faults.clear()
            for name in faults:
                self.context.link.fault(name)

    def _listen(self) -> None:
        """Once every `silent_s`: were there good packets since the last time?"""
        if self._parser.packets > self._heard:
            self._heard, self._bytes = self._parser.packets, 0
            self._watch = asyncio.get_running_loop().call_later(self.config.silent_s, self._listen)
            return
        self._watch = None
        config = self.config
        if self._bytes == 0:
            why = "no byte came: is the lidar powered and its data wire on the receive pin?"
        elif self._parser.trouble == "not turning":
            why = "it sends but does not turn: is it blocked, or its supply too weak?"
        else:
            why = (
                f"{self._bytes} bytes came but no packet of this family: is `baud: {config.baud}` right, "
                f"and is {config.port} this lidar's port?"
            )
        self.lost(f"silent for {config.silent_s:g} s: {why}")

    def _gone(self, reason: str) -> None:
        if self._watch is not None:
            self._watch.cancel()
            self._watch = None
        self.lost(reason)
