"""Holding the car to its line: the line's own curvature, less what brings distance and direction back to it."""

from __future__ import annotations

from dataclasses import dataclass

from robotd_plugins.behaviours.ftg_race.line.on_line import Place, TrackLine


@dataclass(frozen=True, slots=True)
class Tracker:
    """Curvature and speed for a place on the line.

    The place is where the car will be when the command acts. Seen by way driven, the distance from the line then obeys
    e'' + 2 zeta e' / L + e / L^2 = 0: it decays over L = `pull_m` + speed `pull_s`, whatever the speed (lateral control
    by way instead of time, as in Hellstrom, Ringdahl, Follow the Past, 2006, and pure pursuit's gain 2 / L^2).
    """

    pull_m: float = 0.55
    pull_s: float = 0.11
    damping: float = 0.7
    most_m: float = 0.15
    """A greater distance pulls no more, so that a car far from the line comes back at a gentle angle."""
    lead_s: float = 0.02
    """The line's curvature and speed are taken so far ahead of the place."""

    def curvature_pm(self, line: TrackLine, place: Place, speed_mps: float) -> float:
        """Of the way to steer, left positive."""
        reach = self._reach_m(speed_mps)
        aside_m = min(max(place.aside_m, -self.most_m), self.most_m)
        back = -aside_m / (reach * reach) - 2.0 * self.damping * place.turned_rad / reach
        return line.curvature_pm(place.s_m + speed_mps * self.lead_s) + back

    def back_m(self, speed_mps: float) -> float:
        """The way over which a small distance from the line decays to its e-th part, about."""
        return 2.0 * self.damping * self._reach_m(speed_mps)

    def speed_mps(self, line: TrackLine, place: Place, speed_mps: float) -> float:
        """That the line allows where the command acts."""
        return line.speed_mps(place.s_m + speed_mps * self.lead_s)

    def _reach_m(self, speed_mps: float) -> float:
        return self.pull_m + max(speed_mps, 0.0) * self.pull_s
