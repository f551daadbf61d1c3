"""Slamtec RPLIDARs (A1, A2, A3, C1, S1, S2, S3) on a serial port: one `LidarScan` a revolution."""

from __future__ import annotations

import asyncio
from typing import Literal

from pydantic import Field, model_validator

from robotd.authoring.device import DeviceContext, DeviceError, DeviceLost, DeviceUnavailable, Sensor
from robotd.world.messages import LidarScan
from robotd_devices.lidar import rplidar_talk as talk
from robotd_devices.lidar.beam_sweep import BeamSweep
from robotd_devices.lidar.delivery import deliver
from robotd_devices.lidar.dialogue import Dialogue
from robotd_devices.lidar.rplidar_models import BAUDS
from robotd_devices.lidar.rplidar_reader import RplidarReader
from robotd_devices.lidar.rplidar_wire import Info
from robotd_devices.lidar.serial_lidar import SerialLidarConfig
from robotd_devices.ports.serial_port import SerialSettings, load_backend, serial_port

_LOOK_S = 0.1
#: A motor needs this long from standstill to its speed; until then no scan is missed.
_SPIN_UP_S = 3.0
#: Shares of `silent_s` after which a lidar that sends nothing is started anew, then reset.
_SILENT_AT = (1 / 6, 1 / 2)
#: Those after which the motor of one that does not turn is switched off and on.
_STALLED_AT = (1 / 6, 5 / 12, 2 / 3)


class RplidarConfig(SerialLidarConfig):
    """Parameters of an RPLIDAR."""

    baud: int | Literal["auto"] = "auto"
    """Speed of the line; auto tries 115200 (A1, A2M8), 256000 (A2M12, A3, S1), 460800 (C1), 1000000 (S2, S3)."""
    negotiate: bool = False
    """Ask the lidar to take over `baud`, where it does not answer at it: for a UART that cannot do the lidar's own."""
    mode: str = Field(default="auto", min_length=1)
    """Scan mode by the device's own name (Boost, DenseBoost...), standard, or auto: the best that has a checksum."""
    motor: Literal["auto", "dtr", "pwm", "rpm", "none"] = "auto"
    """How the motor is driven; auto asks the device."""
    pwm: int = Field(default=660, ge=0, le=1023)
    """Pulse width for a motor driven by PWM (A2, A3)."""
    rotation_hz: float = Field(default=10.0, ge=2.0, le=20.0)
    """Revolutions a second: what a motor driven by rpm is told, and what the others are expected to do (A1: 5.5)."""
    range_max_m: float = Field(default=12.0, gt=0.0, le=100.0)
    """Farther than this is no return, in metres."""
    silent_s: float = Field(default=6.0, ge=1.0, le=60.0)
    """Without a scan: after a sixth of this it is started anew, after half reset, then the port is opened anew."""

    @model_validator(mode="after")
    def _some_range(self) -> RplidarConfig:
        if self.range_min_m >= self.range_max_m:
            raise ValueError(f"range_min_m {self.range_min_m} must be below range_max_m {self.range_max_m}")
        if self.baud != "auto" and not 9_600 <= self.baud <= 4_000_000:
            raise ValueError(f"baud {self.baud} is no speed of an RPLIDAR: auto, or 9600 to 4000000")
        if self.negotiate and self.baud == "auto":
            raise ValueError("negotiate needs a `baud` to agree on: write a number, say 115200")
        return self


