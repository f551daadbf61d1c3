"""The doctor, what it looks at from outside: one row a fault, each with cause, mend and exit code."""

from __future__ import annotations

import pytest
from doctor_facts import BY_ID, PORT, BusConfig, CameraConfig, FakeProbes, ModelConfig, PadConfig, PortConfig, part

from robotd.authoring.config import Config, NoConfig
from robotd.setup.doctor.devices import check_device, check_together, needs
from robotd.setup.doctor.examine import examine
from robotd.setup.doctor.facts import Account, Adapter, Holder, Need, Node
from robotd.setup.doctor.findings import Finding, exit_code, report
from robotd.setup.problems import ConfigError, Problem

# ------------------------------------------------------------------------------------------ devices

PAD = "/dev/input/by-id/usb-pad-event-joystick"
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
            75,
            "in use by ModemManager (812), a process (900)",
            "kill 812 900",
        ),
        (
            PortConfig(port="/dev/serial/by-id/*"),
            FakeProbes(),
            69,
            "no serial port fits /dev/serial/by-id/*",
            "plug it",
        ),
        (
            PortConfig(port="/dev/ttyUSB*"),
            FakeProbes({PORT: Node("device"), "/dev/ttyUSB1": Node("device")}),
            78,
            "2 serial ports fit /dev/ttyUSB*",
            "write which one: /dev/ttyUSB0, /dev/ttyUSB1",
        ),
        (
            PortConfig(port="/dev/ttyUSB*"),
            FakeProbes({PORT: NO_ACCESS}, MAI),
            77,
            "may not use /dev/ttyUSB0",
            "dialout",
        ),
        (
            PortConfig(port="/dev/serial0"),
            FakeProbes(
                {"/dev/serial0": Node("device")}, links={"/dev/serial0": "/dev/ttyAMA0"}, console=["ttyAMA0", "tty1"]
            ),
            69,
            "the system's console writes to /dev/serial0",
            "take `console=ttyAMA0,...` out",
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
        (ModelConfig(model="a"), FakeProbes({"a": Node("file", head=b"")}), 69, "a is empty", "copy or download"),
        (
            ModelConfig(model="a"),
            FakeProbes({"a": Node("file", head=b"version https://git-lfs.github.com/spec/v1")}),
            69,
            "a is a pointer of Git LFS",
            "git lfs pull",
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
        (BusConfig(bus="unix:/run/chip"), FakeProbes({"/run/chip": Node("socket")}), ["/run/chip is there"]),
        (BusConfig(bus="/run/chip"), FakeProbes({"/run/chip": Node("socket")}), ["/run/chip is there"]),
        (CameraConfig(), FakeProbes({"/dev/video0": Node("device", writable=False)}), ["/dev/video0 is there"]),
        (CameraConfig(source="f"), FakeProbes({"f": Node("folder", pictures=2)}), ["f is there, 2 pictures"]),
        (CameraConfig(source="http://cam/"), FakeProbes(network={("cam", 80): ""}), ["cam:80 answers"]),
        (PadConfig(), FakeProbes({PAD: Node("device", writable=False)}), [f"{PAD} is there"]),
        (ModelConfig(), FakeProbes(), ["names nothing that could be looked at without opening it"]),
        (ModelConfig(model="a"), FakeProbes({"a": Node("file", writable=False, head=b"onnx")}), ["a is there"]),
        (PortConfig(port="/dev/ttyU*"), FakeProbes({PORT: Node("device")}), [f"{PORT} is there"]),
        (
            PortConfig(port=BY_ID),
            FakeProbes({BY_ID: Node("device")}, adapters={BY_ID: Adapter("0403", "6001", latency_ms=1)}),
            [f"{BY_ID} is there"],
        ),
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


def test_an_adapter_that_holds_bytes_back() -> None:
    probes = FakeProbes({BY_ID: Node("device")}, adapters={BY_ID: Adapter("0403", "6001", latency_ms=16)})
    doubt = check_device(part(PortConfig(port=BY_ID)), probes)[1]
    assert (doubt.level, doubt.code, doubt.fault) == ("warning", 0, "slow adapter")
    assert doubt.cause == f"{BY_ID} holds bytes back for 16 ms"
    assert "robotd udev" in doubt.mend


def test_a_camera_that_somebody_holds_may_still_work() -> None:
    probes = FakeProbes({"/dev/video0": Node("device", holders=(Holder(7, "cheese"),))})
    (doubt,) = check_device(part(CameraConfig()), probes)
    assert (doubt.level, doubt.code, doubt.cause) == ("warning", 0, "/dev/video0 is in use by cheese (7)")


@pytest.mark.parametrize(
    ("configs", "probes", "faults"),
    [
        ([PortConfig(), PortConfig(port="/dev/ttyUSB1")], FakeProbes(), []),
        ([PortConfig(), PortConfig()], FakeProbes(), [("one port twice", 78)]),
        ([PortConfig(), PortConfig(port=BY_ID)], FakeProbes(links={BY_ID: PORT}), [("one port twice", 78)]),
        ([BusConfig(), BusConfig(address=0x41)], FakeProbes(), []),
        ([BusConfig(), BusConfig(bus=7)], FakeProbes(), []),
        ([BusConfig(), BusConfig(bus="/dev/i2c-1")], FakeProbes(), [("one address twice", 78)]),
        (
            [PortConfig()],
            FakeProbes(programs=frozenset({"ModemManager", "brltty", "vi"})),
            [("modem manager", 0), ("braille display", 0)],
        ),
        ([PortConfig(port="/dev/ttyAMA0")], FakeProbes(programs=frozenset({"ModemManager"})), []),
        ([BusConfig()], FakeProbes(programs=frozenset({"brltty"})), []),
    ],
)
def test_faults_between_devices(configs: list[Config], probes: FakeProbes, faults: list[tuple[str, int]]) -> None:
    parts = [part(config, f"device{i}") for i, config in enumerate(configs)]
    assert [(finding.fault, finding.code) for finding in check_together(parts, probes)] == faults


@pytest.mark.parametrize(
    ("config", "found"),
    [
        (PortConfig(), [Need("serial port", PORT, "port")]),
        (BusConfig(bus=7), [Need("I2C bus", "/dev/i2c-7", "bus")]),
        (CameraConfig(source="2"), [Need("camera", "/dev/video2", "source")]),
        (CameraConfig(source="csi:1"), []),
        (CameraConfig(source="libcamera"), []),
        (CameraConfig(source="videotestsrc ! appsink"), []),
        (CameraConfig(source="rtsp://cam/1"), [Need("network camera", "rtsp://cam/1", "source")]),
        (PadConfig(), [Need("input device", "/dev/input/by-id/*-event-joystick", "path")]),
        (PadConfig(path="pad"), []),
        (ModelConfig(), []),
        (ModelConfig(model="/m/a.onnx"), [Need("file", "/m/a.onnx", "model")]),
        (NoConfig(), []),
    ],
)
def test_needs(config: Config, found: list[Need]) -> None:
    assert needs(config) == found


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
