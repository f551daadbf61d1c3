"""What is known of the RPLIDAR models before one of them has been asked: names, speeds of the line, motors, modes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from robotd_devices.lidar.rplidar_wire import Info

Motor = Literal["dtr", "pwm", "rpm", "none"]

#: Line speeds in the order in which they are tried: A1 and A2M8; A2M7, A2M12, A3, S1; C1; S2, S3.
BAUDS = (115_200, 256_000, 460_800, 1_000_000)

#: From this firmware on (and from the C1 on always) a device has a table of its scan modes to ask.
CONF_FIRMWARE = 0x0118
#: From this firmware on the A1 and A2 know the express scan.
EXPRESS_FIRMWARE = 0x0111
#: Sample times of devices that do not tell theirs.
STANDARD_SAMPLE_US, EXPRESS_SAMPLE_US = 476.0, 238.0

_FAMILIES = {1: "A1", 2: "A2", 3: "A3", 4: "C1", 6: "S1", 7: "S2", 8: "S3", 9: "T1", 12: "M"}
_FIRST_RPM_FAMILY = 6
_PWM_FAMILIES = (2, 3, 5)
_SELF_TURNING_FAMILY = 4


def name_of(info: Info) -> str:
    """`RPLIDAR A1 (model 0x18, firmware 1.29)`."""
    family = _FAMILIES.get(info.family, "of an unknown family")
    return f"RPLIDAR {family} (model {info.model:#04x}, firmware {info.version})"


def may_have_pwm_board(info: Info) -> bool:
    """Whether it makes sense to ask for the accessory board that drives the motor by PWM."""
    return info.family in _PWM_FAMILIES


def turns_by_itself(info: Info) -> bool:
    """Whether the lidar runs its motor without being told (C1; the SDK asks it for a board, which it has not)."""
    return info.family == _SELF_TURNING_FAMILY


def has_rpm_motor(info: Info) -> bool:
    """Whether the motor takes a speed in revolutions a minute."""
    return info.family >= _FIRST_RPM_FAMILY


def has_conf(info: Info) -> bool:
    """Whether the device has a table of its scan modes."""
    return info.family >= 4 or info.firmware >= CONF_FIRMWARE


@dataclass(frozen=True, slots=True)
class ScanMode:
    """One way of scanning. `number` None: the standard scan of devices without a table; `answer`: type of its data."""

    number: int | None
    name: str
    answer: int
    sample_us: float
    max_distance_m: float = 12.0
