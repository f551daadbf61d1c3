"""Messages to bytes and back, exactly: the form in which a recording keeps every input of every turn.

Layout of one value: version byte (1), length of the head as little-endian uint32, the head as ASCII JSON, then the raw
bytes of its arrays one after the other, in the order in which the head names them. In the head a JSON list is a tuple,
and an object has one key that says what it is:

    {"c": ["module:QualName", {field: value}]}   dataclass        {"e": ["module:QualName", name]}      enum member
    {"m": ["module:QualName", {..}, [set..]]}    pydantic model   {"x": "7ff8000000000000"}             inf or nan
    {"a": [dtype, shape, order, bytes]}          array            {"s": [dtype, [], "C", bytes]}        numpy scalar
    {"b": bytes}  bytes      {"l": [..]}  list   {"d": [[key, value], ..]}  dict   {"f": [..]}  frozenset

Decoding looks classes up in the table that the caller gives, and nowhere else: a recording can name no code. It fills
fields without calling `__init__`, so that nothing is computed anew. Arrays come back read-only, aligned, and in C or
Fortran order as they were; other strides become C order.
"""

from __future__ import annotations

import dataclasses
import enum
import json
import math
import re
import struct
import typing
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from numpy.lib.format import descr_to_dtype, dtype_to_descr
from pydantic import BaseModel

VERSION = 1
_HEAD = struct.Struct("<BI")
_DOUBLE = struct.Struct(">d")
_DAMAGE = (ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError, SyntaxError, struct.error)
"""What Python and numpy raise over a head that is JSON but makes no sense."""
_DTYPE = re.compile(r"[<>|][?biufcSUVmM]\d*(\[\w+\])?")
_PLAIN = (str, int, bool, type(None))


class RecordError(ValueError):
    """Something that cannot be recorded, or bytes that are no recording; the message says what and where."""


def class_name(cls: type) -> str:
    """The name under which a class stands in a recording."""
    return f"{cls.__module__}:{cls.__qualname__}"


def allow(*roots: type) -> dict[str, type]:
    """The table for `decode`: the given classes, and the dataclasses, models and enums that their fields name."""
    table: dict[str, type] = {}
    waiting: list[Any] = list(roots)
    while waiting:
        item = waiting.pop()
        waiting.extend(typing.get_args(item))
        if not isinstance(item, type) or not _is_recordable(item) or class_name(item) in table:
            continue
        table[class_name(item)] = item
        if not issubclass(item, enum.Enum):
            waiting.extend(_hints(item).values())
    return table


def _is_recordable(cls: type) -> bool:
    return dataclasses.is_dataclass(cls) or issubclass(cls, enum.Enum | BaseModel)


def _hints(cls: type) -> dict[str, Any]:
    try:
        return typing.get_type_hints(cls)
    except NameError:
        # a class local to a function may name neighbours that cannot be seen from here; the caller lists those
        return {}


# ---------------------------------------------------------------------------------------------- encode


def encode(value: object) -> bytes:
    """One value as bytes. Raises RecordError naming the field that cannot be kept."""
    blobs: list[bytes] = []
    head = json.dumps(_pack(value, "", blobs), separators=(",", ":"), allow_nan=False).encode("ascii")
    return b"".join((_HEAD.pack(VERSION, len(head)), head, *blobs))


def _pack(value: Any, path: str, blobs: list[bytes]) -> Any:
    cls = type(value)
    if cls in _PLAIN:
        return value
    if cls is float:
        return value if math.isfinite(value) else {"x": _DOUBLE.pack(value).hex()}
    if cls is tuple:
        return [_pack(item, f"{path}[{i}]", blobs) for i, item in enumerate(value)]
    pack = _PACKERS.get(cls)
    if pack is not None:
        return pack(value, path, blobs)
    if isinstance(value, enum.Enum):
        kept: Any = value.value if isinstance(value, enum.Flag) else value.name
        return {"e": [class_name(cls), kept]}
    if dataclasses.is_dataclass(cls):
        return {"c": [class_name(cls), {n: _pack(getattr(value, n), f"{path}.{n}", blobs) for n in _fields(cls)}]}
    if isinstance(value, BaseModel):
        kept = {n: _pack(getattr(value, n), f"{path}.{n}", blobs) for n in cls.model_fields}
        return {"m": [class_name(cls), kept, sorted(value.model_fields_set)]}
    if isinstance(value, np.generic):
        return {"s": _pack_array(np.asarray(value), path, blobs)}
    raise RecordError(f"{path.lstrip('.') or 'the value'}: a {class_name(cls)} cannot be recorded")


