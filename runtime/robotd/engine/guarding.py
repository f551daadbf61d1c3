"""The runtime's side of the guardian: starts it, shows it signs of life, gives it the line, learns of trips and death.

The guardian (`robotd.safety.guardian`, which has the packets) is started before anything else opens, so that nothing
that was forked later holds its socket; signs of life come from the act tick, so only while the loop really turns.

    starting -> idle <-> watching -> tripped -> idle       idle: nothing may move; watching: the robot is armed
    any of them -> dead -> starting                        never while the robot is armed: its death disarmed it

Whoever wakes after a stop, a suspend or a long block asks `may_write` before he moves anything: the time since the last
sign of life says that the guardian has tripped, whether its word was read already or not.
"""

from __future__ import annotations

import asyncio
import contextlib
import enum
import glob
import logging
import os
import socket
import subprocess
import sys
import weakref
from typing import Protocol

import robotd.safety
from robotd.authoring.device import I2cStop, StopLine
from robotd.engine.loops import RealLoop
from robotd.engine.status import DeviceState
from robotd.safety.guardian import clock_ns

log = logging.getLogger("robotd")

GUARDIAN = "the guardian"
"""Its name among the devices of the core; no device of a config can have it."""

UNREAD_BYTES = 8192
"""Of the socket's buffer: a guardian that leaves some twenty signs of life unread does not live."""
AGAIN_S = 0.5
"""Until the next try, after a death or where the line could not be held."""
START_WITHIN_S, END_WITHIN_S = 10.0, 1.0
_PROGRAM = os.path.join(os.path.dirname(robotd.safety.__file__), "guardian.py")
_FORK_SAFE: weakref.WeakSet[socket.socket] = weakref.WeakSet()


class Hears(Protocol):
    """Who is told, on the loop. All three may come at any time."""

    def guardian_ready(self) -> None:
        """It holds the line: the robot may be armed."""
        ...

    def guardian_lost(self, reason: str) -> None:
        """It does not hold the line, or is dead: the robot must not move."""
        ...

    def guardian_tripped(self, reason: str) -> None:
        """It stopped the motors, or is just about to: disarm."""
        ...


class State(enum.Enum):
    """Where the guardian stands, as far as the runtime knows."""

    DEAD = "dead"
    STARTING = "starting"
    IDLE = "idle"
    WATCHING = "watching"
    TRIPPED = "tripped"


_WATCHING = State.WATCHING


