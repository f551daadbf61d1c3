"""Reads a robot's file and the layers over it, checks everything, and returns the parts; the door of this room."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from robotd.engine.parts import Parts
from robotd.setup.assemble import Assembler
from robotd.setup.layers import PREFIX, lay_over
from robotd.setup.problems import ConfigError, Problem, in_order
from robotd.setup.registry import Registry
from robotd.setup.resources import find_config
from robotd.setup.sections import RecorderSection
from robotd.setup.validate import Checker, said
from robotd.setup.yaml_source import Source, read_yaml


@dataclass(frozen=True, slots=True)
class Loaded:
    """One robot's config, read and checked.

    `merged`: the content after all layers, plain and fit for JSON, file names replaced by the paths that they meant;
    `parts_from_merged` makes the same parts of it. `source_text`: the file as it stands. `sets`, `env`: the layers over
    it as they were given, of the environment only what is meant for robotd.
    """

    parts: Parts
    recorder: RecorderSection
    source_text: str
    merged: dict[str, Any]
    file: Path
    sim: bool
    sets: tuple[str, ...] = ()
    env: Mapping[str, str] = field(default_factory=dict)


def load_config(
    file_or_name: str | Path,
    *,
    sim: bool = False,
    sets: Sequence[str] = (),
    env: Mapping[str, str] | None = None,
    registry: Registry | None = None,
    whole: bool = False,
) -> Loaded:
    """Read a config by path or by the name of a shipped one, and build its parts.

    Layers: defaults < the file < `ROBOTD__A__B` of `env` < `sets` (`a.b=value`, later ones win). With `sim` each device
    is replaced by its simulated twin. Only what the file names is imported; without `sim` that leaves out the world
    and the twins, whose parameters are then checked only with `whole`.

    Raises ConfigError with every problem found.
    """
    file = find_config(file_or_name)
    try:
        raw = file.read_bytes()
    except OSError as error:
        raise ConfigError([Problem(str(file), None, None, "", f"cannot be read: {error.strerror}")]) from error
    source = read_yaml(raw, str(file))
    if source.complete:
        lay_over(source, env, sets)
    parts, recorder = _parts(source, file.resolve().parent, registry, sim=sim, whole=whole)
    text = raw.decode("utf-8-sig")
    layer = {name: value for name, value in (env or {}).items() if name.startswith(PREFIX)}
    return Loaded(parts, recorder, text, source.data, file, sim, tuple(sets), layer)


def parts_from_merged(merged: Mapping[str, Any], sim: bool = False, *, registry: Registry | None = None) -> Parts:
    """The parts of `Loaded.merged`, for a replay. Raises ConfigError as `load_config` does, without lines."""
    source = Source("the recorded config", copy.deepcopy(dict(merged)))
    return _parts(source, None, registry, sim=sim, whole=False)[0]


def check_file(
    file_or_name: str | Path,
    *,
    sim: bool = False,
    sets: Sequence[str] = (),
    env: Mapping[str, str] | None = None,
    registry: Registry | None = None,
) -> list[Problem]:
    """Everything that is wrong with a config, the simulation's parameters included; empty where it is good."""
    try:
        load_config(file_or_name, sim=sim, sets=sets, env=env, registry=registry, whole=True)
    except ConfigError as error:
        return list(error.problems)
    return []


def schema(registry: Registry | None = None) -> dict[str, Any]:
    """The JSON Schema of configs with everything installed, for editors."""
    from robotd.setup.schema import json_schema

    return json_schema(registry if registry is not None else Registry())


def _parts(
    source: Source, folder: Path | None, registry: Registry | None, *, sim: bool, whole: bool
) -> tuple[Parts, RecorderSection]:
    if source.complete and not isinstance(source.data, dict):
        what = "is empty" if source.data is None else f"is {said(source.data)}"
        source.problems.append(
            Problem(source.file, 1, 1, "", f"{what} (expected sections such as robot, devices, behaviours)")
        )
        source.complete = False
    if not source.complete:
        raise ConfigError(source.problems)
    checker = Checker(source, folder)
    made = Assembler(checker, registry if registry is not None else Registry(), sim=sim, whole=whole).run()
    if made.parts is None:
        raise ConfigError(in_order([*source.problems, *checker.problems]))
    return made.parts, made.recorder
