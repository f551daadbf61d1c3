"""Plain example messages and views, so that a contract can be checked without knowing the plugin."""

from __future__ import annotations

import dataclasses
import enum
import re
import types
import typing
from typing import Any

import numpy as np
from typing_extensions import TypeVar

from robotd.authoring.view import View, Wake
from robotd.testing.failure import fail
from robotd.testing.scans import box_scan
from robotd.world.messages import CameraFrame, LidarScan, Message

MessageT = TypeVar("MessageT", bound=Message)
ViewT = TypeVar("ViewT", bound=View)


def example_message(message_type: type[MessageT], stamp_ns: int = 0) -> MessageT:
    """A harmless message: a box of 2 m about the lidar, a grey picture, zeros and empty words elsewhere.

    Raises CheckFailed for a type with a required field that it cannot guess.
    """
    made: Any
    if issubclass(message_type, LidarScan):
        made = box_scan(stamp_ns=stamp_ns)
    elif issubclass(message_type, CameraFrame):
        made = message_type(stamp_ns, np.full((48, 64, 3), 128, np.uint8))
    else:
        made = message_type(**{**_required(message_type), "stamp_ns": stamp_ns})
    return typing.cast(MessageT, made)


def _required(cls: type[Any]) -> dict[str, Any]:
    hints = typing.get_type_hints(cls)
    return {
        field.name: _plain(cls, field.name, hints[field.name])
        for field in dataclasses.fields(cls)
        if field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING
    }


def _plain(cls: type[Any], name: str, hint: Any) -> Any:
    origin = typing.get_origin(hint) or hint
    if origin in (typing.Union, types.UnionType):
        options = typing.get_args(hint)
        return None if type(None) in options else _plain(cls, name, options[0])
    if "ndarray" in str(hint).lower():
        # an alias from numpy 2.5 on, `numpy.ndarray[...]` before; either way the scalar type stands last in it
        named = [getattr(np, word, None) for word in re.findall(r"numpy\.(\w+)", str(hint))]
        scalars = [kind for kind in named if isinstance(kind, type) and issubclass(kind, np.generic)]
        return np.zeros(4, scalars[-1] if scalars else np.float64)
    if isinstance(origin, type):
        if issubclass(origin, enum.Enum):
            return next(iter(origin))
        if dataclasses.is_dataclass(origin):
            return origin(**_required(origin))
        if origin in (int, float, str, bool, bytes, tuple, object):
            return None if origin is object else origin()
    return fail(cls, f"no example can be guessed for its field {name}: {hint!r}", "give make_view=")


def example_view(view_type: type[ViewT], now_ns: int = 0, *, with_latest: bool = True) -> ViewT:
    """A view of example messages, all stamped 1 ms ago; `with_latest=False` leaves the optional ones out."""
    stamp_ns = max(0, now_ns - 1_000_000)
    values = {
        spec.name: None if spec.wake is Wake.LATEST and not with_latest else example_message(spec.topic.type, stamp_ns)
        for spec in view_type.specs
    }
    return view_type.assemble(now_ns, values)
