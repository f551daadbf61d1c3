"""A robot to be frozen and killed: the whole program on one motor line, in a process that does as it is told.

A launcher imports everything once and forks a robot whenever it is asked to; each robot answers on a socket of its own.
"""

from __future__ import annotations

import asyncio
import ctypes
import json
import logging
import os
import resource
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benches.guardian_line import LineMotors, LineMotorsConfig
from robotd.app import Options, run
from robotd.authoring.behaviour import Behaviour
from robotd.authoring.bridge import Bridge, Refused, RuntimeLink
from robotd.authoring.config import Config, NoConfig
from robotd.authoring.view import View
from robotd.engine.console import ChangeLog
from robotd.engine.parts import BehaviourPart, BridgePart, DevicePart, Parts
from robotd.safety.settings import GuardConfig, GuardianConfig, Zones
from robotd.setup.load import Loaded
from robotd.setup.sections import RecorderSection
from robotd.world.messages import Drive
from robotd.world.robot import Limits, Robot
from robotd_devices.motor.jetbot import JetBotMotors, JetBotMotorsConfig

KINDS = ("i2c", "serial")
_PR_CAPBSET_DROP = 24  # linux/prctl.h
_USUAL_MEMLOCK = 8 << 20


class Beat(View, hz=50):
    """Steps on time alone."""


class Weave(Behaviour[NoConfig, Beat]):
    """Never asks for the same twice, so that every step is written to the line."""

    _turn = 0

    def step(self, seen: Beat) -> Drive:
        self._turn += 1
        return Drive(0.2 + 0.01 * (self._turn % 20))


class ControlConfig(Config):
    """The descriptor of the robot's end of the socket."""

    fd: int


class Control(Bridge[ControlConfig]):
    """Obeys words, one a packet, and answers with one object of JSON: the time before, what follows, or a refusal."""

    async def run(self, runtime: RuntimeLink) -> None:
        handle: Any = runtime
        loop = asyncio.get_running_loop()
        line = socket.socket(fileno=os.dup(self.config.fd))
        with line:
            line.setblocking(False)
            ended = loop.create_future()

            def obey() -> None:
                packet = line.recv(4096)
                if not packet:
                    loop.remove_reader(line)
                    ended.set_result(None)
                    handle.stop_program()  # nobody is left who could stop it
                    return
                tell = lambda **what: line.send(json.dumps(what).encode())  # noqa: E731
                _obey(runtime, packet.decode().split(), tell)

            loop.add_reader(line, obey)
            await ended


def _obey(runtime: Any, words: list[str], tell: Callable[..., Any]) -> None:
    now_ns = time.monotonic_ns()
    match words:
        case ["status"]:
            guarding = runtime._runtime.guarding
            tell(
                mode=runtime.status()["mode"],
                reason=runtime.status()["reason"],
                ready=not runtime._runtime.core.not_ready,
                guardian=guarding.process.pid if guarding is not None and guarding.process is not None else 0,
                state=guarding.state.value if guarding is not None else "none",
            )
        case ["arm"]:
            try:
                runtime.arm("bench")
                tell(armed=True)
            except Refused as refused:
                tell(armed=False, why=str(refused))
        case ["python", seconds]:
            tell(at_ns=now_ns)
            while time.monotonic_ns() < now_ns + float(seconds) * 1e9:
                pass
        case ["gil", seconds]:
            tell(at_ns=now_ns)
            ctypes.PyDLL(None).usleep(round(float(seconds) * 1e6))  # a C call that keeps the lock all the while
        case ["sleep", seconds]:
            tell(at_ns=now_ns)
            time.sleep(float(seconds))
        case ["estop"]:
            tell(at_ns=now_ns)
            runtime.estop("bench", "a button")
        case ["reset"]:
            runtime.reset_estop("bench")
            tell(at_ns=now_ns)
        case ["fork"]:
            if os.fork() == 0:
                time.sleep(1.0)
                os._exit(0)
            tell(at_ns=now_ns)
        case ["exception"]:
            runtime._runtime.core._act = None  # a turn raises out of the heart of the runtime, and that at once
            asyncio.get_running_loop().call_soon(runtime._runtime._tick, now_ns)
            tell(at_ns=now_ns)
        case _:
            tell(unknown=words)


def parts(kind: str, where: str, fd: int, deadline_ms: int = 100) -> Parts:
    """A robot on a JetBot's bus at a socket, or on a serial line."""
    motors = (
        DevicePart("motors", JetBotMotors, JetBotMotorsConfig(bus=where, odometry_hz=0.0))
        if kind == "i2c"
        else DevicePart("motors", LineMotors, LineMotorsConfig(path=where))
    )
    return Parts(
        Robot(limits=Limits(accel_mps2=1e6, decel_mps2=1e6)),
        (motors,),
        behaviours=(BehaviourPart("weave", Weave, NoConfig(), 1, start=True),),
        bridges=(BridgePart("control", Control, ControlConfig(fd=fd)),),
        guard=GuardConfig(zones=Zones(off="wheels in the air")),
        guardian=GuardianConfig(deadline_ms=deadline_ms),
    )


