"""Looks for what keeps a robot from working and says the cause and the mend: pure checks over probed facts.

Nothing here touches the machine; `robotd.setup.probes` does, and a test puts its own facts in its place. No check opens
a device: opening a serial port resets some boards.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol, TypeAlias
from urllib.parse import urlsplit

from robotd.authoring.config import Config, FileKey
from robotd.engine.logs import printable
from robotd.engine.parts import DevicePart, Parts
from robotd.setup.problems import ConfigError

OK, UNAVAILABLE, PERMISSION, CONFIG = 0, 69, 77, 78

Level: TypeAlias = Literal["good", "note", "warning", "error"]
Kind: TypeAlias = Literal["absent", "device", "folder", "file", "socket", "other"]
NeedKind: TypeAlias = Literal["serial port", "I2C bus", "camera", "network camera", "file"]

OLDEST, NEWEST = (3, 11), (3, 13)
RIVALS: Mapping[str, tuple[str, str]] = {
    "opencv-python": ("opencv-python-headless", "both install the module cv2, and the later one breaks the other"),
    "opencv-contrib-python": ("opencv-python-headless", "both install the module cv2"),
    "serial": ("pyserial", "both install a module named serial; only that of pyserial can open a port"),
}
"""Distributions that must not stand beside one of ours: name to (ours, why)."""
EXTRAS: Mapping[str, str] = {"serialx": "serialx", "matplotlib": "plot"}
"""Modules that come with an extra of robotd."""
PICTURES = (".jpg", ".jpeg", ".png", ".bmp", ".ppm", ".webp")


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was looked at. `code`: exit code that it calls for, 0 unless it is an error."""

    level: Level
    subject: str
    cause: str
    mend: str = ""
    code: int = OK


@dataclass(frozen=True, slots=True)
class Holder:
    """A process that has a node open or locked; `name` is empty where it may not be read."""

    pid: int
    name: str = ""


@dataclass(frozen=True, slots=True)
class Node:
    """What the file system says about one path. `group`: the owning group's name; `pictures`: in a folder."""

    kind: Kind
    readable: bool = True
    writable: bool = True
    group: str = ""
    holders: tuple[Holder, ...] = ()
    pictures: int = 0


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


class Probes(Protocol):
    """Everything that the doctor asks of the machine."""

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

    def node(self, path: str) -> Node: ...
    def account(self) -> Account: ...
    def candidates(self, kind: NeedKind) -> Sequence[str]:
        """Paths of this kind that the machine has now, the lasting names first."""
        ...

    def lasting_name(self, path: str) -> str:
        """The /dev/serial/by-id name of a port, or empty."""
        ...

    def reachable(self, host: str, port: int) -> str:
        """Empty where a connection opens, else why not."""
        ...


# -------------------------------------------------------------------------------------- the machine


def check_python(version: tuple[int, int, int]) -> Finding:
    """Whether this Python is one that robotd is tested with."""
    said = ".".join(map(str, version))
    if version[:2] < OLDEST:
        return Finding("error", "python", f"Python {said} is too old", "use Python 3.11, 3.12 or 3.13", UNAVAILABLE)
    if version[:2] > NEWEST:
        return Finding("warning", "python", f"Python {said} is newer than any tested", "if it fails, use Python 3.13")
    return Finding("good", "python", f"Python {said}")


def check_packages(requirements: Sequence[str], versions: Mapping[str, str]) -> list[Finding]:
    """Missing, too old and rival packages. versions: of the required ones and of the rivals, where installed."""
    findings: list[Finding] = []
    for line in requirements:
        match = re.match(r"\s*([A-Za-z0-9._-]+)\s*(?:\[[^]]*\])?\s*\(?([^;)]*)", line)
        if match is None:
            continue
        name, wanted = match[1], match[2].strip()
        mend = f"pip install '{name}{wanted}'"
        if name not in versions:
            findings.append(Finding("error", "packages", f"{name} is not installed", mend, UNAVAILABLE))
        elif not satisfies(versions[name], wanted):
            cause = f"{name} {versions[name]} is installed, {wanted} is needed"
            findings.append(Finding("error", "packages", cause, mend, UNAVAILABLE))
    for rival, (ours, why) in RIVALS.items():
        if rival in versions:
            mend = f"pip uninstall -y {rival} {ours} && pip install {ours}"
            findings.append(Finding("warning", "packages", f"{rival} stands beside {ours}: {why}", mend))
    if not findings:
        findings.append(Finding("good", "packages", f"all {len(requirements)} are installed"))
    return findings


def satisfies(version: str, wanted: str) -> bool:
    """Whether a version lies in a range such as `>=2.3,<3`; only its leading numbers count, other clauses pass."""
    have = _numbers(version)
    for clause in filter(None, (part.strip() for part in wanted.split(","))):
        match = re.match(r"(>=|<=|==|!=|>|<)\s*([0-9][0-9.]*)\Z", clause)
        if match is None:
            continue
        limit = _numbers(match[2])
        length = max(len(have), len(limit))
        a, b = have + (0,) * (length - len(have)), limit + (0,) * (length - len(limit))
        holds = {">=": a >= b, "<=": a <= b, "==": a == b, "!=": a != b, ">": a > b, "<": a < b}
        if not holds[match[1]]:
            return False
    return True


