"""From a velocity to the registers of a JetBot's motor board and back: pure functions, no bus and no clock.

The registers for a value between -1 and 1 are those of NVIDIA's library `jetbot` (MIT), which gives positive values to
the bridge as its "backward": JetBots are wired that way round. The order of writes is our own (see `plan`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from robotd.world.kinematics import Differential
from robotd.world.messages import Drive
from robotd_devices.motor.pca9685 import OFF, ON, Level, all_off, level_writes
from robotd_devices.ports.i2c_bus import I2cWrite

FULL_SPEED = 255
"""The library's motors have 255 speeds, each 16 counts of the chip."""
_COUNTS = 16


class Speeds(NamedTuple):
    """What each wheel is told, -255 to 255, positive forward."""

    left: int = 0
    right: int = 0


class Bridge(NamedTuple):
    """Channels of a motor bridge with its own PWM input: the Adafruit Motor HAT, and boards like it."""

    pwm: int
    in1: int
    in2: int


class Inputs(NamedTuple):
    """Channels of a bridge whose two inputs take the PWM themselves: the Waveshare JetBot board."""

    ina: int
    inb: int


Outputs = Bridge | Inputs
WIRINGS: Mapping[str, tuple[tuple[Outputs, ...], tuple[Outputs, ...]]] = {
    "adafruit": ((Bridge(8, 10, 9),), (Bridge(13, 11, 12),)),
    "waveshare": ((Inputs(1, 0),), (Inputs(2, 3),)),
    # NVIDIA's library always writes both, and so runs on either board
    "jetbot": ((Bridge(8, 10, 9), Inputs(1, 0)), (Bridge(13, 11, 12), Inputs(2, 3))),
}
"""Outputs of the left and of the right wheel."""


@dataclass(frozen=True, slots=True)
class WheelModel:
    """How fast one wheel turns for the value that it is told.

    Below `dead_band` (0 to 1) it stands; from there its rim speed rises evenly to `top_mps` at 1. `gain`: multiplied
    onto the part above the dead band, as the library's `alpha`. `reversed`: its leads are swapped.
    """

    top_mps: float = 1.0
    dead_band: float = 0.0
    gain: float = 1.0
    reversed: bool = False

    @property
    def fastest_mps(self) -> float:
        """The rim speed at full value."""
        return self.top_mps / self.gain

    def told(self, rim_mps: float) -> int:
        """What to tell the wheel for a rim speed, which is not 0 and at most `fastest_mps`."""
        share = min(1.0, abs(rim_mps) / self.fastest_mps)
        value = self.dead_band + (1.0 - self.dead_band) * share
        # as the library: the fraction is dropped
        speed = int(FULL_SPEED * value)
        return -speed if (rim_mps < 0.0) != self.reversed else speed

    def rim_mps(self, told: int) -> float:
        """The rim speed that a wheel is expected to reach."""
        value = abs(told) / FULL_SPEED
        if told == 0 or value <= self.dead_band:
            return 0.0
        rim_mps = self.fastest_mps * (value - self.dead_band) / (1.0 - self.dead_band)
        return -rim_mps if (told < 0) != self.reversed else rim_mps


@dataclass(frozen=True, slots=True)
class Base:
    """Two wheels and the body between them. `still_mps`: a wheel slower than this is released."""

    body: Differential
    left: WheelModel
    right: WheelModel
    still_mps: float = 0.005

    def speeds(self, drive: Drive) -> Speeds:
        """What to tell the wheels. Too fast a command is slowed down as a whole, so that its curve stays the same."""
        left_mps, right_mps = self.body.rim_speeds(drive)
        over = max(1.0, abs(left_mps) / self.left.fastest_mps, abs(right_mps) / self.right.fastest_mps)
        return Speeds(self._told(self.left, left_mps / over), self._told(self.right, right_mps / over))

    def rims_mps(self, speeds: Speeds) -> tuple[float, float]:
        """Rim speeds that are expected of what was told."""
        return self.left.rim_mps(speeds.left), self.right.rim_mps(speeds.right)

    def _told(self, wheel: WheelModel, rim_mps: float) -> int:
        return wheel.told(rim_mps) if abs(rim_mps) >= self.still_mps else 0


def plan(address: int, wiring: str, before: Speeds | None, wanted: Speeds) -> Sequence[I2cWrite]:
    """The writes that lead from what was written last (None: the stop) to what is wanted.

    A wheel that changes its direction gets PWM 0 first, then its direction, then its PWM: the old duty never drives in
    the new direction. Standing still is the stop itself. Nothing is written where nothing changes.
    """
    before = before or Speeds()
    if wanted == before:
        return ()
    if wanted == Speeds():
        return (all_off(address),)
    quiet: dict[int, Level] = {}
    direction: dict[int, Level] = {}
    duty: dict[int, Level] = {}
    for outputs, old, new in zip(WIRINGS[wiring], before, wanted, strict=True):
        turned = _sign(old) != _sign(new)
        for output in outputs:
            pwm, ways = _levels(output, new)
            if turned:
                if old:
                    quiet.update(dict.fromkeys(pwm, OFF))
                direction.update(ways)
            if new != old:
                duty.update(pwm)
    for channel in [c for c in duty if quiet.get(c) == duty[c]]:
        del duty[channel]
    return [write for levels in (quiet, direction, duty) for write in level_writes(address, levels)]


def _levels(output: Outputs, told: int) -> tuple[dict[int, Level], dict[int, Level]]:
    """Levels of the channels that carry PWM, and of those that only say the direction."""
    speed: Level = (0, abs(told) * _COUNTS) if told else OFF
    if isinstance(output, Inputs):
        return {output.ina: speed if told > 0 else OFF, output.inb: speed if told < 0 else OFF}, {}
    # forward is the library's BACKWARD: in1 off, in2 on
    return {output.pwm: speed}, {output.in1: ON if told < 0 else OFF, output.in2: ON if told > 0 else OFF}


def _sign(told: int) -> int:
    return (told > 0) - (told < 0)
