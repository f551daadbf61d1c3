"""What `doctor` asks of the machine, answered from the file system, /proc and the package metadata; opens no device."""

from __future__ import annotations

import getpass
import glob
import os
import re
import shutil
import socket
import stat
import sys
from collections.abc import Iterable, Mapping, Sequence
from importlib import metadata
from pathlib import Path

from robotd.engine.parts import DevicePart, Parts
from robotd.setup.doctor.facts import HEAD_BYTES, PICTURES, Account, Adapter, Health, Holder, Kind, NeedKind, Node

GROUPS = ("robotd.behaviours", "robotd.perception", "robotd.devices", "robotd.bridges")
CONNECT_LIMIT_S = 2.0
HOT_C = 85.0
_PATTERNS: Mapping[NeedKind, tuple[str, ...]] = {
    "serial port": ("serial/by-id/*", "ttyUSB*", "ttyACM*", "ttyAMA*", "ttyTHS*", "serial[0-9]*"),
    "I2C bus": ("i2c-[0-9]*",),
    "camera": ("video[0-9]*",),
    "input device": ("input/by-id/*-event-joystick",),
}


class SystemProbes:
    """The machine that this runs on."""

    def __init__(
        self, dev: Path = Path("/dev"), proc: Path = Path("/proc"), sys_folder: Path = Path("/sys"), here: str = "."
    ) -> None:
        self._dev = dev
        self._proc = proc
        self._sys = sys_folder
        self._here = here

    def python(self) -> tuple[int, int, int]:
        return sys.version_info[:3]

    def requirements(self) -> Sequence[str]:
        try:
            lines = metadata.requires("robotd") or []
        except metadata.PackageNotFoundError:
            return []
        return [line for line in lines if "extra" not in line.partition(";")[2]]

    def versions(self, names: Iterable[str]) -> Mapping[str, str]:
        found: dict[str, str] = {}
        for name in names:
            try:
                found[name] = metadata.version(name)
            except metadata.PackageNotFoundError:
                continue
        return found

    def plugins(self) -> Sequence[tuple[str, str, Exception | None]]:
        return [
            (group, point.name, _import_error(point))
            for group in GROUPS
            for point in metadata.entry_points(group=group)
        ]

    def parts(self, file: str) -> Parts:
        from robotd.setup.load import load_config

        return load_config(file, sim=False, sets=(), env=os.environ).parts

    def load_error(self, part: DevicePart) -> Exception | None:
        try:
            part.cls.load(part.config)
        except Exception as error:
            return error
        return None

    def health(self) -> Health:
        weak_now, weak_before, slowed = _throttled(self._sys)
        for folder in self._sys.glob("class/hwmon/hwmon*"):
            if _read(folder / "name") == "rpi_volt":
                weak_now = weak_now or _read(folder / "in0_lcrit_alarm") == "1"
        zones = [
            int(text) for zone in self._sys.glob("class/thermal/thermal_zone*") if (text := _number(zone / "temp"))
        ]
        celsius = max(zones, default=0) / 1000.0
        try:
            free_mb: int | None = shutil.disk_usage(self._here).free // 1_000_000
        except OSError:
            free_mb = None
        return Health(weak_now, weak_before, celsius if slowed or celsius > HOT_C else None, free_mb)

    def node(self, path: str) -> Node:
        try:
            status = os.stat(path)
        except PermissionError:
            return Node("other", readable=False, writable=False)
        except (OSError, ValueError):
            return Node("absent")
        kind = _kind(status.st_mode)
        pictures = 0
        if kind == "folder" and os.access(path, os.R_OK | os.X_OK):
            pictures = sum(entry.suffix.lower() in PICTURES for entry in Path(path).iterdir())
        return Node(
            kind,
            readable=os.access(path, os.R_OK),
            writable=os.access(path, os.W_OK),
            group=_group_name(status.st_gid),
            holders=self.holders(path, status) if kind == "device" else (),
            pictures=pictures,
            head=_head(path) if kind == "file" else None,
        )

    def holders(self, path: str, status: os.stat_result) -> tuple[Holder, ...]:
        """Processes that locked the node (/proc/locks) or have it open (their descriptors, where readable)."""
        pids: set[int] = set(self._lockers(status))
        real = os.path.realpath(path)
        for folder in self._proc.glob("[0-9]*"):
            try:
                if any(os.readlink(entry) == real for entry in (folder / "fd").iterdir()):
                    pids.add(int(folder.name))
            except OSError:
                continue  # another user's process, or one that has just ended: it cannot be asked
        pids.discard(os.getpid())
        return tuple(Holder(pid, self._name(pid)) for pid in sorted(pids))

    def _lockers(self, status: os.stat_result) -> list[int]:
        try:
            lines = (self._proc / "locks").read_text().splitlines()
        except OSError:
            return []
        wanted = f"{os.major(status.st_dev):02x}:{os.minor(status.st_dev):02x}:{status.st_ino}"
        fields = [line.split() for line in lines]
        # "1: FLOCK  ADVISORY  WRITE 812 00:06:345 0 EOF"; a waiting one has "->" after its number
        return [
            int(f[4]) for f in fields if len(f) >= 6 and f[1] in ("FLOCK", "POSIX") and f[5] == wanted and int(f[4]) > 0
        ]

    def _name(self, pid: int) -> str:
        try:
            return (self._proc / str(pid) / "comm").read_text().strip()
        except OSError:
            return ""

    def account(self) -> Account:
        import grp

        user = _user_name()
        held = frozenset(_group_name(gid) for gid in {os.getegid(), *os.getgroups()})
        return Account(user, held, frozenset(entry.gr_name for entry in grp.getgrall() if user in entry.gr_mem))

    def candidates(self, kind: NeedKind) -> Sequence[str]:
        found: dict[str, str] = {}
        for pattern in _PATTERNS.get(kind, ()):
            for path in sorted(self._dev.glob(pattern)):
                found.setdefault(os.path.realpath(path), str(path))  # one name a device, the lasting one first
        return list(found.values())

    def lasting_name(self, path: str) -> str:
        real = os.path.realpath(path)
        links = sorted((self._dev / "serial" / "by-id").glob("*"))
        return next((str(link) for link in links if os.path.realpath(link) == real), "")

    def fitting(self, pattern: str) -> Sequence[str]:
        return sorted(glob.glob(pattern))

    def real_path(self, path: str) -> str:
        return os.path.realpath(path)

    def adapter(self, path: str) -> Adapter | None:
        tty = self._sys / "class" / "tty" / os.path.basename(os.path.realpath(path)) / "device"
        # the port, the USB interface, the USB device: the ids stand at the last, some steps up
        for folder in (tty.resolve(), *tty.resolve().parents):
            if (folder / "idVendor").exists():
                driver = os.path.basename(os.path.realpath(tty / "driver")) if (tty / "driver").exists() else ""
                latency = _number(tty / "latency_timer")
                return Adapter(
                    _read(folder / "idVendor"),
                    _read(folder / "idProduct"),
                    _read(folder / "serial"),
                    driver,
                    int(latency) if latency else None,
                )
        return None

    def consoles(self) -> Sequence[str]:
        words = _read(self._proc / "cmdline").split()
        names = [word.removeprefix("console=").partition(",")[0] for word in words if word.startswith("console=")]
        return [os.path.basename(os.path.realpath(self._dev / name)) for name in names]

    def running(self, names: Iterable[str]) -> frozenset[str]:
        wanted = set(names)
        # the kernel keeps 15 letters of a name
        return frozenset(wanted & {_read(folder / "comm") for folder in self._proc.glob("[0-9]*")})

    def reachable(self, host: str, port: int) -> str:
        try:
            socket.create_connection((host, port), timeout=CONNECT_LIMIT_S).close()
        except OSError as error:
            return error.strerror or str(error)
        return ""