def _numbers(version: str) -> tuple[int, ...]:
    match = re.match(r"[0-9]+(?:\.[0-9]+)*", version)
    return tuple(int(part) for part in match[0].split(".")) if match else ()


def check_plugins(plugins: Sequence[tuple[str, str, Exception | None]]) -> list[Finding]:
    """Entry points that cannot be imported."""
    broken = [
        Finding("error", f"{group}: {name}", f"cannot be imported: {_words(error)}", _import_mend(error), UNAVAILABLE)
        for group, name, error in plugins
        if error is not None
    ]
    return broken or [Finding("good", "plugins", f"all {len(plugins)} can be imported")]


def _words(error: Exception) -> str:
    return str(error) or type(error).__name__


def _import_mend(error: Exception) -> str:
    missing = (error.name or "").partition(".")[0] if isinstance(error, ImportError) else ""
    if missing in EXTRAS:
        return f"pip install 'robotd[{EXTRAS[missing]}]'"
    if isinstance(error, ModuleNotFoundError) and missing and not missing.startswith("robotd"):
        return f"pip install {missing}"
    return "install its distribution again, or remove it; `robotd plugins` says which one it is"


# -------------------------------------------------------------------------------------- the devices


def needs(config: Config) -> list[Need]:
    """What of the machine a device's config names: by the keys `port`, `bus` and `source`, and by `FileKey`."""
    found: list[Need] = []
    for key, about in type(config).model_fields.items():
        value = getattr(config, key)
        if value is None or isinstance(value, bool) or value == "":
            continue
        text = str(value)
        if key == "port" and not isinstance(value, int):
            found.append(Need("serial port", text, key))
        elif key == "bus":
            found.append(Need("I2C bus", f"/dev/i2c-{text}" if text.isdigit() else text, key))
        elif key == "source" and " ! " not in text:  # a pipeline names its own source, in its own words
            kind: NeedKind = "network camera" if urlsplit(text).scheme in _URL_PORTS else "camera"
            found.append(Need(kind, f"/dev/video{text}" if text.isdigit() else text, key))
        elif any(isinstance(mark, FileKey) and not mark.shelf for mark in about.metadata):
            found.append(Need("file", text, key))
    return found


_URL_PORTS: Mapping[str, int] = {"http": 80, "https": 443, "rtsp": 554, "tcp": 0, "udp": 0}


def check_device(part: DevicePart, probes: Probes) -> list[Finding]:
    """Everything that can be said about one device without opening it."""
    findings: list[Finding] = []
    error = probes.load_error(part)
    if error is not None:
        findings.append(Finding("error", part.name, _words(error), _import_mend(error), UNAVAILABLE))
    for need in needs(part.config):
        if need.kind == "network camera":
            findings.append(_check_network(part.name, need, probes))
        else:
            findings += _check_node(part.name, need, probes)
    return findings or [Finding("good", part.name, "names nothing that could be looked at without opening it")]


def _check_network(name: str, need: Need, probes: Probes) -> Finding:
    url = urlsplit(need.path)
    try:
        host, port = url.hostname or "", url.port or _URL_PORTS[url.scheme]
    except ValueError:
        return Finding("error", name, f"{need.path} is no valid address", f"correct `{need.key}` in the config", CONFIG)
    if url.scheme == "udp" or not port:
        return Finding("note", name, f"{need.path} can only be tried by opening it")
    why = probes.reachable(host, port)
    if why:
        mend = f"is the camera switched on, and does `ping {host}` answer?"
        return Finding("error", name, f"{host}:{port} does not answer: {why}", mend, UNAVAILABLE)
    return Finding("good", name, f"{host}:{port} answers")


def _check_node(name: str, need: Need, probes: Probes) -> list[Finding]:
    node = probes.node(need.path)
    if node.kind == "absent":
        return [_absent(name, need, probes.candidates(need.kind))]
    if wrong := _wrong_kind(need, node):
        return [Finding("error", name, f"{need.path} is {wrong}", f"correct `{need.key}` in the config", CONFIG)]
    write = need.kind in ("serial port", "I2C bus")
    if not node.readable or (write and not node.writable):
        return [_forbidden(name, need, node, probes.account())]
    if need.kind == "serial port" and node.holders:
        return [_busy(name, need, node.holders)]
    if node.kind == "folder" and not node.pictures:
        known = ", ".join(PICTURES)
        return [Finding("error", name, f"{need.path} holds no pictures", f"put some there ({known})", UNAVAILABLE)]
    findings = [Finding("good", name, f"{need.path} is there{f', {node.pictures} pictures' if node.pictures else ''}")]
    if need.kind == "serial port" and re.match(r"/dev/tty(USB|ACM)\d+\Z", need.path):
        lasting = probes.lasting_name(need.path)
        if lasting:
            mend = f"write port: {lasting}"
            findings.append(Finding("note", name, f"{need.path} may be another device after a replug", mend))
    return findings


