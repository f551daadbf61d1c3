"""The doctor: one row a fault, each with cause, mend and exit code; and nothing to say where all is well."""

from __future__ import annotations

import os
import pty
import socket
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import pytest

from robotd.authoring.config import Config, FileKey, NoConfig
from robotd.authoring.device import Sensor
from robotd.engine.parts import DevicePart, Parts
from robotd.setup.doctor import (
    Account,
    Finding,
    Holder,
    Need,
    NeedKind,
    Node,
    check_device,
    check_packages,
    check_plugins,
    check_python,
    examine,
    exit_code,
    needs,
    report,
    satisfies,
)
from robotd.setup.probes import SystemProbes
from robotd.setup.problems import ConfigError, Problem
from robotd.world.messages import LidarScan
from robotd.world.robot import Robot

PORT = "/dev/ttyUSB0"
BY_ID = "/dev/serial/by-id/usb-1a86_0001-if00-port0"


class PortConfig(Config):
    port: str = PORT
    baud: int = 230400


class BusConfig(Config):
    bus: int | str = 1
    address: int = 0x60


class CameraConfig(Config):
    source: int | str = 0


class ModelConfig(Config):
    model: Annotated[str | None, FileKey()] = None
    map: Annotated[str, FileKey("maps")] = "line_loop"


class Lidar(Sensor[PortConfig, LidarScan]):
    pass


def part(config: Config, name: str = "lidar") -> DevicePart:
    return DevicePart(name, Lidar, config)


@dataclass
class FakeProbes:
    """A machine made of facts. Paths that are not named do not exist."""

    nodes: Mapping[str, Node] = field(default_factory=dict)
    who: Account = field(default_factory=lambda: Account("mai", frozenset({"mai"}), frozenset()))
    here: Mapping[str, Sequence[str]] = field(default_factory=dict)
    lasting: Mapping[str, str] = field(default_factory=dict)
    network: Mapping[tuple[str, int], str] = field(default_factory=dict)
    loading: Exception | None = None
    robot: Parts | Exception = field(default_factory=lambda: Parts(Robot(), (part(PortConfig()),)))
    version: tuple[int, int, int] = (3, 11, 9)
    required: Sequence[str] = ("numpy>=2.0", "pydantic<3,>=2.10")
    have: Mapping[str, str] = field(default_factory=lambda: {"numpy": "2.2.1", "pydantic": "2.10.0"})
    points: Sequence[tuple[str, str, Exception | None]] = (("robotd.devices", "ld19", None),)

    def python(self) -> tuple[int, int, int]:
        return self.version

    def requirements(self) -> Sequence[str]:
        return self.required

    def versions(self, names: Iterable[str]) -> Mapping[str, str]:
        return {name: self.have[name] for name in names if name in self.have}

    def plugins(self) -> Sequence[tuple[str, str, Exception | None]]:
        return self.points

    def parts(self, file: str) -> Parts:
        if isinstance(self.robot, Exception):
            raise self.robot
        return self.robot

    def load_error(self, part: DevicePart) -> Exception | None:
        return self.loading

    def node(self, path: str) -> Node:
        return self.nodes.get(path, Node("absent"))

    def account(self) -> Account:
        return self.who

    def candidates(self, kind: NeedKind) -> Sequence[str]:
        return self.here.get(kind, ())

    def lasting_name(self, path: str) -> str:
        return self.lasting.get(path, "")

    def reachable(self, host: str, port: int) -> str:
        return self.network.get((host, port), "Connection refused")


# ------------------------------------------------------------------------------------------ devices

NO_ACCESS = Node("device", readable=False, writable=False, group="dialout")
MAI = Account("mai", frozenset({"mai"}), frozenset())
JOINED = Account("mai", frozenset({"mai"}), frozenset({"dialout"}))
MEMBER = Account("mai", frozenset({"mai", "dialout"}), frozenset({"dialout"}))