class Rplidar(Sensor[RplidarConfig, LidarScan]):
    """Finds the speed of the line, asks the lidar how it is, turns its motor, starts the best scan and reads it.

    Faults that it counts: those of the stream (`bad checksum`, `stray bytes`, `no packet behind a packet`,
    `impossible angle`, `not turning`; in the standard mode `senseless node`, `lost alignment`), of whole scans
    (`lost packets`, `no return anywhere`, `old scan dropped`, `rotation off`), of the device (`health warning`,
    `protection stop`) and of its silence (`scan restarted`, `lidar reset`, `does not come back`). Lost where the port
    goes away or where nothing brings scans back within `silent_s`.
    """

    sim_twin = "sim_lidar"

    def __init__(self, config: RplidarConfig, context: DeviceContext | None = None) -> None:
        super().__init__(config, context)
        self._wishes = talk.Wishes(config.mode, config.motor, config.pwm, round(60.0 * config.rotation_hz))
        self._line: Dialogue | None = None
        self._watch: asyncio.Task[None] | None = None
        self._baud: int | None = None
        self._reader: RplidarReader | None = None
        self._stamp_ns = 0
        self._scans = 0
        self._quiet_from = -1
        """Bytes of the line when scans began to be missed."""
        self.scanning: talk.Scanning | None = None
        """Model, firmware, scan mode and motor; None while closed."""

    @classmethod
    def load(cls, config: RplidarConfig) -> None:
        load_backend(config.backend)

    @classmethod
    def publish_period_s(cls, config: RplidarConfig) -> float:
        return 1.0 / config.rotation_hz

    async def open(self) -> None:
        line, settings, info = await self._find()
        self._line = line
        # known before the motor turns, so that `close` stops it also where the scan does not begin
        self.scanning = await line.say(talk.get_ready(info, self._wishes))
        await line.say(talk.begin(self.scanning, self._wishes))
        self._listen(settings)
        self._watch = asyncio.get_running_loop().create_task(self._keep_going(settings))

    async def _find(self) -> tuple[Dialogue, SerialSettings, Info]:
        """The open line at the speed at which the lidar answers."""
        config = self.config
        bauds = [config.baud] if config.baud != "auto" else sorted(BAUDS, key=lambda baud: baud != self._baud)
        heard = 0
        for baud in bauds:
            line, settings = await self._open_at(baud)
            info = await line.say(talk.hello())
            if info is None and config.negotiate and await line.say(talk.measure_speed()) is not None:
                await line.leave(b"", dtr=None)
                line, settings = await self._open_at(baud)
                await line.say(talk.settle(baud))
                info = await line.say(talk.hello())
            if info is not None:
                self._baud = baud
                return line, settings, info
            heard += line.bytes
            await line.leave(b"", self._dtr_at_end())
        tried = ", ".join(str(baud) for baud in bauds)
        why = (
            f"{heard} bytes came but no answer: is {config.port} this lidar's port?"
            if heard
            else "no byte came: is the lidar powered (5 V, 1 A at start), and are its data wires crossed?"
        )
        raise DeviceUnavailable(f"no RPLIDAR answers on {config.port} at {tried} baud; {why}")

    async def _open_at(self, baud: int) -> tuple[Dialogue, SerialSettings]:
        config = self.config
        settings = SerialSettings(config.port, baud, dtr=None if config.motor == "none" else False)
        line = self._line = Dialogue(self.context.link.fault)
        await line.open(serial_port(settings, config.backend, line.take, self._gone))
        return line, settings

    def _listen(self, settings: SerialSettings) -> None:
        """Hand the stream to a parser and a sweep of the scan's format."""
        config, mount, scanning = self.config, self.context.mount, self.scanning
        assert scanning is not None and self._line is not None
        sweep = BeamSweep(
            beam_ns=scanning.mode.sample_us * 1e3,
            range_min_m=config.range_min_m,
            range_max_m=config.range_max_m,
            inverted=config.is_inverted(mount),
            seam_deg=config.seam_deg,
            trust_empty=config.trust_empty,
            mount=mount,
            after_ns=self._stamp_ns,
        )
        self._reader = reader = RplidarReader(scanning.mode.answer, sweep, settings.byte_ns, config.rotation_hz)
        self._line.stream(lambda data: self._read(reader, data))

    def _read(self, reader: RplidarReader, data: bytes) -> None:
        """Bytes of the scan that were just read: the scans that they complete are published in this very call."""
        now_ns = self.context.clock.now_ns()
        for scan in reader.feed(data, now_ns):
            self._stamp_ns, self._scans = scan.stamp_ns, self._scans + 1
            deliver(self, scan, reader.sweep, self.config.rotation_hz, now_ns)
        for name in reader.take_faults():
            self.context.link.fault(name)

    async def _keep_going(self, settings: SerialSettings) -> None:
        """Looks for scans; brings a silent or stalled lidar back step by step, and gives the port up at last."""
        loop, silent_s = asyncio.get_running_loop(), self.config.silent_s
        scans, since_s, tried, told = -1, loop.time() + _SPIN_UP_S, 0, False
        while True:
            await asyncio.sleep(_LOOK_S)
            if self._scans != scans:
                first, scans = scans < 0, self._scans
                if not first:
                    since_s, tried, told = loop.time(), 0, False
                self._quiet_from = -1
                continue
            if self._quiet_from < 0 and self._line is not None:
                self._quiet_from = self._line.bytes
            silence_s = loop.time() - since_s
            stalled = self._reader is not None and self._reader.not_turning
            if stalled and not told and silence_s > 0.0:
                told = True
                self.context.link.fault("not turning", self._why())
            steps = _STALLED_AT if stalled else _SILENT_AT
            try:
                if silence_s >= silent_s:
                    self.lost(f"silent for {silent_s:g} s: {self._why()}")
                    return
                if tried < len(steps) and silence_s >= steps[tried] * silent_s:
                    tried += 1
                    if stalled or tried == 1:
                        await self._restart(settings)
                    else:
                        await self._reset(settings)
            except DeviceLost:
                return  # the port has reported it
            except DeviceError as error:
                self.context.link.fault("does not come back", str(error))

    async def _restart(self, settings: SerialSettings) -> None:
        line, scanning, reader = self._line, self.scanning, self._reader
        assert line is not None and scanning is not None and reader is not None
        stuck = reader.not_turning
        self.context.link.fault("scan restarted", self._why())
        await line.say(talk.again(scanning, self._wishes, motor_too=stuck))
        self._listen(settings)

    async def _reset(self, settings: SerialSettings) -> None:
        line = self._line
        assert line is not None
        self.context.link.fault("lidar reset", self._why())
        self.scanning = await line.say(talk.anew(self._wishes))
        self._listen(settings)

    def _why(self) -> str:
        reader, line = self._reader, self._line
        assert reader is not None and line is not None
        count = line.bytes - self._quiet_from
        if count == 0:
            return "no byte came: has the lidar lost its supply?"
        if reader.not_turning:
            return "it sends but does not turn: is it blocked, or its supply too weak?"
        return f"{count} bytes came but no whole turn: is something else sending on {self.config.port}?"

    async def close(self) -> None:
        watch, self._watch = self._watch, None
        line, self._line = self._line, None
        scanning, self.scanning = self.scanning, None
        if watch is not None:
            watch.cancel()
            await asyncio.wait((watch,))
        if line is not None:
            motor = scanning.motor if scanning is not None else "none"
            await line.leave(talk.stop_commands(motor), self._dtr_at_end())

    def _dtr_at_end(self) -> bool | None:
        """Raised again, unless it was left alone: cleared, it lets the motor of an A1 turn for ever."""
        return None if self.config.motor == "none" else True

    def _gone(self, reason: str) -> None:
        opening = self._watch is None
        if self._line is not None:
            self._line.lost(reason)
        if not opening:
            self.lost(reason)
