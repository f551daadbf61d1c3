"""The gamepad from recorded input events: parsing under every cut, the dead-man's button, drops, unplugging."""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotd.authoring.device import DeviceLost, DeviceMisconfigured, DeviceUnavailable
from robotd.testing import FakeLink, ManualClock, check_sensor, connected, virtual_time
from robotd.world.messages import Gamepad
from robotd_devices.gamepad import EvdevGamepad, GamepadConfig, IdleGamepad
from robotd_devices.gamepad.input_events import EVENT, USUAL, AxisRange, PadState, position
from robotd_devices.gamepad.node import ask_axes, open_node

SYN, KEY, ABS = 0, 1, 3
TL, SOUTH, EAST = 0x136, 0x130, 0x131
X, Y, RX = 0x00, 0x01, 0x03

# 24 bytes each: time (8 + 8), type, code, value; the left shoulder goes down, the left stick away, a report
RECORDED = bytes.fromhex(
    "4a3c8f6700000000 0b3d060000000000 0400 0400 37010000"  # MSC_SCAN, which says nothing new
    "4a3c8f6700000000 0b3d060000000000 0100 3601 01000000"
    "4a3c8f6700000000 0b3d060000000000 0300 0100 00c0ffff"
    "4a3c8f6700000000 0b3d060000000000 0000 0000 00000000"
    "4a3c8f6700000000 2a5c060000000000 0100 3601 00000000"
    "4a3c8f6700000000 2a5c060000000000 0000 0000 00000000"
)


def event(kind: int, code: int, value: int = 0) -> bytes:
    return struct.pack("@llHHi", 1737440330, 0, kind, code, value)


REPORT = event(SYN, 0)


def test_an_event_has_24_bytes_here() -> None:
    assert EVENT.size == 24


def test_recorded_bytes() -> None:
    state = PadState()
    assert state.feed(RECORDED[:95]) == 0
    assert (state.held, state.values) == (set(), {})  # a report counts when it is complete
    assert state.feed(RECORDED[95:96]) == 1
    assert (state.held, state.values) == ({"tl"}, {"y": -16384})
    assert state.feed(RECORDED[96:]) == 1
    assert (state.held, state.values, state.presses) == (set(), {"y": -16384}, {"tl": 1})


_EVENTS = st.lists(
    st.one_of(
        st.tuples(st.just(ABS), st.sampled_from([X, Y, RX, 0x10, 0x28]), st.integers(-32768, 32767)),
        st.tuples(st.just(KEY), st.sampled_from([TL, SOUTH, 0x2C0]), st.integers(0, 2)),
        st.tuples(st.just(SYN), st.sampled_from([0, 0, 0, 3]), st.just(0)),
        st.tuples(st.just(4), st.just(4), st.integers(0, 99)),
    ),
    max_size=40,
)


@given(events=_EVENTS, cuts=st.lists(st.integers(0, 1000), max_size=20))
def test_any_cut_of_the_bytes_means_the_same(events: list[tuple[int, int, int]], cuts: list[int]) -> None:
    data = b"".join(event(*one) for one in events)
    whole, cut = PadState(), PadState()
    whole.feed(data)
    edges = [0, *sorted(min(at, len(data)) for at in cuts), len(data)]
    assert sum(cut.feed(data[a:b]) for a, b in pairwise(edges)) == whole.reports
    assert (cut.held, cut.values, cut.presses, cut.must_ask) == (
        whole.held,
        whole.values,
        whole.presses,
        whole.must_ask,
    )


def test_key_repeat_is_no_press() -> None:
    state = PadState()
    state.feed(event(KEY, SOUTH, 1) + REPORT + event(KEY, SOUTH, 2) + REPORT)
    assert (state.held, state.presses) == ({"south"}, {"south": 1})


def test_a_press_that_is_over_within_one_read_is_counted() -> None:
    state = PadState()
    state.feed(event(KEY, EAST, 1) + REPORT + event(KEY, EAST, 0) + REPORT)
    assert (state.held, state.presses) == (set(), {"east": 1})


def test_dropped_events_release_everything_until_pressed_anew() -> None:
    state = PadState()
    state.feed(event(KEY, TL, 1) + event(ABS, Y, -9000) + REPORT)
    state.feed(event(ABS, X, 5) + event(SYN, 3) + event(KEY, SOUTH, 1) + event(ABS, Y, 7))
    assert (state.held, state.values, state.must_ask) == (set(), {}, True)
    state.feed(REPORT)  # what stood before it is not to be believed
    assert (state.held, state.values) == (set(), {})
    state.asked({"y": -9000})
    state.feed(event(KEY, TL, 1) + REPORT)
    assert (state.held, state.values, state.must_ask) == ({"tl"}, {"y": -9000}, False)


