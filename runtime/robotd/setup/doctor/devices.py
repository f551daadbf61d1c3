"""Pure checks of what each device needs, without opening it: opening a serial port resets some boards."""

from __future__ import annotations

import glob
import re
from collections.abc import Mapping, Sequence
from urllib.parse import urlsplit

from robotd.authoring.config import Config, FileKey
from robotd.engine.parts import DevicePart
from robotd.setup.doctor.facts import PICTURES, Account, Holder, Kind, Need, NeedKind, Node, Probes
from robotd.setup.doctor.faults import found
from robotd.setup.doctor.findings import Finding
from robotd.setup.doctor.machine import import_fault

_URL_PORTS: Mapping[str, int] = {"http": 80, "https": 443, "rtsp": 554, "tcp": 0, "udp": 0}
_LFS = b"version https://git-lfs"
_SLOW_MS = 2
MEDDLERS: Mapping[str, str] = {"ModemManager": "modem manager", "brltty": "braille display"}
"""Programs that speak to serial adapters unasked, to their rows of the table."""


def _is_path(source: str) -> bool:
    """Whether a camera's source is something in the file system or on the network, and no pipeline."""
    return " ! " not in source and source.partition(":")[0] not in ("csi", "libcamera")


def needs(config: Config) -> list[Need]:
    """What of the machine a device's config names: by the keys `port`, `bus`, `source` and `path`, and by `FileKey`."""
    wanted: list[Need] = []
    for key, about in type(config).model_fields.items():
        value = getattr(config, key)
        if value is None or isinstance(value, bool) or value == "":
            continue
        text = str(value)
        if key == "port" and not isinstance(value, int):
            wanted.append(Need("serial port", text, key))
        elif key == "bus":
            wanted.append(Need("I2C bus", f"/dev/i2c-{text}" if text.isdigit() else text.removeprefix("unix:"), key))
        elif key == "source" and _is_path(text):
            kind: NeedKind = "network camera" if urlsplit(text).scheme in _URL_PORTS else "camera"
            wanted.append(Need(kind, f"/dev/video{text}" if text.isdigit() else text, key))
        elif key == "path" and text.startswith("/dev/input/"):
            wanted.append(Need("input device", text, key))
        elif any(isinstance(mark, FileKey) and not mark.shelf for mark in about.metadata):
            wanted.append(Need("file", text, key))
    return wanted


def check_device(part: DevicePart, probes: Probes) -> list[Finding]:
    """Everything that can be said about one device without opening it."""
    findings: list[Finding] = []
    error = probes.load_error(part)
    if error is not None:
        findings.append(import_fault(part.name, error))
    for need in needs(part.config):
        if need.kind == "network camera":
            findings.append(_check_network(part.name, need, probes))
        else:
            findings += _check_node(part.name, need, probes)
    return findings or [Finding("good", part.name, "names nothing that could be looked at without opening it")]


def check_together(parts: Sequence[DevicePart], probes: Probes) -> list[Finding]:
    """What is wrong between devices: one port or one address named twice; programs that meddle with their ports."""
    ports: dict[str, list[str]] = {}
    chips: dict[tuple[str, int], list[str]] = {}
    for part in parts:
        for need in needs(part.config):
            real = probes.real_path(need.path)
            if need.kind == "serial port":
                ports.setdefault(real, []).append(part.name)
            elif need.kind == "I2C bus" and isinstance(address := getattr(part.config, "address", None), int):
                chips.setdefault((real, address), []).append(part.name)
    findings = [
        found("one port twice", names[0], path=path, names=" and ".join(names))
        for path, names in ports.items()
        if len(names) > 1
    ]
    findings += [
        found("one address twice", names[0], path=path, names=" and ".join(names), address=f"0x{address:02X}")
        for (path, address), names in chips.items()
        if len(names) > 1
    ]
    if any(re.match(r"/dev/(tty(USB|ACM)|serial/by-)", path) for path in ports):
        findings += [found(MEDDLERS[name], "serial ports") for name in sorted(probes.running(MEDDLERS))]
    return findings


