"""The faults that the doctor knows, as one table: cause and mend of each; docs/devices/faults.md shows the same."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from robotd.setup.doctor.findings import Finding, Level
from robotd.setup.exit_codes import CONFIG, INTERNAL, OK, PERMISSION, TEMPORARY, UNAVAILABLE


@dataclass(frozen=True, slots=True)
class Fault:
    """One row. `cause`, `mend`: sentences with places for facts, those named `or_...` may be empty.

    code: exit code of an error. by: how it is seen, by looking at the machine or by opening the devices.
    """

    cause: str
    mend: str
    code: int = UNAVAILABLE
    level: Level = "error"
    by: Literal["looking", "opening"] = "looking"


def _opening(cause: str, mend: str, code: int = UNAVAILABLE, level: Level = "error") -> Fault:
    return Fault(cause, mend, code, level, "opening")


def _doubt(cause: str, mend: str) -> Fault:
    return Fault(cause, mend, level="warning")


def _opening_doubt(cause: str, mend: str) -> Fault:
    return Fault(cause, mend, level="warning", by="opening")


_CORRECT = "correct `{key}` in the config"

FAULTS: Mapping[str, Fault] = {
    # ------------------------------------------------------------------------------------- the machine
    "python too old": Fault("Python {version} is too old", "use Python 3.11, 3.12 or 3.13"),
    "python untested": _doubt("Python {version} is newer than any tested", "if it fails, use Python 3.13"),
    "package missing": Fault("{name} is not installed", "pip install '{name}{wanted}'"),
    "package too old": Fault("{name} {have} is installed, {wanted} is needed", "pip install '{name}{wanted}'"),
    "rival package": _doubt(
        "{rival} stands beside {name}: {why}", "pip uninstall -y {rival} {name} && pip install {name}"
    ),
    "extra missing": Fault("{words}", "pip install 'robotd[{extra}]'"),
    "module missing": Fault("{words}", "pip install {module}"),
    "plugin broken": Fault(
        "{words}", "install its distribution again, or remove it; `robotd plugins` says which one it is"
    ),
    "under-voltage now": Fault(
        "this computer's supply is too weak at this moment", "a 5 V supply of 3 A and more, a short thick cable"
    ),
    "under-voltage before": _doubt(
        "this computer's supply broke down since it was started",
        "supply the motors by a line of their own; a 5 V supply of 3 A and more, a short thick cable",
    ),
    "too hot": _doubt("this computer is slowed down: it is at {celsius} degrees", "a heat sink, a fan, or less load"),
    "disk nearly full": _doubt("{free_mb} MB are free here", "recordings will end early: delete old ones"),
    # -------------------------------------------------------------------------------------- the config
    "config wrong": Fault("{words}", "", CONFIG),
    "one port twice": Fault(
        "{path} is the port of {names} alike", "give each its own `port`; `ls -l /dev/serial/by-id` names them", CONFIG
    ),
    "one address twice": Fault(
        "{path} has {names} at the same address {address}",
        "set another `address` (by the board's solder bridges), or use another bus",
        CONFIG,
    ),
    # --------------------------------------------------------------------------------- ports and files
    "port absent": Fault(
        "serial port {path} does not exist",
        "plug it in; `dmesg | tail` says whether the machine noticed{or_here}",
    ),
    "no port fits": Fault(
        "no serial port fits {path}",
        "plug it in; `dmesg | tail` says whether the machine noticed{or_here}",
    ),
    "several ports fit": Fault("{count} serial ports fit {path}", "write which one: {paths}", CONFIG),
    "bus absent": Fault(
        "I2C bus {path} does not exist",
        "switch the bus on (Raspberry Pi: `sudo raspi-config`, Interface Options; "
        "else `sudo modprobe i2c-dev`){or_here}",
    ),
    "camera absent": Fault("camera {path} does not exist", "plug it in, or correct the path{or_here}"),
    "input absent": Fault(
        "input device {path} does not exist",
        "plug the pad in or switch it on; `ls /dev/input/by-id` names what is there{or_here}",
    ),
    "file absent": Fault(
        "file {path} does not exist",
        "correct the path in the config; a relative one counts from the config's folder",
    ),
    "wrong sort": Fault("{path} is {sort}, not {wanted}", _CORRECT, CONFIG),
    "no pictures": Fault("{path} holds no pictures", "put some there ({known})"),
    "file empty": Fault("{path} is empty", "copy or download it again"),
    "file is a pointer": Fault(
        "{path} is a pointer of Git LFS, not the file itself", "git lfs install && git lfs pull, then copy it again"
    ),
    "file unreadable": Fault("user {user} may not read {path}", "give read permission: chmod a+r {path}", PERMISSION),
    "not in the group": Fault(
        "user {user} may not use {path}", "sudo usermod -aG {group} {user}, then log out and in again", PERMISSION
    ),
    "group not in effect": Fault(
        "user {user} may not use {path}",
        "{user} joined the group {group} after this login: log out and in again",
        PERMISSION,
    ),
    "group may not write": Fault(
        "user {user} may not use {path}",
        "the group {group} may not write it either: sudo chmod g+rw {path} (or a udev rule, `robotd udev`)",
        PERMISSION,
    ),
    "root alone": Fault(
        "user {user} may not use {path}",
        "it belongs to root alone: a udev rule must give {path} to a group such as dialout (`robotd udev`)",
        PERMISSION,
    ),
    "port busy": Fault("{path} is in use by {who}", "end it: kill {pids}", TEMPORARY),
    "camera busy": _doubt("{path} is in use by {who}", "where no picture comes, end it: kill {pids}"),
    "console on port": Fault(
        "the system's console writes to {path}",
        "take `console={tty},...` out of the kernel's command line (`sudo raspi-config`, Interface Options, "
        "Serial Port), then restart",
    ),
    "modem manager": _doubt(
        "ModemManager runs; it speaks to new serial adapters as if they were modems",
        "sudo apt purge modemmanager, or install the rules of `robotd udev`",
    ),
    "braille display": _doubt(
        "brltty runs; it takes some serial adapters for a braille display and disconnects them",
        "sudo apt purge brltty, or install the rules of `robotd udev`",
    ),
    "slow adapter": _doubt(
        "{path} holds bytes back for {ms} ms", "install the rules of `robotd udev`, which set latency_timer to 1"
    ),
    "name may change": Fault("{path} may be another device after a replug", "write port: {lasting}", level="note"),
    "address wrong": Fault("{path} is no valid address", _CORRECT, CONFIG),
    "host silent": Fault("{host}:{port} does not answer: {why}", "is it switched on, and does `ping {host}` answer?"),
    # ------------------------------------------------------------------------------------ when opening
    "no answer": _opening(
        "{words}", "supply and ground of the device; TX to RX and RX to TX; its page in docs/devices"
    ),
    "no byte": _opening(
        "{words}", "supply at the device itself, common ground, its TX on our RX; a scanner that turns has its supply"
    ),
    "bytes of something else": _opening(
        "{words}", "the right `baud` and the right `port`; another model than `use:` says?"
    ),
    "does not turn": _opening(
        "{words}", "is it blocked? Measure its 5 V while it starts; a USB hub with its own supply, a shorter cable"
    ),
    "health error": _opening(
        "{words}", "let the head turn freely and give it a strong 5 V; where it stays, the device is broken"
    ),
    "no chip": _opening("{words}", "supply of the board; `i2cdetect -y BUS` shows the addresses that answer"),
    "bus stuck": _opening(
        "{words}", "switch the board off and on; pull-ups, short wires, no two boards on one address"
    ),
    "another chip": _opening("{words}", "correct `address`; `i2cdetect -y BUS` shows the addresses that answer"),
    "settings lost": _opening(
        "{words}", "the supply broke down, usually as the motors start: a larger capacitor, a charged battery"
    ),
    "does not start": _opening("{words}", "switch it off and on; a stronger supply; where it stays, it is broken"),
    "no picture": _opening("{words}", "unplug it, plug it in again; does another program show its picture?"),
    "taken meanwhile": _opening("{words}", "end the other program; `sudo fuser -v PORT` names it", TEMPORARY),
    "not allowed": _opening("{words}", "`robotd doctor FILE` without --probe says which group to join", PERMISSION),
    "cannot be so": _opening("{words}", "correct the config; the device's page in docs/devices has the keys", CONFIG),
    "cannot open": _opening("{words}", "the device's page in docs/devices"),
    "opens too slowly": _opening("did not open within {limit_s} s", "switch the device off and on"),
    "driver broken": _opening("its driver failed: {words}", "a fault of the driver: report it to its author", INTERNAL),
    "undeclared message": _opening(
        "its driver published {kind}, it declares {declared}",
        "a fault of the driver: report it to its author",
        INTERNAL,
    ),
    "closes too slowly": _opening_doubt(
        "took {close_s:.1f} s to close, 0.2 s are allowed", "a fault of the driver: report it to its author"
    ),
    "ports swapped": _opening(
        "silent on {path}, but it answers on {other}, the port of {owner}",
        "swap `port` of {name} and {owner} in the config (or their cables)",
        CONFIG,
    ),
    "on another port": _opening("silent on {path}, but it answers on {other}", "write port: {other}", CONFIG),
    "other baud": _opening("silent at {baud} baud, but it answers at {other}", "write baud: {other}", CONFIG),
    # --------------------------------------------------------------------------------- while it is open
    "silent": _opening(
        "open, but no message within {watched_s:.1f} s", "its supply, and whether it is the device that `use:` names"
    ),
    "quiet": _opening(
        "no message within {watched_s:.1f} s", "good where it speaks only when something changes", OK, "note"
    ),
    "lost again": _opening("lost after {watched_s:.1f} s: {words}", "cable and plug; a USB hub with its own supply"),
    "too few": _opening_doubt(
        "{kind} at {hz:.1f} Hz, {wanted_hz:.1f} Hz are expected",
        "a lower baud, a weak supply, or a busy computer (`top`)",
    ),
    "pauses": _opening_doubt(
        "{kind}: {gap_s:.2f} s without one, {period_s:.2f} s are expected", "cable; a busy computer (`top`)"
    ),
    "old when they come": _opening_doubt(
        "{kind} is {age_s:.2f} s old when it comes", "a buffer before us: fewer pictures, low latency (`robotd udev`)"
    ),
    "from the future": _opening(
        "{kind} is stamped {ahead_s:.3f} s in the future", "a fault of the driver: report it to its author", INTERNAL
    ),
    "bad bytes": _opening_doubt(
        "{count} times `{name}`{or_detail}", "cable away from the motors' wires, common ground; nobody else on the port"
    ),
    "weak supply": _opening_doubt(
        "{count} times `{name}`{or_detail}", "measure its 5 V while it runs; a shorter cable"
    ),
    "turns wrongly": _opening_doubt(
        "{count} times `{name}`{or_detail}", "something in its way, a weak supply, or another `rotation_hz`"
    ),
    "warns of itself": _opening_doubt(
        "{count} times `{name}`{or_detail}", "let the head turn freely, clean its window, give it a strong 5 V"
    ),
    "falls behind": _opening_doubt("{count} times `{name}`{or_detail}", "less load (`top`), less heat"),
    "controller complains": _opening_doubt(
        "{count} times `{name}`{or_detail}", "switch it off and on; its page in docs"
    ),
    "weak battery": _opening_doubt("{count} times `{name}`{or_detail}", "charge it before the robot drives"),
    "runs hot": _opening_doubt("{count} times `{name}`{or_detail}", "let it cool down; less load, more air"),
    "beyond the range": _opening_doubt(
        "{count} times `{name}`{or_detail}", "a wider range in the config, where the sensor has one"
    ),
    "picture black at times": _opening_doubt("{count} times `{name}`{or_detail}", "light, lens cap, exposure"),
    "picture repeated": _opening_doubt(
        "{count} times `{name}`{or_detail}", "unplug it, plug it in; `frozen_s: 0` where the source may repeat itself"
    ),
    "picture spoilt": _opening_doubt(
        "{count} times `{name}`{or_detail}", "cable, hub or network; a smaller picture or a lower `rate_hz`; the file"
    ),
    "wheels disagree": _opening_doubt(
        "{count} times `{name}`{or_detail}", "a stuck wheel, one off the ground, or an encoder's plug"
    ),
    "command refused": _opening_doubt(
        "{count} times `{name}`{or_detail}", "a behaviour asks for what this base cannot do: its page in docs/devices"
    ),
    "moved while zeroing": _opening_doubt(
        "{count} times `{name}`{or_detail}", "let the robot stand still while it starts"
    ),
    "pad out of reach": _opening_doubt(
        "{count} times `{name}`{or_detail}", "charge the pad, stay nearer; `idle_s` says how long it may be silent"
    ),
    "other fault": _opening_doubt("{count} times `{name}`{or_detail}", "the device's page in docs/devices"),
    "nothing measured": _opening(
        "no beam of any scan was measured", "take off the cover, clean the window; sunlight blinds it"
    ),
    "no return": _opening_doubt(
        "no beam of any scan returned", "good only in the open; else the cover, the window, `range_max_m`"
    ),
    "something touches": _opening_doubt(
        "{share:.0%} of the beams end nearer than {least_m:.2f} m",
        "the robot's own parts in its view; `mounts`, height",
    ),
    "picture black": _opening("the pictures are black", "lens cap, light, exposure, a privacy shutter"),
    "picture white": _opening_doubt("the pictures are white", "less exposure or light; no lamp into the lens"),
    "picture empty": _opening_doubt("the pictures are one even grey", "lens cap, focus, or a wrong pixel format"),
    "stands still": _opening_doubt(
        "{kind} repeats itself to the last bit", "good for a fake or a single picture; else it hangs: unplug it"
    ),
    "battery low": _opening_doubt("the battery is at {charge:.0%}", "charge it before the robot drives"),
    "battery absent": _opening("{volts:.1f} V where the battery should be", "is its wire on, is the switch on?"),
    "imu mute": _opening("no axis of the IMU has a value", "its wiring and address"),
    "imu off": _opening_doubt(
        "the IMU at rest feels {felt:.1f} m/s2 instead of 9.8", "leave the robot still; range or scale of the sensor"
    ),
    "imu upside down": _opening_doubt("the IMU feels the floor above it", "turn it, or say so in `mounts` (roll_rad)"),
    "imu turns": _opening_doubt(
        "the IMU at rest turns at {rate:.2f} rad/s", "leave the robot still; calibrate its bias"
    ),
    "odometry drifts": _opening_doubt(
        "stopped, but its odometry moves at {mps:.2f} m/s", "does a wheel turn? Encoder wires and supply"
    ),
    "bumper pressed": _opening_doubt(
        "`{where}` is pressed", "free it; where nothing presses, its switch or `inverted`"
    ),
    "no watchdog": _opening(
        "nothing stops the motors when this computer dies", "a hardware switch within reach; docs/safety.md", OK, "note"
    ),
}


def found(fault: str, subject: str, /, *, mend: str = "", **facts: object) -> Finding:
    """The finding that a row of the table makes of these facts. mend: a better one than the table's, where known."""
    row = FAULTS[fault]
    code = row.code if row.level == "error" else OK
    return Finding(row.level, subject, row.cause.format(**facts), mend or row.mend.format(**facts), code, fault)
