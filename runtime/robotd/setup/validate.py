"""From raw config values to a checked model, and from a model's complaints to problems at file, line and column."""

from __future__ import annotations

import json
import math
import types
import typing
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path as FilePath
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from robotd.authoring.config import FileKey
from robotd.setup.problems import Path, Problem
from robotd.setup.resources import find_shipped, shipped
from robotd.setup.words import as_number, meant_key, nearest, other_unit, suggestion
from robotd.setup.yaml_source import Source

ModelT = TypeVar("ModelT", bound=BaseModel)

_EXPECTED = {
    "float_type": "a number",
    "float_parsing": "a number",
    "int_type": "a whole number",
    "int_parsing": "a whole number",
    "int_from_float": "a whole number",
    "int_parsing_size": "a smaller number",
    "string_type": "text",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "dict_type": "a mapping",
    "model_type": "a mapping",
    "model_attributes_type": "a mapping",
    "dataclass_type": "a mapping",
    "list_type": "a list",
    "tuple_type": "a list",
    "set_type": "a list",
    "none_required": "nothing",
    "path_type": "a path",
}
_BOUNDS = {
    "greater_than": ("more than", "gt"),
    "greater_than_equal": ("at least", "ge"),
    "less_than": ("less than", "lt"),
    "less_than_equal": ("at most", "le"),
}
_NO_FILE = {"path_not_file": "file", "path_not_directory": "folder", "path_does_not_exist": "file"}
_BOOL_WORDS = {"yes": "true", "on": "true", "y": "true", "no": "false", "off": "false", "n": "false"}


