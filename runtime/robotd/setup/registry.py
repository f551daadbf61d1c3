"""Finds plugins and devices through entry points: lists them without importing, loads exactly the one that is named."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from robotd.authoring.behaviour import Behaviour
from robotd.authoring.bridge import Bridge
from robotd.authoring.device import Device
from robotd.authoring.perceptor import Perceptor
from robotd.setup.words import nearest

GROUPS: dict[str, str] = {
    "devices": "robotd.devices",
    "perception": "robotd.perception",
    "behaviours": "robotd.behaviours",
    "bridges": "robotd.bridges",
}
"""Section of a config to group of entry points."""
_BASES: dict[str, tuple[type, str]] = {
    "devices": (Device, "device"),
    "perception": (Perceptor, "perceptor"),
    "behaviours": (Behaviour, "behaviour"),
    "bridges": (Bridge, "bridge"),
}


class PluginError(Exception):
    """A plugin that cannot be had: `message` says why, `hint` what to do. `unknown`: no such name is installed."""

    def __init__(self, message: str, hint: str = "", *, unknown: bool = False) -> None:
        super().__init__(message)
        self.message, self.hint, self.unknown = message, hint, unknown


@dataclass(frozen=True, slots=True)
class Plugin:
    """One installed entry point, not imported."""

    name: str
    group: str
    distribution: str
    version: str
    target: str


class Registry:
    """Entry points of the four groups. A test gives its own; otherwise those of the installed distributions are read
    when first asked for, once."""

    def __init__(self, points: Iterable[EntryPoint] | None = None) -> None:
        self._given = None if points is None else tuple(points)

    @cached_property
    def _points(self) -> dict[str, tuple[EntryPoint, ...]]:
        found = self._given
        if found is None:
            found = tuple(point for group in GROUPS.values() for point in entry_points(group=group))
        return {section: tuple(p for p in found if p.group == group) for section, group in GROUPS.items()}

    def names(self, section: str) -> tuple[str, ...]:
        """Installed names of a section of the config, sorted, without importing anything."""
        return tuple(sorted({point.name for point in self._points[section]}))

    def plugins(self) -> tuple[Plugin, ...]:
        """Everything installed, by group and name."""
        return tuple(
            Plugin(
                point.name,
                point.group,
                point.dist.name if point.dist is not None else "",
                point.dist.version if point.dist is not None else "",
                point.value,
            )
            for section in GROUPS
            for point in sorted(self._points[section], key=lambda p: p.name)
        )

    def load(self, section: str, name: str) -> type[Any]:
        """Import one plugin and return its class. Raises PluginError, whatever the import raised."""
        base, kind = _BASES[section]
        matching = {point.value: point for point in self._points[section] if point.name == name}
        if not matching:
            raise PluginError(f"no {kind} named '{name}' is installed", self._advice(section, name), unknown=True)
        if len(matching) > 1:
            raise PluginError(
                f"{kind} '{name}' is installed twice: {' and '.join(sorted(matching))}", "uninstall one of them"
            )
        ((target, point),) = matching.items()
        try:
            cls = point.load()
        except ModuleNotFoundError as error:
            raise PluginError(
                f"{kind} '{name}' ({target}) cannot be imported: there is no module {error.name!r}",
                "install what it needs, or take it out of the config",
            ) from error
        except Exception as error:
            raise PluginError(
                f"{kind} '{name}' ({target}) cannot be imported: {type(error).__name__}: {error}",
                "mend the plugin, or take it out of the config",
            ) from error
        if not (isinstance(cls, type) and issubclass(cls, base)):
            raise PluginError(
                f"{kind} '{name}' ({target}) is not a {base.__name__}",
                f"the entry point must name a class that derives from robotd.{base.__name__}",
            )
        return cls

    def _advice(self, section: str, name: str) -> str:
        names = self.names(section)
        near = nearest(name, names)
        if near is not None:
            return f"did you mean '{near}'?"
        for other, (_, kind) in _BASES.items():
            if other != section and name in self.names(other):
                return f"'{name}' is a {kind} and belongs under `{other}:`"
        return f"installed: {', '.join(names)}" if names else "none is installed"


def installed() -> tuple[Plugin, ...]:
    """All installed plugins and devices, without importing them."""
    return Registry().plugins()
