"""One running robot: opens the devices, drives the turn and the act tick, restarts what may restart, always halts.

Everything runs in one task group. A sensor that goes away is reopened; a behaviour or perceptor that raises is benched
(both inside the turn); a bridge that raises is restarted. Anything else that breaks ends the group, and every way out
passes `halt`.
"""

from __future__ import annotations

import asyncio
import gc
import logging
import os
import signal
import socket
import sys
from collections.abc import Callable
from functools import partial
from typing import Any

from robotd.authoring.bridge import Bridge
from robotd.authoring.device import Actuator, DeviceContext, World
from robotd.engine.armed_mark import ArmedMark
from robotd.engine.contracts import Base, Journal
from robotd.engine.core import Core
from robotd.engine.devices import KeptDevice
from robotd.engine.graph import base_of, compile_graph
from robotd.engine.guarding import GUARDIAN, Guarding
from robotd.engine.handle import RuntimeHandle
from robotd.engine.loops import RobotLoop
from robotd.engine.nodes import Node, PerceptorNode
from robotd.engine.offload import ThreadOffloader, VirtualOffloader
from robotd.engine.parts import BridgePart, Parts
from robotd.safety.operator import Arm, Disarm
from robotd.world.clock import ns
from robotd.world.messages import EStopped, Event, Message

log = logging.getLogger("robotd")

GIVE_UP_S = 3.0
"""How long a needed device may be absent at start before robotd says so and exits."""
BRIDGE_BACKOFF_S = (0.2, 1.0, 5.0)
BRIDGE_END_S = 0.5
"""How long a bridge may take to end before it is told again."""
SECOND_STOP_AFTER_NS = 3_000_000
"""How long a driver may take for the stop of an e-stop until the guardian writes it as well."""
SUSPEND_AFTER_NS = 20_000_000
"""What a driver's writer thread has for the stop before the whole process stands still."""


class _NoBase:
    """Stands in where a config has no actuator: a robot that only watches."""

    def apply(self, command: object) -> None:
        pass

    def halt(self) -> None:
        pass

    def estop(self) -> None:
        pass