def _pack_array(array: np.ndarray[Any, Any], path: str, blobs: list[bytes]) -> list[Any]:
    if array.dtype.hasobject:
        raise RecordError(f"{path.lstrip('.') or 'the value'}: an array of Python objects cannot be recorded")
    order: typing.Literal["C", "F"] = "F" if array.flags.f_contiguous and not array.flags.c_contiguous else "C"
    blobs.append(array.tobytes(order))
    return [dtype_to_descr(array.dtype), list(array.shape), order, array.nbytes]


def _pack_bytes(value: bytes, path: str, blobs: list[bytes]) -> dict[str, Any]:
    blobs.append(value)
    return {"b": len(value)}


def _pack_items(tag: str) -> Callable[[Any, str, list[bytes]], dict[str, Any]]:
    def pack(value: Any, path: str, blobs: list[bytes]) -> dict[str, Any]:
        return {tag: [_pack(item, f"{path}[{i}]", blobs) for i, item in enumerate(value)]}

    return pack


def _pack_dict(value: dict[Any, Any], path: str, blobs: list[bytes]) -> dict[str, Any]:
    return {"d": [[_pack(k, path, blobs), _pack(v, f"{path}[{k!r}]", blobs)] for k, v in value.items()]}


_PACKERS: dict[type, Callable[[Any, str, list[bytes]], Any]] = {
    np.ndarray: lambda value, path, blobs: {"a": _pack_array(value, path, blobs)},
    bytes: _pack_bytes,
    list: _pack_items("l"),
    frozenset: _pack_items("f"),
    dict: _pack_dict,
}

_FIELDS: dict[type, tuple[str, ...]] = {}


def _fields(cls: type) -> tuple[str, ...]:
    names = _FIELDS.get(cls)
    if names is None:
        names = _FIELDS[cls] = tuple(field.name for field in dataclasses.fields(cls))
    return names


# ---------------------------------------------------------------------------------------------- decode


def decode(data: bytes, classes: Mapping[str, type]) -> Any:
    """The value that `encode` was given. `classes`: see `allow`. Raises RecordError naming the offset in `data`."""
    if len(data) < _HEAD.size:
        raise RecordError(f"byte {len(data)}: cut off, a value begins with {_HEAD.size} bytes")
    version, length = _HEAD.unpack_from(data)
    if version != VERSION:
        raise RecordError(f"byte 0: version {version}, this program reads version {VERSION}")
    begin, end = _HEAD.size, _HEAD.size + length
    if len(data) < end:
        raise RecordError(f"byte {len(data)}: cut off, the head should end at byte {end}")
    try:
        head = json.loads(data[begin:end].decode("ascii"))
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        at = error.start if isinstance(error, UnicodeDecodeError) else error.pos
        raise RecordError(f"byte {begin + at}: the head is no JSON: {error}") from error
    except (ValueError, RecursionError) as error:
        raise RecordError(f"byte {begin}: the head cannot be read: {error}") from error
    unpacker = _Unpacker(data, end, classes)
    try:
        value = unpacker.unpack(head)
    except RecordError:
        raise
    except _DAMAGE as error:
        raise RecordError(f"byte {unpacker.at}: {type(error).__name__}: {error}") from error
    if unpacker.at != len(data):
        raise RecordError(f"byte {unpacker.at}: {len(data) - unpacker.at} bytes too many")
    return value