@dataclass(slots=True)
class Checker:
    """Checks values of one source and gathers every problem.

    `folder`: what relative file names count from; None leaves them as they are.
    """

    source: Source
    folder: FilePath | None = None
    problems: list[Problem] = field(default_factory=list)

    def at_key(self, path: Path, message: str, hint: str = "") -> None:
        """A problem at the key that a path ends with."""
        if not self.source.is_spoiled(path):
            self.problems.append(self.source.key_place(path).problem(path, message, hint))

    def at_value(self, path: Path, message: str, hint: str = "") -> None:
        """A problem at the value of a path."""
        if not self.source.is_spoiled(path):
            self.problems.append(self.source.value_place(path).problem(path, message, hint))

    def model(
        self,
        cls: type[ModelT],
        raw: dict[str, Any],
        path: Path,
        also: Sequence[str] = (),
        excused: Collection[str | None] = (),
    ) -> ModelT | None:
        """A checked instance, or None after noting every problem.

        YAML's types are taken as they are: text is never read as a number, a bool is not a number, a whole number
        serves as float, lists become tuples. File names among the values are replaced in `raw` by the paths that they
        mean. `also`: keys that stand in the same mapping but belong to somebody else, for suggestions. `excused`:
        keys whose absence was reported already, as a misspelling.
        """
        before = len(self.problems)
        for name, info in _fields(cls).items():
            if name in raw:
                raw[name] = self._files(info.annotation, info.metadata, raw[name], (*path, name))
        try:
            instance = cls.model_validate_json(json.dumps(raw), strict=True)
        except ValidationError as error:
            self._refused(cls, error, raw, path, also, excused)
            return None
        return instance if len(self.problems) == before else None

    # ------------------------------------------------------------------------------------------- files

    def _files(self, kind: Any, marks: Sequence[Any], value: Any, path: Path) -> Any:
        origin = typing.get_origin(kind)
        if origin is Annotated:
            inner, *more = typing.get_args(kind)
            return self._files(inner, (*marks, *more), value, path)
        if isinstance(value, str):
            if origin in (typing.Union, types.UnionType):
                marked = [arm for arm in typing.get_args(kind) if _names_file(arm)]
                return self._files(marked[0], marks, value, path) if marked else self._file(marks, value, path)
            is_path = isinstance(kind, type) and issubclass(kind, FilePath)
            return self._file(marks, value, path, is_path=is_path)
        if isinstance(value, dict):
            for arm in _arms(kind):
                if isinstance(arm, type) and issubclass(arm, BaseModel):
                    for name, info in _fields(arm).items():
                        if name in value:
                            value[name] = self._files(info.annotation, info.metadata, value[name], (*path, name))
                elif typing.get_origin(arm) is not None and len(typing.get_args(arm)) == 2:
                    for name in value:
                        value[name] = self._files(typing.get_args(arm)[1], (), value[name], (*path, name))
        elif isinstance(value, list):
            for arm in _arms(kind):
                items = [a for a in typing.get_args(arm) if a is not Ellipsis]
                if len(items) == 1:
                    value = [self._files(items[0], (), item, (*path, i)) for i, item in enumerate(value)]
        return value

    def _file(self, marks: Sequence[Any], value: str, path: Path, *, is_path: bool = False) -> str:
        key = next((mark for mark in marks if isinstance(mark, FileKey)), None)
        if key is None and not is_path:
            return value
        given = FilePath(value).expanduser()
        full = given if self.folder is None else self.folder / given
        if key is None or full.is_file():
            return str(full)
        if key.shelf and given.name == value and find_shipped(key.shelf, value, key.suffix) is not None:
            return value
        names = [name.removesuffix(key.suffix) for name in shipped(key.shelf, key.suffix)] if key.shelf else []
        near = nearest(given.name.removesuffix(key.suffix), names) or _neighbour(full, given)
        hint = f"did you mean '{near}'?" if near else f"shipped {key.shelf}: {', '.join(names)}" if names else ""
        self.at_value(path, f"there is no file '{value}' (expected a path, relative to this config)", hint)
        return value

    # ------------------------------------------------------------------------------------------ errors

    def _refused(
        self,
        cls: type[BaseModel],
        error: ValidationError,
        raw: Any,
        path: Path,
        also: Sequence[str],
        excused: Collection[str | None],
    ) -> None:
        found = _one_arm(_Fault.of(item, raw) for item in error.errors(include_url=False))
        meant = {
            fault.place: meant_key(str(fault.place[-1]), self._known(cls, fault.place[:-1], also))
            for fault in found
            if fault.type == "extra_forbidden"
        }
        renamed = {(*place[:-1], key) for place, key in meant.items() if key is not None}
        renamed |= {(key,) for key in excused if key is not None}
        for fault in found:
            where = (*path, *fault.place)
            if fault.type == "extra_forbidden":
                known = self._known(cls, fault.place[:-1], also)
                self.at_key(where, "unknown key", suggestion(str(fault.place[-1]), known, fault.value))
            elif fault.type == "union_tag_not_found":
                # nothing more is known of this mapping until the key that chooses is right
                known = self._known(cls, fault.place[:-1], ())
                slip = [key for key in fault.value if key not in known and meant_key(key, known) == fault.place[-1]]
                if slip:
                    self.at_key((*where[:-1], slip[0]), "unknown key", suggestion(slip[0], known))
                else:
                    self.at_key(where, "is missing")
            elif fault.type == "missing":
                # a misspelt key is one mistake, not two
                if fault.place not in renamed:
                    info = _field_at(cls, fault.place)
                    about = info.description.strip().split("\n")[0].rstrip(".") if info and info.description else ""
                    self.at_key(where, f"is missing ({about[:1].lower()}{about[1:]})" if about else "is missing")
            else:
                message, hint = _words(fault, _field_at(cls, fault.place), str(where[-1]) if where else "")
                self.at_value(where, message, hint)

    def _known(self, cls: type[BaseModel], place: Path, also: Sequence[str]) -> list[str]:
        names = [name for model in _models_at(cls, place) for name in _fields(model)]
        return list(dict.fromkeys([*names, *(also if not place else ())]))


