"""Writes a new outside distribution for one behaviour, perceptor, device or bridge, whose tests pass at once."""

from __future__ import annotations

import re
from collections.abc import Iterator
from importlib.metadata import entry_points
from importlib.resources import files
from importlib.resources.abc import Traversable
from importlib.util import find_spec
from pathlib import Path, PurePosixPath
from string import Template
from typing import Literal, TypeAlias, get_args

import robotd

Kind: TypeAlias = Literal["behaviour", "perceptor", "device", "bridge"]
KINDS: tuple[Kind, ...] = get_args(Kind)
GROUPS: dict[Kind, str] = {
    "behaviour": "behaviours",
    "perceptor": "perception",
    "device": "devices",
    "bridge": "bridges",
}

_IN_A_ROBOT: dict[Kind, str] = {
    "behaviour": "\nbehaviours:\n  {name}: {{priority: 10, start: true}}\n",
    "perceptor": "\nperception:\n  {name}: {{}}\n",
    "device": "  {name}: {{port: /dev/ttyUSB0}}\n",
    "bridge": "\nbridges:\n  {name}: {{events_file: events.jsonl}}\n",
}
"""How a robot's file names a plugin of each kind; devices stand in a section that is already there."""

_NAME = re.compile(r"[a-z][a-z0-9]*(_[a-z0-9]+)*\Z")
_LONGEST_NAME = 30
_SUFFIX = ".template"
_TAKEN_CLASSES = frozenset(
    {*robotd.__all__, "Sees", "Path", "Field", "FakeRuntime", "LineParser", "Explanation", "Points", "Scalar"}
)
"""Names that the templates use beside the plugin's own."""


class ScaffoldError(ValueError):
    """A plugin that cannot be written; the message says why and what to type instead."""


def class_name(name: str) -> str:
    """`wall_follow` to `WallFollow`."""
    return "".join(word.capitalize() for word in name.split("_"))


def contents(kind: str, name: str) -> dict[PurePosixPath, str]:
    """The text of every file of a new distribution, by path inside it. Raises ScaffoldError for a kind or name."""
    known = _kind(kind)
    _check_name(name)
    package, cls = f"robotd_{name}", class_name(name)
    entries = [f'{name} = "{package}:{cls}"']
    imports = [cls, f"{cls}Config"]
    if known == "device":
        entries.append(f'sim_{name} = "{package}:Sim{cls}"')
        imports += [f"Sim{cls}", f"Sim{cls}Config", "LineParser"]
    elif known != "bridge":
        imports.append("Sees")
    words = {
        "name": name,
        "Class": cls,
        "package": package,
        "distribution": package.replace("_", "-"),
        "kind": known,
        "group": GROUPS[known],
        "entry_points": "\n".join(entries),
        "section": _IN_A_ROBOT[known].format(name=name),
        "imports": ", ".join(sorted(imports)),
    }
    return {
        PurePosixPath(str(path).replace("PACKAGE", package).replace("NAME", name)): Template(text).substitute(words)
        for path, text in [*_templates("every"), *_templates(known)]
    }


def new(kind: str, name: str, folder: Path | None = None) -> Path:
    """Write a new distribution into `folder` (the current one where None) and return its own folder in there.

    Raises ScaffoldError for a kind or name that cannot be, a name that is installed already, or an existing folder.
    """
    written = contents(kind, name)
    for entry in entry_points(group=f"robotd.{GROUPS[_kind(kind)]}", name=name):
        raise ScaffoldError(f"a {kind} {name!r} is installed already ({entry.value}); choose another name")
    if find_spec(f"robotd_{name}") is not None:
        raise ScaffoldError(f"a Python package robotd_{name} is installed already; choose another name")
    place = (folder if folder is not None else Path.cwd()) / f"robotd_{name}"
    try:
        place.mkdir(parents=True)
    except FileExistsError as error:
        raise ScaffoldError(f"{place} exists already; choose another name, or move it away") from error
    for path, text in written.items():
        file = place / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")
    return place


def _kind(kind: str) -> Kind:
    for known in KINDS:
        if kind == known:
            return known
    raise ScaffoldError(f"there is no kind of plugin {kind!r}; write one of: {', '.join(KINDS)}")


def _check_name(name: str) -> None:
    if not _NAME.match(name) or len(name) > _LONGEST_NAME:
        raise ScaffoldError(
            f"name {name!r}: expected lower snake case of at most {_LONGEST_NAME} letters, for example wall_follow"
        )
    if name.startswith("robotd"):
        raise ScaffoldError(f"name {name!r}: the package gets robotd_ in front by itself; leave it out")
    if class_name(name) in _TAKEN_CLASSES:
        raise ScaffoldError(f"name {name!r}: {class_name(name)} means something else in robotd; choose another name")


def _templates(shelf: str) -> Iterator[tuple[PurePosixPath, str]]:
    """Path without suffix, and text, of each template of one shelf."""
    yield from _walk(files("robotd.setup") / "templates" / shelf, PurePosixPath())


def _walk(folder: Traversable, inside: PurePosixPath) -> Iterator[tuple[PurePosixPath, str]]:
    for entry in sorted(folder.iterdir(), key=lambda entry: entry.name):
        if entry.is_dir():
            yield from _walk(entry, inside / entry.name)
        elif entry.name.endswith(_SUFFIX):
            yield inside / entry.name.removesuffix(_SUFFIX), entry.read_text(encoding="utf-8")
