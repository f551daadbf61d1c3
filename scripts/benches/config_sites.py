"""Where keys and values stand in a config's text and what the schema says of each, without robotd's own reader."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any, TypeAlias

from ruamel.yaml import YAML
from ruamel.yaml.nodes import MappingNode, ScalarNode, SequenceNode

from robotd.authoring.config import Config
from robotd.safety.settings import GuardConfig, GuardianConfig
from robotd.setup.registry import Registry
from robotd.setup.sections import (
    ENTRIES,
    OperatorSection,
    RecorderSection,
    RobotSection,
    SimulationEntry,
    TopSection,
    entry_keys,
)

Path: TypeAlias = tuple[str | int, ...]
_SECTIONS: dict[str, type[Config]] = {
    "robot": RobotSection,
    "guard": GuardConfig,
    "guardian": GuardianConfig,
    "operator": OperatorSection,
    "recorder": RecorderSection,
}


@dataclass(frozen=True, slots=True)
class Site:
    """One value of a mapping or list. Indices count characters of the text; lines and columns count from 1.

    `key_at` is -1 for an item of a list. `own_line`: the key is the first thing on its line.
    """

    path: Path
    key_at: int
    key_end: int
    at: int
    end: int
    key_place: tuple[int, int]
    place: tuple[int, int]
    kind: str
    flow: bool
    own_line: bool

    @property
    def key(self) -> str:
        return str(self.path[-1])


def sites(text: str) -> list[Site]:
    """Every value in the text, those above before those inside them."""
    root = YAML(typ="safe", pure=True).compose(text)
    return list(_inside(root, (), text)) if root is not None else []


def _inside(node: Any, path: Path, text: str) -> Iterator[Site]:
    if isinstance(node, MappingNode):
        pairs = [(key.value, key, value) for key, value in node.value]
    elif isinstance(node, SequenceNode):
        pairs = [(i, None, value) for i, value in enumerate(node.value)]
    else:
        return
    for step, key, value in pairs:
        mark, where = value.start_mark, key.start_mark if key is not None else None
        kind = "scalar" if isinstance(value, ScalarNode) else "mapping" if isinstance(value, MappingNode) else "list"
        line_start = text.rfind("\n", 0, where.index) + 1 if where is not None else 0
        yield Site(
            (*path, step),
            where.index if where is not None else -1,
            key.end_mark.index if key is not None else -1,
            mark.index,
            value.end_mark.index,
            (where.line + 1, where.column + 1) if where is not None else (0, 0),
            (mark.line + 1, mark.column + 1),
            kind,
            bool(node.flow_style),
            where is not None and not text[line_start : where.index].strip(" "),
        )
        yield from _inside(value, (*path, step), text)


def is_flow(site: Site, text: str) -> bool:
    """Whether the value itself is written in brackets."""
    return site.kind != "scalar" and text[site.at] in "[{"


@cache
def _schema(cls: type[Config]) -> dict[str, Any]:
    return cls.model_json_schema()


class Truth:
    """What the plugins' own JSON schemas say of the places of one config."""

    def __init__(self, data: dict[str, Any], registry: Registry) -> None:
        self._data = data
        self.registry = registry

    def of(self, path: Path) -> dict[str, Any] | None:
        """The schema of the value at a path; None where there is none to be had."""
        root, rest = self._root(path)
        return _walk(root, root, rest, self._at(path[: len(path) - len(rest)])) if root is not None else None

    def keys(self, path: Path) -> list[str] | None:
        """All keys that the mapping at a path may have; None where any key may stand."""
        if path == ():
            return [*_SECTIONS, *ENTRIES, "act_hz", "simulation"]
        schema = self.of(path)
        if schema is None or "properties" not in schema or schema.get("additionalProperties") is not False:
            return None
        return list(schema["properties"])

    def _at(self, path: Path) -> Any:
        node: Any = self._data
        for step in path:
            node = node[step]
        return node

    def _root(self, path: Path) -> tuple[dict[str, Any] | None, Path]:
        """The model that owns a path, as schema, and the rest of the path inside it."""
        section = str(path[0]) if path else ""
        if section in _SECTIONS:
            return _schema(_SECTIONS[section]), path[1:]
        if section in TopSection.model_fields:
            return _schema(TopSection), path
        if section in ENTRIES and len(path) >= 2:
            cls = self._plugin(section, str(path[1]))
            made = dict(_schema(cls.config_type))
            own = _schema(ENTRIES[section])
            if len(path) >= 3 and path[2] == "goal":
                return _schema(cls.goal_type), path[3:]
            made["properties"] = {**own["properties"], **made.get("properties", {})}
            return made, path[2:]
        if section == "simulation":
            if path[1:2] == ("devices",):
                if len(path) < 3:
                    return None, ()
                entry = self._data["simulation"]["devices"][path[2]] or {}
                twin = entry.get("use") or self._plugin("devices", str(path[2])).sim_twin
                made = dict(_schema(self.registry.load("devices", str(twin)).config_type))
                made["properties"] = {"use": {"type": "string"}, **made.get("properties", {})}
                return made, path[3:]
            world = self.registry.load("devices", self._data["simulation"].get("use", "flat_world"))
            made = dict(_schema(world.config_type))
            own = _schema(SimulationEntry)
            made["properties"] = {**own["properties"], **made.get("properties", {})}
            return made, path[1:]
        return None, ()

    def _plugin(self, section: str, name: str) -> type[Any]:
        entry = self._data[section][name] or {}
        return self.registry.load(section, entry.get("use", name))


def reserved(path: Path) -> bool:
    """Whether a path ends with a key that robotd keeps for itself (`use`, `as`, `priority`...)."""
    if path[:2] == ("simulation", "devices"):
        return path[3:] == ("use",)
    return len(path) == 3 and path[0] in ENTRIES and path[2] in entry_keys(ENTRIES[str(path[0])])


def _walk(root: dict[str, Any], schema: dict[str, Any], path: Path, data: Any) -> dict[str, Any] | None:
    while True:
        if "$ref" in schema:
            schema = {**root["$defs"][schema["$ref"].rpartition("/")[2]], **_without(schema, "$ref")}
            continue
        if "oneOf" in schema and "discriminator" in schema:
            said = data.get(schema["discriminator"]["propertyName"]) if isinstance(data, dict) else None
            if said not in schema["discriminator"]["mapping"]:
                return None
            schema = {"$ref": schema["discriminator"]["mapping"][said]}
            continue
        if "anyOf" in schema:
            arms = [arm for arm in schema["anyOf"] if arm.get("type") != "null"]
            if len(arms) != 1:
                return None
            schema = {**arms[0], **_without(schema, "anyOf")}
            continue
        break
    if not path:
        return schema
    step = path[0]
    inner: Any = None
    if isinstance(step, str):
        inner = schema.get("properties", {}).get(step, schema.get("additionalProperties"))
    elif "prefixItems" in schema:
        inner = schema["prefixItems"][step] if step < len(schema["prefixItems"]) else None
    else:
        inner = schema.get("items")
    if not isinstance(inner, dict):
        return None
    below: Any = None
    if (isinstance(data, dict) and isinstance(step, str)) or (isinstance(data, list) and isinstance(step, int)):
        below = data[step]  # type: ignore[index]
    return _walk(root, inner, path[1:], below)


def _without(schema: dict[str, Any], key: str) -> dict[str, Any]:
    return {name: value for name, value in schema.items() if name != key}
