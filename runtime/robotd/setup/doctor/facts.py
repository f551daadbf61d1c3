"""What the doctor asks of the machine: the facts as small classes, and `Probes`, behind which a test puts its own."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol, TypeAlias

from robotd.engine.parts import DevicePart, Parts

Kind: TypeAlias = Literal["absent", "device", "folder", "file", "socket", "other"]
NeedKind: TypeAlias = Literal["serial port", "I2C bus", "camera", "network camera", "input device", "file"]

PICTURES = (".jpg", ".jpeg", ".png", ".bmp", ".ppm", ".webp")
HEAD_BYTES = 64


@dataclass(frozen=True, slots=True)
class Holder:
    """A process that has a node open or locked; `name` is empty where it may not be read."""

    pid: int
    name: str = ""


@dataclass(frozen=True, slots=True)
class Node:
    """What the file system says about one path.

    group: the owning group's name; pictures: in a folder; head: how a plain file begins, None where it was not read.
    """

    kind: Kind
    readable: bool = True
    writable: bool = True
    group: str = ""
    holders: tuple[Holder, ...] = ()
    pictures: int = 0
    head: bytes | None = None


@dataclass(frozen=True, slots=True)
class Account:
    """Who runs this. `groups`: of this process; `enrolled`: in the user database, effective from the next login."""

    user: str
    groups: frozenset[str] = frozenset()
    enrolled: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True)
class Need:
    """One thing of the machine that a device's config names."""

    kind: NeedKind
    path: str
    key: str


@dataclass(frozen=True, slots=True)
class Health:
    """How the computer itself is. `celsius`: None where it is not slowed down by heat; `free_mb`: in this folder."""

    weak_now: bool = False
    weak_before: bool = False
    celsius: float | None = None
    free_mb: int | None = None


@dataclass(frozen=True, slots=True)
class Adapter:
    """The USB adapter behind a serial port. `latency_ms`: of an FTDI's timer, None where it has none."""

    vendor: str = ""
    product: str = ""
    serial: str = ""
    driver: str = ""
    latency_ms: int | None = None


class Probes(Protocol):
    """Everything that the doctor asks of the machine. Nothing here opens a device."""

    def python(self) -> tuple[int, int, int]: ...
    def requirements(self) -> Sequence[str]:
        """Requirement lines of the installed robotd, without those of extras."""
        ...

    def versions(self, names: Iterable[str]) -> Mapping[str, str]:
        """Versions of those distributions that are installed."""
        ...

    def plugins(self) -> Sequence[tuple[str, str, Exception | None]]:
        """(group, name, error on import or None) of every installed entry point."""
        ...

    def parts(self, file: str) -> Parts:
        """The parts of the robot in `file`; raises ConfigError."""
        ...

    def load_error(self, part: DevicePart) -> Exception | None:
        """What the part's own `load` raises, or None."""
        ...

    def health(self) -> Health: ...
    def node(self, path: str) -> Node: ...
    def account(self) -> Account: ...
    def fitting(self, pattern: str) -> Sequence[str]:
        """Paths that a pattern with `*` fits now."""
        ...

    def candidates(self, kind: NeedKind) -> Sequence[str]:
        """Paths of this kind that the machine has now, the lasting names first."""
        ...

    def lasting_name(self, path: str) -> str:
        """The /dev/serial/by-id name of a port, or empty."""
        ...

    def real_path(self, path: str) -> str:
        """Where links lead; the path itself where it is none."""
        ...

    def adapter(self, path: str) -> Adapter | None:
        """The USB adapter of a serial port; None where it is none or not there."""
        ...

    def consoles(self) -> Sequence[str]:
        """Names in /dev on which the kernel's console writes."""
        ...

    def running(self, names: Iterable[str]) -> frozenset[str]:
        """Which of these programs run now."""
        ...

    def reachable(self, host: str, port: int) -> str:
        """Empty where a connection opens, else why not."""
        ...
