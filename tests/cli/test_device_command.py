"""robotd device: one device alone on the bench, listened to or driven, and halted on every way out."""

from __future__ import annotations

import asyncio
import atexit
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from doctor_facts import PortConfig

from robotd import cli
from robotd.authoring.config import NoConfig
from robotd.authoring.device import Actuator, DeviceLost, DeviceUnavailable, Sensor
from robotd.engine.parts import DevicePart, Parts
from robotd.setup import bench
from robotd.setup.exit_codes import Usage
from robotd.testing import run_virtual
from robotd.world.kinematics import Ackermann, Differential, Mecanum
from robotd.world.messages import Battery, CameraFrame, Command, Drive, LidarScan, Message, Odometry, Steer
from robotd.world.robot import Limits, Robot
from robotd_devices.motor.pca9685_fake import Pca9685Fake
from robotd_devices.ports.i2c_fake import FakeI2cBus
from robotd_devices.ports.i2c_host import I2cHost

FAST = Limits(vx_mps=1.0, vy_mps=0.8, wz_radps=4.0, accel_mps2=10.0, angular_accel_radps2=40.0)
TWO_WHEELS = Robot(kinematics=Differential(track_m=0.3, wheel_radius_m=0.05), limits=FAST)
MECANUM = Robot(kinematics=Mecanum(wheelbase_m=0.16, track_m=0.17, wheel_radius_m=0.0325), limits=FAST)
CAR = Robot(kinematics=Ackermann(wheelbase_m=0.257, track_m=0.16, max_steering_rad=0.436), limits=FAST)


class Wheels(Actuator[NoConfig, Drive]):
    emits = (Odometry,)
    log: ClassVar[list[Any]] = []
    fails: ClassVar[str] = ""

    async def open(self) -> None:
        if self.fails == "open":
            raise DeviceUnavailable("motors: no answer")
        self.log.append("open")

    def apply(self, command: Drive) -> None:
        self.log.append(command)
        if self.fails == "apply":
            raise OSError(5, "no")
        if self.fails == "loss":
            self.lost("the cable fell out")
        self.publish(Odometry(self.context.clock.now_ns(), 0.0, 0.0, 0.0, command.vx_mps))

    def halt(self) -> None:
        self.log.append("halt")

    async def close(self) -> None:
        self.log.append("close")


class Car(Actuator[NoConfig, Steer]):
    log: ClassVar[list[Any]] = []

    def apply(self, command: Steer) -> None:
        self.log.append(command)

    def halt(self) -> None:
        self.log.append("halt")


class Gauge(Sensor[NoConfig, Battery]):
    says: ClassVar[bool] = True

    async def open(self) -> None:
        self._task = asyncio.ensure_future(self._speak())

    async def _speak(self) -> None:
        while self.says:
            self.publish(Battery(self.context.clock.now_ns(), 12.25, charge=0.5))
            self.context.link.fault("noise")
            await asyncio.sleep(0.1)

    async def close(self) -> None:
        self._task.cancel()