TRIGGER = AxisRange(0, 255, 0, 0)
PS = AxisRange(0, 255, 15, 128)


@pytest.mark.parametrize(
    ("name", "value", "axis", "dead_zone", "place"),
    [
        ("x", -32768, USUAL.get("x", AxisRange(-32768, 32767, 128)), 0.08, -1.0),
        ("x", 32767, AxisRange(-32768, 32767, 128), 0.08, 1.0),
        ("x", 2600, AxisRange(-32768, 32767, 128), 0.08, 0.0),
        ("x", 17694, AxisRange(-32768, 32767, 128), 0.08, 0.5),  # half way from the zone's edge
        ("y", 128, PS, 0.0, 0.0),
        ("y", 0, PS, 0.0, -1.0),
        ("y", 255, PS, 0.0, 1.0),
        ("y", 140, PS, 0.0, 0.0),  # within the kernel's flat place
        ("rz", 0, TRIGGER, 0.08, 0.0),
        ("rz", 255, TRIGGER, 0.08, 1.0),
        ("rz", 138, TRIGGER, 0.08, 0.5),
        ("rz", 0, PS, 0.08, -1.0),  # a second stick under a trigger's name
        ("x", 0, AxisRange(0, 255, 0, 0), 0.08, -1.0),  # a stick that was held aside at opening is no trigger
        ("hat0x", -1, AxisRange(-1, 1), 0.08, -1.0),
        ("hat0x", 0, AxisRange(-1, 1), 0.08, 0.0),
        ("x", 99999, AxisRange(-100, 100), 0.08, 1.0),
        ("x", 5, AxisRange(0, 0), 0.08, 0.0),
    ],
)
def test_positions(name: str, value: int, axis: AxisRange, dead_zone: float, place: float) -> None:
    assert position(name, value, axis, dead_zone) == pytest.approx(place, abs=0.002)


class Pipe:
    """A named pipe in the place of /dev/input/event0."""

    def __init__(self, path: Path) -> None:
        self.path = path
        os.mkfifo(path)
        self.fd = -1
        self.plug()

    def plug(self) -> None:
        reader = os.open(self.path, os.O_RDONLY | os.O_NONBLOCK)
        self.fd = os.open(self.path, os.O_WRONLY | os.O_NONBLOCK)
        os.close(reader)

    def unplug(self) -> None:
        os.close(self.fd)
        self.fd = -1

    def send(self, *events: bytes) -> None:
        os.write(self.fd, b"".join(events))


@pytest.fixture
def pipe(tmp_path: Path) -> Iterator[Pipe]:
    made = Pipe(tmp_path / "event0")
    yield made
    if made.fd >= 0:
        made.unplug()


def pad(pipe: Pipe, clock: ManualClock | None = None, **config: Any) -> tuple[EvdevGamepad, FakeLink]:
    config = {"path": str(pipe.path), "rate_hz": 100.0} | config
    return connected(EvdevGamepad, GamepadConfig(**config), name="gamepad", clock=clock)


def newest(link: FakeLink) -> Gamepad:
    return link.of(Gamepad)[-1]


async def test_events_become_a_state(pipe: Pipe) -> None:
    device, link = pad(pipe, rate_hz=5.0, reversed_axes=("rx",))
    await device.open()
    assert newest(link) == Gamepad(newest(link).stamp_ns)
    pipe.send(RECORDED[:96])
    await link.received(2)
    assert newest(link).deadman
    assert newest(link).buttons == ("tl",)
    assert newest(link).axis("y") == pytest.approx(-0.457, abs=0.001)
    assert newest(link).axis("x") == 0.0
    pipe.send(RECORDED[96:], event(ABS, RX, 32767), event(KEY, EAST, 1), REPORT, event(KEY, EAST, 0), REPORT)
    await link.received(3)
    assert not newest(link).deadman
    assert newest(link).axis("rx") == -1.0
    assert newest(link).presses == (("east", 1), ("tl", 1))
    assert newest(link).buttons == ()
    await device.close()


async def test_keeps_the_contract_of_sensors(pipe: Pipe) -> None:
    device, link = pad(pipe)
    await check_sensor(device, messages=4)
    assert link.losses == [] and link.faults == []


async def test_unplugged_and_plugged_in_again_nothing_is_held(pipe: Pipe) -> None:
    device, link = pad(pipe)
    await device.open()
    pipe.send(event(KEY, TL, 1), REPORT)
    await link.until(lambda link: newest(link).deadman)
    pipe.unplug()
    await link.until(lambda link: bool(link.losses))
    assert isinstance(link.losses[0], DeviceLost)
    assert "gamepad: its events ended" in str(link.losses[0])
    count = len(link.messages)
    await device.close()
    assert len(link.messages) == count
    pipe.plug()
    await device.open()
    await link.received(count + 1)
    assert not newest(link).deadman
    assert newest(link).presses == (("tl", 1),)  # goes on counting, so that a reader sees no press twice
    await device.close()


