"""What is said with an RPLIDAR, without input or output: who are you, are you well, turn, scan.

Conversations are generators of the steps of `dialogue`.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import cast, get_args

from robotd.authoring.device import DeviceMisconfigured, DeviceUnavailable
from robotd_devices.lidar import rplidar_wire as wire
from robotd_devices.lidar.dialogue import Ask, Dtr, Pause, Quiet, Repeat, Say, Start, Talk, Warn
from robotd_devices.lidar.rplidar_capsules import FORMATS
from robotd_devices.lidar.rplidar_hq import HQ
from robotd_devices.lidar.rplidar_models import (
    EXPRESS_FIRMWARE,
    EXPRESS_SAMPLE_US,
    STANDARD_SAMPLE_US,
    Motor,
    ScanMode,
    has_conf,
    has_rpm_motor,
    may_have_pwm_board,
    name_of,
    turns_by_itself,
)

STANDARD_ANSWER = 0x81
CHECKED_ANSWERS = (*FORMATS, HQ)
"""Types of data that carry a checksum."""

_BOARD_S = 0.5
_BOOT_S, _BOOT_QUIET_S = 2.0, 0.3
_SCAN_S = 1.5


@dataclass(frozen=True, slots=True)
class Wishes:
    """What the config asks for. mode: `auto`, `standard`, or a mode's name; motor: `auto` or a kind."""

    mode: str = "auto"
    motor: Motor | str = "auto"
    pwm: int = wire.DEFAULT_PWM
    rpm: int = 600


@dataclass(frozen=True, slots=True)
class Scanning:
    """How it scans now."""

    info: wire.Info
    mode: ScanMode
    motor: Motor


def hello() -> Talk[wire.Info | None]:
    """Stop whatever it does and ask who it is; None where nothing answers (at this speed of the line)."""
    yield Say(wire.request(wire.STOP))
    yield Quiet(within_s=0.3)
    for _ in range(2):
        answer = yield Ask(wire.request(wire.GET_INFO), wire.INFO, within_s=0.15)
        if answer is not None and len(answer) == 20:
            return wire.decode_info(answer)
    return None


def measure_speed() -> Talk[int | None]:
    """Let the device measure the speed of this line; what it measured, in baud, or None where it cannot.

    The port is to be opened anew then, for `settle`.
    """
    yield Say(wire.request(wire.STOP))
    yield Quiet(within_s=0.3)
    answer = yield Repeat(wire.MEASURE_ME, 4)
    return None if answer is None else int.from_bytes(answer, "little")


def settle(baud: int) -> Talk[None]:
    """On a port that was opened anew: stay at the speed that was measured."""
    yield Quiet(0.02, within_s=0.1)
    yield Say(wire.confirm_baud(baud))
    yield Pause(0.01)


def get_ready(info: wire.Info, wishes: Wishes) -> Talk[Scanning]:
    """Is it well, and how is it to scan? Nothing moves yet. Raises DeviceUnavailable or DeviceMisconfigured."""
    yield from check_health(info)
    mode = yield from choose_mode(info, wishes.mode)
    motor = yield from choose_motor(info, wishes.motor)
    return Scanning(info, mode, motor)


def begin(scanning: Scanning, wishes: Wishes) -> Talk[None]:
    """The motor turns and the scan runs. Raises DeviceUnavailable where it does not; then the motor may turn."""
    yield from turn(scanning.motor, wishes)
    yield from scan(scanning.info, scanning.mode)


def check_health(info: wire.Info) -> Talk[None]:
    """Warn of a warning; lead it out of its protection stop by one reset, else raise DeviceUnavailable."""
    for attempt in ("first", "after a reset"):
        answer = yield Ask(wire.request(wire.GET_HEALTH), wire.HEALTH)
        if answer is None or len(answer) != 3:
            raise DeviceUnavailable(f"{name_of(info)} does not say whether it is well: is its supply strong enough?")
        health = wire.decode_health(answer)
        if health.status == 1:
            yield Warn("health warning", f"code {health.code:#06x}")
        if health.status != 2:
            return
        if attempt == "first":
            yield Warn("protection stop", f"code {health.code:#06x}: it is reset once")
            yield from reset()
    raise DeviceUnavailable(
        f"{name_of(info)} is in its protection stop, code {health.code:#06x}, also after a reset: "
        "does the head turn freely, is the supply at least 5 V at its plug?"
    )


def reset() -> Talk[None]:
    """Reset, wait until it has booted and its boot text is through."""
    yield Say(wire.request(wire.RESET))
    yield Pause(_BOOT_QUIET_S)
    yield Quiet(_BOOT_QUIET_S, _BOOT_S)


def choose_mode(info: wire.Info, wish: str) -> Talk[ScanMode]:
    """The wished scan mode; for `auto` the device's own choice, or a better one where that has no checksum."""
    if not has_conf(info):
        return (yield from _mode_without_table(info, wish))
    count = yield from _entry(wire.MODE_COUNT, None, "<H")
    typical = yield from _entry(wire.MODE_TYPICAL, None, "<H")
    if count is None or typical is None:
        return (yield from _mode_without_table(info, wish))
    modes: list[ScanMode] = []
    if wish == "auto":
        mode = yield from _mode(typical)
        if mode is not None and mode.answer in CHECKED_ANSWERS:
            return mode
    for number in range(count):
        mode = yield from _mode(number)
        if mode is not None:
            modes.append(mode)
    known = [mode for mode in modes if mode.answer in CHECKED_ANSWERS]
    standard = [mode for mode in modes if mode.answer == STANDARD_ANSWER]
    if wish == "auto":
        found = known[-1:] or standard[:1]
    elif wish == "standard":
        found = standard[:1]
    else:
        found = [mode for mode in [*known, *standard] if mode.name.lower() == wish.lower()]
    if found:
        return found[0]
    names = ", ".join(mode.name for mode in [*standard, *known]) or "none"
    raise DeviceMisconfigured(f"{name_of(info)} has no scan mode `{wish}` that can be read; it has: {names}")