class Runtime:
    """Built from checked parts, run once."""

    def __init__(
        self,
        parts: Parts,
        *,
        journal: Journal | None = None,
        virtual: bool = False,
        arm: bool | None = None,
        mark: ArmedMark | None = None,
    ) -> None:
        self.parts = parts
        self.virtual = virtual
        self.journal = journal
        self.arm_when_ready = parts.arm_at_start if arm is None else arm
        self.mark = mark
        if mark is not None and mark.found and self.arm_when_ready:
            log.warning("the last run ended while the robot was armed: it waits for somebody to arm it")
            self.arm_when_ready = False
        self.tick_late_ns = 0
        self.ticks_missed = 0
        self.started_ns = 0
        self.core: Core
        self.devices: tuple[KeptDevice, ...] = ()
        self.world: World[Any] | None = None
        self.handle: RuntimeHandle
        self.guarding: Guarding | None = None
        self._loop: RobotLoop
        self._stopping: asyncio.Future[None]
        self._tick_timer: asyncio.TimerHandle | None = None
        self._timers: dict[int, asyncio.TimerHandle] = {}
        self._period_ns = ns(1.0 / parts.act_hz)

    def stop(self) -> None:
        """End the run as soon as the loop turns; safe to call more than once."""
        if not self._stopping.done():
            self._stopping.set_result(None)

    def fail(self, error: BaseException) -> None:
        """The turn itself broke: stop the motors at once, then end the run with this error."""
        self._halt()
        if self.journal is not None:
            self.journal.note("failed", "", self._loop.now_ns(), f"{type(error).__name__}: {error}")
        if not self._stopping.done():
            self._stopping.set_exception(error)

    async def run(self, on_started: Callable[[Runtime], None] | None = None) -> None:
        """Runs until `stop`, or raises what ended it. The base has been halted when this returns or raises."""
        loop: Any = asyncio.get_running_loop()
        self._loop = loop
        self._stopping = loop.create_future()
        await loop.run_in_executor(None, self._load)
        base = self._build(loop)
        try:
            self._start_guardian(base, loop)
            self.started_ns = loop.now_ns()
            if self.world is not None:
                await self.world.open()
            async with asyncio.TaskGroup() as group:
                tasks = [
                    group.create_task(self._keep(kept), name=f"device {kept.name}") for kept in self._in_order(base)
                ]
                self._start_timers()
                tasks += [
                    group.create_task(self._serve(part), name=f"bridge {part.name}") for part in self.parts.bridges
                ]
                if on_started is not None:
                    on_started(self)
                try:
                    await self._stopping
                finally:
                    self._halt()
                    for task in tasks:
                        task.cancel()
        finally:
            await self._wind_up(base)
        if self.mark is not None:
            self.mark.clear()

    # ----------------------------------------------------------------------------------------- set-up

    def _load(self) -> None:
        """Heavy imports and models of everything that the config names; in a worker, before anything moves."""
        for part in self.parts.devices:
            part.cls.load(part.config)
        if self.parts.world is not None:
            self.parts.world.cls.load(self.parts.world.config)
        for perceptor in self.parts.perceptors:
            perceptor.cls.load(perceptor.config)
        for behaviour in self.parts.behaviours:
            behaviour.cls.load(behaviour.config)
        for bridge in self.parts.bridges:
            bridge.cls.load(bridge.config)

    def _build(self, loop: Any) -> KeptDevice | None:
        parts = self.parts
        graph = compile_graph(parts)
        if parts.world is not None:
            context = DeviceContext("world", loop, parts.robot)
            self.world = parts.world.cls(parts.world.config, context)
        self.devices = tuple(KeptDevice(part, graph, loop, parts.robot, self.world) for part in parts.devices)
        base_part = base_of(parts)
        base = next((kept for kept in self.devices if base_part is not None and kept.name == base_part.name), None)
        kind = VirtualOffloader if self.virtual else ThreadOffloader
        self._offloader = offloader = kind(loop, self._offloaded)
        sink: Base = base if base is not None else _NoBase()
        self.core = Core(
            parts, graph, sink, timers=loop, offloader=offloader, journal=self.journal, now_ns=loop.now_ns()
        )
        self.core.on_armed.append(_freeze_heap)
        if self.mark is not None:
            self.core.on_armed.append(partial(self.mark.set, True))
        for kept in self.devices:
            kept.connect(self.core, self.fail)
            kept.on_open = self._device_opened
        self.handle = RuntimeHandle(self)
        return base

    def _offloaded(self, node: PerceptorNode, result: Message | str | None, oldest_ns: int) -> None:
        try:
            self.core.offloaded(node, result, oldest_ns, self._loop.now_ns())
        except Exception as error:
            self.fail(error)

    def _in_order(self, base: KeptDevice | None) -> list[KeptDevice]:
        """The base first: it writes its stop before any sensor speaks."""
        return ([base] if base is not None else []) + [kept for kept in self.devices if kept is not base]

    # --------------------------------------------------------------------------------------- guardian

    def _start_guardian(self, base: KeptDevice | None, loop: Any) -> None:
        """Before anything opens or is forked. A simulated robot has no line that anybody could hold."""
        if self.virtual or base is None:
            return
        cls, off = type(base.device), self.parts.guardian.off
        if off is not None or getattr(cls, "stop_line", None) is Actuator.stop_line:
            log.warning("no guardian for %s: %s", base.name, off or f"{cls.__name__} offers no stop line")
            return
        if not hasattr(socket, "SOCK_SEQPACKET") or sys.platform != "linux":
            log.warning("no guardian for %s: it needs Linux", base.name)
            return
        deadline_ms = max(self.parts.guardian.deadline_ms, round(2.5e-6 * self._period_ns))
        self.guarding = guarding = Guarding(loop, self, deadline_ms=deadline_ms)
        self.guardian_lost("starts")
        self.core.on_armed.append(guarding.armed)
        self.core.on_event.append(self._stop_by_guardian)
        base.may_write = guarding.may_write
        base.on_open = partial(self._hand_over, base)
        base.on_gone = guarding.drop
        guarding.start()

    def _hand_over(self, base: KeptDevice) -> None:
        assert self.guarding is not None and isinstance(base.device, Actuator)
        stop = base.device.stop_line()
        if stop is None:
            log.warning("the guardian holds nothing: %s offers no stop line", base.name)
        self.guarding.hand_over(stop)

    def guardian_ready(self) -> None:
        """The guardian holds the motor line."""
        self.core.device_opened(GUARDIAN, self._loop.now_ns())
        self._device_opened()

    def guardian_lost(self, reason: str) -> None:
        """The guardian holds no line, or is dead: nothing may move."""
        try:
            self.core.device_lost(GUARDIAN, reason, self._loop.now_ns())
        except Exception as error:
            self.fail(error)

    def guardian_tripped(self, reason: str) -> None:
        """The guardian stopped the motors, or is about to: disarmed, before anything else is written."""
        log.error("%s", reason)
        if self.core.operator.armed:
            try:
                self.core.request(Disarm("guardian", reason), self._loop.now_ns())
            except Exception as error:
                self.fail(error)

    def _stop_by_guardian(self, event: Event) -> None:
        if self.guarding is not None and isinstance(event, EStopped):
            self._stop_twice(self.guarding)

    def _stop_twice(self, guarding: Guarding) -> None:
        """Behind the driver's own stop, or a command that it is just writing would come after the guardian's."""
        self._loop.call_at_ns(self._loop.now_ns() + SECOND_STOP_AFTER_NS, guarding.stop_now)

    def _halt(self) -> None:
        """A way out: the stop by the driver, and by the guardian in case the driver's line is stuck."""
        self.core.halt()
        if self.guarding is not None:
            self._stop_twice(self.guarding)

    def suspend(self) -> None:
        """Stop and disarm, then let the terminal stop this process; after SIGCONT it stands there, disarmed."""
        if self.devices and self.core.operator.armed:  # else it is still loading
            self.core.request(Disarm("SIGTSTP", "suspended"), self._loop.now_ns())
        if self.guarding is not None:
            self._stop_twice(self.guarding)
        self._loop.call_at_ns(self._loop.now_ns() + SUSPEND_AFTER_NS, os.kill, os.getpid(), signal.SIGSTOP)

    # ----------------------------------------------------------------------------------------- arming

    def _device_opened(self) -> None:
        if self.arm_when_ready and not self.core.not_ready:
            self.arm_when_ready = False
            self.core.request(Arm("config"), self._loop.now_ns())

    # -------------------------------------------------------------------------------------- what runs

    async def _keep(self, kept: KeptDevice) -> None:
        await kept.keep(kept.name in self.core.needed_devices, GIVE_UP_S)

    async def _serve(self, part: BridgePart) -> None:
        attempt = 0
        while True:
            try:
                bridge: Bridge[Any] = part.cls(part.config)
                await _until_it_ends(asyncio.ensure_future(bridge.run(self.handle)), part.name)
                return
            except Exception as error:
                wait_s = BRIDGE_BACKOFF_S[min(attempt, len(BRIDGE_BACKOFF_S) - 1)]
                log.error("bridge %s: %s: %s; again in %g s", part.name, type(error).__name__, error, wait_s)
                attempt += 1
                await asyncio.sleep(wait_s)

    def _start_timers(self) -> None:
        first_ns = self.started_ns + self._period_ns
        self._tick_timer = self._loop.call_at_ns(first_ns, self._tick, first_ns)
        for node in self.core.graph.nodes:
            period_ns = node.lookout.view_type.period_ns
            if period_ns is not None:
                due_ns = self.started_ns + period_ns
                self._timers[node.index] = self._loop.call_at_ns(due_ns, self._step_on_time, node, due_ns, period_ns)

    def _tick(self, due_ns: int) -> None:
        now_ns = self._loop.now_ns()
        if self.guarding is not None:
            self.guarding.may_write()  # where this comes too late, it disarms before the tick decides anything
        late_ns = now_ns - due_ns
        self.tick_late_ns = late_ns
        missed, next_ns = skip_missed(due_ns, self._period_ns, now_ns)
        if missed:
            self.ticks_missed += missed
            log.warning("the loop was held up for %.0f ms; %d act ticks skipped", late_ns / 1e6, missed)
        self._tick_timer = self._loop.call_at_ns(next_ns, self._tick, next_ns)
        try:
            self.core.tick(now_ns)
        except Exception as error:
            self.fail(error)
            return
        armed = self.core.operator.armed
        if self.guarding is not None:
            self.guarding.beat(armed)  # the motors' write is not kept waiting for it
        if self.mark is not None and not armed:
            self.mark.set(False)

    def _step_on_time(self, node: Node, due_ns: int, period_ns: int) -> None:
        now_ns = self._loop.now_ns()
        _, next_ns = skip_missed(due_ns, period_ns, now_ns)
        self._timers[node.index] = self._loop.call_at_ns(next_ns, self._step_on_time, node, next_ns, period_ns)
        try:
            self.core.timer(node, now_ns)
        except Exception as error:
            self.fail(error)

    async def _wind_up(self, base: KeptDevice | None) -> None:
        """Close in the reverse order: sensors, then the base, whose close writes the last stop, then the world."""
        self._halt()
        if self._tick_timer is not None:
            self._tick_timer.cancel()
        for timer in self._timers.values():
            timer.cancel()
        self._offloader.close()
        for kept in reversed(self._in_order(base)):
            await kept.close()
        if self.guarding is not None:
            await self.guarding.close()
        if self.world is not None:
            await self.world.close()


async def _until_it_ends(running: asyncio.Future[None], name: str) -> None:
    """Wait for a bridge; raises what it raises. One that does not end when it is told to is told again, then left."""
    try:
        await asyncio.wait({running})
    except asyncio.CancelledError:
        for _ in range(2):
            running.cancel()
            if (await asyncio.wait({running}, timeout=BRIDGE_END_S))[0]:
                break
        else:
            log.error("bridge %s does not end; it is left behind", name)
        if running.done() and not running.cancelled() and (error := running.exception()) is not None:
            log.error("bridge %s: %s: %s", name, type(error).__name__, error)
        raise
    running.result()


def skip_missed(due_ns: int, period_ns: int, now_ns: int) -> tuple[int, int]:
    """(ticks missed, instant of the next one) on the fixed grid; missed ticks are counted, never caught up."""
    missed = max(0, (now_ns - due_ns) // period_ns)
    return missed, due_ns + (missed + 1) * period_ns


def _freeze_heap() -> None:
    """Everything alive at arming is kept out of the collector's way: a full collection costs 5 to 80 ms."""
    gc.collect()
    gc.freeze()
