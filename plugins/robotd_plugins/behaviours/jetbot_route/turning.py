"""A turn on the spot, closed by odometry and ended by the new line; never by time."""

from __future__ import annotations

import math
from dataclasses import dataclass

from robotd import Drive

_AIMED_RAD = 0.04
_GAIN_PS = 3.0
_SLOWEST_RADPS = 0.35
_STEADY_LOOKS = 2


@dataclass(frozen=True, slots=True)
class TurnSettings:
    """angle_rad: the turn by odometry, counter-clockwise positive. slack_rad: the new line may be this far from it.
    speed_radps: fastest. accept_rad: a line is the new one only within this of where it is expected."""

    angle_rad: float
    slack_rad: float
    speed_radps: float
    accept_rad: float


class Turning:
    """One turn. `turned` goes to True over the new line, to False where there is none within the slack on either side.

    Angles count from the turn's beginning, by odometry. Where the line is seen, it is the aim; until then the aim is
    the end of the slack beyond the angle, then the end before it.
    """

    def __init__(self, settings: TurnSettings, begun_rad: float) -> None:
        self.settings = settings
        self.turned: bool | None = None
        self._begun_rad = begun_rad
        sign = math.copysign(1.0, settings.angle_rad)
        self._aims = [settings.angle_rad + sign * settings.slack_rad, settings.angle_rad - sign * settings.slack_rad]
        self._seen_rad = math.nan
        self._looks = 0
        self._at_rad = 0.0

    @property
    def left_rad(self) -> float:
        """What is left of the turn, as far as it is known."""
        aim_rad = self.settings.angle_rad if math.isnan(self._seen_rad) else self._seen_rad
        return aim_rad - self._at_rad

    def look(self, at_rad: float, line_rad: float) -> None:
        """A picture showed a line in direction `line_rad` in base when odometry's sum of turns was `at_rad`."""
        settings, seen_rad = self.settings, at_rad - self._begun_rad + line_rad
        if abs(seen_rad - settings.angle_rad) > settings.accept_rad:
            return
        same = not math.isnan(self._seen_rad) and abs(seen_rad - self._seen_rad) <= settings.accept_rad / 2.0
        self._looks = self._looks + 1 if same else 1
        self._seen_rad = seen_rad

    def command(self, at_rad: float) -> Drive:
        """The next command; stands still once the turn has ended. at_rad: odometry's sum of turns."""
        self._at_rad = at_rad - self._begun_rad
        if self.turned is not None:
            return Drive()
        if self._looks >= _STEADY_LOOKS:
            if abs(self.left_rad) <= _AIMED_RAD:
                self.turned = True
                return Drive()
            return self._turn(self.left_rad)
        while self._aims and self._passed(self._aims[0]):
            self._aims.pop(0)
        if not self._aims:
            self.turned = False
            return Drive()
        off_rad = self._aims[0] - self._at_rad
        # beyond the angle itself it looks for the line, slowly
        searching = len(self._aims) == 1 or abs(off_rad) <= self.settings.slack_rad
        return self._turn(off_rad, _SLOWEST_RADPS * 2.0 if searching else self.settings.speed_radps)

    def _passed(self, aim_rad: float) -> bool:
        return abs(aim_rad - self._at_rad) <= _AIMED_RAD

    def _turn(self, off_rad: float, fastest_radps: float = math.inf) -> Drive:
        speed = min(max(_GAIN_PS * abs(off_rad), _SLOWEST_RADPS), self.settings.speed_radps, fastest_radps)
        return Drive(wz_radps=math.copysign(speed, off_rad))