@pytest.fixture(autouse=True)
def _fresh(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    before = signal.getsignal(signal.SIGTERM)
    Wheels.log.clear()
    Car.log.clear()
    yield
    signal.signal(signal.SIGTERM, before)


WHEELS, GAUGE, STEERED = (DevicePart(n, c, NoConfig()) for n, c in (("m", Wheels), ("b", Gauge), ("c", Car)))


def driven(part: DevicePart, robot: Robot, command: Command, seconds: float = 1.0, **more: Any) -> list[str]:
    lines: list[str] = []
    assert run_virtual(bench.drive(part, robot, command, seconds, lines.append, **more)) == 0
    return lines


# ---------------------------------------------------------------------------------------------- drive


def test_it_drives_for_its_time_and_halts() -> None:
    lines = driven(WHEELS, TWO_WHEELS, Drive(0.1))
    log = Wheels.log
    assert log[:2] == ["open", "halt"]
    assert log[-3:] == ["halt", "halt", "close"]
    assert set(log[2:-3]) - {Drive()} == {Drive(0.1)}
    assert 20 <= len(log[2:-3]) <= 21
    assert lines[-2:] == [
        "driven: vx +0.10 m/s, wz +0.00 rad/s; halted",
        "Odometry 20.0 Hz, 0.05 s old: x_m 0.000, y_m 0.000, yaw_rad 0.000, vx_mps 0.100, vy_mps 0.000, wz_radps 0.000",
    ]


@pytest.mark.parametrize(
    ("part", "robot", "command", "fastest", "written"),
    [
        (WHEELS, TWO_WHEELS, Drive(0.1), None, Drive(0.1)),
        (WHEELS, TWO_WHEELS, Drive(3.0), None, Drive(0.2)),
        (WHEELS, TWO_WHEELS, Drive(-3.0), None, Drive(-0.2)),
        (WHEELS, TWO_WHEELS, Drive(0.0, 9.0), None, Drive(0.0, 1.0)),
        (WHEELS, TWO_WHEELS, Drive(0.6), 0.5, Drive(0.5)),
        (WHEELS, TWO_WHEELS, Drive(3.0), 9.0, Drive(1.0)),
        (WHEELS, TWO_WHEELS, Drive(0.0, 9.0), 9.0, Drive(0.0, 4.0)),
        (WHEELS, MECANUM, Drive(0.0, 0.0, 0.5), None, Drive(0.0, 0.0, 0.2)),
        (WHEELS, TWO_WHEELS, Drive(float("nan")), None, Drive()),
        (STEERED, CAR, Steer(2.0, 0.1), None, Steer(0.2, 0.1)),
        (STEERED, CAR, Steer(0.1, -2.0), None, Steer(0.1, -0.436)),
    ],
)
def test_limits(part: DevicePart, robot: Robot, command: Command, fastest: float | None, written: Command) -> None:
    lines = driven(part, robot, command, fastest_mps=fastest)
    log: list[Any] = part.cls.log  # type: ignore[attr-defined]
    last = [entry for entry in log if isinstance(entry, Drive | Steer)][-1]
    for name in type(written).__slots__:
        assert getattr(last, name) == pytest.approx(getattr(written, name))
    assert ("limited by" in lines[-2]) is (written != command)


def test_it_starts_gently() -> None:
    driven(WHEELS, Robot(limits=Limits(accel_mps2=0.5)), Drive(0.2))
    speeds = [entry.vx_mps for entry in Wheels.log if isinstance(entry, Drive)]
    steps = np.diff([0.0, *speeds])
    assert steps.max() <= 0.5 / bench.WRITES_HZ + 1e-9
    assert speeds[-1] == pytest.approx(0.2)


def test_never_longer_than_ten_seconds() -> None:
    driven(WHEELS, TWO_WHEELS, Drive(0.1), 3600.0)
    writes = len([entry for entry in Wheels.log if isinstance(entry, Drive)])
    assert writes == pytest.approx(10 * bench.WRITES_HZ, abs=2)


@pytest.mark.parametrize(
    ("fails", "error", "log"),
    [
        ("open", DeviceUnavailable, ["halt", "close"]),
        ("apply", OSError, ["open", "halt", Drive(), "halt", "close"]),
        ("loss", DeviceLost, ["open", "halt", Drive(), "halt", "close"]),
    ],
)
def test_halted_after_every_error(
    monkeypatch: pytest.MonkeyPatch, fails: str, error: type[Exception], log: list[Any]
) -> None:
    monkeypatch.setattr(Wheels, "fails", fails)
    with pytest.raises(error):
        driven(WHEELS, TWO_WHEELS, Drive(0.1))
    assert Wheels.log == log


def test_the_interpreter_s_end_halts_too(monkeypatch: pytest.MonkeyPatch) -> None:
    kept: list[Any] = []
    monkeypatch.setattr(atexit, "register", kept.append)
    monkeypatch.setattr(atexit, "unregister", kept.remove)

    async def watched() -> None:
        task = asyncio.ensure_future(bench.drive(WHEELS, TWO_WHEELS, Drive(0.1), 5.0, print))
        await asyncio.sleep(1.0)
        Wheels.log.clear()
        (halt,) = kept
        halt()
        assert Wheels.log == ["halt"]
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)

    run_virtual(watched())
    assert kept == []