def drive(kind: str, where: str, fd: int) -> int:
    """Be that robot until somebody ends it; returns the exit code."""
    loaded = Loaded(parts(kind, where, fd), RecorderSection(), "", {}, Path("bench"), sim=False)
    try:
        return run(loaded, Options(headless=True), ChangeLog())
    except BaseExceptionGroup:
        return 1


class Told:
    """One robot as whoever started it sees it."""

    def __init__(self, pid: int, line: socket.socket) -> None:
        self.pid = pid
        self._line = line
        line.settimeout(20.0)

    def ask(self, words: str) -> dict[str, Any]:
        """Its answer. Raises OSError where it is gone or does not answer."""
        self._line.send(words.encode())
        return self.answer()

    def answer(self) -> dict[str, Any]:
        """The next answer."""
        packet = self._line.recv(4096)
        if not packet:
            raise ConnectionResetError("the robot is gone")
        told: dict[str, Any] = json.loads(packet)
        return told

    def until(self, holds: Callable[[dict[str, Any]], object], what: str, within_s: float = 10.0) -> dict[str, Any]:
        """Its status, once that is as wanted. Raises TimeoutError naming what did not come."""
        until_s = time.monotonic() + within_s
        while not holds(status := self.ask("status")):
            if time.monotonic() > until_s:
                raise TimeoutError(f"waited {within_s:g} s for {what}: {status}")
            time.sleep(0.002)
        return status

    def signal(self, number: int, *, group: bool = False) -> int:
        """Send it a signal, or its whole process group; returns the time just before."""
        now_ns = time.monotonic_ns()
        (os.killpg if group else os.kill)(self.pid, number)
        return now_ns

    def gone_ns(self) -> int:
        """Wait until the kernel has closed a killed robot's end of the line, as the guardian's; returns when."""
        try:
            while self._line.recv(4096):
                pass
        except ConnectionResetError:  # it had not read everything
            pass
        return time.monotonic_ns()

    def end(self) -> None:
        """Make sure that it is gone."""
        try:
            os.kill(self.pid, signal.SIGCONT)
            os.kill(self.pid, signal.SIGKILL)
        except ProcessLookupError:
            pass
        self._line.settimeout(5.0)
        try:
            while self._line.recv(4096):
                pass
        except OSError:
            pass
        self._line.close()


def give_up_privileges() -> None:
    """Between fork and exec: what runs from there on, and all its children, can have no capability any more.

    The user stays, so that it may read this project wherever that lies; scheduling, locking memory and the like ask for
    capabilities alone.
    """
    prctl = ctypes.CDLL(None, use_errno=True).prctl
    for capability in range(64):
        prctl(_PR_CAPBSET_DROP, capability, 0, 0, 0)  # fails behind the last one that the kernel knows
    resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
    resource.setrlimit(resource.RLIMIT_MEMLOCK, (_USUAL_MEMLOCK, _USUAL_MEMLOCK))


class Launcher:
    """A process that forks robots: `with Launcher() as launcher: robot = launcher.start("serial", path)`.

    plain: the robots, and so their guardians, have no privileges, whoever runs the bench.
    """

    def __init__(self, *, plain: bool = False) -> None:
        self._plain = plain

    def __enter__(self) -> Launcher:
        self._ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "benches.guardian_robot", str(theirs.fileno())],
                pass_fds=(theirs.fileno(),),
                stdin=subprocess.DEVNULL,
                env=os.environ | {"PYTHONPATH": str(Path(__file__).resolve().parents[1])},
                preexec_fn=give_up_privileges if self._plain else None,
            )
        self._ours.settimeout(30.0)
        self._ours.recv(16)  # everything is imported
        return self

    def __exit__(self, *error: object) -> None:
        self._ours.close()
        self._process.wait()

    def start(self, kind: str, where: str | os.PathLike[str]) -> Told:
        """A new robot, in a process group of its own; it still has to open its devices."""
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            socket.send_fds(self._ours, [json.dumps([kind, os.fspath(where)]).encode()], [theirs.fileno()])
        return Told(int(self._ours.recv(16)), ours)


def launch(line: socket.socket) -> None:
    """The launcher's own process: forks until the other end is closed."""
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # nobody waits for them
    line.send(b"ready")
    while True:
        packet, fds, _, _ = socket.recv_fds(line, 4096, 1)
        if not packet:
            return
        pid = os.fork()
        if pid:
            os.close(fds[0])
            line.send(str(pid).encode())
            continue
        line.close()
        os.setpgid(0, 0)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        logging.getLogger("robotd").setLevel(os.environ.get("ROBOTD_BENCH_LOG", "CRITICAL"))
        kind, where = json.loads(packet)
        code = 70
        try:
            code = drive(kind, where, fds[0])
        finally:
            os._exit(code)


if __name__ == "__main__":
    with socket.socket(fileno=int(sys.argv[1])) as channel:
        launch(channel)
