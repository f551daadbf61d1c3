"""Every fault that the doctor knows, one row each: what makes it, and that docs/devices/faults.md says the same."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from importlib import metadata
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
from doctor_facts import BY_ID, PORT, BusConfig, CameraConfig, FakeProbes, ModelConfig, PadConfig, PortConfig, part

from robotd.authoring.config import Config, NoConfig
from robotd.authoring.device import (
    Actuator,
    Device,
    DeviceError,
    DeviceLost,
    DeviceMisconfigured,
    DeviceUnavailable,
    Sensor,
    Watchdog,
)
from robotd.engine.parts import DevicePart
from robotd.setup.doctor.devices import check_device, check_together
from robotd.setup.doctor.examine import examine
from robotd.setup.doctor.facts import Account, Adapter, Health, Holder, Node
from robotd.setup.doctor.faults import FAULTS, found
from robotd.setup.doctor.findings import Finding
from robotd.setup.doctor.judge import judge_sighting
from robotd.setup.doctor.machine import check_health, check_packages, check_plugins, check_python
from robotd.setup.doctor.sight import Sighting, Stream
from robotd.setup.problems import ConfigError, Problem
from robotd.world.messages import Battery, CameraFrame, Contact, Drive, Imu, LidarScan, Message, Odometry
from robotd_devices.motor import roboclaw_packets, vesc_packets

PAGE = Path(__file__).resolve().parents[2] / "docs" / "devices" / "faults.md"


class Lidar(Sensor[PortConfig, LidarScan]):
    mends = MappingProxyType({"dust": "wipe the window"})

    @classmethod
    def publish_period_s(cls, config: PortConfig) -> float:
        return 0.1


class Camera(Sensor[CameraConfig, CameraFrame]):
    pass


class Gauge(Sensor[NoConfig, Battery | Imu | Contact]):
    pass


class Wheels(Actuator[NoConfig, Drive]):
    emits = (Odometry,)
    watchdog = Watchdog("firmware", 500)


class Bare(Actuator[NoConfig, Drive]):
    pass


# ------------------------------------------------------------------------------------------ messages

BEAMS = 90


def scan(ranges_m: Any = None, seed: int = 0) -> LidarScan:
    """A scan of a room with a little noise, or of what is given."""
    noise = np.random.default_rng(seed).normal(2.0, 0.01, BEAMS)
    ranges = np.asarray(noise if ranges_m is None else np.full(BEAMS, ranges_m), np.float32)
    return LidarScan(0, ranges, np.linspace(-3, 3, BEAMS, dtype=np.float32), range_min_m=0.1)


def frame(grey: float | None = None, seed: int = 0) -> CameraFrame:
    picture = np.random.default_rng(seed).integers(0, 256, (24, 32, 3), dtype=np.uint8)
    return CameraFrame(0, picture if grey is None else np.full((24, 32, 3), grey, np.uint8))


def scans(count: int = 12) -> list[LidarScan]:
    return [scan(seed=i) for i in range(count)]


def sighting(messages: Sequence[Message] = (), *, every_s: float = 0.1, age_s: float = 0.01, **more: Any) -> Sighting:
    """What is noted of messages that come evenly."""
    seen = Sighting("lidar", watched_s=4.0, **more)
    for i, message in enumerate(messages):
        stream = seen.streams.setdefault(type(message), Stream(type(message)))
        stream.arrived_ns.append(round(i * every_s * 1e9))
        stream.age_ns.append(round(age_s * 1e9))
        stream.last.append(message)
    return seen


def of(cls: type[Device[Any]], seen: Sighting, config: Config | None = None) -> list[Finding]:
    """The judgement of a sighting of such a device."""
    return judge_sighting(DevicePart("lidar", cls, config if config is not None else cls.config_type()), seen)


def lidar(messages: Sequence[Message], **more: Any) -> list[Finding]:
    return of(Lidar, sighting(messages, **more))


def refused(error: Exception) -> list[Finding]:
    return of(Lidar, sighting(error=error))


def counted(name: str, detail: str = "") -> list[Finding]:
    return lidar(scans(), faults={name: 3}, details={name: detail})


def lost(words: str) -> list[Finding]:
    return lidar(scans(), loss=DeviceLost(f"lidar: {words}"))


def gauge(*messages: Message) -> list[Finding]:
    return of(Gauge, sighting(messages))


def pauses() -> list[Finding]:
    seen = sighting(scans(30))
    seen.streams[LidarScan].arrived_ns[20:] = [at + 500_000_000 for at in seen.streams[LidarScan].arrived_ns[20:]]
    return of(Lidar, seen)


def caused(error: DeviceError, cause: OSError) -> DeviceError:
    error.__cause__ = cause
    return error


# ---------------------------------------------------------------------------------------- the machine


def device(node: Node | None = None, config: Config | None = None, **more: Any) -> list[Finding]:
    """What the doctor says of a device whose one need is this node."""
    config = config if config is not None else PortConfig()
    path = getattr(config, "port", None) or getattr(config, "model", None) or getattr(config, "source", None)
    return check_device(part(config), FakeProbes({str(path): node} if node is not None else {}, **more))


def together(*configs: Config, **more: Any) -> list[Finding]:
    return check_together([part(config, f"device{i}") for i, config in enumerate(configs)], FakeProbes(**more))


NO_ACCESS = Node("device", readable=False, writable=False, group="dialout")
HELD = Node("device", holders=(Holder(812, "minicom"),))
JOINED = Account("mai", frozenset({"mai"}), frozenset({"dialout"}))
MEMBER = Account("mai", frozenset({"mai", "dialout"}), frozenset({"dialout"}))
CATALOGUE = ModuleNotFoundError("No module named 'serialx'", name="serialx")
WRONG = ConfigError([Problem("a.yaml", 3, 1, "robot", "is unknown")])

ROWS: list[tuple[str, Callable[[], list[Finding]]]] = [
    ("python too old", lambda: [check_python((3, 9, 1))]),
    ("python untested", lambda: [check_python((3, 15, 0))]),
    ("package missing", lambda: check_packages(["numpy>=2"], {})),
    ("package too old", lambda: check_packages(["numpy>=2"], {"numpy": "1.26"})),
    ("rival package", lambda: check_packages([], {"opencv-python": "4.10"})),
    ("extra missing", lambda: check_plugins([("robotd.devices", "x", CATALOGUE)])),
    ("module missing", lambda: check_plugins([("robotd.devices", "x", ModuleNotFoundError("no", name="cv2"))])),
    ("plugin broken", lambda: check_plugins([("robotd.devices", "x", SyntaxError("bad"))])),
    ("under-voltage now", lambda: check_health(Health(weak_now=True))),
    ("under-voltage before", lambda: check_health(Health(weak_before=True))),
    ("too hot", lambda: check_health(Health(celsius=90.0))),
    ("disk nearly full", lambda: check_health(Health(free_mb=12))),
    ("config wrong", lambda: examine("a.yaml", FakeProbes(robot=WRONG))),
    ("one port twice", lambda: together(PortConfig(), PortConfig())),
    ("one address twice", lambda: together(BusConfig(), BusConfig())),
    ("port absent", device),
    ("no port fits", lambda: device(config=PortConfig(port="/dev/ttyUSB*"))),
    (
        "several ports fit",
        lambda: check_device(
            part(PortConfig(port="/dev/ttyUSB*")), FakeProbes({PORT: HELD, "/dev/ttyUSB1": Node("device")})
        ),
    ),
    ("bus absent", lambda: device(config=BusConfig())),
    ("camera absent", lambda: device(config=CameraConfig())),
    ("input absent", lambda: device(config=PadConfig())),
    ("file absent", lambda: device(config=ModelConfig(model="a.onnx"))),
    ("wrong sort", lambda: device(Node("file"))),
    ("no pictures", lambda: device(Node("folder"), CameraConfig(source="photos"))),
    ("file empty", lambda: device(Node("file", head=b""), ModelConfig(model="a"))),
    ("file is a pointer", lambda: device(Node("file", head=b"version https://git-lfs"), ModelConfig(model="a"))),
    ("file unreadable", lambda: device(Node("file", readable=False), ModelConfig(model="a"))),
    ("not in the group", lambda: device(NO_ACCESS)),
    ("group not in effect", lambda: device(NO_ACCESS, who=JOINED)),
    ("group may not write", lambda: device(NO_ACCESS, who=MEMBER)),
    ("root alone", lambda: device(Node("device", writable=False, group="root"))),
    ("port busy", lambda: device(HELD)),
    ("camera busy", lambda: device(HELD, CameraConfig(source="/dev/video2"))),
    ("console on port", lambda: device(Node("device"), console=["ttyUSB0"])),
    ("modem manager", lambda: together(PortConfig(), programs=frozenset({"ModemManager"}))),
    ("braille display", lambda: together(PortConfig(), programs=frozenset({"brltty"}))),
    ("slow adapter", lambda: device(Node("device"), adapters={PORT: Adapter("0403", "6001", latency_ms=16)})),
    ("name may change", lambda: device(Node("device"), lasting={PORT: BY_ID})),
    ("address wrong", lambda: device(config=CameraConfig(source="http://cam:x/"))),
    ("host silent", lambda: device(config=CameraConfig(source="http://cam/"))),
    # what drivers say when they do not open, in the words that the shipped ones use
    ("no answer", lambda: refused(DeviceUnavailable("lidar: no answer on /dev/a at 115200 baud for 2 s: powered?"))),
    ("no byte", lambda: refused(DeviceUnavailable("no RPLIDAR answers on /dev/a at 115200 baud; no byte came: is it"))),
    ("bytes of something else", lambda: refused(DeviceUnavailable("no RPLIDAR answers; 12 bytes came but no answer"))),
    ("does not turn", lambda: lost("silent for 3 s: it sends but does not turn: is it blocked?")),
    ("health error", lambda: refused(DeviceUnavailable("A1 is in its protection stop, code 0x0001, also after"))),
    ("no chip", lambda: refused(DeviceUnavailable("no chip answers at address 0x60 on I2C bus /dev/i2c-1: is the"))),
    ("bus stuck", lambda: refused(DeviceUnavailable("the bus is stuck (address 0x60): a chip holds a line low"))),
    ("another chip", lambda: refused(DeviceUnavailable("the chip at 0x41 says 0x12 when asked who it is; known are"))),
    ("settings lost", lambda: lost("the chip at 0x60 on I2C bus /dev/i2c-1 lost its settings (MODE1 11)")),
    ("does not start", lambda: refused(DeviceUnavailable("A1 does not begin its scan `Boost`: nothing came"))),
    ("no picture", lambda: lost("no picture for 2 s: does the camera hang?")),
    ("taken meanwhile", lambda: refused(caused(DeviceUnavailable("/dev/a is taken"), BlockingIOError(11, "no")))),
    ("not allowed", lambda: refused(caused(DeviceUnavailable("cannot open"), PermissionError(13, "no")))),
    ("cannot be so", lambda: refused(DeviceMisconfigured("/dev/a cannot do 7 baud"))),
    ("cannot open", lambda: refused(DeviceUnavailable("the moon is full"))),
    ("opens too slowly", lambda: of(Lidar, sighting(hung=True))),
    ("driver broken", lambda: refused(ZeroDivisionError("by zero"))),
    ("undeclared message", lambda: lidar([*scans(), Battery(0, 12.0)])),
    ("closes too slowly", lambda: lidar(scans(), close_s=0.9)),
    ("ports swapped", lambda: [found("ports swapped", "a", path="/dev/a", other="/dev/b", owner="motors", name="a")]),
    ("on another port", lambda: [found("on another port", "a", path="/dev/a", other="/dev/b")]),
    ("other baud", lambda: [found("other baud", "a", baud=9600, other=115_200)]),
    ("silent", lambda: lidar([])),
    ("quiet", lambda: gauge()),
    ("lost again", lambda: lost("/dev/a went away")),
    ("too few", lambda: lidar(scans(), every_s=0.2)),
    ("pauses", pauses),
    ("old when they come", lambda: lidar(scans(), age_s=0.5)),
    ("from the future", lambda: lidar(scans(), age_s=-0.01)),
    ("bad bytes", lambda: counted("bad checksum", "x")),
    ("weak supply", lambda: counted("under-voltage")),
    ("turns wrongly", lambda: counted("rotation off", "7.0 Hz")),
    ("warns of itself", lambda: counted("health warning")),
    ("falls behind", lambda: counted("old scan dropped", "0.3 s old")),
    ("controller complains", lambda: counted("kill latched")),
    ("weak battery", lambda: counted("battery low", "10.1 V")),
    ("runs hot", lambda: counted("controller too hot")),
    ("beyond the range", lambda: counted("beyond the range", "raise `gyro_range_dps`")),
    ("picture black at times", lambda: counted("black picture")),
    ("picture repeated", lambda: counted("repeated picture")),
    ("picture spoilt", lambda: counted("torn picture")),
    ("wheels disagree", lambda: counted("wheels disagree", "by 33% of the fastest one")),
    ("command refused", lambda: counted("cannot reverse")),
    ("moved while zeroing", lambda: counted("moved while zeroing")),
    ("pad out of reach", lambda: counted("no event")),
    ("other fault", lambda: counted("whatever")),
    ("nothing measured", lambda: lidar([scan(np.nan)] * 3)),
    ("no return", lambda: lidar([scan(np.inf)] * 3)),
    ("something touches", lambda: lidar([scan(0.05)] * 2)),
    ("picture black", lambda: of(Camera, sighting([frame(0)]))),
    ("picture white", lambda: of(Camera, sighting([frame(255)]))),
    ("picture empty", lambda: of(Camera, sighting([frame(128)]))),
    ("stands still", lambda: lidar([scan(seed=1)] * 12)),
    ("battery low", lambda: gauge(Battery(0, 10.5, charge=0.1))),
    ("battery absent", lambda: gauge(Battery(0, 0.1))),
    ("imu mute", lambda: gauge(Imu(0))),
    ("imu off", lambda: gauge(Imu(0, ax_mps2=0.0, ay_mps2=0.0, az_mps2=1.0))),
    ("imu upside down", lambda: gauge(Imu(0, ax_mps2=0.0, ay_mps2=0.0, az_mps2=-9.8))),
    ("imu turns", lambda: gauge(Imu(0, wz_radps=0.4))),
    ("odometry drifts", lambda: of(Wheels, sighting([Odometry(0, 0, 0, 0, vx_mps=0.3)] * 3))),
    ("bumper pressed", lambda: gauge(Contact(0, True, "front"))),
    ("no watchdog", lambda: of(Bare, sighting())),
]


@pytest.mark.parametrize(("name", "make"), ROWS, ids=[name for name, _ in ROWS])
def test_each_fault_is_found_with_cause_and_mend(name: str, make: Callable[[], list[Finding]]) -> None:
    findings = make()
    (finding,) = [one for one in findings if one.fault == name]
    row = FAULTS[name]
    assert finding.level == row.level
    assert finding.code == (row.code if row.level == "error" else 0)
    assert "{" not in finding.cause + finding.mend
    assert finding.cause
    assert finding.mend or name == "config wrong"
    assert not any(one.level == "error" and one.fault != name for one in findings)


def test_each_fault_has_a_row() -> None:
    assert [name for name, _ in ROWS] == list(FAULTS)


@pytest.mark.parametrize(
    ("findings", "said"),
    [
        (lidar(scans()), "opens; LidarScan 10.0 Hz, 0.01 s old"),
        (lidar([scan(seed=i) for i in range(12)], faults={"no return anywhere": 1}), "opens; LidarScan 10.0 Hz"),
        (of(Camera, sighting([frame(seed=i) for i in range(5)])), "opens; CameraFrame 10.0 Hz"),
        (gauge(Battery(0, 12.0), Imu(0, ax_mps2=0.1, ay_mps2=0.0, az_mps2=9.7, wz_radps=0.01)), "opens; Battery"),
        (gauge(Battery(0, 12.0, charge=0.21)), "opens; Battery"),
        (gauge(Contact(0, False)), "opens; Contact"),
        (of(Wheels, sighting([Odometry(0, 0, 0, 0, vx_mps=v) for v in (0.3, 0.0)])), "opens; Odometry"),
        (of(Wheels, sighting([], has_stop_line=True)), "opens"),
    ],
)
def test_a_device_that_does_well(findings: list[Finding], said: str) -> None:
    assert findings[0].level == "good"
    assert findings[0].cause.startswith(said)
    assert [one.level for one in findings[1:] if one.level != "note"] == []


def test_a_driver_may_say_its_own_mend() -> None:
    (finding,) = counted("dust")
    assert (finding.fault, finding.mend) == ("other fault", "wipe the window")


def test_words_of_the_driver_stay() -> None:
    (finding,) = refused(DeviceUnavailable("lidar: the moon is full"))
    assert finding.cause == "the moon is full"


def names_of(cls: type[Device[Any]]) -> set[str]:
    """The faults that a shipped driver says, in its docstring, that it counts, and those of its controller's tables."""
    told = " ".join((cls.__doc__ or "").split()).partition("Faults that it counts:")[2]
    told = told.partition(". Lost")[0]
    return set(re.findall(r"`([^`]+)`", told)) - {"rotation_hz", "idle_s"}


