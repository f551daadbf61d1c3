"""From a robot's config to the header of a recording, and from that header back to a robot that replays it."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from robotd.engine.codec import RecordError
from robotd.engine.journal import FORMAT, RunJournal
from robotd.engine.parts import Parts
from robotd.engine.record_file import RecordWriter
from robotd.engine.record_reader import Recording
from robotd.engine.replay import ReplayReport, replay, same_arithmetic
from robotd.setup.load import Loaded, parts_from_merged
from robotd.setup.registry import GROUPS, Registry
from robotd.setup.yaml_source import read_yaml

_SECRET = re.compile(r"password|passwd|secret|token|credential", re.IGNORECASE)
_MASK = "***"
_LARGEST_FILE = 64_000_000
"""Files of more bytes than this (a film in place of a camera) are not read for their digest."""
_NOT_REPLAYED = ("bridges", "recorder")
"""Sections that take no part in a turn: a replay needs neither their plugins nor their folders."""


def open_journal(
    path: Path | str,
    loaded: Loaded,
    *,
    start_ns: int = 0,
    viewer_hz: float = 10.0,
    on_failure: Callable[[OSError], None] | None = None,
    registry: Registry | None = None,
) -> RunJournal:
    """Begin the recording of a run of `loaded`; give it to the `Runtime` and close it after the run.

    With `loaded.sim` it is written in the turn, nothing is dropped, and the same run gives the same bytes; otherwise a
    thread writes. Frames are kept where the config's `recorder:` says so. `start_ns`: the loop's time now.
    `on_failure`: called once on the writing thread where the disk fails. Raises OSError where the file cannot be made.
    """
    frames = loaded.recorder.frames == "lossless"
    header = {**_header(loaded, registry if registry is not None else Registry()), "frames": frames}
    header["start_ns"] = start_ns
    writer = RecordWriter(path, header, synchronous=loaded.sim, viewer_hz=viewer_hz, on_failure=on_failure)
    return RunJournal(writer, frames=frames)


def replay_file(
    path: Path | str, *, tolerance: float = 0.0, demand: bool = False, registry: Registry | None = None
) -> ReplayReport:
    """Replay a recorded run through the robot of its own config, with what is installed here.

    demand: equal bits are asked for; without a `tolerance` that is refused where numpy, processor or C library are
    others than the recording's. Raises RecordError for a file that is no recording, that needs a plugin which is not
    installed, or where `demand` cannot be met; ConfigError where its config no longer makes a robot; OSError.
    """
    recording = Recording(path)
    header = recording.header
    if demand and not tolerance and not same_arithmetic(header):
        was = ", ".join(f"{key} {header.get(key)}" for key in ("numpy", "cpu", "libc"))
        raise RecordError(
            f"{recording.path}: made with {was}; here the last bits of a number may differ. "
            "Say how much: --tolerance 1e-6"
        )
    known = registry if registry is not None else Registry()
    notes = tuple(_plugin_notes(recording, known)) + tuple(_file_notes(header))
    parts = recorded_parts(recording, known)
    report = replay(recording, parts, tolerance)
    return ReplayReport(
        report.compared, report.first_difference, report.uncompared, report.turns, (*notes, *report.notes)
    )


def recorded_parts(recording: Recording, registry: Registry | None = None) -> Parts:
    """The robot that a recording's header describes, without bridges. Raises RecordError, ConfigError."""
    merged = recording.header.get("config")
    if not isinstance(merged, dict):
        raise RecordError(f"{recording.path}: holds no config, and so no robot that could be replayed")
    rest = {key: value for key, value in merged.items() if key not in _NOT_REPLAYED}
    return parts_from_merged(rest, bool(recording.header.get("sim")), registry=registry)


# --------------------------------------------------------------------------------------------- header


def _header(loaded: Loaded, registry: Registry) -> dict[str, Any]:
    secrets: set[str] = set()
    merged = _without_secrets(loaded.merged, secrets)
    _without_secrets(read_yaml(loaded.source_text, loaded.file.name).data, secrets)
    text = loaded.source_text
    for secret in sorted(secrets, key=len, reverse=True):
        text = text.replace(secret, _MASK)
    return {
        "format": FORMAT,
        "config": merged,
        "config_file": loaded.file.name,
        "config_text": text,
        "sets": [_set_without_secret(text) for text in loaded.sets],
        "env": {name: _MASK if _SECRET.search(name) else value for name, value in loaded.env.items()},
        "sim": loaded.sim,
        "plugins": dict(_used_plugins(merged, registry)),
        "files": dict(_used_files(merged)),
    }


def _set_without_secret(assignment: str) -> str:
    key, _, value = assignment.partition("=")
    return f"{key}={_MASK if _SECRET.search(key) else value}"


def _without_secrets(config: Any, secrets: set[str]) -> Any:
    if not isinstance(config, dict) or "bridges" not in config:
        return config
    return {**config, "bridges": _masked(config["bridges"], "", secrets)}


def _masked(value: Any, key: str, secrets: set[str]) -> Any:
    """A bridge's parameters without what stands under a key such as `password`: a recording is passed around.

    What was taken out is added to `secrets`.
    """
    if isinstance(value, dict):
        return {name: _masked(inner, name, secrets) for name, inner in value.items()}
    if isinstance(value, list):
        return [_masked(inner, key, secrets) for inner in value]
    if isinstance(value, str) and value and _SECRET.search(key):
        secrets.add(value)
        return _MASK
    return value


def _used_plugins(merged: Mapping[str, Any], registry: Registry) -> Iterator[tuple[str, list[str]]]:
    """`section.plugin` to [distribution, version] for what the config names."""
    installed = {(plugin.group, plugin.name): plugin for plugin in registry.plugins()}
    for section, group in GROUPS.items():
        for name, entry in (merged.get(section) or {}).items():
            use = (entry or {}).get("use") or name
            plugin = installed.get((group, use))
            if plugin is not None:
                yield f"{section}.{use}", [plugin.distribution, plugin.version]


def _used_files(value: Any) -> Iterator[tuple[str, str]]:
    """Path to SHA-256 of each file (map, model) that a value of the config names by its whole path."""
    if isinstance(value, dict | list):
        for inner in value.values() if isinstance(value, dict) else value:
            yield from _used_files(inner)
    elif isinstance(value, str) and value.startswith("/") and "\0" not in value:
        path = Path(value)
        if path.is_file() and path.stat().st_size <= _LARGEST_FILE:
            yield value, _digest(path)


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


# --------------------------------------------------------------------------------------- what differs


def _plugin_notes(recording: Recording, registry: Registry) -> Iterator[str]:
    installed = {(plugin.group, plugin.name): plugin for plugin in registry.plugins()}
    for place, (distribution, version) in recording.header.get("plugins", {}).items():
        section, _, name = place.partition(".")
        if section in _NOT_REPLAYED:
            continue
        plugin = installed.get((GROUPS.get(section, ""), name))
        if plugin is None:
            needs = f"{distribution} {version}".strip() or "a distribution without a name"
            raise RecordError(f"{recording.path}: needs {name!r} of {section}, which is not installed: install {needs}")
        if (plugin.distribution, plugin.version) != (distribution, version):
            yield (
                f"{place}: recorded with {distribution} {version}, replayed with {plugin.distribution} {plugin.version}"
            )


def _file_notes(header: Mapping[str, Any]) -> Iterator[str]:
    for name, digest in header.get("files", {}).items():
        path = Path(name)
        if path.is_file() and _digest(path) != digest:
            yield f"{name} is not what it was when the run was recorded"