class _Unpacker:
    """`at`: where the next array's bytes begin."""

    def __init__(self, data: bytes, at: int, classes: Mapping[str, type]) -> None:
        self.data = data
        self.at = at
        self.classes = classes

    def unpack(self, node: Any) -> Any:
        if isinstance(node, list):
            return tuple([self.unpack(item) for item in node])
        if not isinstance(node, dict):
            return node
        if len(node) != 1:
            raise self.error(f"expected an object with one key, got {sorted(node)}")
        ((tag, body),) = node.items()
        method = _UNPACKERS.get(tag)
        if method is None:
            raise self.error(f"unknown kind {tag!r}")
        return method(self, body)

    def error(self, what: str) -> RecordError:
        return RecordError(f"byte {self.at}: {what}")

    def take(self, count: Any) -> bytes:
        if not isinstance(count, int) or count < 0 or self.at + count > len(self.data):
            raise self.error(f"cut off, expected {count} more bytes, there are {len(self.data) - self.at}")
        self.at += count
        return self.data[self.at - count : self.at]

    def cls(self, name: Any, kind: str) -> Any:
        found = self.classes.get(name) if isinstance(name, str) else None
        if found is None:
            raise self.error(f"class {name!r} is not among the {len(self.classes)} that this robot may load")
        fits = {
            "c": dataclasses.is_dataclass(found),
            "e": issubclass(found, enum.Enum),
            "m": issubclass(found, BaseModel),
        }
        if not fits[kind]:
            raise self.error(f"class {name!r} is not of the recorded kind {kind!r}")
        return found

    def array(self, body: Any) -> np.ndarray[Any, Any]:
        descr, shape, order, size = body
        dtype = descr_to_dtype(_tuples(descr))
        if dtype.hasobject or order not in ("C", "F") or any(type(n) is not int or n < 0 for n in shape):
            raise self.error(f"impossible array {body!r}")
        if math.prod(shape) * dtype.itemsize != size:
            raise self.error(f"an array of {descr} {shape} has not {size} bytes")
        raw = self.take(size)
        array = np.empty(tuple(shape), dtype, order)
        if size:
            array[...] = np.ndarray(tuple(shape), dtype, raw, order=order)
        array.flags.writeable = False
        return array

    def dataclass(self, body: Any) -> Any:
        name, values = body
        cls = self.cls(name, "c")
        made = object.__new__(cls)
        known = {field.name: field for field in dataclasses.fields(cls)}
        if strange := sorted(values.keys() - known.keys()):
            raise self.error(f"{name} has no field {strange[0]!r}")
        unpacked = {key: self.unpack(value) for key, value in values.items()}
        for key, field in known.items():
            object.__setattr__(made, key, unpacked[key] if key in unpacked else self.default(name, field))
        return made

    def default(self, name: str, field: dataclasses.Field[Any]) -> Any:
        """For a field that came to the class after the recording was made."""
        if field.default is not dataclasses.MISSING:
            return field.default
        if field.default_factory is not dataclasses.MISSING:
            return field.default_factory()
        raise self.error(f"{name} lacks its field {field.name!r}")

    def model(self, body: Any) -> Any:
        name, values, was_set = body
        cls = self.cls(name, "m")
        if strange := sorted(values.keys() - cls.model_fields.keys()):
            raise self.error(f"{name} has no field {strange[0]!r}")
        unpacked = {key: self.unpack(value) for key, value in values.items()}
        for key, field in cls.model_fields.items():
            if key not in unpacked and field.is_required():
                raise self.error(f"{name} lacks its field {key!r}")
        made = cls.model_construct(**unpacked)
        object.__setattr__(made, "__pydantic_fields_set__", set(was_set))
        return made

    def member(self, body: Any) -> Any:
        name, kept = body
        cls = self.cls(name, "e")
        return cls(kept) if issubclass(cls, enum.Flag) else cls[kept]


def _tuples(descr: Any) -> Any:
    """JSON lists to the tuples and lists that numpy's own descriptions of dtypes are made of."""
    if isinstance(descr, str):
        if not _DTYPE.fullmatch(descr):
            raise ValueError(f"no dtype: {descr!r}")
        return descr
    if len(descr) == 2 and isinstance(descr[1], list) and all(isinstance(n, int) for n in descr[1]):
        return _tuples(descr[0]), tuple(descr[1])
    return [_field_tuple(field) for field in descr]