SHIPPED = {
    point.name: point.load()
    for point in metadata.entry_points(group="robotd.devices")
    if point.value.startswith("robotd_devices.") and not point.name.startswith("sim_")
}
TABLES = {*roboclaw_packets.FAULTS.values(), *vesc_packets.FAULTS.values()}


def test_a_fault_of_a_shipped_driver_is_never_just_another_one() -> None:
    named = {name: names_of(cls) for name, cls in SHIPPED.items()}
    assert {"rplidar", "camera", "ina219", "rosmaster"} <= {name for name, faults in named.items() if faults}
    shared = {"line full", "no finite command", "fault 99"}
    unknown = {
        fault for fault in set().union(*named.values(), TABLES, shared) - {"no return anywhere"}
        if counted(fault)[0].fault == "other fault"
    }  # fmt: skip
    assert unknown == set()


# ------------------------------------------------------------------------------------------- the page


def shown(text: str) -> str:
    """A sentence of the table as the page has it: facts in italics, what may be empty left out."""
    text = re.sub(r"\{or_\w+\}", "", text)
    return re.sub(r"\{(\w+)[^}]*\}", r"*\1*", text).replace("|", "\\|")


@pytest.mark.parametrize("by", ["looking", "opening"])
def test_the_page_has_the_same_table(by: str) -> None:
    lines = PAGE.read_text().splitlines()
    rows = [
        f"| {name} | {shown(row.cause)} | {shown(row.mend)} | {row.level if row.level != 'error' else row.code} |"
        for name, row in FAULTS.items()
        if row.by == by
    ]
    start = lines.index(rows[0]) if rows[0] in lines else 0
    assert lines[start : start + len(rows)] == rows
    assert not lines[start + len(rows)].startswith("|")