_DEVICE_HELP: Mapping[str, str] = {
    "serial port": "plug it in; `dmesg | tail` says whether the machine noticed",
    "I2C bus": "switch the bus on (Raspberry Pi: `sudo raspi-config`, Interface Options; else `sudo modprobe i2c-dev`)",
    "camera": "plug it in, or correct the path",
    "file": "correct the path in the config; a relative one counts from the config's folder",
}


def _absent(name: str, need: Need, candidates: Sequence[str]) -> Finding:
    mend = _DEVICE_HELP[need.kind]
    if candidates:
        mend = f"{mend}; or name one that is here: {', '.join(candidates)}"
    return Finding("error", name, f"{need.kind} {need.path} does not exist", mend, UNAVAILABLE)


def _wrong_kind(need: Need, node: Node) -> str:
    """What is wrong with this sort of node for this need, or empty. A socket may stand for a bus: that is a fake."""
    words: Mapping[Kind, str] = {
        "device": "a device",
        "folder": "a folder",
        "file": "a plain file",
        "socket": "a socket",
    }
    allowed: Mapping[str, tuple[Kind, ...]] = {
        "serial port": ("device",),
        "I2C bus": ("device", "socket"),
        "camera": ("device", "folder", "file"),
        "file": ("file",),
    }
    if node.kind in allowed[need.kind]:
        return ""
    return f"{words.get(node.kind, 'a pipe or the like')}, not {'an' if need.kind == 'I2C bus' else 'a'} {need.kind}"


def _forbidden(name: str, need: Need, node: Node, account: Account) -> Finding:
    cause = f"user {account.user} may not {'use' if need.kind != 'file' else 'read'} {need.path}"
    if need.kind == "file" or node.kind != "device":
        mend = f"give read permission: chmod a+r {need.path}"
    elif node.group in ("", "root"):
        mend = f"it belongs to root alone: a udev rule must give {need.path} to a group such as dialout"
    elif node.group in account.enrolled and node.group not in account.groups:
        mend = f"{account.user} joined the group {node.group} after this login: log out and in again"
    elif node.group in account.groups:
        mend = f"the group {node.group} may not write it either: sudo chmod g+rw {need.path} (or a udev rule)"
    else:
        mend = f"sudo usermod -aG {node.group} {account.user}, then log out and in again"
    return Finding("error", name, cause, mend, PERMISSION)


def _busy(name: str, need: Need, holders: Sequence[Holder]) -> Finding:
    who = ", ".join(f"{holder.name or 'a process'} ({holder.pid})" for holder in holders)
    pids = " ".join(str(holder.pid) for holder in holders)
    return Finding("error", name, f"{need.path} is in use by {who}", f"end it: kill {pids}", UNAVAILABLE)


# ---------------------------------------------------------------------------------------- all of it


def examine(file: str | None, probes: Probes) -> list[Finding]:
    """All findings, the machine's first. file: a config, or None for the machine and the plugins alone."""
    requirements = probes.requirements()
    names = [match[0] for line in requirements if (match := re.match(r"[A-Za-z0-9._-]+", line.strip()))]
    findings = [
        check_python(probes.python()),
        *check_packages(requirements, probes.versions([*names, *RIVALS])),
    ]
    if file is None:
        return [*findings, *check_plugins(probes.plugins()), *_present(probes)]
    try:
        parts = probes.parts(file)
    except ConfigError as error:
        return [*findings, *(Finding("error", "config", str(problem), code=CONFIG) for problem in error.problems)]
    findings.append(Finding("good", "config", f"{file} has no errors"))
    for part in parts.devices:
        findings += check_device(part, probes)
    return findings


def _present(probes: Probes) -> list[Finding]:
    kinds: tuple[NeedKind, ...] = ("serial port", "I2C bus", "camera")
    return [Finding("note", kind, ", ".join(probes.candidates(kind)) or "none here") for kind in kinds]


def exit_code(findings: Sequence[Finding]) -> int:
    """78 where the config is wrong, else 77 where something is forbidden, else 69 where it is missing, else 0."""
    return max((finding.code for finding in findings), default=OK)


def report(findings: Sequence[Finding]) -> list[str]:
    """Lines for people: level, subject, cause, and the mend below it."""
    width = max((len(finding.subject) for finding in findings), default=0)
    lines: list[str] = []
    for finding in findings:
        lines.append(f"{finding.level:<8} {finding.subject:<{width}}  {printable(finding.cause)}")
        if finding.mend:
            lines.append(f"{'':<8} {'':<{width}}  -> {printable(finding.mend)}")
    errors = sum(finding.level == "error" for finding in findings)
    warnings = sum(finding.level == "warning" for finding in findings)
    counted = f"{errors} error{'s' * (errors != 1)}, {warnings} warning{'s' * (warnings != 1)}"
    return [*lines, "", counted if errors or warnings else "nothing stands in the way"]