@dataclass(frozen=True, slots=True)
class _Fault:
    """One complaint of a model. `place`: keys and indices that exist in the data (and perhaps a missing last key);
    `arm`: where in the data a union was met and which of its arms complains."""

    place: Path
    type: str
    value: Any
    context: dict[str, Any]
    text: str
    expected: str
    arm: tuple[Path, str] | None

    @classmethod
    def of(cls, item: Any, raw: Any) -> _Fault:
        place: list[str | int] = []
        arm: tuple[Path, str] | None = None
        node, loc = raw, item["loc"]
        for i, step in enumerate(loc):
            inside = (isinstance(node, dict) and step in node) or (
                isinstance(node, list) and isinstance(step, int) and step < len(node)
            )
            if inside:
                place.append(step)
                node = node[step]
            elif item["type"] == "missing" and i == len(loc) - 1:
                place.append(step)
            elif arm is None:
                arm = (tuple(place), str(step))
        kind, context = item["type"], item.get("ctx", {})
        if kind in ("union_tag_invalid", "union_tag_not_found"):
            # pydantic blames the whole mapping, a person looks at the key that chooses
            place.append(str(context["discriminator"]).strip("'"))
            node = node.get(place[-1]) if kind == "union_tag_invalid" and isinstance(node, dict) else node
        text = str(context["error"]) if "error" in context else item["msg"].removeprefix("Value error, ")
        expected = _EXPECTED.get(kind, "")
        if kind in ("literal_error", "enum", "union_tag_invalid"):
            expected = str(context.get("expected", context.get("expected_tags", "")))
        return cls(tuple(place), kind, node, context, text, expected, arm)


def _one_arm(faults: Iterable[_Fault]) -> list[_Fault]:
    """Of a union's arms keep the complaints of the nearest one; arms that all refuse the value itself are joined."""
    kept: list[_Fault] = []
    unions: dict[Path, dict[str, list[_Fault]]] = {}
    for fault in faults:
        if fault.arm is None:
            kept.append(fault)
        else:
            unions.setdefault(fault.arm[0], {}).setdefault(fault.arm[1], []).append(fault)
    for place, arms in unions.items():
        outright = [f for told in arms.values() for f in told if f.place == place and f.type in _EXPECTED]
        if len(outright) == len(arms) and len(arms) > 1:
            first = outright[0]
            expected = " or ".join(dict.fromkeys(f.expected for f in outright))
            kept.append(_Fault(place, first.type, first.value, first.context, first.text, expected, None))
        else:
            candidates = list(arms.values())
            deeper = [told for told in candidates if not any(f in outright for f in told)]
            least: list[_Fault] = min(deeper if deeper else candidates, key=len)
            kept += least
    return kept


def _words(fault: _Fault, info: FieldInfo | None, key: str) -> tuple[str, str]:
    """Message and hint for a value that is there and wrong."""
    value = fault.value
    if fault.type in _BOUNDS:
        name = _BOUNDS[fault.type][1]
        bounds = dict(_bounds(info)) or {name: float(fault.context[name])}
        low = bounds.get("ge", bounds.get("gt", -math.inf))
        high = bounds.get("le", bounds.get("lt", math.inf))
        if "ge" in bounds and "le" in bounds:
            expected = f"{low:g} to {high:g}"
        else:
            expected = ", ".join(f"{text} {bounds[mark]:g}" for text, mark in _BOUNDS.values() if mark in bounds)
        return f"is {value!r} (expected {expected})", other_unit(float(value), key, low, high)
    if fault.type in _NO_FILE:
        return f"there is no {_NO_FILE[fault.type]} '{value}'", ""
    if fault.type in ("literal_error", "enum", "union_tag_invalid"):
        words = [word for word in fault.expected.replace(" or ", ", ").replace("'", "").split(", ") if word]
        near = nearest(value, words) if isinstance(value, str) else None
        return f"is {said(value)} (expected {fault.expected})", f"did you mean '{near}'?" if near else ""
    if fault.type in ("too_long", "too_short"):
        most = fault.type == "too_long"
        bound = fault.context["max_length" if most else "min_length"]
        has = len(value) if isinstance(value, list | dict) else fault.context.get("actual_length")
        return f"has {has} entries (expected at {'most' if most else 'least'} {bound})", ""
    if fault.expected:
        hint = ""
        if isinstance(value, str):
            if "number" in fault.expected:
                hint = as_number(value, key)
            elif fault.expected == "true or false" and value.lower() in _BOOL_WORDS:
                hint = f"write {_BOOL_WORDS[value.lower()]} (this is YAML 1.2)"
            elif fault.expected == "true or false" and value.lower() in ("true", "false"):
                hint = f"write it without quotes: {value.lower()}"
        elif fault.expected == "text" and isinstance(value, int | float):
            hint = "put it in quotes"
        return f"is {said(value)} (expected {fault.expected})", hint
    text = fault.text[:1].lower() + fault.text[1:]
    return (text if fault.type == "value_error" or isinstance(value, dict) else f"is {said(value)}: {text}"), ""


