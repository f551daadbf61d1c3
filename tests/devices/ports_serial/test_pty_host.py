"""The host of fakes: paced as the wire would be, with a cable that can be pulled; faults come from a seed."""

from __future__ import annotations

import os
import random
import subprocess
import sys
import termios
import time
import tty
from pathlib import Path

import pytest

from robotd_devices.ports.fakes import DAMAGES, Damage, Faulty, damage
from robotd_devices.ports.pty_host import PtyHost


class Counting:
    """Sends 1000 bytes at power-on and echoes what it hears."""

    def __init__(self) -> None:
        self.out = b""
        self.powered = 0

    def power_on(self, now_ns: int) -> None:
        self.powered += 1
        self.out = bytes(1000)

    def feed(self, data: bytes, now_ns: int) -> None:
        self.out += data

    def tick(self, now_ns: int) -> bytes:
        out, self.out = self.out, b""
        return out


def read_exactly(fd: int, count: int, within_s: float = 5.0) -> bytes:
    got, until = b"", time.monotonic() + within_s
    while len(got) < count and time.monotonic() < until:
        got += os.read(fd, count - len(got))
    return got


def opened(path: Path) -> int:
    fd = os.open(path, os.O_RDWR | os.O_NOCTTY)
    tty.setraw(fd, 0)
    return fd


def test_bytes_take_their_time(tmp_path: Path) -> None:
    link = tmp_path / "port"
    host = PtyHost(Counting(), link, baud=38_400)
    begun = time.monotonic()
    with host:
        fd = opened(link)
        assert read_exactly(fd, 1000) == bytes(1000)
        took_s = time.monotonic() - begun
        assert took_s >= 1000 / 3840
        assert took_s < 1000 / 3840 + 0.25
        os.write(fd, b"hello")
        assert read_exactly(fd, 5) == b"hello"
        os.close(fd)
    assert (host.sent, host.overrun) == (1005, 0)


def test_unplug_takes_the_link_away_and_plug_brings_another_pty(tmp_path: Path) -> None:
    link = tmp_path / "port"
    fake = Counting()
    with PtyHost(fake, link, baud=115_200) as host:
        fd = opened(link)
        host.unplug()
        host.unplug()
        assert not link.is_symlink()
        with pytest.raises(termios.error, match="Input/output error"):
            tty.setraw(fd)
        assert os.read(fd, 10) == b""
        host.plug()
        host.plug()
        assert fake.powered == 2
        again = opened(link)
        assert read_exactly(again, 1000) == bytes(1000)
        os.close(fd)
        os.close(again)
    assert not link.is_symlink()


def test_stuck_line_moves_only_by_whoever_holds_it(tmp_path: Path) -> None:
    with PtyHost(Counting(), tmp_path / "port", baud=4_000_000) as host:
        fd = opened(tmp_path / "port")
        read_exactly(fd, 1000)
        with host.stuck() as master:
            os.write(fd, b"to nobody")
            os.set_blocking(master, True)
            assert read_exactly(master, 9) == b"to nobody"
            os.set_blocking(master, False)
            os.write(fd, b"later")
        assert read_exactly(fd, 5) == b"later"
        os.close(fd)
        host.unplug()
        with pytest.raises(RuntimeError, match="not plugged in"), host.stuck():
            pass


def test_what_nobody_reads_is_lost(tmp_path: Path) -> None:
    class Flood(Counting):
        def tick(self, now_ns: int) -> bytes:
            return bytes(2000)

    host = PtyHost(Flood(), tmp_path / "port", baud=4_000_000)
    with host:
        until = time.monotonic() + 5.0
        while host.overrun == 0 and time.monotonic() < until:
            time.sleep(0.01)
    assert host.overrun > 0


def test_as_a_program(tmp_path: Path) -> None:
    link = tmp_path / "port"
    command = [sys.executable, "-m", "robotd_devices.ports.pty_host", "--link", str(link), "--baud", "230400"]
    command += ["--fake", "robotd_devices.lidar.ld19_fake:Ld19Fake"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as program:
        assert program.stdin is not None
        assert program.stdout is not None

        def say(word: str) -> str:
            assert program.stdin is not None
            assert program.stdout is not None
            program.stdin.write(word + "\n")
            program.stdin.flush()
            return program.stdout.readline().strip()

        assert program.stdout.readline() == "ok\n"
        fd = opened(link)
        assert b"\x54\x2c" in read_exactly(fd, 200)
        assert say("unplug") == "ok"
        assert not link.is_symlink()
        assert say("plug") == "ok"
        assert link.is_symlink()
        assert say("jump") == "unknown word 'jump'; known: plug, unplug, quit"
        program.stdin.write("quit\n")
        program.stdin.flush()
        assert program.wait(5.0) == 0
        os.close(fd)
    assert not link.is_symlink()


@pytest.mark.parametrize("kind", DAMAGES)
def test_damage_is_one_fault_of_its_kind(kind: Damage) -> None:
    rng = random.Random(3)
    data = rng.randbytes(500)
    for _ in range(200):
        bad = damage(data, kind, rng, longest=40)
        longer = len(bad) - len(data)
        assert bad != data or kind in ("insert", "duplicate")
        assert {
            "flip": longer == 0 and sum(a != b for a, b in zip(bad, data, strict=False)) == 1,
            "drop": longer == -1,
            "insert": longer == 1,
            "burst": -40 <= longer <= -1,
            "duplicate": 1 <= longer <= 40,
        }[kind]
    assert damage(b"", kind, rng) == b""


def test_faults_come_from_the_seed() -> None:
    def run(seed: int) -> tuple[bytes, int]:
        fake = Counting()
        faulty = Faulty(fake, seed=seed, every_bytes=500)
        out = b""
        for turn in range(50):
            faulty.feed(bytes(range(50)), turn)
            out += faulty.tick(turn)
        return out, faulty.injected

    assert run(1) == run(1)
    assert run(1) != run(2)
    assert 1 <= run(1)[1] <= 15