@pytest.mark.parametrize(
    ("config", "probes", "code", "cause", "mend"),
    [
        (PortConfig(), FakeProbes(), 69, "serial port /dev/ttyUSB0 does not exist", "plug it in"),
        (
            PortConfig(),
            FakeProbes(here={"serial port": [BY_ID]}),
            69,
            "does not exist",
            f"name one that is here: {BY_ID}",
        ),
        (PortConfig(), FakeProbes({PORT: Node("file")}), 78, "is a plain file, not a serial port", "correct `port`"),
        (PortConfig(port="/dev"), FakeProbes({"/dev": Node("folder")}), 78, "is a folder, not a serial port", "`port`"),
        (
            PortConfig(),
            FakeProbes({PORT: NO_ACCESS}, MAI),
            77,
            "user mai may not use /dev/ttyUSB0",
            "sudo usermod -aG dialout mai",
        ),
        (PortConfig(), FakeProbes({PORT: NO_ACCESS}, JOINED), 77, "may not use", "log out and in again"),
        (PortConfig(), FakeProbes({PORT: NO_ACCESS}, MEMBER), 77, "may not use", "sudo chmod g+rw /dev/ttyUSB0"),
        (
            PortConfig(),
            FakeProbes({PORT: Node("device", writable=False, group="root")}),
            77,
            "may not use",
            "a udev rule must give /dev/ttyUSB0 to a group",
        ),
        (
            PortConfig(),
            FakeProbes({PORT: Node("device", holders=(Holder(812, "ModemManager"), Holder(900)))}),
            69,
            "in use by ModemManager (812), a process (900)",
            "kill 812 900",
        ),
        (BusConfig(), FakeProbes(), 69, "I2C bus /dev/i2c-1 does not exist", "raspi-config"),
        (BusConfig(), FakeProbes(here={"I2C bus": ["/dev/i2c-7"]}), 69, "does not exist", "/dev/i2c-7"),
        (BusConfig(bus="/run/bus"), FakeProbes({"/run/bus": Node("file")}), 78, "not an I2C bus", "correct `bus`"),
        (CameraConfig(), FakeProbes(), 69, "camera /dev/video0 does not exist", "plug it in"),
        (CameraConfig(source="pictures"), FakeProbes({"pictures": Node("folder")}), 69, "holds no pictures", ".jpg"),
        (
            CameraConfig(source="/dev/log"),
            FakeProbes({"/dev/log": Node("socket")}),
            78,
            "is a socket, not a camera",
            "correct `source`",
        ),
        (CameraConfig(source="p"), FakeProbes({"p": Node("other")}), 78, "is a pipe or the like", "correct `source`"),
        (
            CameraConfig(source="http://cam/stream"),
            FakeProbes(),
            69,
            "cam:80 does not answer: Connection refused",
            "ping cam",
        ),
        (CameraConfig(source="rtsp://10.0.0.4:x/1"), FakeProbes(), 78, "is no valid address", "correct `source`"),
        (ModelConfig(model="a.onnx"), FakeProbes(), 69, "file a.onnx does not exist", "correct the path"),
        (
            ModelConfig(model="a.onnx"),
            FakeProbes({"a.onnx": Node("file", readable=False)}),
            77,
            "user mai may not read a.onnx",
            "chmod a+r a.onnx",
        ),
        (
            NoConfig(),
            FakeProbes(loading=ModuleNotFoundError("No module named 'serialx'", name="serialx")),
            69,
            "No module named 'serialx'",
            "pip install 'robotd[serialx]'",
        ),
        (NoConfig(), FakeProbes(loading=FileNotFoundError("no model m.onnx")), 69, "no model m.onnx", "robotd plugins"),
    ],
)
def test_faults_of_devices(config: Config, probes: FakeProbes, code: int, cause: str, mend: str) -> None:
    findings = check_device(part(config), probes)
    assert exit_code(findings) == code
    (fault,) = [finding for finding in findings if finding.level == "error"]
    assert fault.subject == "lidar"
    assert cause in fault.cause
    assert mend in fault.mend


