"""Conversations with a device on a serial line: their steps, and carrying them out on the running event loop.

A conversation is a generator: it yields what to do and is sent what came of it. A shell (or a test on virtual time)
carries the steps out:

    Say(data)                     write                                            -> None
    Ask(data, kind, within_s)     write, wait for the answer of a type             -> its bytes, or None: no answer
    Start(data, within_s)         write, wait for the descriptor of a stream       -> Descriptor, or None
    Repeat(data, size, ...)       write again and again until bytes come  -> the first `size` of them, or None
    Pause(s), Quiet(s, within_s)  wait; wait for a silence, dropping what comes    -> None
    Dtr(on)                       set the modem line, where there is one           -> None
    Warn(name, detail)            count a fault                                    -> None
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Generator
from typing import Any, NamedTuple, TypeAlias, TypeVar

from robotd.authoring.device import DeviceLost
from robotd_devices.lidar.answers import AnswerReader
from robotd_devices.ports.serial_port import SerialPort


class Say(NamedTuple):
    """Write."""

    data: bytes


class Ask(NamedTuple):
    """Write and wait for an answer of a type."""

    data: bytes
    kind: int
    within_s: float = 0.3


class Start(NamedTuple):
    """Write and wait for a stream to begin."""

    data: bytes
    within_s: float


class Repeat(NamedTuple):
    """Write every so often until anything comes, then wait a moment for the rest of what is wanted."""

    data: bytes
    size: int
    every_s: float = 0.01
    within_s: float = 1.5
    rest_s: float = 0.5


class Pause(NamedTuple):
    """Wait."""

    seconds: float


class Quiet(NamedTuple):
    """Drop what comes until nothing came for `seconds`, at most for `within_s`."""

    seconds: float = 0.05
    within_s: float = 1.0


class Dtr(NamedTuple):
    """Set the modem line."""

    on: bool


class Warn(NamedTuple):
    """Count a fault that is survived."""

    name: str
    detail: str


Step: TypeAlias = Say | Ask | Start | Repeat | Pause | Quiet | Dtr | Warn
T = TypeVar("T")
Talk: TypeAlias = Generator[Step, Any, T]


class Dialogue:
    """One open port and who listens to it: the conversation, or (from `stream` on) a parser.

    warn(name, detail): called for what a conversation survived.
    """

    def __init__(self, warn: Callable[[str, str], None]) -> None:
        self._warn = warn
        self._port: SerialPort | None = None
        self._reader: AnswerReader | None = None
        self._parse: Callable[[bytes], None] | None = None
        self._rest = b""
        self._news = asyncio.Event()
        self._gone = ""
        self.bytes = 0
        """Bytes that came since opening."""

    async def open(self, port: SerialPort) -> None:
        """Take over a closed port and open it; its callbacks must be `take` and, on a loss, `lost`."""
        self._port = port
        await port.open()

    def take(self, data: bytes) -> None:
        """Bytes from the port."""
        self.bytes += len(data)
        if self._parse is not None:
            self._parse(data)
            return
        if self._reader is None or self._reader.feed(data):
            self._news.set()

    def lost(self, reason: str) -> None:
        """The port went away: a conversation under way ends with DeviceLost."""
        self._gone = reason
        self._news.set()

    def stream(self, parse: Callable[[bytes], None]) -> None:
        """From now on all bytes go to `parse`, first those that came behind the descriptor of the stream."""
        self._parse = parse
        rest, self._rest = self._rest, b""
        if rest:
            parse(rest)

    async def say(self, talk: Talk[T]) -> T:
        """A conversation from beginning to end; its result. Raises what it raises, and DeviceLost."""
        self._parse = None
        answer: object = None
        while True:
            try:
                step = talk.send(answer)
            except StopIteration as end:
                result: T = end.value
                return result
            answer = await self._carry_out(step)

    async def _carry_out(self, step: Step) -> object:
        port = self._port
        assert port is not None
        if isinstance(step, Say):
            port.write(step.data)
        elif isinstance(step, Dtr):
            port.set_dtr(step.on)
        elif isinstance(step, Warn):
            self._warn(step.name, step.detail)
        elif isinstance(step, Pause):
            await asyncio.sleep(step.seconds)
        elif isinstance(step, Quiet):
            await self._quiet(step)
        elif isinstance(step, Repeat):
            return await self._repeat(port, step)
        else:
            return await self._answer(port, step)
        return None

    async def _answer(self, port: SerialPort, step: Ask | Start) -> object:
        reader = self._reader = AnswerReader(step.kind if isinstance(step, Ask) else None)
        self._news.clear()
        port.write(step.data)
        heard = await self._heard(step.within_s)
        if isinstance(step, Ask):
            self._reader = None
            return reader.answer
        if not heard or reader.answer is None:
            self._reader = None
            return None
        # the reader stays and keeps what comes until `stream` takes it
        self._rest = reader.rest
        reader.rest = b""
        self._reader = None
        self._parse = self._keep
        return reader.descriptor

    def _keep(self, data: bytes) -> None:
        self._rest += data

    async def _repeat(self, port: SerialPort, step: Repeat) -> bytes | None:
        loop, got = asyncio.get_running_loop(), bytearray()

        def collect(data: bytes) -> None:
            got.extend(data)
            self._news.set()

        self._parse, until_s = collect, loop.time() + step.within_s
        try:
            while not got and loop.time() < until_s:
                self._news.clear()
                port.write(step.data)
                await self._heard(step.every_s)
            until_s = loop.time() + step.rest_s
            while 0 < len(got) < step.size and loop.time() < until_s:
                self._news.clear()
                await self._heard(step.every_s)
        finally:
            self._parse = None
        return bytes(got[: step.size]) if len(got) >= step.size else None

    async def _quiet(self, step: Quiet) -> None:
        loop = asyncio.get_running_loop()
        until_s = loop.time() + step.within_s
        self._reader = None
        self._rest = b""
        self._parse = None
        while loop.time() < until_s:
            self._news.clear()
            if not await self._heard(step.seconds):
                return

    async def _heard(self, within_s: float) -> bool:
        try:
            async with asyncio.timeout(within_s):
                await self._news.wait()
        except TimeoutError:
            return False
        finally:
            if self._gone:
                raise DeviceLost(self._gone)
        return True

    async def leave(self, last_words: bytes, dtr: bool | None) -> None:
        """Say the last words, set the modem line, wait a moment at most for them to be out, and let go of the port."""
        port, self._port = self._port, None
        if port is None:
            return
        if not self._gone:
            if dtr is not None:
                port.set_dtr(dtr)
            if last_words:
                port.write(last_words, first=True)
                await port.drain(0.1)
        port.abort()