def _field_tuple(field: Any) -> tuple[Any, ...]:
    name, inner, *shape = field
    name = tuple(name) if isinstance(name, list) else name
    return (name, _tuples(inner), *(tuple(s) for s in shape))


_UNPACKERS: dict[str, Callable[[_Unpacker, Any], Any]] = {
    "c": _Unpacker.dataclass,
    "m": _Unpacker.model,
    "e": _Unpacker.member,
    "a": _Unpacker.array,
    "s": lambda self, body: self.array(body)[()],
    "b": lambda self, body: self.take(body),
    "x": lambda self, body: _DOUBLE.unpack(bytes.fromhex(body))[0],
    "l": lambda self, body: [self.unpack(item) for item in body],
    "f": lambda self, body: frozenset(self.unpack(item) for item in body),
    "d": lambda self, body: {self.unpack(key): self.unpack(value) for key, value in body},
}


# ----------------------------------------------------------------------------------------- for viewers

_VIEWER_ITEMS = 400
"""A viewer's copy of an array has at most about this many numbers; every n-th is kept."""


def to_viewer_json(message: object) -> str:
    """A copy for people's viewers: thinned and rounded to 5 decimals; null where a number is inf or nan.

    Arrays of more than one dimension (pictures) are described by dtype and shape instead.
    """
    return json.dumps(_view(message), separators=(",", ":"), allow_nan=False)


def _view(value: Any) -> Any:
    if isinstance(value, enum.Enum):
        return value.name.lower() if value.name else int(value.value)
    if value is None or isinstance(value, bool | str):
        return value
    if isinstance(value, np.ndarray):
        return _view_array(value)
    if isinstance(value, np.generic):
        return _view(value.item())
    if isinstance(value, int):
        return int(value)
    if isinstance(value, float):
        return round(float(value), 5) if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): _view(item) for key, item in value.items()}
    if isinstance(value, tuple | list | frozenset):
        return [_view(item) for item in value]
    names = _viewer_fields(value)
    return {name: _view(getattr(value, name)) for name in names} if names is not None else repr(value)


def _viewer_fields(value: Any) -> tuple[str, ...] | None:
    if dataclasses.is_dataclass(type(value)):
        return _fields(type(value))
    return tuple(type(value).model_fields) if isinstance(value, BaseModel) else None


def _view_array(array: np.ndarray[Any, Any]) -> Any:
    if array.ndim > 1 or array.dtype.kind not in "biuf":
        return {"dtype": str(array.dtype), "shape": list(array.shape)}
    thinned = np.atleast_1d(array)[:: -(-array.size // _VIEWER_ITEMS) or 1]
    if array.dtype.kind == "f":
        return [number if math.isfinite(number) else None for number in np.round(thinned.astype(float), 5).tolist()]
    return thinned.tolist()


def viewer_schema(cls: type) -> dict[str, Any]:
    """A JSON Schema of `to_viewer_json` for one class, so that viewers can offer its fields."""
    if not dataclasses.is_dataclass(cls):
        return {"type": "object", "title": cls.__name__}
    hints = _hints(cls)
    properties = {name: dict(_schema_of(hints.get(name))) for name in _fields(cls)}
    return {"type": "object", "title": cls.__name__, "properties": properties}


def _schema_of(hint: Any) -> Iterator[tuple[str, Any]]:
    kinds = {int: "integer", float: "number", str: "string", bool: "boolean"}
    if hint in kinds:
        yield "type", kinds[hint]
    elif isinstance(hint, type) and issubclass(hint, enum.Enum):
        yield "type", "string"
    elif "ndarray" in str(hint).lower():
        # an alias from numpy 2.5 on, `numpy.ndarray[...]` before
        yield from (("type", "array"), ("items", {"type": "number"}))
    elif isinstance(hint, type) and dataclasses.is_dataclass(hint):
        yield from viewer_schema(hint).items()
