"""Facts for tests of the doctor: small configs, and a machine that consists of what a test says."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatch
from typing import Annotated

from robotd.authoring.config import Config, FileKey
from robotd.authoring.device import Sensor
from robotd.engine.parts import DevicePart, Parts
from robotd.setup.doctor.facts import Account, Adapter, Health, NeedKind, Node
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


class PadConfig(Config):
    path: str = "/dev/input/by-id/*-event-joystick"


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
    computer: Health = Health()
    links: Mapping[str, str] = field(default_factory=dict)
    adapters: Mapping[str, Adapter] = field(default_factory=dict)
    console: Sequence[str] = ()
    programs: frozenset[str] = frozenset()

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

    def health(self) -> Health:
        return self.computer

    def fitting(self, pattern: str) -> Sequence[str]:
        return [path for path in self.nodes if fnmatch(path, pattern)]

    def real_path(self, path: str) -> str:
        return self.links.get(path, path)

    def adapter(self, path: str) -> Adapter | None:
        return self.adapters.get(path)

    def consoles(self) -> Sequence[str]:
        return self.console

    def running(self, names: Iterable[str]) -> frozenset[str]:
        return self.programs & set(names)

    def reachable(self, host: str, port: int) -> str:
        return self.network.get((host, port), "Connection refused")