def said(value: object) -> str:
    """A value as a person would say what it is."""
    match value:
        case None:
            return "empty"
        case bool():
            return str(value).lower()
        case str():
            return f"the text {value if len(value) <= 40 else value[:37] + '...'!r}"
        case list():
            return f"a list of {len(value)}"
        case dict():
            return "a mapping"
    return repr(value)


# ----------------------------------------------------------------------------------------- looking into models


def _fields(cls: type[BaseModel]) -> dict[str, FieldInfo]:
    return {info.alias or name: info for name, info in cls.model_fields.items()}


def _arms(kind: Any) -> list[Any]:
    """The alternatives of an annotation, without Annotated around them."""
    origin = typing.get_origin(kind)
    if origin is Annotated:
        return _arms(typing.get_args(kind)[0])
    if origin in (typing.Union, types.UnionType):
        return [arm for part in typing.get_args(kind) for arm in _arms(part)]
    return [kind]


def _names_file(kind: Any) -> bool:
    if typing.get_origin(kind) is Annotated:
        inner, *marks = typing.get_args(kind)
        return any(isinstance(mark, FileKey) for mark in marks) or _names_file(inner)
    return isinstance(kind, type) and issubclass(kind, FilePath)


def _step(kinds: Iterable[Any], step: str | int) -> list[Any]:
    found: list[Any] = []
    for kind in kinds:
        for arm in _arms(kind):
            if isinstance(arm, type) and issubclass(arm, BaseModel):
                info = _fields(arm).get(step) if isinstance(step, str) else None
                found += [info.annotation] if info is not None else []
                continue
            items = [a for a in typing.get_args(arm) if a is not Ellipsis]
            if isinstance(step, int) and items:
                found.append(items[step] if step < len(items) else items[-1])
            elif isinstance(step, str) and len(items) == 2:
                found.append(items[1])
    return found


def _models_at(cls: type[BaseModel], place: Path) -> list[type[BaseModel]]:
    kinds: list[Any] = [cls]
    for step in place:
        kinds = _step(kinds, step)
    return [arm for kind in kinds for arm in _arms(kind) if isinstance(arm, type) and issubclass(arm, BaseModel)]


def _field_at(cls: type[BaseModel], place: Path) -> FieldInfo | None:
    if not place:
        return None
    last = str(place[-1])
    return next((known[last] for known in map(_fields, _models_at(cls, place[:-1])) if last in known), None)


def _bounds(info: FieldInfo | None) -> Iterator[tuple[str, float]]:
    for mark in info.metadata if info is not None else ():
        for name in ("ge", "gt", "le", "lt"):
            bound = getattr(mark, name, None)
            if isinstance(bound, int | float):
                yield name, float(bound)


def _neighbour(full: FilePath, given: FilePath) -> str | None:
    """The file in the named folder that is most like one that does not exist, as it would stand in the config."""
    if not full.parent.is_dir():
        return None
    near = nearest(given.name, sorted(file.name for file in full.parent.iterdir() if file.is_file()))
    return str(given.with_name(near)) if near is not None else None
