"""Reads the type arguments that an author wrote: `Behaviour[MyConfig, Sees]`."""

from __future__ import annotations

import typing
from typing import Any


def type_arguments(cls: type, root: type, example: str) -> tuple[Any, ...] | None:
    """Arguments given to `root[...]` among the direct bases of `cls`; None where a base already has them.

    Raises TypeError naming the class where nobody gave any.
    """
    for base in cls.__dict__.get("__orig_bases__", ()):
        origin = typing.get_origin(base)
        if isinstance(origin, type) and issubclass(origin, root):
            args = typing.get_args(base)
            if any(isinstance(arg, typing.TypeVar) or type(arg).__name__ == "TypeVar" for arg in args):
                return None
            return args
    if any(base is not root and issubclass(base, root) for base in cls.__bases__):
        return None
    raise TypeError(f"{cls.__qualname__}: say what it reads and takes, for example {example}")
