"""The doctor with the devices open: scripted devices on virtual time, then the shipped drivers against their fakes."""

from __future__ import annotations

import asyncio
import os
import re
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from robotd import cli
from robotd.authoring.config import Config
from robotd.authoring.device import Actuator, DeviceLost, DeviceUnavailable, Sensor
from robotd.engine.loops import real_loop
from robotd.engine.parts import DevicePart
from robotd.setup.doctor.elsewhere import look_elsewhere, port_of
from robotd.setup.doctor.examine import probe
from robotd.setup.doctor.findings import Finding
from robotd.setup.doctor.judge import judge_sighting
from robotd.setup.doctor.sight import KEPT, Sighting, sight
from robotd.testing import run_virtual
from robotd.world.kinematics import Ackermann
from robotd.world.messages import Battery, Drive, Float64s
from robotd.world.robot import Robot
from robotd_devices.camera import Camera
from robotd_devices.camera.config import CameraConfig
from robotd_devices.lidar.ld19 import Ld19, Ld19Config
from robotd_devices.lidar.ld19_fake import BoxRoom, Ld19Fake
from robotd_devices.lidar.rplidar import Rplidar, RplidarConfig
from robotd_devices.lidar.rplidar_fake import RplidarFake
from robotd_devices.lidar.rplidar_wire import Health
from robotd_devices.motor.jetbot import JetBotMotors, JetBotMotorsConfig
from robotd_devices.motor.mc_fake import McFake
from robotd_devices.motor.mc_motors import McConfig, McMotors
from robotd_devices.motor.pca9685_fake import Pca9685Fake
from robotd_devices.ports.fakes import FakeDevice
from robotd_devices.ports.i2c_fake import BusFault, FakeI2cBus
from robotd_devices.ports.i2c_host import I2cHost
from robotd_devices.ports.pty_host import PtyHost
from robotd_devices.ports.serial_line import speed_of

CAR = Robot(kinematics=Ackermann(wheelbase_m=0.257, track_m=0.16, max_steering_rad=0.436))


class Script(Config):
    """What a scripted device does."""

    port: str = "/dev/a"
    baud: int = 9600
    answers_on: str = "/dev/a"
    answers_at: int = 9600
    opens_in_s: float = 0.0
    refuses: str = ""
    lost_after_s: float | None = None
    every_s: float = 0.1
    closes_in_s: float = 0.0


class Scripted(Sensor[Script, Battery]):
    """Publishes evenly where port and baud are right. `log`: what was called, by all of them."""

    log: ClassVar[list[str]] = []

    @classmethod
    def publish_period_s(cls, config: Script) -> float:
        return config.every_s

    async def open(self) -> None:
        config = self.config
        self.log.append("open")
        await asyncio.sleep(config.opens_in_s)
        if config.refuses:
            raise DeviceUnavailable(config.refuses)
        self._task = asyncio.ensure_future(self._speak())

    async def _speak(self) -> None:
        config, loop = self.config, asyncio.get_running_loop()
        began_s = loop.time()
        while config.lost_after_s is None or loop.time() - began_s < config.lost_after_s:
            if (config.port, config.baud) == (config.answers_on, config.answers_at):
                self.publish(Battery(self.context.clock.now_ns(), 12.0))
            await asyncio.sleep(config.every_s)
        self.lost("it went away")

    async def close(self) -> None:
        self.log.append("close")
        if hasattr(self, "_task"):
            self._task.cancel()
        await asyncio.sleep(self.config.closes_in_s)


class Wheels(Actuator[Script, Drive]):
    log: ClassVar[list[str]] = []

    async def open(self) -> None:
        self.log.append("open")

    def apply(self, command: Drive) -> None:
        self.log.append("apply")

    def halt(self) -> None:
        self.log.append("halt")

    async def close(self) -> None:
        self.log.append("close")