@pytest.mark.parametrize(
    ("part", "robot", "given", "said"),
    [
        (WHEELS, TWO_WHEELS, {"vx": 0.1}, Drive(0.1)),
        (WHEELS, TWO_WHEELS, {"vx": 0.1, "wz": -1.0, "vy": None}, Drive(0.1, -1.0)),
        (WHEELS, MECANUM, {"vy": 0.1}, Drive(0.0, 0.0, 0.1)),
        (STEERED, CAR, {"speed": 0.1, "steering": 0.2}, Steer(0.1, 0.2)),
        (WHEELS, TWO_WHEELS, {}, "say --vx, --vy, --wz"),
        (WHEELS, TWO_WHEELS, {"speed": 0.1}, "m takes Drive: say --vx"),
        (WHEELS, TWO_WHEELS, {"vy": 0.1}, "a differential base cannot move sideways"),
        (STEERED, CAR, {"vx": 0.1}, "c takes Steer: say --speed, --steering"),
        (GAUGE, TWO_WHEELS, {"vx": 0.1}, "b is no actuator"),
    ],
)
def test_options_become_a_command(
    part: DevicePart, robot: Robot, given: dict[str, float | None], said: Command | str
) -> None:
    if isinstance(said, str):
        with pytest.raises(Usage, match=said):
            bench.wanted_command(part, robot, given)
    else:
        assert bench.wanted_command(part, robot, given) == said


@pytest.mark.parametrize(
    ("answer", "allowed"), [("y", True), (" YES ", True), ("", False), ("n", False), ("yeah", False)]
)
def test_somebody_must_say_yes(answer: str, allowed: bool) -> None:
    asked: list[str] = []

    def ask(question: str) -> str:
        asked.append(question)
        return answer

    assert bench.is_allowed(True, ask) is allowed
    assert "off the ground" in asked[0]


def test_nobody_to_ask() -> None:
    with pytest.raises(Usage, match="--yes"):
        bench.is_allowed(False, input)


# --------------------------------------------------------------------------------------------- listen


def test_listening_prints_a_line_a_second() -> None:
    lines: list[str] = []
    assert run_virtual(bench.listen(GAUGE, Robot(), 2.5, lines.append)) == 0
    assert len(lines) == 3
    assert lines[0].startswith("Battery 10.0 Hz, 0.")
    assert lines[2].endswith("s old: voltage_v 12.250, current_a nan, charge 0.500, low False | noise: 25")


def test_listening_in_vain(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Gauge, "says", False)
    lines: list[str] = []
    assert run_virtual(bench.listen(GAUGE, Robot(), 1.0, lines.append)) == 69
    assert lines == ["no message"]


def test_listening_to_motors_halts_them() -> None:
    assert run_virtual(bench.listen(WHEELS, Robot(), 1.0, print)) == 69
    assert Wheels.log == ["open", "halt", "halt", "close"]


def angles(count: int) -> Any:
    return np.linspace(-np.pi / 2, np.pi / 2, count, dtype=np.float32)


@pytest.mark.parametrize(
    ("message", "said"),
    [
        (
            LidarScan(0, np.array([np.nan, 0.8, np.inf, 2.0], np.float32), angles(4)),
            "4 beams, nearest 0.80 m at -30 deg, 25% not measured",
        ),
        (LidarScan(0, np.full(2, np.inf, np.float32), angles(2)), "2 beams, no return, 0% not measured"),
        (LidarScan(0, np.empty(0, np.float32), angles(0)), "0 beams, no return, 100% not measured"),
        (CameraFrame(0, np.full((8, 12, 3), 100, np.uint8), 7), "12 x 8, number 7, brightness 100 of 255"),
        (Battery(0, 12.0), "voltage_v 12.000, current_a nan, charge nan, low False"),
    ],
)
def test_values(message: Message, said: str) -> None:
    assert bench.values(message) == said


