"""Tests on virtual time: an hour passes in a moment, and in the same order each time."""

from __future__ import annotations

import asyncio
import functools
from collections.abc import Callable, Coroutine
from typing import Any, ParamSpec

from typing_extensions import TypeVar

from robotd.engine.loops import virtual_loop

T = TypeVar("T")
P = ParamSpec("P")


def run_virtual(main: Coroutine[Any, Any, T], *, pace: float | None = None, start_ns: int = 0) -> T:
    """Run a coroutine to its end on a new virtual loop and return its result.

    pace: virtual seconds per wall second, None for as fast as possible. Raises what `main` raises, and
    `VirtualDeadlock` where it would wait for ever.
    """
    with asyncio.Runner(loop_factory=lambda: virtual_loop(pace, start_ns)) as runner:
        return runner.run(main)


def virtual_time(test: Callable[P, Coroutine[Any, Any, T]]) -> Callable[P, T]:
    """Decorator: an `async def` test becomes an ordinary one that runs on virtual time; fixtures work as before."""

    @functools.wraps(test)
    def inside(*args: P.args, **kwargs: P.kwargs) -> T:
        return run_virtual(test(*args, **kwargs))

    return inside
