"""Waiting for what threads and other programs bring about, where no event of the loop tells of it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable


async def until(done: Callable[[], object], within_s: float = 5.0) -> None:
    """Let the loop run until `done()`; raises TimeoutError where it does not come."""
    async with asyncio.timeout(within_s):
        while not done():  # noqa: ASYNC110
            await asyncio.sleep(0.001)