def _check_network(name: str, need: Need, probes: Probes) -> Finding:
    url = urlsplit(need.path)
    try:
        host, port = url.hostname or "", url.port or _URL_PORTS[url.scheme]
    except ValueError:
        return found("address wrong", name, path=need.path, key=need.key)
    if url.scheme == "udp" or not port:
        return Finding("note", name, f"{need.path} can only be tried by opening it")
    if why := probes.reachable(host, port):
        return found("host silent", name, host=host, port=port, why=why)
    return Finding("good", name, f"{host}:{port} answers")


def _check_node(name: str, need: Need, probes: Probes) -> list[Finding]:
    node = probes.node(need.path)
    if node.kind == "absent" and glob.has_magic(need.path):
        fitting = probes.fitting(need.path)
        if len(fitting) > 1 and need.kind == "serial port":
            said = ", ".join(fitting)
            return [found("several ports fit", name, count=len(fitting), path=need.path, paths=said)]
        if fitting:
            return _check_node(name, Need(need.kind, fitting[0], need.key), probes)
    if node.kind == "absent":
        return [_absent(name, need, probes.candidates(need.kind))]
    if sort := _wrong_sort(need, node):
        wanted = f"{'an' if need.kind[0] in 'Ii' else 'a'} {need.kind}"
        return [found("wrong sort", name, path=need.path, sort=sort, wanted=wanted, key=need.key)]
    write = need.kind in ("serial port", "I2C bus")
    if not node.readable or (write and not node.writable):
        return [_forbidden(name, need, node, probes.account())]
    if node.holders and need.kind in ("serial port", "camera"):
        return [_busy(name, need, node.holders)]
    if node.kind == "folder" and not node.pictures:
        return [found("no pictures", name, path=need.path, known=", ".join(PICTURES))]
    if need.kind == "file" and node.head is not None and (node.head == b"" or node.head.startswith(_LFS)):
        return [found("file empty" if not node.head else "file is a pointer", name, path=need.path)]
    findings = [Finding("good", name, f"{need.path} is there{f', {node.pictures} pictures' if node.pictures else ''}")]
    return findings + (_check_port(name, need.path, probes) if need.kind == "serial port" else [])


def _check_port(name: str, path: str, probes: Probes) -> list[Finding]:
    """What else may be wrong with a serial port that is there and free."""
    findings: list[Finding] = []
    if re.match(r"/dev/tty(USB|ACM)\d+\Z", path) and (lasting := probes.lasting_name(path)):
        findings.append(found("name may change", name, path=path, lasting=lasting))
    tty = probes.real_path(path).removeprefix("/dev/")
    if tty in probes.consoles():
        findings.append(found("console on port", name, path=path, tty=tty))
    adapter = probes.adapter(path)
    if adapter is not None and adapter.latency_ms is not None and adapter.latency_ms > _SLOW_MS:
        findings.append(found("slow adapter", name, path=path, ms=adapter.latency_ms))
    return findings


_ABSENT: Mapping[NeedKind, str] = {
    "serial port": "port absent",
    "I2C bus": "bus absent",
    "camera": "camera absent",
    "input device": "input absent",
    "file": "file absent",
}


def _absent(name: str, need: Need, candidates: Sequence[str]) -> Finding:
    row = "no port fits" if need.kind == "serial port" and glob.has_magic(need.path) else _ABSENT[need.kind]
    here = f"; or name one that is here: {', '.join(candidates)}" if candidates else ""
    return found(row, name, path=need.path, or_here=here)


def _wrong_sort(need: Need, node: Node) -> str:
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
        "input device": ("device",),
        "file": ("file",),
    }
    return "" if node.kind in allowed[need.kind] else words.get(node.kind, "a pipe or the like")


def _forbidden(name: str, need: Need, node: Node, account: Account) -> Finding:
    if need.kind == "file" or node.kind != "device":
        row = "file unreadable"
    elif node.group in ("", "root"):
        row = "root alone"
    elif node.group in account.enrolled and node.group not in account.groups:
        row = "group not in effect"
    elif node.group in account.groups:
        row = "group may not write"
    else:
        row = "not in the group"
    return found(row, name, user=account.user, path=need.path, group=node.group)


def _busy(name: str, need: Need, holders: Sequence[Holder]) -> Finding:
    who = ", ".join(f"{holder.name or 'a process'} ({holder.pid})" for holder in holders)
    pids = " ".join(str(holder.pid) for holder in holders)
    return found("port busy" if need.kind == "serial port" else "camera busy", name, path=need.path, who=who, pids=pids)