def _throttled(sys_folder: Path) -> tuple[bool, bool, bool]:
    """What a Raspberry Pi's firmware says: weak supply now, weak since the start, slowed down by heat now.

    Bits of `vcgencmd get_throttled` (Raspberry Pi documentation, os/utilities): 0 under-voltage, 2 throttled, 3 soft
    temperature limit, 16 under-voltage has occurred.
    """
    text = _read(sys_folder / "devices" / "platform" / "soc" / "soc:firmware" / "get_throttled")
    bits = int(text, 16) if re.fullmatch(r"(0x)?[0-9a-fA-F]+", text) else 0
    return bool(bits & 1), bool(bits & 1 << 16), bool(bits & 0b1100)


def _read(path: Path) -> str:
    """The text of a small file, or empty where it cannot be read."""
    try:
        return path.read_text(errors="replace").strip()
    except OSError:
        return ""


def _number(path: Path) -> str:
    text = _read(path)
    return text if text.isdigit() else ""


def _head(path: str) -> bytes | None:
    try:
        with open(path, "rb") as file:
            return file.read(HEAD_BYTES)
    except OSError:
        return None


def _import_error(point: metadata.EntryPoint) -> Exception | None:
    try:
        point.load()
    except Exception as error:
        return error
    return None


def _kind(mode: int) -> Kind:
    if stat.S_ISCHR(mode):
        return "device"
    if stat.S_ISDIR(mode):
        return "folder"
    if stat.S_ISREG(mode):
        return "file"
    return "socket" if stat.S_ISSOCK(mode) else "other"


def _group_name(gid: int) -> str:
    import grp

    try:
        return grp.getgrgid(gid).gr_name
    except KeyError:
        return str(gid)


def _user_name() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return str(os.getuid())
