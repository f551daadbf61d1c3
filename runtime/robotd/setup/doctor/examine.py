"""The doctor's round: the machine, the config, each device from outside, and where asked each device opened."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence

from robotd.engine.loops import real_loop
from robotd.engine.parts import DevicePart
from robotd.setup.doctor.devices import check_device, check_together
from robotd.setup.doctor.elsewhere import look_elsewhere, port_of
from robotd.setup.doctor.facts import NeedKind, Probes
from robotd.setup.doctor.faults import found
from robotd.setup.doctor.findings import Finding
from robotd.setup.doctor.judge import is_mute, judge_sighting
from robotd.setup.doctor.machine import check_health, check_packages, check_plugins, check_python, required_names
from robotd.setup.doctor.sight import sight_all
from robotd.setup.problems import ConfigError
from robotd.world.robot import Robot

PROBE_S = 4.0
"""Longer than a lidar takes to find out that it is silent."""


def examine(file: str | None, probes: Probes, probe_s: float | None = None) -> list[Finding]:
    """All findings, the machine's first.

    file: a config, or None for the machine and the plugins alone. probe_s: also open the devices for that long; a
    device whose port, bus or file is known to be bad already is not opened.
    """
    requirements = probes.requirements()
    findings = [
        check_python(probes.python()),
        *check_packages(requirements, probes.versions(required_names(requirements))),
        *check_health(probes.health()),
    ]
    if file is None:
        return [*findings, *check_plugins(probes.plugins()), *_present(probes)]
    try:
        parts = probes.parts(file)
    except ConfigError as error:
        return [*findings, *(found("config wrong", "config", words=str(problem)) for problem in error.problems)]
    findings.append(Finding("good", "config", f"{file} has no errors"))
    looked = {part.name: check_device(part, probes) for part in parts.devices}
    findings += [*check_together(parts.devices, probes), *(one for some in looked.values() for one in some)]
    if probe_s is not None:
        sound = [part for part in parts.devices if not any(one.level == "error" for one in looked[part.name])]
        taken = {probes.real_path(path) for part in parts.devices for path in _ports(part, probes)}
        free = [path for path in probes.candidates("serial port") if probes.real_path(path) not in taken]
        with asyncio.Runner(loop_factory=real_loop) as runner:
            findings += runner.run(probe(sound, parts.robot, free, probe_s))
    return findings


def _ports(part: DevicePart, probes: Probes) -> Sequence[str]:
    """The ports that a part's config names, also by a pattern."""
    port = port_of(part)
    return [port, *probes.fitting(port)] if port else []


async def probe(parts: Sequence[DevicePart], robot: Robot, free: Sequence[str], seconds: float) -> list[Finding]:
    """Open all at once for `seconds`; what stays mute is then looked for on the other ports and at other speeds.

    free: serial ports that no device has.
    """
    sightings = await sight_all(parts, robot, seconds)
    owners: Mapping[str, str] = {port: part.name for part in parts if (port := port_of(part))}
    findings: list[Finding] = []
    for part, sighting in zip(parts, sightings, strict=True):
        findings += judge_sighting(part, sighting)
        if is_mute(part, sighting):
            elsewhere = await look_elsewhere(part, robot, owners, free)
            findings += [elsewhere] if elsewhere is not None else []
    return findings


def _present(probes: Probes) -> list[Finding]:
    kinds: tuple[NeedKind, ...] = ("serial port", "I2C bus", "camera")
    return [Finding("note", kind, ", ".join(probes.candidates(kind)) or "none here") for kind in kinds]
