"""What speaks for having reached the next node, weighed: the bar, the line's end, the lidar, the distance."""

from __future__ import annotations

import math
from dataclasses import dataclass

from pydantic import Field

from robotd import Config


class CueWeights(Config):
    """What each cue weighs. A node is believed from a weight of 1 on, and only where the map lets it be."""

    bar: float = Field(default=1.0, ge=0.0, le=2.0)
    """A bar across the line, agreed on by several pictures."""
    line_end: float = Field(default=1.0, ge=0.0, le=2.0)
    """The line's end, where the map has no road straight on."""
    lidar: float = Field(default=0.5, ge=0.0, lt=1.0)
    """The lidar's strategy says that this is a crossing. Below 1: alone it never is one."""
    distance: float = Field(default=0.5, ge=0.0, lt=1.0)
    """Odometry is within `distance_near_m` of where the map has the node. Below 1: alone it never is one."""


@dataclass(frozen=True, slots=True)
class Cues:
    """Odometer readings over the node's centre, each by one cue; nan where that cue says nothing.

    expected_m: by the map, half_window_m how far from it the node may be. unmarked: the node is one that nothing can
    show, tape that goes straight on. sure: odometry has learned its scale so well that distance alone is good enough
    where the sensors stay silent.
    """

    expected_m: float
    half_window_m: float
    bar_m: float = math.nan
    end_m: float = math.nan
    lidar_m: float = math.nan
    unmarked: bool = False
    sure: bool = False


@dataclass(frozen=True, slots=True)
class NodeSeen:
    """Where the next node is believed to be. seen: by a sensor, not by its distance alone."""

    at_m: float
    why: str
    seen: bool = True


def fuse(cues: Cues, weights: CueWeights, near_m: float) -> NodeSeen | None:
    """The next node's place, from the best cue that there is, or None while they do not suffice.

    Only cues within the window count; the distance counts for a place within `near_m` of the expected one.
    """
    if cues.unmarked:
        return NodeSeen(cues.expected_m, "by distance; the map has nothing to see there", seen=False)
    weight, named, at_m = 0.0, [], math.nan
    for name, place_m, worth in (
        ("bar", cues.bar_m, weights.bar),
        ("end of the line", cues.end_m, weights.line_end),
        ("lidar", cues.lidar_m, weights.lidar),
    ):
        if abs(place_m - cues.expected_m) <= cues.half_window_m:
            weight += worth
            named.append(name)
            at_m = place_m if math.isnan(at_m) else at_m
    if not named:
        # silence is no evidence against it: a shadow hides an arm, glare cuts one off
        return NodeSeen(cues.expected_m, "distance; nothing of it was seen", seen=False) if cues.sure else None
    if abs(at_m - cues.expected_m) <= near_m:
        weight += weights.distance
        named.append("distance")
    return NodeSeen(at_m, ", ".join(named)) if weight >= 1.0 else None