@pytest.fixture(autouse=True)
def _fresh() -> None:
    Scripted.log.clear()
    Wheels.log.clear()


def scripted(**script: object) -> DevicePart:
    return DevicePart("gauge", Scripted, Script.model_validate(script))


def seen(seconds: float = 2.0, *, until_heard: bool = False, **script: object) -> Sighting:
    return run_virtual(sight(scripted(**script), Robot(), seconds, until_heard=until_heard))


def test_a_sighting_counts_and_keeps_the_last() -> None:
    got = seen(2.05)
    stream = got.streams[Battery]
    assert (len(stream.arrived_ns), len(stream.last), stream.hz) == (21, KEPT, pytest.approx(10.0))
    assert set(stream.age_ns) == {0}
    assert (got.watched_s, got.close_s, got.loss) == (pytest.approx(2.05), 0.0, None)
    assert Scripted.log == ["open", "close"]


def test_until_heard_it_waits_no_longer_than_it_must() -> None:
    assert seen(2.0, until_heard=True).watched_s == 0.0
    assert seen(2.0, until_heard=True, answers_at=115_200).watched_s == pytest.approx(2.0)


def test_a_loss_ends_it() -> None:
    got = seen(lost_after_s=0.55)
    assert got.watched_s == pytest.approx(0.6)
    assert isinstance(got.loss, DeviceLost)


@pytest.mark.parametrize(
    ("script", "fault"),
    [
        ({"opens_in_s": 60.0}, "opens too slowly"),
        ({"refuses": "no chip answers at 7"}, "no chip"),
        ({"closes_in_s": 0.4}, "closes too slowly"),
        ({"closes_in_s": 60.0}, "closes too slowly"),
        ({"answers_at": 4800}, "silent"),
        ({"lost_after_s": 1.0}, "lost again"),
    ],
)
def test_what_goes_wrong_is_judged_and_the_device_closed(script: dict[str, object], fault: str) -> None:
    assert [one.fault for one in judge_sighting(scripted(), seen(**script))] == [fault]
    assert Scripted.log == ["open", "close"]


def test_motors_are_halted_never_driven() -> None:
    run_virtual(sight(DevicePart("motors", Wheels, Script()), Robot(), 1.0))
    assert Wheels.log == ["open", "halt", "halt", "close"]


def test_a_cancelled_sighting_halts_and_closes() -> None:
    async def cancelled() -> None:
        task = asyncio.ensure_future(sight(DevicePart("motors", Wheels, Script()), Robot(), 10.0))
        await asyncio.sleep(1.0)
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)

    run_virtual(cancelled())
    assert Wheels.log == ["open", "halt", "halt", "close"]


@pytest.mark.parametrize(
    ("script", "owners", "free", "fault", "mend"),
    [
        ({"answers_on": "/dev/b"}, {"/dev/b": "motors"}, [], "ports swapped", "swap `port` of gauge and motors"),
        ({"answers_on": "/dev/c"}, {"/dev/b": "motors"}, ["/dev/c"], "on another port", "write port: /dev/c"),
        ({"answers_at": 115_200}, {"/dev/a": "gauge"}, ["/dev/b"], "other baud", "write baud: 115200"),
        ({"answers_on": "/dev/x"}, {"/dev/b": "motors"}, ["/dev/c"], "", ""),
    ],
)
def test_a_mute_device_is_looked_for(
    script: dict[str, object], owners: dict[str, str], free: list[str], fault: str, mend: str
) -> None:
    finding = run_virtual(look_elsewhere(scripted(**script), Robot(), owners, free))
    assert (finding.fault if finding else "") == fault
    assert mend in (finding.mend if finding else "")


