"""From YAML text to plain data and the place of every key and value, refusing what a robot's config has no use for.

Scalars follow the core schema of YAML 1.2 (section 10.3.2): `yes`, `no`, `on`, `off`, `012:30` and `1_000` are text,
`0o17` is 15 and `012` is 12. Refused: duplicate keys, anchors, aliases, tags, keys that are not text, more than one
document, numbers that are not finite, and files beyond the limits below. ruamel.yaml scans and parses; what the scalars
mean and which keys collide is decided here, so that each refusal has its place.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from robotd.setup.problems import Path, Problem, dotted

MAX_BYTES = 1_000_000
MAX_DEPTH = 24
MAX_INT = 2**63 - 1

Scalar: TypeAlias = str | int | float | bool | None

_NULL = frozenset(("", "~", "null", "Null", "NULL"))
_BOOL = {
    word: value for value, words in ((True, "true True TRUE"), (False, "false False FALSE")) for word in words.split()
}
_INT = re.compile(r"[-+]?[0-9]+\Z")
_OCT = re.compile(r"0o[0-7]+\Z")
_HEX = re.compile(r"0x[0-9a-fA-F]+\Z")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?\Z")
_ENDLESS = {
    ".nan": math.nan,
    **{sign + ".inf": -math.inf if sign == "-" else math.inf for sign in ("", "+", "-")},
}


@dataclass(frozen=True, slots=True)
class Place:
    """A point of a source; line and column count from 1, or are None where the source has no lines."""

    file: str
    line: int | None = None
    column: int | None = None

    def problem(self, path: Path, message: str, hint: str = "") -> Problem:
        """A problem at this place."""
        return Problem(self.file, self.line, self.column, dotted(path), message, hint)


@dataclass(slots=True)
class Source:
    """Plain data (dict, list, str, int, float, bool, None) with the place of each key and each value.

    `problems`: what was refused while reading. `spoiled`: paths whose value is a stand-in because the real one was
    refused; whoever checks further says nothing about them. `complete`: False where a syntax error ended the reading.
    """

    file: str
    data: Any = None
    keys: dict[Path, Place] = field(default_factory=dict)
    values: dict[Path, Place] = field(default_factory=dict)
    problems: list[Problem] = field(default_factory=list)
    spoiled: set[Path] = field(default_factory=set)
    complete: bool = True

    def key_place(self, path: Path) -> Place:
        """The key that a path ends with; of a path that is not there, the nearest one above it."""
        while path:
            if path in self.keys:
                return self.keys[path]
            if path in self.values:
                return self.values[path]
            path = path[:-1]
        return Place(self.file, 1, 1)

    def value_place(self, path: Path) -> Place:
        """The value at a path; of a path that is not there, the nearest key above it."""
        return self.values[path] if path in self.values else self.key_place(path)

    def is_spoiled(self, path: Path) -> bool:
        """Whether the value at a path, or one above it, is only a stand-in."""
        return any(path[:length] in self.spoiled for length in range(len(path) + 1))


def scalar(text: str) -> Scalar:
    """The value of an unquoted scalar by the core schema; infinities and nan come out as float. Raises ValueError for
    a whole number beyond 64 bits."""
    if text in _NULL:
        return None
    if text in _BOOL:
        return _BOOL[text]
    for pattern, base in ((_INT, 10), (_OCT, 8), (_HEX, 16)):
        if pattern.match(text):
            if len(text) > 40:
                raise ValueError("a number beyond 64 bits")
            number = int(text if base == 10 else text[2:], base)
            if abs(number) > MAX_INT:
                raise ValueError("a number beyond 64 bits")
            return number
    if _FLOAT.match(text):
        return float(text)
    return _ENDLESS.get(text.lower(), text)


def read_yaml(text: str | bytes, file: str) -> Source:
    """Read one document. Nothing is raised: what is wrong stands in the result's `problems`."""
    source = Source(file)
    if len(text) > MAX_BYTES:
        source.problems.append(
            Problem(file, 1, 1, "", f"is larger than {MAX_BYTES:,} bytes; is this a robot's config?")
        )
        source.complete = False
        return source
    if isinstance(text, bytes):
        raw = text
        try:
            text = raw.decode("utf-8-sig")
        except UnicodeDecodeError as error:
            before = raw[: error.start]
            column = error.start - (before.rfind(b"\n") + 1) + 1
            source.problems.append(
                Problem(file, before.count(b"\n") + 1, column, "", "is not UTF-8 text", "save the file as UTF-8")
            )
            source.complete = False
            return source
    _Reader(source).read(text)
    return source


class _Stop(Exception):
    """Reading cannot go on."""