@pytest.mark.parametrize(
    ("config", "probes", "causes"),
    [
        (PortConfig(port=BY_ID), FakeProbes({BY_ID: Node("device")}), [f"{BY_ID} is there"]),
        (BusConfig(), FakeProbes({"/dev/i2c-1": Node("device")}), ["/dev/i2c-1 is there"]),
        (BusConfig(bus="/run/chip"), FakeProbes({"/run/chip": Node("socket")}), ["/run/chip is there"]),
        (CameraConfig(), FakeProbes({"/dev/video0": Node("device", writable=False)}), ["/dev/video0 is there"]),
        (CameraConfig(source="f"), FakeProbes({"f": Node("folder", pictures=2)}), ["f is there, 2 pictures"]),
        (CameraConfig(source="http://cam/"), FakeProbes(network={("cam", 80): ""}), ["cam:80 answers"]),
        (ModelConfig(), FakeProbes(), ["names nothing that could be looked at without opening it"]),
        (ModelConfig(model="a"), FakeProbes({"a": Node("file", writable=False)}), ["a is there"]),
    ],
)
def test_a_healthy_device_raises_no_alarm(config: Config, probes: FakeProbes, causes: list[str]) -> None:
    findings = check_device(part(config), probes)
    assert [(finding.level, finding.cause) for finding in findings] == [("good", cause) for cause in causes]


def test_a_port_that_may_change_its_name_gets_a_note() -> None:
    probes = FakeProbes({PORT: Node("device")}, lasting={PORT: BY_ID})
    findings = check_device(part(PortConfig()), probes)
    assert exit_code(findings) == 0
    assert findings[1].level == "note"
    assert findings[1].mend == f"write port: {BY_ID}"


@pytest.mark.parametrize(
    ("config", "found"),
    [
        (PortConfig(), [Need("serial port", PORT, "port")]),
        (BusConfig(bus=7), [Need("I2C bus", "/dev/i2c-7", "bus")]),
        (CameraConfig(source="2"), [Need("camera", "/dev/video2", "source")]),
        (CameraConfig(source="rtsp://cam/1"), [Need("network camera", "rtsp://cam/1", "source")]),
        (ModelConfig(), []),
        (ModelConfig(model="/m/a.onnx"), [Need("file", "/m/a.onnx", "model")]),
        (NoConfig(), []),
    ],
)
def test_needs(config: Config, found: list[Need]) -> None:
    assert needs(config) == found


# ---------------------------------------------------------------------------------------- the machine


@pytest.mark.parametrize(
    ("version", "level", "code"),
    [
        ((3, 10, 14), "error", 69),
        ((3, 11, 0), "good", 0),
        ((3, 13, 5), "good", 0),
        ((3, 14, 0), "warning", 0),
        ((4, 0, 0), "warning", 0),
    ],
)
def test_python(version: tuple[int, int, int], level: str, code: int) -> None:
    finding = check_python(version)
    assert (finding.level, finding.code) == (level, code)


@pytest.mark.parametrize(
    ("required", "have", "code", "words"),
    [
        ([], {}, 0, "all 0 are installed"),
        (["numpy>=2.0"], {"numpy": "2.1"}, 0, "all 1 are installed"),
        (["numpy>=2.0"], {}, 69, "numpy is not installed -> pip install 'numpy>=2.0'"),
        (["numpy>=2.0"], {"numpy": "1.26.4"}, 69, "numpy 1.26.4 is installed, >=2.0 is needed"),
        (["aiomqtt<3,>=2.3"], {"aiomqtt": "3.0"}, 69, "aiomqtt 3.0 is installed, <3,>=2.3 is needed"),
        (['numpy[x] (>=2.0); python_version > "3"'], {"numpy": "2.0"}, 0, "all 1"),
        ([], {"opencv-python": "4.10"}, 0, "opencv-python stands beside opencv-python-headless"),
        ([], {"serial": "0.0.97"}, 0, "pip uninstall -y serial pyserial && pip install pyserial"),
    ],
)
def test_packages(required: list[str], have: dict[str, str], code: int, words: str) -> None:
    findings = check_packages(required, have)
    assert exit_code(findings) == code
    assert words in " ".join(f"{finding.cause} -> {finding.mend}" for finding in findings)