@pytest.mark.parametrize(
    ("script", "looked"),
    [
        ({"answers_on": "/dev/b"}, True),
        ({"refuses": "no answer on /dev/a"}, True),
        ({"refuses": "/dev/a is in use by minicom (pid 3)"}, False),
        ({}, False),
    ],
)
def test_only_a_mute_device_is_looked_for(script: dict[str, object], looked: bool) -> None:
    run_virtual(probe([scripted(**script)], Robot(), ["/dev/b"], 1.0))
    assert (Scripted.log.count("open") > 1) is looked


def test_port_of() -> None:
    assert port_of(scripted()) == "/dev/a"
    assert port_of(DevicePart("motors", JetBotMotors, JetBotMotorsConfig())) == ""


# ---------------------------------------------------------------------------- shipped drivers on fakes


class Picky:
    """A fake whose line is garbage at any other speed than its own."""

    def __init__(self, inner: FakeDevice, link: Path, baud: int) -> None:
        self._inner, self._link, self._baud, self._fd = inner, link, baud, -1

    def power_on(self, now_ns: int) -> None:
        self._inner.power_on(now_ns)

    def feed(self, data: bytes, now_ns: int) -> None:
        self._inner.feed(data, now_ns)

    def tick(self, now_ns: int) -> bytes:
        data = self._inner.tick(now_ns)
        if not data:
            return b""
        if self._fd < 0:
            self._fd = os.open(self._link, os.O_RDWR | os.O_NOCTTY)
        return data if speed_of(self._fd) == self._baud else bytes(byte ^ 0x5A for byte in data)

    def close(self) -> None:
        os.close(self._fd)


class Mute:
    def power_on(self, now_ns: int) -> None: ...
    def feed(self, data: bytes, now_ns: int) -> None: ...
    def tick(self, now_ns: int) -> bytes:
        return b""


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as kept:
        yield kept


def lidar_on(path: Path, **config: object) -> DevicePart:
    return DevicePart("lidar", Ld19, Ld19Config.model_validate({"port": str(path), "silent_s": 0.5, **config}))


def probed(*parts: DevicePart, seconds: float = 0.7, robot: Robot | None = None) -> list[Finding]:
    with asyncio.Runner(loop_factory=real_loop) as runner:
        return runner.run(probe(parts, robot if robot is not None else Robot(), [], seconds))


def names(findings: list[Finding]) -> list[tuple[str, str]]:
    return [(one.subject, one.fault) for one in findings if one.fault]


def test_a_lidar_at_the_wrong_speed(tmp_path: Path, stack: ExitStack) -> None:
    fake = Picky(Ld19Fake(), tmp_path / "lidar", 230_400)
    stack.enter_context(PtyHost(fake, tmp_path / "lidar", baud=230_400))
    stack.callback(fake.close)
    findings = probed(lidar_on(tmp_path / "lidar", baud=115_200))
    found = [one for one in names(findings) if one[1] != "bad bytes"]
    assert found == [("lidar", "bytes of something else"), ("lidar", "other baud")]
    assert findings[-1].mend == "write baud: 230400"


