"""The JSON Schema of configs, made of the installed plugins' own models, so that an editor completes and checks."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from pydantic import BaseModel

from robotd.authoring.config import Config
from robotd.authoring.device import World
from robotd.safety.settings import GuardConfig, GuardianConfig
from robotd.setup.registry import PluginError, Registry
from robotd.setup.sections import (
    ENTRIES,
    BehaviourEntry,
    OperatorSection,
    RecorderSection,
    RobotSection,
    SimulationEntry,
    TopSection,
    entry_keys,
)

DIALECT = "https://json-schema.org/draft/2020-12/schema"


def json_schema(registry: Registry, only: Iterable[str] | None = None) -> dict[str, Any]:
    """The schema of a whole file. `only`: entry points to describe; None means all that are installed and importable.

    A plugin that cannot be imported is left out and named in the description of its section.
    """
    defs: dict[str, Any] = {}
    wanted = None if only is None else frozenset(only)
    loaded: dict[str, dict[str, type[Any]]] = {}
    broken: dict[str, list[str]] = {}
    for section in ENTRIES:
        loaded[section], broken[section] = {}, []
        for name in registry.names(section):
            if wanted is not None and name not in wanted:
                continue
            try:
                loaded[section][name] = registry.load(section, name)
            except PluginError as error:
                broken[section].append(error.message)
    worlds = {name: cls for name, cls in loaded["devices"].items() if issubclass(cls, World)}
    properties: dict[str, Any] = {
        "robot": _model(RobotSection, "robot", defs),
        "guard": _model(GuardConfig, "guard", defs),
        "guardian": _model(GuardianConfig, "guardian", defs),
        "operator": _model(OperatorSection, "operator", defs),
        "recorder": _model(RecorderSection, "recorder", defs),
        **_model(TopSection, "top", defs)["properties"],
    }
    for section in ENTRIES:
        plugins = {name: cls for name, cls in loaded[section].items() if name not in worlds}
        properties[section] = _plugins(section, plugins, defs)
        if broken[section]:
            properties[section]["description"] = "Left out: " + "; ".join(broken[section])
    properties["simulation"] = _simulation(worlds, defs)
    return {
        "$schema": DIALECT,
        "title": "A robot's config for robotd",
        "type": "object",
        "additionalProperties": False,
        "required": ["robot"],
        "properties": properties,
        "$defs": defs,
    }


def _model(cls: type[BaseModel], prefix: str, defs: dict[str, Any]) -> dict[str, Any]:
    """The schema of one model; the models inside it move to the common `$defs` under names that cannot collide."""
    made = cls.model_json_schema(ref_template=f"#/$defs/{prefix}.{{model}}", mode="validation")
    for name, inner in made.pop("$defs", {}).items():
        defs[f"{prefix}.{name}"] = inner
    return made


def _plugins(section: str, plugins: dict[str, type[Any]], defs: dict[str, Any]) -> dict[str, Any]:
    """One section: entries whose name is a plugin, and entries of other names that say `use:`."""
    entry = ENTRIES[section]
    for name, cls in plugins.items():
        defs[f"{section}.{name}"] = _entry(entry, cls, f"{section}.{name}", defs)
    named = {
        # an entry may have the name of one plugin and use another
        name: {
            "if": {"type": "object", "required": ["use"]},
            "then": _by_use(section, plugins),
            "else": {"anyOf": [{"$ref": f"#/$defs/{section}.{name}"}, {"type": "null"}]},
        }
        for name in plugins
    }
    return {
        "type": "object",
        "properties": named,
        "additionalProperties": {"type": "object", "required": ["use"], **_by_use(section, plugins)},
    }


def _by_use(section: str, plugins: dict[str, type[Any]]) -> dict[str, Any]:
    choices = [
        {
            "if": {"properties": {"use": {"const": name}}, "required": ["use"]},
            "then": {"$ref": f"#/$defs/{section}.{name}"},
        }
        for name in plugins
    ]
    return {"properties": {"use": {"enum": list(plugins)}}, **({"allOf": choices} if choices else {})}


def _entry(entry: type[Config], cls: type[Any], prefix: str, defs: dict[str, Any]) -> dict[str, Any]:
    own, params = _model(entry, prefix, defs), _model(cls.config_type, prefix, defs)
    if entry is BehaviourEntry:
        own["properties"]["goal"] = _model(cls.goal_type, f"{prefix}.goal", defs)
    about = (cls.__doc__ or "").strip().split("\n")[0]
    return {
        "type": "object",
        "description": about or cls.__name__,
        "additionalProperties": False,
        "required": [*own.get("required", ()), *params.get("required", ())],
        "properties": {**own["properties"], **params.get("properties", {})},
    }


def _simulation(worlds: dict[str, type[Any]], defs: dict[str, Any]) -> dict[str, Any]:
    own = _model(SimulationEntry, "simulation", defs)
    for name, cls in worlds.items():
        params = _model(cls.config_type, f"simulation.{name}", defs)
        defs[f"simulation.{name}"] = {
            "type": "object",
            "additionalProperties": False,
            "required": params.get("required", []),
            "properties": {**own["properties"], **params.get("properties", {})},
        }
    default = SimulationEntry.model_fields["use"].default
    choices: list[dict[str, Any]] = [
        {
            "if": {"properties": {"use": {"const": name}}, **({} if name == default else {"required": ["use"]})},
            "then": {"$ref": f"#/$defs/simulation.{name}"},
        }
        for name in worlds
    ]
    return {
        "type": "object",
        "description": "The world that --sim puts around the robot.",
        "properties": {"use": {"enum": list(worlds)}, **{k: {} for k in entry_keys(SimulationEntry) if k != "use"}},
        **({"allOf": choices} if choices else {}),
    }