@pytest.mark.parametrize(
    ("version", "wanted", "holds"),
    [
        ("2.0", ">=2.0", True),
        ("2", ">=2.0.0", True),
        ("1.9.9", ">=2", False),
        ("2.3.1", ">=2.3,<3", True),
        ("3.0rc1", ">=2.3,<3", False),
        ("1.0", "==1.0.0", True),
        ("1.0", "!=1", False),
        ("1.0", ">1", False),
        ("1.0.1", ">1", True),
        ("1.0", "<=1", True),
        ("1.0", "~=9.0", True),
        ("1.0", "", True),
    ],
)
def test_satisfies(version: str, wanted: str, holds: bool) -> None:
    assert satisfies(version, wanted) is holds


@pytest.mark.parametrize(
    ("error", "code", "mend"),
    [
        (None, 0, ""),
        (ModuleNotFoundError("No module named 'cv2'", name="cv2"), 69, "pip install cv2"),
        (ModuleNotFoundError("No module named 'serialx'", name="serialx.core"), 69, "pip install 'robotd[serialx]'"),
        (AttributeError("no class Ld19"), 69, "`robotd plugins` says which one it is"),
        (SyntaxError(), 69, "install its distribution again"),
    ],
)
def test_plugins(error: Exception | None, code: int, mend: str) -> None:
    findings = check_plugins([("robotd.devices", "ld19", error)])
    assert exit_code(findings) == code
    assert mend in findings[0].mend


# ------------------------------------------------------------------------------------------ the whole


def test_without_a_file_the_machine_and_the_plugins_are_examined() -> None:
    findings = examine(None, FakeProbes(here={"serial port": [BY_ID]}))
    assert exit_code(findings) == 0
    assert [(f.level, f.subject) for f in findings] == [
        ("good", "python"),
        ("good", "packages"),
        ("good", "plugins"),
        ("note", "serial port"),
        ("note", "I2C bus"),
        ("note", "camera"),
    ]
    assert [f.cause for f in findings[3:]] == [BY_ID, "none here", "none here"]


def test_with_a_file_its_devices_are_examined() -> None:
    findings = examine("a.yaml", FakeProbes({PORT: NO_ACCESS}))
    assert [f.subject for f in findings] == ["python", "packages", "config", "lidar"]
    assert exit_code(findings) == 77


def test_every_error_of_a_config_is_a_finding() -> None:
    problems = [Problem("a.yaml", line, 1, "robot", "is unknown") for line in (3, 9)]
    findings = examine("a.yaml", FakeProbes(robot=ConfigError(problems)))
    assert [(f.cause, f.code) for f in findings if f.level == "error"] == [
        ("a.yaml:3:1: robot: is unknown", 78),
        ("a.yaml:9:1: robot: is unknown", 78),
    ]


def test_the_worst_finding_decides() -> None:
    levels = [Finding("error", "a", "b", code=code) for code in (69, 78, 77)]
    assert exit_code(levels) == 78
    assert exit_code([]) == 0


def test_report() -> None:
    findings = [Finding("good", "python", "Python 3.11.9"), Finding("error", "lidar", "gone\x1b", "plug it in", 69)]
    assert report(findings) == [
        "good     python  Python 3.11.9",
        "error    lidar   gone?",
        "                 -> plug it in",
        "",
        "1 error, 0 warnings",
    ]
    assert report(findings[:1])[-1] == "nothing stands in the way"


# --------------------------------------------------------------------------------------- real probes


def test_this_machine_has_what_robotd_requires() -> None:
    probes = SystemProbes()
    requirements = probes.requirements()
    assert any(line.startswith("numpy") for line in requirements)
    assert not any("hypothesis" in line for line in requirements)
    assert probes.versions(["numpy", "no-such-distribution"]).keys() == {"numpy"}