def test_a_lidar_without_a_word(tmp_path: Path, stack: ExitStack, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robotd.setup.doctor.elsewhere.LOOK_S", 0.01)
    stack.enter_context(PtyHost(Mute(), tmp_path / "lidar", baud=230_400))
    assert names(probed(lidar_on(tmp_path / "lidar"))) == [("lidar", "no byte")]


def test_lidar_and_motors_on_each_other_s_port(tmp_path: Path, stack: ExitStack) -> None:
    stack.enter_context(PtyHost(Ld19Fake(), tmp_path / "a", baud=230_400))
    stack.enter_context(PtyHost(McFake(), tmp_path / "b", baud=921_600))
    motors = McConfig(port=str(tmp_path / "a"), answer_s=0.3, odometry="status")
    findings = probed(lidar_on(tmp_path / "b"), DevicePart("motors", McMotors, motors), robot=CAR)
    swapped = [one for one in findings if one.fault == "ports swapped"]
    assert [one.subject for one in swapped] == ["lidar", "motors"]
    assert swapped[0].mend == "swap `port` of lidar and motors in the config (or their cables)"
    assert {one.code for one in swapped} == {78}


def test_a_lidar_in_its_protection_stop(tmp_path: Path, stack: ExitStack) -> None:
    fake = RplidarFake("a1")
    fake.health, fake.stubborn = Health(2, 0x8001), True
    stack.enter_context(PtyHost(fake, tmp_path / "lidar", baud=115_200))
    part = DevicePart("lidar", Rplidar, RplidarConfig(port=str(tmp_path / "lidar"), baud=115_200))
    findings = probed(part)
    assert "health error" in [one.fault for one in findings]
    assert "code 0x8001" in next(one.cause for one in findings if one.fault == "health error")


@pytest.mark.parametrize(("fault", "name"), [("nack", "no chip"), ("stuck", "bus stuck")])
def test_a_bus_without_an_answer(fault: BusFault, name: str, tmp_path: Path, stack: ExitStack) -> None:
    host = stack.enter_context(I2cHost(FakeI2cBus([Pca9685Fake()]), tmp_path / "i2c"))
    host.bus.fail(fault)
    part = DevicePart("motors", JetBotMotors, JetBotMotorsConfig(bus=str(tmp_path / "i2c")))
    assert names(probed(part, seconds=0.1)) == [("motors", name)]


def test_a_camera_with_its_cap_on(tmp_path: Path) -> None:
    import cv2

    for i in range(2):
        cv2.imwrite(str(tmp_path / f"{i}.png"), np.full((32, 48, 3), i, np.uint8))
    part = DevicePart("camera", Camera, CameraConfig(source=str(tmp_path), rate_hz=30.0))
    assert ("camera", "picture black") in names(probed(part, seconds=0.3))


ROBOT = """
robot:
  kinematics: {{type: differential, track_m: 0.118, wheel_radius_m: 0.0325}}
  footprint_m: [[0.06, 0.065], [0.06, -0.065], [-0.12, -0.065], [-0.12, 0.065]]
devices:
  lidar: {{use: ld19, port: {folder}/lidar}}
  motors: {{use: jetbot_motors, bus: {folder}/i2c}}
guard:
  zones: {{off: "on the bench"}}
"""


def rough_room(bearing_rad: Float64s) -> Float64s:
    """A room whose walls are never measured twice the same."""
    return BoxRoom()(bearing_rad) + ROUGH.normal(0.0, 0.01, bearing_rad.shape)


ROUGH = np.random.default_rng(1)


def test_the_whole_command_on_a_healthy_robot(
    tmp_path: Path, stack: ExitStack, capsys: pytest.CaptureFixture[str]
) -> None:
    bus = FakeI2cBus([Pca9685Fake()])
    stack.enter_context(PtyHost(Ld19Fake(rough_room), tmp_path / "lidar", baud=230_400))
    stack.enter_context(I2cHost(bus, tmp_path / "i2c"))
    file = tmp_path / "robot.yaml"
    file.write_text(ROBOT.format(folder=tmp_path))
    assert cli.main(["doctor", str(file), "--probe", "--seconds", "0.8"]) == 0
    out = capsys.readouterr().out
    # a machine that is busy with other things may cost warnings of its own, but no error
    assert re.search(r"lidar +\S.*LidarScan", out)
    assert re.search(r"motors +\S.*Odometry", out)
    assert not re.search(r"^error", out, re.M)
    assert bus.writes  # the stop and the settings
    chip = bus.chips[0]
    assert isinstance(chip, Pca9685Fake)
    assert {chip.duty(channel) for channel in range(16)} == {0.0}


@pytest.mark.parametrize(
    ("argv", "words"),
    [("doctor --probe", "name its FILE"), ("doctor a.yaml --seconds 3", "add --probe")],
)
def test_options_that_make_no_sense(argv: str, words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(argv.split()) == 64
    assert words in capsys.readouterr().err
