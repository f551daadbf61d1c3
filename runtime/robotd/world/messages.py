"""What flows: frozen messages, each stamped with when it was true, and the commands that answer them.

REP-103 everywhere: x forward, y left, counter-clockwise positive, metres, radians, seconds.
`stamp_ns` is on the clock of the event loop; for a sweep it is the end of the sweep.
Arrays are read-only: a message is shared by reference with everything that reads it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, ClassVar, TypeAlias

import numpy as np
from numpy.typing import NDArray

Float32s: TypeAlias = NDArray[np.float32]
Float64s: TypeAlias = NDArray[np.float64]
Bytes2D: TypeAlias = NDArray[np.uint8]


def read_only(array: NDArray[Any]) -> NDArray[Any]:
    """The same array with writing switched off; a base that others may still write is copied first."""
    if array.flags.writeable:
        if array.base is not None:
            array = array.copy()
        array.flags.writeable = False
    return array


@dataclass(frozen=True, slots=True)
class Message:
    """The root of everything that flows. `stamp_ns`: when it was true, not when it was sent."""

    stamp_ns: int

    #: True for topics that hold until replaced (mode, goal): they have no age.
    is_state: ClassVar[bool] = False


@dataclass(frozen=True, slots=True)
class Event(Message):
    """A message that must not be lost: it travels a bounded queue whose overflow is an alarm."""


# --------------------------------------------------------------------------------------------- sensors


@dataclass(frozen=True, slots=True, eq=False)
class LidarScan(Message):
    """One revolution (or one sweep) of a planar lidar.

    ranges_m: float32 (n,), `inf` = nothing within range, `nan` = not measured, below `range_min_m` = touching.
    angles_rad: float32 (n,), bearing of each beam in the lidar's own frame, counter-clockwise, 0 = its x axis.
    stamp_ns: end of the sweep; `start_ns`: its beginning (beam i at start + (end - start) * i / (n - 1) unless
    `beam_ns` says otherwise). x_m, y_m, yaw_rad: the lidar seen in base, so that a reader needs no config.
    intensities: uint8 (n,) or None.
    """

    ranges_m: Float32s
    angles_rad: Float32s
    start_ns: int = 0
    range_min_m: float = 0.0
    range_max_m: float = math.inf
    x_m: float = 0.0
    y_m: float = 0.0
    yaw_rad: float = 0.0
    intensities: NDArray[np.uint8] | None = None
    beam_ns: NDArray[np.int64] | None = None

    def __post_init__(self) -> None:
        ranges, angles = self.ranges_m, self.angles_rad
        if ranges.ndim != 1 or ranges.shape != angles.shape:
            raise ValueError(f"ranges_m {ranges.shape} and angles_rad {angles.shape} must be one-dimensional and equal")
        if ranges.dtype != np.float32 or angles.dtype != np.float32:
            raise ValueError(f"ranges_m and angles_rad must be float32, not {ranges.dtype} and {angles.dtype}")
        if ranges.flags.writeable:
            object.__setattr__(self, "ranges_m", read_only(ranges))
        if angles.flags.writeable:
            object.__setattr__(self, "angles_rad", read_only(angles))


@dataclass(frozen=True, slots=True, eq=False)
class CameraFrame(Message):
    """One picture. `bgr`: uint8 (height, width, 3), read-only, passed by reference; perceptors only.

    stamp_ns: middle of the exposure as well as the source can tell. `sequence` counts frames of the source, so that
    a gap shows. `source` names the picture (file name, device) for people.
    """

    bgr: Bytes2D
    sequence: int = 0
    source: str = ""

    def __post_init__(self) -> None:
        if self.bgr.ndim != 3 or self.bgr.shape[2] != 3 or self.bgr.dtype != np.uint8:
            raise ValueError(f"bgr must be uint8 (height, width, 3), not {self.bgr.dtype} {self.bgr.shape}")
        if self.bgr.flags.writeable:
            object.__setattr__(self, "bgr", read_only(self.bgr))


@dataclass(frozen=True, slots=True)
class Odometry(Message):
    """Base seen in the odometry frame (REP-105), and the base's own velocity in its own frame."""

    x_m: float
    y_m: float
    yaw_rad: float
    vx_mps: float = 0.0
    vy_mps: float = 0.0
    wz_radps: float = 0.0


@dataclass(frozen=True, slots=True)
class Pose2D(Message):
    """A pose of the base in `frame` ('map' unless said otherwise)."""

    x_m: float
    y_m: float
    yaw_rad: float
    frame: str = "map"


@dataclass(frozen=True, slots=True)
class Target(Message):
    """Something to follow, in the base frame. `range_m` is nan where unknown, never invented."""

    bearing_rad: float
    range_m: float = math.nan
    bearing_std_rad: float = math.nan
    range_std_m: float = math.nan
    track_id: int = 0
    confidence: float = 1.0