class Guarding:
    """One guardian after another. Everything belongs on the loop thread; nothing blocks but `start`, some 10 ms."""

    def __init__(self, loop: RealLoop, hears: Hears, *, deadline_ms: int) -> None:
        self.state = State.DEAD
        self.detail = "not started"
        self.process: subprocess.Popen[bytes] | None = None
        self.trips = 0
        self._loop = loop
        self._hears = hears
        self._deadline_ms = deadline_ms
        # a little earlier than the guardian's own: who may still write has not been stopped yet
        self._limit_ns = deadline_ms * 900_000
        self._shortest_ns = deadline_ms * 50_000
        self._beat_ns = 0
        self._socket: socket.socket | None = None
        self._stop: StopLine | None = None
        self._is_open = False
        self._again: asyncio.TimerHandle | None = None
        self._ended: asyncio.Event = asyncio.Event()
        self._closing = False

    def start(self) -> None:
        """Start the process. Only while the robot is disarmed: it blocks for as long as a fork takes."""
        self._again = None
        self._ended.clear()
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        ours.setblocking(False)
        ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, UNREAD_BYTES)
        _FORK_SAFE.add(ours)
        with theirs:
            command = [sys.executable, "-I", "-S", _PROGRAM, str(theirs.fileno()), str(self._deadline_ms)]
            try:
                self.process = subprocess.Popen(
                    command,
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                    pass_fds=(theirs.fileno(),),
                    start_new_session=True,
                )
            except OSError as error:
                ours.close()
                self._die(f"cannot be started ({error})")
                return
        self._socket = ours
        self.state, self.detail = State.STARTING, "starts"
        self._loop.add_reader(ours.fileno(), self._readable)
        self._again = self._loop.call_later(START_WITHIN_S, self._die, "does not start")

    @property
    def device_state(self) -> DeviceState:
        """Its state among the devices: open while it holds the line, or has none to hold."""
        if self.state is State.DEAD:
            return "lost"
        return "opening" if self.detail else "open"

    # ------------------------------------------------------------------------------------ signs of life

    def beat(self, armed: bool) -> None:
        """The sign of life at the end of an act tick; after a trip it says that the robot is disarmed."""
        now_ns = clock_ns()
        if self.state is State.TRIPPED and not armed:
            self.state = State.IDLE
            self._send(b"A")
        elif armed and not self.may_write():
            return
        elif self.state in (State.IDLE, State.WATCHING) and now_ns - self._beat_ns >= self._shortest_ns:
            self._breathe(armed, now_ns)

    def armed(self) -> None:
        """The robot was armed just now, and nothing has been written since: watch from here on."""
        if self.state is State.TRIPPED:
            self._send(b"A")
        if self.state in (State.IDLE, State.TRIPPED):
            self._breathe(True, clock_ns())

    def may_write(self) -> bool:
        """Whether a command may go to the motors; where it may not because the loop stood still, that is a trip."""
        if self.state is not _WATCHING:  # the member by itself: an enum looks it up each time, and this is asked often
            return self.state is State.IDLE
        silent_ns = clock_ns() - self._beat_ns
        if silent_ns <= self._limit_ns:
            return True
        self._trip(silent_ns)
        return False

    def stop_now(self) -> None:
        """Have the stop written by the guardian as well, at once, whatever the state of the driver's line."""
        if self.state in (State.IDLE, State.WATCHING):
            self._send(b"S")

    def _breathe(self, armed: bool, now_ns: int) -> None:
        self.state = State.WATCHING if armed else State.IDLE
        self._beat_ns = now_ns
        self._send(b"B" + now_ns.to_bytes(8, "big") if armed else b"b")

    def _trip(self, silent_ns: int) -> None:
        self.state = State.TRIPPED
        self.trips += 1
        self._hears.guardian_tripped(f"the guardian stopped the motors: no sign of life for {silent_ns / 1e6:.0f} ms")

    # ------------------------------------------------------------------------------------------ the line

    def hand_over(self, stop: StopLine | None) -> None:
        """The base is open: this is its line and its stop, until `drop` or the next one. None: it has none."""
        self._stop, self._is_open = stop, True
        if self.state is not State.DEAD:
            self.detail = "gets the line"
            self._hears.guardian_lost(f"{GUARDIAN} does not hold the line yet")
            self._offer()

    def drop(self) -> None:
        """The base is lost. The guardian stops it once more and lets go, or the line could not be opened anew."""
        self._stop, self._is_open, self.detail = None, False, "holds no line"
        if self.state is not State.STARTING:
            self._send(b"D")

    def _offer(self) -> None:
        """Describe the line to a guardian that is ready; a line that cannot be held is offered again later."""
        if not self._is_open or self.state in (State.DEAD, State.STARTING):
            return
        self._cancel_again()
        stop = self._stop
        if stop is None:
            self.detail = ""
            self._hears.guardian_ready()
            return
        if isinstance(stop, I2cStop):
            self._send(b"i" + os.fsencode(stop.bus) + b"\0" + b"".join(bytes((a, len(d))) + d for a, d in stop.writes))
            return
        fd = descriptor_of(stop.path)
        if fd is None:
            self._not_held(f"{stop.path} is not open in this program")
        else:
            self._send(b"s" + stop.data, fd)

    def _not_held(self, why: str) -> None:
        words = f"cannot hold the line: {why}"
        if words != self.detail:
            log.warning("%s %s", GUARDIAN, words)
        self.detail = words
        self._hears.guardian_lost(f"{GUARDIAN} {words}")
        self._again = self._loop.call_later(AGAIN_S, self._offer)

    # ------------------------------------------------------------------------------------- what it says

    def _readable(self) -> None:
        while self._socket is not None:
            try:
                packet = self._socket.recv(4096)
            except (BlockingIOError, InterruptedError):
                return
            except OSError:
                packet = b""
            if not packet:
                self._die("died")
                return
            self._hear(packet[:1], packet[1:])

    def _hear(self, kind: bytes, rest: bytes) -> None:
        match kind:
            case b"R":
                self._cancel_again()
                self.state, self.detail = State.IDLE, "holds no line"
                assert self.process is not None
                privileges = rest.decode() or "no privileges"
                log.info("%s watches (pid %d, %d ms, %s)", GUARDIAN, self.process.pid, self._deadline_ms, privileges)
                self._offer()
            case b"H":
                self.detail = ""
                self._hears.guardian_ready()
            case b"N":
                self._not_held(rest.decode(errors="replace"))
            case b"T" if self.state is State.WATCHING:
                self._trip(int.from_bytes(rest, "big"))
            case b"T":
                self.state = State.TRIPPED  # the robot was disarmed meanwhile: the next tick acknowledges

    def _send(self, packet: bytes, fd: int | None = None) -> None:
        if self._socket is None:
            return
        try:
            if fd is None:
                self._socket.send(packet)
            else:
                socket.send_fds(self._socket, [packet], [fd])
        except BlockingIOError:
            self._die("does not answer")
        except OSError:
            self._die("died")

    # --------------------------------------------------------------------------------------------- ends

    def _die(self, how: str) -> None:
        """It is dead, or as good as: stop, and start another one once the robot stands disarmed, which is now."""
        self._cancel_again()
        if how != self.detail and not self._closing:
            log.error("%s %s; another one is started", GUARDIAN, how)
        self.state, self.detail = State.DEAD, how
        self._let_go()
        self._ended.set()
        if not self._closing:
            self._hears.guardian_lost(f"{GUARDIAN} {how}")
            self._again = self._loop.call_later(AGAIN_S, self.start)
        self._reap()

    def _let_go(self) -> None:
        made, self._socket = self._socket, None
        if made is not None:
            self._loop.remove_reader(made.fileno())
            made.close()

    def _reap(self) -> None:
        process, self.process = self.process, None
        if process is not None:
            process.kill()  # where it only did not answer
            process.wait()

    def _cancel_again(self) -> None:
        if self._again is not None:
            self._again.cancel()
            self._again = None

    async def close(self) -> None:
        """The motors are stopped and the base is closed: let the guardian write its last stop and end."""
        self._closing = True
        self._cancel_again()
        if self._socket is not None and self.state is not State.DEAD:
            self._send(b"Q")
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(END_WITHIN_S):
                    await self._ended.wait()
        self._let_go()
        self._reap()


def descriptor_of(path: str) -> int | None:
    """This program's own open descriptor of a device, whatever library opened it; None where there is none.

    path: may hold wildcards, as a config may.
    """
    wanted = [os.stat(each) for each in glob.glob(path)]
    for name in os.listdir("/dev/fd"):
        with contextlib.suppress(OSError):  # the listing's own descriptor is closed by now
            found = os.fstat(int(name))
            if any(os.path.samestat(found, each) for each in wanted):
                return int(name)
    return None


def _close_after_fork() -> None:
    """A forked child must not keep the socket: the guardian would take it for the runtime that lives on."""
    for each in _FORK_SAFE:
        each.close()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_close_after_fork)
