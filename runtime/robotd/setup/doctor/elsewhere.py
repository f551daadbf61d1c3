"""Looks for a mute device elsewhere: on another port, or at another speed of the line."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from robotd.engine.parts import DevicePart
from robotd.setup.doctor.devices import needs
from robotd.setup.doctor.faults import found
from robotd.setup.doctor.findings import Finding
from robotd.setup.doctor.sight import sight
from robotd.world.robot import Robot

LOOK_S = 1.0
BAUDS = (115_200, 230_400, 460_800, 921_600, 256_000, 128_000, 153_600, 57_600, 512_000, 1_000_000, 38_400, 9_600)


def port_of(part: DevicePart) -> str:
    """The serial port that a part's config names, or empty."""
    return next((need.path for need in needs(part.config) if need.kind == "serial port"), "")


async def look_elsewhere(
    part: DevicePart, robot: Robot, owners: Mapping[str, str], free: Iterable[str], bauds: Sequence[int] = BAUDS
) -> Finding | None:
    """Where a mute serial device does answer; None where it answers nowhere.

    owners: ports of the other devices, to their names, looked at first; free: ports that no device has. At each of
    them this device's own driver is opened, and what counts is a message of it, or that it opens where it did not.
    """
    path = port_of(part)
    if not path:
        return None
    for other, owner in owners.items():
        if other != path and await _answers(part, robot, port=other):
            return found("ports swapped", part.name, path=path, other=other, owner=owner, name=part.name)
    for other in free:
        if other != path and other not in owners and await _answers(part, robot, port=other):
            return found("on another port", part.name, path=path, other=other)
    baud = getattr(part.config, "baud", None)
    if isinstance(baud, int):
        for other_baud in bauds:
            if other_baud != baud and await _answers(part, robot, baud=other_baud):
                return found("other baud", part.name, baud=baud, other=other_baud)
    return None


async def _answers(part: DevicePart, robot: Robot, **changed: object) -> bool:
    tried = replace(part, config=part.config.model_copy(update=changed))
    sighting = await sight(tried, robot, LOOK_S, until_heard=True)
    return sighting.is_open and bool(sighting.streams)