# -------------------------------------------------------------------------------------- the command line

ROBOT = """
robot:
  kinematics: {{type: differential, track_m: 0.118, wheel_radius_m: 0.0325}}
  footprint_m: [[0.06, 0.065], [0.06, -0.065], [-0.12, -0.065], [-0.12, 0.065]]
devices:
  motors: {{use: jetbot_motors, bus: {folder}/i2c}}
guard:
  zones: {{off: "on the bench"}}
"""


@pytest.fixture
def host(tmp_path: Path) -> Iterator[I2cHost]:
    (tmp_path / "robot.yaml").write_text(ROBOT.format(folder=tmp_path))
    with I2cHost(FakeI2cBus([Pca9685Fake()]), tmp_path / "i2c") as hosted:
        yield hosted


def chip(host: I2cHost) -> Pca9685Fake:
    (made,) = host.bus.chips
    assert isinstance(made, Pca9685Fake)
    return made


def duties(host: I2cHost) -> set[float]:
    return {chip(host).duty(channel) for channel in range(16)}


def test_a_jetbot_drives_and_stands(host: I2cHost, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    argv = ["device", str(tmp_path / "robot.yaml"), "motors", "drive", "--vx", "0.1", "--seconds", "0.3", "--yes"]
    assert cli.main(argv) == 0
    assert "driven: vx +0.10 m/s" in capsys.readouterr().out
    assert any(write.register not in (0x00, 0x01, 0xFD, 0xFE) and any(write.data) for write in host.bus.writes)
    assert duties(host) == {0.0}


def test_a_jetbot_is_listened_to(host: I2cHost, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["device", str(tmp_path / "robot.yaml"), "motors", "listen", "--seconds", "0.3"]) == 0
    assert capsys.readouterr().out.startswith("Odometry ")
    assert duties(host) == {0.0}


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        ("motors drive --vx 0.1", "add --yes"),
        ("motors drive --yes", "say --vx"),
        ("wheels listen", "no device 'wheels'; the config has: motors"),
        ("motors push", "invalid choice"),
        ("motors listen --seconds 0", "seconds above 0"),
    ],
)
def test_wrong_command_lines(tmp_path: Path, argv: str, words: str, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "robot.yaml").write_text(ROBOT.format(folder=tmp_path))
    assert cli.main(["device", str(tmp_path / "robot.yaml"), *argv.split()]) == 64
    assert words in capsys.readouterr().err


def test_no_bus_no_drive(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "robot.yaml").write_text(ROBOT.format(folder=tmp_path))
    assert cli.main(["device", str(tmp_path / "robot.yaml"), "motors", "listen"]) == 69
    assert "does not exist" in capsys.readouterr().err


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGTSTP])
def test_a_signal_stops_the_wheels(host: I2cHost, tmp_path: Path, number: signal.Signals) -> None:
    argv = ["device", str(tmp_path / "robot.yaml"), "motors", "drive", "--vx", "0.2", "--seconds", "9", "--yes"]
    code = "import sys; from robotd.cli import main; sys.exit(main())"
    with subprocess.Popen(
        [sys.executable, "-c", code, *argv], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline().startswith("vx +0.20")  # it has driven for a second
        assert max(duties(host)) > 0.0
        os.kill(process.pid, number)
        assert process.wait(10.0) == 130
    assert duties(host) == {0.0}


def test_part_named() -> None:
    parts = Parts(Robot(), (DevicePart("a", Gauge, NoConfig()), DevicePart("b", Gauge, PortConfig())))
    assert bench.part_named(parts, "b") is parts.devices[1]
