"""From JSON text to plain data and the place of every key and value (RFC 8259), listing what is wrong with it.

The standard library's reader knows neither where a value stood nor that a key was there twice, and it takes NaN.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, field
from typing import Any, NoReturn

from robotd.setup.problems import Path

MAX_DEPTH = 24

_SPACE = re.compile(r"[ \t\r\n]*")
_NUMBER = re.compile(r"-?(?:0|[1-9][0-9]*)(\.[0-9]+)?([eE][-+]?[0-9]+)?")
_STRING = re.compile(r'"(?:[^"\\\x00-\x1f]|\\(?:["\\/bfnrt]|u[0-9a-fA-F]{4}))*"')
_ENDLESS = re.compile(r"[-+]?(?:NaN|nan|Infinity|inf)\b")
_WORDS = {"true": True, "false": False, "null": None}


@dataclass(frozen=True, slots=True)
class Mistake:
    """One thing that is wrong with the text, at an offset."""

    code: str
    path: Path
    message: str
    offset: int


@dataclass(slots=True)
class JsonSource:
    """Plain data with the offset of each key and value in `text`.

    spoiled: paths whose value is a stand-in (None) because the real one was refused; whoever checks further says
    nothing about them. complete: False where a mistake ended the reading.
    """

    text: str
    data: Any = None
    keys: dict[Path, int] = field(default_factory=dict)
    values: dict[Path, int] = field(default_factory=dict)
    mistakes: list[Mistake] = field(default_factory=list)
    spoiled: set[Path] = field(default_factory=set)
    complete: bool = True

    def offset(self, path: Path) -> int:
        """Where a value begins; of one that is not there, where the nearest thing above it begins."""
        while path and path not in self.values:
            path = path[:-1]
        return self.values.get(path, 0)

    def line_column(self, offset: int) -> tuple[int, int]:
        """Line and column of an offset, both from 1."""
        return self.text.count("\n", 0, offset) + 1, offset - (self.text.rfind("\n", 0, offset) + 1) + 1


class _Stop(Exception):
    """Reading cannot go on."""


def read_json(text: str) -> JsonSource:
    """Read one JSON text. Nothing is raised; the result's `mistakes` have the codes `json_malformed`, `json_too_deep`,
    `json_duplicate_key` and `number_not_finite`."""
    source = JsonSource(text)
    try:
        _Reader(source).read()
    except _Stop:
        source.complete = False
    return source


class _Reader:
    def __init__(self, source: JsonSource) -> None:
        self._source = source
        self._text = source.text
        self._pos = 0

    def read(self) -> None:
        self._skip()
        self._source.data = self._value(())
        self._skip()
        if self._pos < len(self._text):
            self._stop((), "text goes on after the end of the JSON value")

    def _tell(self, code: str, path: Path, message: str, offset: int) -> None:
        self._source.mistakes.append(Mistake(code, path, message, offset))

    def _stop(self, path: Path, message: str, code: str = "json_malformed") -> NoReturn:
        self._tell(code, path, message, self._pos)
        raise _Stop

    def _skip(self) -> str:
        """Move past white space; returns the next character, or an empty text at the end."""
        match = _SPACE.match(self._text, self._pos)
        assert match is not None
        self._pos = match.end()
        return self._text[self._pos : self._pos + 1]

    def _value(self, path: Path) -> Any:
        if len(path) > MAX_DEPTH:
            self._stop(path, f"is nested deeper than {MAX_DEPTH} levels", "json_too_deep")
        begin = self._source.values[path] = self._pos
        first = self._skip()
        if first == "{":
            return self._object(path)
        if first == "[":
            return self._array(path)
        if first == '"':
            return self._string(path)
        for word, meaning in _WORDS.items():
            if self._text.startswith(word, self._pos):
                self._pos += len(word)
                return meaning
        if endless := _ENDLESS.match(self._text, self._pos):
            self._pos = endless.end()
            return self._refuse(path, f"{endless[0]} is not a number of JSON", begin)
        number = _NUMBER.match(self._text, self._pos)
        if number is None:
            self._stop(path, f"a value was expected, not {first!r}" if first else "the text ends within a value")
        self._pos = number.end()
        if len(number[0]) > 40:
            return self._refuse(path, "a number of more than 40 digits is not one for a map", begin)
        value = float(number[0]) if number[1] or number[2] else int(number[0])
        if value in (float("inf"), float("-inf")):
            return self._refuse(path, f"{number[0]} is beyond the largest number", begin)
        return value

    def _refuse(self, path: Path, message: str, begin: int) -> None:
        self._tell("number_not_finite", path, message, begin)
        self._source.spoiled.add(path)

    def _string(self, path: Path) -> str:
        match = _STRING.match(self._text, self._pos)
        if match is None:
            self._stop(path, "a text is not closed, or holds a line break or an escape that JSON does not know")
        self._pos = match.end()
        text: str = json.loads(match[0])
        return text

    def _object(self, path: Path) -> dict[str, Any]:
        found: dict[str, Any] = {}
        self._pos += 1
        if self._skip() == "}":
            self._pos += 1
            return found
        while True:
            if self._skip() != '"':
                self._stop(path, "a key in double quotes was expected")
            begin = self._pos
            key = self._string(path)
            inner = (*path, key)
            if key in found:
                self._tell("json_duplicate_key", inner, f"the key {key!r} is there twice", begin)
            self._source.keys[inner] = begin
            if self._skip() != ":":
                self._stop(inner, f"a colon was expected after the key {key!r}")
            self._pos += 1
            self._skip()
            found[key] = self._value(inner)
            if self._more(path, "}"):
                return found

    def _array(self, path: Path) -> list[Any]:
        found: list[Any] = []
        self._pos += 1
        if self._skip() == "]":
            self._pos += 1
            return found
        while True:
            self._skip()
            found.append(self._value((*path, len(found))))
            if self._more(path, "]"):
                return found

    def _more(self, path: Path, end: str) -> bool:
        """Move past a comma (False) or the end (True)."""
        after = self._skip()
        if after not in (",", end) or not after:
            self._stop(
                path, f"',' or '{end}' was expected" + (f", not {after!r}" if after else " before the text ends")
            )
        self._pos += 1
        return after == end