def _mode_without_table(info: wire.Info, wish: str) -> Talk[ScanMode]:
    standard_us, express_us = STANDARD_SAMPLE_US, EXPRESS_SAMPLE_US
    answer = yield Ask(wire.request(wire.GET_SAMPLE_RATE), wire.SAMPLE_RATE)
    if answer is not None and len(answer) == 4:
        standard_us, express_us = (float(us) for us in struct.unpack("<HH", answer))
    has_express = info.firmware >= EXPRESS_FIRMWARE
    if wish.lower() == "standard" or (wish == "auto" and not has_express):
        return ScanMode(None, "Standard", STANDARD_ANSWER, standard_us)
    if wish.lower() in ("auto", "express") and has_express:
        return ScanMode(0, "Express", 0x82, express_us)
    raise DeviceMisconfigured(
        f"{name_of(info)} has no scan mode `{wish}`; it has: Standard" + (", Express" if has_express else "")
    )


def _entry(entry: int, mode: int | None, form: str) -> Talk[int | None]:
    answer = yield Ask(wire.conf(entry, mode), wire.CONF)
    size = 4 + struct.calcsize(form)
    if answer is None or len(answer) < size or int.from_bytes(answer[:4], "little") != entry:
        return None
    return int(struct.unpack_from(form, answer, 4)[0])


def _mode(number: int) -> Talk[ScanMode | None]:
    answer = yield from _entry(wire.MODE_ANSWER, number, "<B")
    sample_q8 = yield from _entry(wire.MODE_US_PER_SAMPLE, number, "<I")
    distance_q8 = yield from _entry(wire.MODE_MAX_DISTANCE, number, "<I")
    name = yield Ask(wire.conf(wire.MODE_NAME, number), wire.CONF)
    if answer is None or not sample_q8:
        return None
    text = name[4:].split(b"\0")[0].decode("ascii", "replace") if name else str(number)
    return ScanMode(number, text, answer, sample_q8 / 256.0, (distance_q8 or 0) / 256.0)


def choose_motor(info: wire.Info, wish: Motor | str) -> Talk[Motor]:
    """How the motor is driven: as wished, else by the vendor's rule."""
    if wish in get_args(Motor):
        return cast(Motor, wish)
    if has_rpm_motor(info):
        return "rpm"
    if turns_by_itself(info):
        return "none"
    if not may_have_pwm_board(info):
        return "dtr"
    flag = yield Ask(wire.request(wire.GET_BOARD_FLAG, bytes(4)), wire.BOARD_FLAG, within_s=_BOARD_S)
    return "pwm" if flag and flag[0] & 1 else "dtr"


def turn(motor: Motor, wishes: Wishes) -> Talk[None]:
    """Let the motor run. The line is cleared for all but `none`: raised, it stops the motor of an A1, A2 or A3."""
    if motor != "none":
        yield Dtr(False)
    if motor == "pwm":
        yield Say(wire.motor_pwm(wishes.pwm))
    elif motor == "rpm":
        yield Say(wire.motor_rpm(wishes.rpm))


def stop_commands(motor: Motor) -> bytes:
    """What ends the scan and stops the motor, to be written on the way out; DTR is raised beside it."""
    halt = {"pwm": wire.motor_pwm(0), "rpm": wire.motor_rpm(0)}.get(motor, b"")
    return wire.request(wire.STOP) + halt


def scan(info: wire.Info, mode: ScanMode, within_s: float = _SCAN_S) -> Talk[None]:
    """Start the scan; raises DeviceUnavailable where no stream of the mode's type begins."""
    standard = mode.answer == STANDARD_ANSWER
    start = wire.request(wire.SCAN) if standard else wire.express_scan(mode.number or 0)
    for _ in range(2):
        descriptor = yield Start(start, within_s)
        if descriptor is not None and descriptor.kind == mode.answer:
            return
        yield Say(wire.request(wire.STOP))
        yield Quiet()
    heard = f"it began to send type {descriptor.kind:#04x}" if descriptor is not None else "it does not answer"
    raise DeviceUnavailable(f"{name_of(info)} does not begin its scan `{mode.name}`: {heard}")


def again(scanning: Scanning, wishes: Wishes, *, motor_too: bool) -> Talk[None]:
    """A scan that ran dry begins anew; with `motor_too` the motor is off for half a second first."""
    yield Say(stop_commands(scanning.motor) if motor_too else wire.request(wire.STOP))
    if motor_too:
        if scanning.motor == "dtr":
            yield Dtr(True)
        yield Pause(0.5)
    yield Quiet(within_s=0.3)
    # also where it was not stopped: after a brown-out it has forgotten
    yield from turn(scanning.motor, wishes)
    yield from scan(scanning.info, scanning.mode, within_s=0.4)


def anew(wishes: Wishes) -> Talk[Scanning]:
    """Reset it and begin as after power-on. Raises DeviceUnavailable where it does not come back."""
    yield from reset()
    info = yield from hello()
    if info is None:
        raise DeviceUnavailable("it does not answer after a reset")
    scanning = yield from get_ready(info, wishes)
    yield from begin(scanning, wishes)
    return scanning
