"""Bumper: its parser on bytes, its shell on a pseudo-terminal, its twin on virtual time."""

import asyncio
import os
import pty
from pathlib import Path

import pytest
from robotd.authoring.device import DeviceUnavailable
from robotd.testing import check_sensor, connected, run_virtual
from robotd.world.messages import Contact

from robotd_wander.bumper import Bumper, BumperConfig, BumperParser, TimedBumper, TimedBumperConfig


@pytest.mark.parametrize(
    ("pieces", "states", "wrong"),
    [
        ([b"1\n0\n"], [True, False], 0),
        ([b"1", b"\n", b"0\r\n"], [True, False], 0),
        ([b"1"], [], 0),
        ([b"\n2\nx1\n0\n"], [False], 3),
        ([b"x" * 1000, b"\n1\n"], [True], 1),
    ],
)
def test_parser(pieces: list[bytes], states: list[bool], wrong: int) -> None:
    parser = BumperParser()
    assert [state for piece in pieces for state in parser.feed(piece)] == states
    assert parser.wrong == wrong


def test_reads_a_port_and_says_when_it_is_gone() -> None:
    async def scene() -> None:
        ours, theirs = pty.openpty()
        device, link = connected(Bumper, BumperConfig(port=os.ttyname(theirs)))
        await device.open()
        os.write(ours, b"0\n1\nwhat\n")
        await link.received(2)
        assert [message.closed for message in link.of(Contact)] == [False, True]
        await link.until(lambda link: link.faults == [("unreadable line", "")])
        os.close(theirs)
        os.close(ours)
        await link.until(lambda link: bool(link.losses))
        await device.close()

    asyncio.run(scene())


def test_a_port_that_is_not_there_is_named(tmp_path: Path) -> None:
    device, _ = connected(Bumper, BumperConfig(port=str(tmp_path / "nothing")))
    with pytest.raises(DeviceUnavailable, match="nothing"):
        asyncio.run(device.open())


def test_the_twin_keeps_the_contract() -> None:
    async def scene() -> None:
        twin, _ = connected(TimedBumper, TimedBumperConfig())
        await check_sensor(twin)

    run_virtual(scene())


def test_the_twin_is_pressed_by_the_clock() -> None:
    async def scene() -> list[float]:
        twin, link = connected(TimedBumper, TimedBumperConfig(rate_hz=10.0, every_s=2.0, for_s=0.3))
        await twin.open()
        await asyncio.sleep(4.25)
        await twin.close()
        return [message.stamp_ns / 1e9 for message in link.of(Contact) if message.closed]

    assert run_virtual(scene()) == pytest.approx([2.0, 2.1, 2.2, 4.0, 4.1, 4.2])
