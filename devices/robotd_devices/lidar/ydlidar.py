"""YDLIDARs of the triangle family (X2, X3, X4, G4, SCL, T-mini) on a serial port: one `LidarScan` a revolution."""

from __future__ import annotations

import asyncio
from typing import Literal

from pydantic import Field, model_validator

from robotd.authoring.device import DeviceContext, DeviceUnavailable, Sensor
from robotd.world.messages import LidarScan
from robotd_devices.lidar import ydlidar_talk as talk
from robotd_devices.lidar.beam_sweep import BeamSweep
from robotd_devices.lidar.delivery import deliver
from robotd_devices.lidar.dialogue import Dialogue
from robotd_devices.lidar.serial_lidar import SerialLidarConfig
from robotd_devices.lidar.ydlidar_models import MODELS
from robotd_devices.lidar.ydlidar_packets import YdParser
from robotd_devices.lidar.ydlidar_sweep import YdSweep
from robotd_devices.ports.serial_port import SerialSettings, load_backend, serial_port

_FIRST_S = 3.0
"""A motor needs this long from standstill to its speed; until then no packet is missed."""


class YdlidarConfig(SerialLidarConfig):
    """Parameters of a YDLIDAR."""

    model: Literal["x4", "x2", "x3", "g4", "scl", "tmini", "tmini_plus"] = "x4"
    """Which lidar it is: the packets do not say, and samples are read differently."""
    baud: int | None = Field(default=None, ge=9_600, le=4_000_000)
    """Speed of the line; by default the model's."""
    rotation_hz: float = Field(default=7.0, ge=2.0, le=20.0)
    """Revolutions a second that are expected; 7 as the X4 comes."""
    range_max_m: float | None = Field(default=None, gt=0.0, le=100.0)
    """Farther than this is no return, in metres; by default the model's."""

    @model_validator(mode="after")
    def _some_range(self) -> YdlidarConfig:
        if self.range_max_m is not None and self.range_min_m >= self.range_max_m:
            raise ValueError(f"range_min_m {self.range_min_m} must be below range_max_m {self.range_max_m}")
        return self


class Ydlidar(Sensor[YdlidarConfig, LidarScan]):
    """Reads a YDLIDAR; a commanded model (X4, G4) is asked how it is, turned by DTR, and told to scan.

    Faults that it counts: those of the stream (`bad checksum`, `stray bytes`, `senseless header`, `impossible angles`,
    `no packet behind a packet`, `repeated packet`, `not turning`), of whole scans (`lost packets`,
    `no return anywhere`, `old scan dropped`, `rotation off`) and of the device (`health warning`, `health error`).
    Lost where the port goes away or no good packet comes for `silent_s`.
    """

    sim_twin = "sim_lidar"

    def __init__(self, config: YdlidarConfig, context: DeviceContext | None = None) -> None:
        super().__init__(config, context)
        self._model = MODELS[config.model]
        dtr = True if self._model.commanded else None
        self._settings = SerialSettings(config.port, config.baud or self._model.baud, dtr)
        self._line: Dialogue | None = None
        self._watch: asyncio.TimerHandle | None = None
        self._streaming = False
        self._stamp_ns = 0
        self._heard = 0

    @classmethod
    def load(cls, config: YdlidarConfig) -> None:
        load_backend(config.backend)

    @classmethod
    def publish_period_s(cls, config: YdlidarConfig) -> float:
        return 1.0 / config.rotation_hz

    async def open(self) -> None:
        config, model = self.config, self._model
        line = self._line = Dialogue(self.context.link.fault)
        await line.open(serial_port(self._settings, config.backend, line.take, self._gone))
        if model.commanded:
            try:
                await line.say(talk.begin())
            except DeviceUnavailable as error:
                heard = f"{line.bytes} bytes came" if line.bytes else "no byte came"
                raise DeviceUnavailable(
                    f"YDLIDAR {model.name} on {config.port} at {self._settings.baud} baud: {error}; {heard}. "
                    "Is it powered, and is `model` right?"
                ) from error
        self._listen()

    def _listen(self) -> None:
        config, mount, model, line = self.config, self.context.mount, self._model, self._line
        assert line is not None
        sweep = BeamSweep(
            beam_ns=1e9 / model.rate_hz,
            range_min_m=config.range_min_m,
            range_max_m=config.range_max_m or model.range_max_m,
            inverted=config.is_inverted(mount),
            seam_deg=config.seam_deg,
            trust_empty=config.trust_empty,
            mount=mount,
            after_ns=self._stamp_ns,
        )
        byte_ns = self._settings.byte_ns
        self._parser = YdParser(model.sample_bytes, byte_ns, sweep.beam_ns)
        self._turn, self._sweep = YdSweep(model, sweep, byte_ns), sweep
        self._heard, self._streaming = 0, True
        self._watch = asyncio.get_running_loop().call_later(max(self.config.silent_s, _FIRST_S), self._look)
        line.stream(self.feed)

    def feed(self, data: bytes) -> None:
        """Take bytes that were just read: parse, and publish the scans that they complete, in this very call."""
        now_ns = self.context.clock.now_ns()
        parser = self._parser
        for packet in parser.feed(data, now_ns):
            for scan in self._turn.add(packet):
                self._stamp_ns = scan.stamp_ns
                deliver(self, scan, self._sweep, self.config.rotation_hz, now_ns)
        if parser.faults:
            faults, parser.faults = parser.faults, []
            for name in faults:
                self.context.link.fault(name)

    def _look(self) -> None:
        """Once every `silent_s`: were there good packets since the last time?"""
        silent_s, line = self.config.silent_s, self._line
        assert line is not None
        if self._parser.packets > self._heard:
            self._heard, line.bytes = self._parser.packets, 0
            self._watch = asyncio.get_running_loop().call_later(silent_s, self._look)
            return
        self._watch = None
        if line.bytes == 0:
            why = "no byte came: is the lidar powered and its data wire on the receive pin?"
        elif self._parser.trouble == "not turning":
            why = "it sends but does not turn: is it blocked, or its supply too weak?"
        else:
            why = (
                f"{line.bytes} bytes came but no packet of this family: are `model: {self.config.model}` and "
                f"{self._settings.baud} baud right, and is {self.config.port} this lidar's port?"
            )
        self.lost(f"silent for {silent_s:g} s: {why}")

    async def close(self) -> None:
        if self._watch is not None:
            self._watch.cancel()
            self._watch = None
        line, self._line = self._line, None
        self._streaming = False
        if line is not None:
            last_words = talk.request(talk.STOP) if self._model.commanded else b""
            await line.leave(last_words, dtr=False if self._model.commanded else None)

    def _gone(self, reason: str) -> None:
        streaming, self._streaming = self._streaming, False
        if self._watch is not None:
            self._watch.cancel()
            self._watch = None
        if self._line is not None:
            self._line.lost(reason)
        if streaming:
            self.lost(reason)