class _Reader:
    def __init__(self, source: Source) -> None:
        self._source = source

    def read(self, text: str) -> None:
        from ruamel.yaml import YAML
        from ruamel.yaml.error import MarkedYAMLError, YAMLError

        source = self._source
        try:
            self._document(YAML(typ="safe", pure=True).parse(text))
        except _Stop:
            source.complete = False
        except MarkedYAMLError as error:
            mark = error.problem_mark or error.context_mark
            line, column = (mark.line + 1, mark.column + 1) if mark is not None else (1, 1)
            what = " ".join(str(part) for part in (error.context, error.problem) if part)
            source.problems.append(Problem(source.file, line, column, "", f"is not YAML: {what}", _syntax_hint(what)))
            source.complete = False
        except YAMLError as error:
            # characters that YAML forbids: the reader knows only how far it came
            at = getattr(error, "position", 0)
            before = text[:at] if isinstance(at, int) else ""
            source.problems.append(
                Problem(
                    source.file,
                    before.count("\n") + 1,
                    len(before) - (before.rfind("\n") + 1) + 1,
                    "",
                    f"is not YAML: {getattr(error, 'reason', error)}",
                )
            )
            source.complete = False

    def _document(self, events: Iterator[Any]) -> None:
        from ruamel.yaml.events import DocumentStartEvent, StreamEndEvent

        documents = 0
        for event in events:
            if isinstance(event, DocumentStartEvent):
                documents += 1
                if documents > 1:
                    self._refuse(event, (), "holds a second document (---)", "one file describes one robot")
                    raise _Stop
                if event.tags:
                    self._refuse(event, (), "declares tags (%TAG)", "remove the line")
                self._source.data = self._node(next(events), events, (), keep=True)
            elif isinstance(event, StreamEndEvent):
                return

    def _refuse(self, event: Any, path: Path, message: str, hint: str = "") -> None:
        self._source.problems.append(self._place(event).problem(path, message, hint))

    def _place(self, event: Any) -> Place:
        return Place(self._source.file, event.start_mark.line + 1, event.start_mark.column + 1)

    def _node(self, event: Any, events: Iterator[Any], path: Path, *, keep: bool) -> Any:
        from ruamel.yaml.events import AliasEvent, MappingStartEvent, ScalarEvent

        if keep:
            # an empty value has no place of its own: the parser would point at whatever follows
            empty = isinstance(event, ScalarEvent) and event.value == "" and event.style is None
            self._source.values[path] = self._source.key_place(path) if empty else self._place(event)
        if len(path) > MAX_DEPTH:
            self._refuse(event, path[:4], f"is nested deeper than {MAX_DEPTH} levels")
            raise _Stop
        if isinstance(event, AliasEvent):
            self._refuse(event, path, f"alias *{event.anchor} is not allowed in a config", "write the value here again")
            self._source.spoiled.add(path)
            return None
        if event.anchor is not None:
            self._refuse(event, path, f"anchor &{event.anchor} is not allowed in a config", "remove it")
        if getattr(event, "tag", None) is not None:
            self._refuse(event, path, f"tag {_short(event.tag)} is not allowed in a config", "write the plain value")
            self._source.spoiled.add(path)
        if isinstance(event, ScalarEvent):
            return self._scalar(event, path)
        if isinstance(event, MappingStartEvent):
            return self._mapping(events, path, keep=keep)
        return self._sequence(events, path, keep=keep)

    def _scalar(self, event: Any, path: Path) -> Scalar:
        if event.style is not None:
            text: str = event.value
            return text
        try:
            value = scalar(event.value)
        except ValueError as error:
            self._refuse(event, path, f"{event.value[:24]}... is {error}")
            self._source.spoiled.add(path)
            return None
        if isinstance(value, float) and not math.isfinite(value):
            self._refuse(event, path, f"{event.value} is not a finite number", "write the number that you mean")
            self._source.spoiled.add(path)
            return None
        return value

    def _sequence(self, events: Iterator[Any], path: Path, *, keep: bool) -> list[Any]:
        from ruamel.yaml.events import SequenceEndEvent

        items: list[Any] = []
        for event in events:
            if isinstance(event, SequenceEndEvent):
                break
            items.append(self._node(event, events, (*path, len(items)), keep=keep))
        return items

    def _mapping(self, events: Iterator[Any], path: Path, *, keep: bool) -> dict[str, Any]:
        from ruamel.yaml.events import MappingEndEvent, ScalarEvent

        found: dict[str, Any] = {}
        places: dict[str, Place] = {}
        for event in events:
            if isinstance(event, MappingEndEvent):
                break
            place = self._place(event)
            key: object = self._scalar(event, path) if isinstance(event, ScalarEvent) else None
            if getattr(event, "anchor", None) is not None:
                self._refuse(event, path, f"anchors and aliases are not allowed in a config ({event.anchor})")
            if not isinstance(key, str):
                text = event.value if isinstance(event, ScalarEvent) else "a list or mapping"
                self._refuse(event, path, f"the key {text!r} is not text", "put it in quotes if it is meant as a name")
                if not isinstance(event, ScalarEvent):
                    raise _Stop
                self._node(next(events), events, (*path, text), keep=False)
                continue
            if key in found:
                first = places[key]
                self._refuse(
                    event, (*path, key), f"duplicate key, it stands on line {first.line} already", "remove one of them"
                )
                self._node(next(events), events, (*path, key), keep=False)
                continue
            places[key] = place
            inner = (*path, key)
            if keep:
                self._source.keys[inner] = place
            found[key] = self._node(next(events), events, inner, keep=keep)
        return found


def _short(tag: object) -> str:
    return str(tag).replace("tag:yaml.org,2002:", "!!")


def _syntax_hint(what: str) -> str:
    if "'\\t'" in what or "\\t" in what:
        return "indent with spaces, not with tabs"
    if "mapping values are not allowed" in what:
        return "is a line indented too far, or does a text with ': ' need quotes?"
    return ""
