"""Slow perceptors off the loop: a worker thread each in real time, a declared latency in virtual time."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

from robotd.authoring.view import View
from robotd.engine.contracts import Timers
from robotd.engine.nodes import PerceptorNode
from robotd.world.clock import ns
from robotd.world.messages import Message

Finished = Callable[[PerceptorNode, "Message | str | None", int], None]


def _step(node: PerceptorNode, view: View) -> Message | str | None:
    try:
        return node.perceptor.step(view)
    except Exception as error:
        return f"{type(error).__name__}: {error}"


class ThreadOffloader:
    """One worker thread a perceptor, so that a slow one never makes another wait."""

    def __init__(self, loop: asyncio.AbstractEventLoop, finished: Finished) -> None:
        self._loop = loop
        self._finished = finished
        self._workers: dict[str, ThreadPoolExecutor] = {}

    def submit(self, node: PerceptorNode, view: View, oldest_ns: int, now_ns: int) -> None:
        worker = self._workers.get(node.name)
        if worker is None:
            worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix=f"robotd-{node.name}")
            self._workers[node.name] = worker

        def run() -> None:
            result = _step(node, view)
            if not self._loop.is_closed():
                self._loop.call_soon_threadsafe(self._finished, node, result, oldest_ns)

        worker.submit(run)

    def close(self) -> None:
        """Waits for nobody: what still runs ends with its process."""
        for worker in self._workers.values():
            worker.shutdown(wait=False, cancel_futures=True)


class VirtualOffloader:
    """Computes at once, answers `sim_latency_s` later: the same in every run, at any pace."""

    def __init__(self, timers: Timers, finished: Finished) -> None:
        self._timers = timers
        self._finished = finished

    def submit(self, node: PerceptorNode, view: View, oldest_ns: int, now_ns: int) -> None:
        result = _step(node, view)
        self._timers.call_at_ns(now_ns + ns(node.sim_latency_s), self._finished, node, result, oldest_ns)

    def close(self) -> None:
        """Nothing runs in the background."""
