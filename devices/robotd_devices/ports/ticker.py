"""A device's own beat on any asyncio loop, real or virtual."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from robotd.world.clock import NS_PER_S, ns


class Ticker:
    """Calls `action` at start + n periods, n = 1, 2, ...; deadlines are computed from the whole number n.

    `delay_s` shifts all of them. A beat that is already over when the loop comes round is left out, never caught up;
    on a virtual loop that does not happen.
    """

    def __init__(self, period_s: float, action: Callable[[], None], delay_s: float = 0.0) -> None:
        self.period_ns = max(1, ns(period_s))
        self._action = action
        self._delay_s = delay_s
        self._n = 0
        self._start_s = 0.0
        self._handle: asyncio.TimerHandle | None = None

    def start(self) -> None:
        """Begin to count now, on the running loop."""
        self.stop()
        self._start_s = asyncio.get_running_loop().time() + self._delay_s
        self._n = 0
        self._schedule()

    def stop(self) -> None:
        """No call after this one."""
        if self._handle is not None:
            self._handle.cancel()
            self._handle = None

    def _deadline_s(self, n: int) -> float:
        return self._start_s + n * self.period_ns / NS_PER_S

    def _schedule(self) -> None:
        loop = asyncio.get_running_loop()
        self._n += 1
        late_s = loop.time() - self._deadline_s(self._n)
        if late_s > 0.0:
            self._n += 1 + int(late_s * NS_PER_S) // self.period_ns
        self._handle = loop.call_at(self._deadline_s(self._n), self._fire)

    def _fire(self) -> None:
        self._schedule()
        self._action()
