"""Hosts a fake device on a pty, paced at the baud rate of the real line, with a cable that can be pulled.

In a test, a thread:

    with PtyHost(Ld19Fake(), tmp_path / "lidar", baud=230_400) as host: ...; host.unplug(); host.plug()

As a program of its own, with `unplug`, `plug` and `quit` read from standard input, each answered with `ok`:

    python -m robotd_devices.ports.pty_host --fake robotd_devices.lidar.ld19_fake:Ld19Fake --baud 230400 --link lidar
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import os
import sys
import threading
import time
import tty
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType

from robotd_devices.ports.fakes import FakeDevice
from robotd_devices.ports.serial_port import BITS_PER_BYTE

_STEP_S = 0.001
_TICK_NS = 100_000


class PtyHost:
    """One fake behind one pty. `link`: a symbolic link that stands for `/dev/serial/by-id/...`.

    A pty has no speed of its own, so each byte is handed over when its last bit would have come at `baud`. `chunk`:
    the most bytes handed over at once, as USB bridges do (CP210x 64, FTDI 62, CH340 32). Bytes that nobody reads are
    lost when the kernel's buffer (about 20 KiB) is full, as on a real line.
    """

    def __init__(self, fake: FakeDevice, link: str | os.PathLike[str], *, baud: int, chunk: int = 64) -> None:
        self.fake = fake
        self.link = Path(link)
        self.overrun = 0
        """Bytes lost because nobody read them."""
        self.sent = 0
        """Bytes handed over since the cable went in."""
        self._byte_ns = BITS_PER_BYTE * 1_000_000_000 / baud
        self._chunk = chunk
        self._lock = threading.Lock()
        self._stopping = threading.Event()
        self._master = self._slave = -1
        # what is on its way: when its first byte's transmission begins, and the bytes
        self._queue: deque[tuple[float, bytes]] = deque()
        self._free_ns = 0.0
        self._ticked_ns = 0
        self._thread = threading.Thread(target=self._run, name=f"pty {self.link.name}", daemon=True)

    def __enter__(self) -> PtyHost:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def start(self) -> None:
        """Plug in and begin."""
        self.plug()
        self._thread.start()

    def stop(self) -> None:
        """Unplug and end the thread."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join()
        self.unplug()

    def plug(self) -> None:
        """A new pty under the same link; the device powers on. Nothing happens where it is plugged in already."""
        with self._lock:
            if self._master >= 0:
                return
            # the slave stays open here, or the master reports an error whenever no reader is there
            self._master, self._slave = os.openpty()
            tty.setraw(self._slave)
            os.set_blocking(self._master, False)
            self._queue.clear()
            self.sent = 0
            now_ns = time.monotonic_ns()
            self._free_ns, self._ticked_ns = float(now_ns), now_ns
            self.fake.power_on(now_ns)
            fresh = self.link.with_name(f".{self.link.name}.{os.getpid()}")
            fresh.unlink(missing_ok=True)
            fresh.symlink_to(os.ttyname(self._slave))
            fresh.replace(self.link)

    def unplug(self) -> None:
        """Pull the cable: both ends close, readers see end of file at once, the link disappears."""
        with self._lock:
            if self._master < 0:
                return
            # first the link, so that nobody finds another program's pty under a number that became free
            self.link.unlink(missing_ok=True)
            os.close(self._master)
            os.close(self._slave)
            self._master = self._slave = -1

    @contextlib.contextmanager
    def stuck(self) -> Iterator[int]:
        """The adapter hangs: inside, no byte goes either way but by whoever reads the master's descriptor given here.

        Raises RuntimeError where the cable is out.
        """
        with self._lock:
            if self._master < 0:
                raise RuntimeError(f"{self.link} is not plugged in")
            yield self._master

    def _run(self) -> None:
        while not self._stopping.is_set():
            with self._lock:
                if self._master >= 0:
                    self._turn()
            time.sleep(_STEP_S)

    def _turn(self) -> None:
        heard = b""
        with contextlib.suppress(BlockingIOError):  # nobody wrote anything
            heard = os.read(self._master, 4096)
        now_ns = time.monotonic_ns()  # behind the read: nothing is heard before it was written
        if heard:
            self.fake.feed(heard, now_ns)
        # in small steps of the fake's own time, so that this thread's pauses do not show on the line
        while self._ticked_ns + _TICK_NS <= now_ns:
            self._ticked_ns += _TICK_NS
            data = self.fake.tick(self._ticked_ns)
            if data:
                self._free_ns = max(self._free_ns, self._ticked_ns)
                self._queue.append((self._free_ns, data))
                self._free_ns += len(data) * self._byte_ns
        while self._queue:
            start_ns, data = self._queue[0]
            count = min(int((now_ns - start_ns) / self._byte_ns), self._chunk, len(data))
            if count <= 0:
                return
            self._hand_over(data[:count])
            if count == len(data):
                self._queue.popleft()
            else:
                self._queue[0] = (start_ns + count * self._byte_ns, data[count:])

    def _hand_over(self, data: bytes) -> None:
        try:
            written = os.write(self._master, data)
        except BlockingIOError:
            written = 0
        self.sent += written
        self.overrun += len(data) - written


def main(arguments: list[str] | None = None) -> int:
    """Host a fake until standard input ends or says `quit`. Returns an exit code."""
    parser = argparse.ArgumentParser(prog="python -m robotd_devices.ports.pty_host", description=main.__doc__)
    parser.add_argument("--fake", required=True, help="module:class of a fake that needs no arguments")
    parser.add_argument("--link", required=True, help="path of the symbolic link to the pty")
    parser.add_argument("--baud", type=int, required=True)
    chosen = parser.parse_args(arguments)
    module, _, name = str(chosen.fake).partition(":")
    fake: FakeDevice = getattr(importlib.import_module(module), name)()
    with PtyHost(fake, chosen.link, baud=chosen.baud) as host:
        _say("ok")
        for line in sys.stdin:
            word = line.strip()
            if word == "quit":
                break
            if word not in ("plug", "unplug"):
                _say(f"unknown word {word!r}; known: plug, unplug, quit")
                continue
            (host.plug if word == "plug" else host.unplug)()
            _say("ok")
    return 0


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    raise SystemExit(main())