@pytest.mark.parametrize("make", ["absent", "file", "folder", "socket", "device"])
def test_kinds_of_nodes(make: str, tmp_path: Path) -> None:
    path = tmp_path / "node"
    name = str(path)
    line: socket.socket | None = None
    match make:
        case "file":
            path.touch()
        case "folder":
            path.mkdir()
            (path / "a.JPG").touch()
            (path / "notes.txt").touch()
        case "socket":
            line = socket.socket(socket.AF_UNIX)
            line.bind(name)
        case "device":
            name = "/dev/null"
    node = SystemProbes().node(name)
    if line is not None:
        line.close()
    assert node.kind == make
    assert node.pictures == (1 if make == "folder" else 0)


@pytest.mark.skipif(not Path("/proc/locks").exists(), reason="needs Linux's /proc")
def test_a_port_in_use_names_its_holder() -> None:
    ours, theirs = pty.openpty()
    name = os.ttyname(theirs)
    code = (
        "import fcntl, os, sys\n"
        "port = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY)\n"
        "fcntl.flock(port, fcntl.LOCK_EX)\n"
        "print('held', flush=True)\n"
        "sys.stdin.read()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code, name], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "held\n"
        assert SystemProbes().node(name).holders[0].pid == other.pid
    assert SystemProbes().node(name).holders == ()
    os.close(ours)
    os.close(theirs)


def test_holders_are_read_from_locks_and_descriptors(tmp_path: Path) -> None:
    node = tmp_path / "node"
    node.touch()
    status = os.stat(node)
    where = f"{os.major(status.st_dev):02x}:{os.minor(status.st_dev):02x}:{status.st_ino}"
    (tmp_path / "locks").write_text(
        f"1: FLOCK  ADVISORY  WRITE 41 {where} 0 EOF\n2: -> FLOCK ADVISORY WRITE 42 {where} 0 EOF\n"
        f"3: FLOCK  ADVISORY  WRITE 43 00:00:1 0 EOF\n4: OFDLCK ADVISORY WRITE -1 {where} 0 EOF\nbroken\n"
    )
    for pid, opened in ((44, node), (45, tmp_path / "other")):
        (tmp_path / str(pid) / "fd").mkdir(parents=True)
        (tmp_path / str(pid) / "fd" / "3").symlink_to(opened)
    (tmp_path / "44" / "comm").write_text("minicom\n")
    holders = SystemProbes(proc=tmp_path).holders(str(node), status)
    assert holders == (Holder(41, ""), Holder(44, "minicom"))


def test_candidates_name_each_device_once_and_lastingly(tmp_path: Path) -> None:
    (tmp_path / "serial" / "by-id").mkdir(parents=True)
    for name in ("ttyUSB0", "ttyUSB1", "video0"):
        (tmp_path / name).touch()
    link = tmp_path / "serial" / "by-id" / "usb-lidar"
    link.symlink_to(tmp_path / "ttyUSB0")
    probes = SystemProbes(dev=tmp_path)
    assert probes.candidates("serial port") == [str(link), str(tmp_path / "ttyUSB1")]
    assert probes.candidates("camera") == [str(tmp_path / "video0")]
    assert probes.candidates("file") == []
    assert probes.lasting_name(str(tmp_path / "ttyUSB0")) == str(link)
    assert probes.lasting_name(str(tmp_path / "ttyUSB1")) == ""


def test_reachable() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        assert SystemProbes().reachable("127.0.0.1", port) == ""
    assert SystemProbes().reachable("127.0.0.1", port) != ""


def test_account() -> None:
    account = SystemProbes().account()
    assert account.user
    assert account.groups


def test_load_error() -> None:
    class Heavy(Sensor[NoConfig, LidarScan]):
        @classmethod
        def load(cls, config: Any) -> None:
            raise ModuleNotFoundError("No module named 'x'", name="x")

    assert isinstance(SystemProbes().load_error(DevicePart("lidar", Heavy, NoConfig())), ModuleNotFoundError)
    assert SystemProbes().load_error(part(PortConfig())) is None