@dataclass(frozen=True, slots=True)
class Detection:
    """One thing seen in a picture; the box is in pixels of that picture (left, top, right, bottom)."""

    name: str
    score: float
    left_px: float
    top_px: float
    right_px: float
    bottom_px: float


@dataclass(frozen=True, slots=True)
class Detections(Message):
    """All that one detector saw in one picture of `width_px` x `height_px`."""

    items: tuple[Detection, ...] = ()
    width_px: int = 0
    height_px: int = 0


@dataclass(frozen=True, slots=True)
class Imu(Message):
    """Angular velocity and specific force in the base frame; nan where the sensor has no such axis."""

    wx_radps: float = math.nan
    wy_radps: float = math.nan
    wz_radps: float = math.nan
    ax_mps2: float = math.nan
    ay_mps2: float = math.nan
    az_mps2: float = math.nan


@dataclass(frozen=True, slots=True)
class Battery(Message):
    """Pack voltage and current (positive = discharging); `charge` 0..1, nan where unknown; `low`: charge it now."""

    voltage_v: float
    current_a: float = math.nan
    charge: float = math.nan
    low: bool = False


@dataclass(frozen=True, slots=True)
class Contact(Message):
    """A bumper or a dock contact. `where` is the name that the config gives the switch."""

    closed: bool
    where: str = "bumper"


@dataclass(frozen=True, slots=True)
class Gamepad(Message):
    """A gamepad's state, said again and again while nothing changes.

    axes: by the kernel's names (x, y, rx, ry, z, rz, hat0x, ...); -1 to 1, to the right and towards the person
    positive; triggers 0 to 1. buttons: names of those held now. presses: how often each was pressed so far, so that a
    short press is not lost between two messages. deadman: the dead-man's button is held, and the pad is alive.
    """

    axes: tuple[tuple[str, float], ...] = ()
    buttons: tuple[str, ...] = ()
    presses: tuple[tuple[str, int], ...] = ()
    deadman: bool = False

    def axis(self, name: str) -> float:
        """The position of one axis; 0 where the pad has no such axis, or it was not moved yet."""
        return dict(self.axes).get(name, 0.0)


# -------------------------------------------------------------------------------------------- commands


@dataclass(frozen=True, slots=True)
class Drive:
    """A velocity of the base in its own frame. `vy_mps` needs a holonomic base."""

    vx_mps: float = 0.0
    wz_radps: float = 0.0
    vy_mps: float = 0.0

    @property
    def is_finite(self) -> bool:
        """Whether all its numbers are."""
        return math.isfinite(self.vx_mps + self.wz_radps + self.vy_mps)


@dataclass(frozen=True, slots=True)
class Steer:
    """A car's command: speed of the rear axle's middle and front wheel angle, left positive."""

    speed_mps: float = 0.0
    steering_rad: float = 0.0

    @property
    def is_finite(self) -> bool:
        """Whether both its numbers are."""
        return math.isfinite(self.speed_mps + self.steering_rad)


Command: TypeAlias = Drive | Steer
STOP = Drive()


# ------------------------------------------------------------------- what comes back from the way down


class Mode(Enum):
    """Who may move the robot. The order is the order of authority, the strongest first."""

    ESTOP = "estop"
    DISARMED = "disarmed"
    MANUAL = "manual"
    PAUSED = "paused"
    AUTO = "auto"


@dataclass(frozen=True, slots=True)
class ModeChange(Message):
    """The operator's state, a topic that holds until replaced."""

    mode: Mode
    reason: str = ""
    is_state: ClassVar[bool] = True


@dataclass(frozen=True, slots=True)
class ActiveGoal(Message):
    """The goal that a behaviour works on now, a topic that holds until replaced; empty `behaviour`: none."""

    behaviour: str = ""
    goal: object = None
    is_state: ClassVar[bool] = True


@dataclass(frozen=True, slots=True)
class Applied(Message):
    """The command last written to the base, who proposed it and what limited it."""

    command: Command = field(default=STOP)
    by: str = ""
    limited_by: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Outcome(Event):
    """How a goal ended: SUCCEEDED, FAILED or CANCELLED, with the reason."""

    behaviour: str
    result: str
    reason: str = ""


@dataclass(frozen=True, slots=True)
class BatteryLow(Event):
    """A pack became low: `device` measures it. `charge` 0..1, nan where unknown."""

    device: str
    voltage_v: float
    charge: float = math.nan


@dataclass(frozen=True, slots=True)
class EStopped(Event):
    """The e-stop was tripped by `source`; it stays latched until reset."""

    source: str
    reason: str = ""