async def test_a_node_that_is_gone_is_a_loss(pipe: Pipe, monkeypatch: pytest.MonkeyPatch) -> None:
    def gone(fd: int, size: int) -> bytes:
        raise OSError(19, "No such device")  # what a read of an unplugged pad gives

    device, link = pad(pipe)
    await device.open()
    monkeypatch.setattr("robotd_devices.gamepad.driver.os.read", gone)
    pipe.send(REPORT)
    await link.until(lambda link: bool(link.losses))
    monkeypatch.undo()
    assert "unplugged, or switched off (No such device)" in str(link.losses[0])
    await device.close()


async def test_dropped_events_are_counted_and_let_go(pipe: Pipe) -> None:
    device, link = pad(pipe)
    await device.open()
    pipe.send(event(KEY, TL, 1), REPORT)
    await link.until(lambda link: newest(link).deadman)
    pipe.send(event(SYN, 3), event(ABS, X, 1), REPORT)
    await link.until(lambda link: not newest(link).deadman)
    assert [name for name, _ in link.faults] == ["events dropped"]
    await device.close()


async def test_a_pad_that_says_nothing_for_long_counts_as_let_go(pipe: Pipe) -> None:
    clock = ManualClock(10**10)
    device, link = pad(pipe, clock, idle_s=3.0)
    await device.open()
    pipe.send(event(KEY, TL, 1), REPORT)
    await link.until(lambda link: newest(link).deadman)
    clock.set_ns(clock.now_ns() + 2_900_000_000)
    count = len(link.messages)
    await link.received(count + 2)
    assert newest(link).deadman
    clock.set_ns(clock.now_ns() + 200_000_000)
    await link.until(lambda link: not newest(link).deadman)
    assert [name for name, _ in link.faults] == ["no event"]
    pipe.send(event(ABS, X, 9000), REPORT)  # it is back; the button has to be pressed anew
    await link.until(lambda link: newest(link).axis("x") > 0.0)
    assert not newest(link).deadman
    pipe.send(event(KEY, TL, 0), REPORT, event(KEY, TL, 1), REPORT)
    await link.until(lambda link: newest(link).deadman)
    await device.close()


def test_a_pipe_cannot_be_asked_for_its_axes(pipe: Pipe) -> None:
    fd = open_node(str(pipe.path))
    assert ask_axes(fd) == {}
    os.close(fd)


def test_the_kernel_is_asked_for_range_and_place(pipe: Pipe, monkeypatch: pytest.MonkeyPatch) -> None:
    answers = {
        0x80084523: (1 << X | 1 << 0x05).to_bytes(8, "little"),  # EVIOCGBIT(EV_ABS, 8)
        0x80184540: struct.pack("6i", 131, 0, 255, 0, 15, 0),  # EVIOCGABS(ABS_X)
        0x80184545: struct.pack("6i", 0, 0, 1023, 0, 0, 0),  # EVIOCGABS(ABS_RZ)
    }
    monkeypatch.setattr("robotd_devices.gamepad.node.fcntl.ioctl", lambda fd, request, data: answers[request])
    assert ask_axes(0) == {"x": AxisRange(0, 255, 15, 131), "rz": AxisRange(0, 1023, 0, 0)}


@pytest.mark.parametrize(
    ("name", "error", "words"),
    [
        ("nothing*", DeviceUnavailable, "nothing is at .*nothing.*plug the pad in or switch it on"),
        ("file", DeviceMisconfigured, ".*file is no input device"),
    ],
)
async def test_opening_says_why_not(tmp_path: Path, name: str, error: type[Exception], words: str) -> None:
    (tmp_path / "file").write_text("")
    device, link = connected(EvdevGamepad, GamepadConfig(path=str(tmp_path / name)), name="gamepad")
    with pytest.raises(error, match="gamepad: `path`: " + words):
        await device.open()
    await device.close()
    assert link.messages == []


async def test_no_permission(pipe: Pipe, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*args: object) -> int:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("robotd_devices.gamepad.node.os.open", refuse)
    with pytest.raises(DeviceUnavailable, match="usermod -aG input"):
        open_node(str(pipe.path))


@virtual_time
async def test_the_simulated_pad_is_at_rest() -> None:
    device, link = connected(partial(IdleGamepad), IdleGamepad.config_type())
    await check_sensor(device, messages=5)
    assert {(message.deadman, message.buttons, message.axes) for message in link.of(Gamepad)} == {(False, (), ())}
