"""RoboClaw: vectors, answers among acknowledgements, wheels and signs, its time limit, odometry, faults."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from itertools import pairwise
from statistics import fmean

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from pydantic import ValidationError
from serial_motors import TWO_WHEELS, hold, motor, now_ns, when

from robotd.authoring.device import DeviceUnavailable
from robotd.testing import virtual_time
from robotd.world.messages import Battery, Drive, Odometry
from robotd_devices.motor import roboclaw_packets as packets
from robotd_devices.motor.roboclaw import RoboClaw, RoboClawConfig
from robotd_devices.motor.roboclaw_fake import RoboClawFake
from robotd_devices.motor.roboclaw_packets import Answer, RoboClawReader

QPPS = 1000 / (math.tau * 0.05)
"""Counts a second at 1 m/s with the defaults and the tests' wheels."""


# research on devices, section 4.3; tcr-roboclaw writes the same
@pytest.mark.parametrize(
    ("text", "packet"),
    [
        ("8025000003e8fffffc188290", packets.speed(0x80, 1000, -1000)),
        ("80222000e000bfeb", packets.duty(0x80, 0x2000, -0x2000)),
        ("8015", packets.question(0x80, packets.VERSION)),
    ],
)
def test_vectors(text: str, packet: bytes) -> None:
    assert packet.hex() == text


@given(
    st.sampled_from(sorted(packets.ANSWER_BYTES)),
    st.binary(min_size=8, max_size=8),
    st.integers(0, 8),
    st.integers(0, 3),
    st.lists(st.integers(0, 20)),
)
def test_answer_is_found_among_acknowledgements_however_cut(
    command: int, noise: bytes, before: int, behind: int, cuts: list[int]
) -> None:
    data = (b"\xff" + noise)[: packets.ANSWER_BYTES[command]]
    stream = b"\xff" * before + packets.answer(0x80, command, data) + b"\xff" * behind
    edges = sorted({min(cut, len(stream)) for cut in cuts} | {0, len(stream)})
    reader = RoboClawReader(0x80)
    reader.asked(command)
    found = [a for i, j in pairwise(edges) if (a := reader.feed(stream[i:j])) is not None]
    assert found == [Answer(command, data)]
    assert reader.open is None
    assert reader.faults == 0


@given(
    st.lists(st.sampled_from(sorted(packets.ANSWER_BYTES)), min_size=1, max_size=3),
    st.sampled_from(sorted(packets.ANSWER_BYTES)),
    st.integers(0, 6),
    st.booleans(),
)
def test_answer_is_found_behind_late_ones_and_behind_half_of_one(
    late: list[int], command: int, lost: int, in_pieces: bool
) -> None:
    assume(command not in late)  # the driver asks something else first
    reader = RoboClawReader(0x80)
    stream = b""
    for other in late:
        reader.asked(other)
        reader.give_up()
        stream += b"\xff" + packets.answer(0x80, other, bytes(range(1, packets.ANSWER_BYTES[other] + 1)))
    reader.asked(command)
    wanted = Answer(command, bytes(range(0x41, 0x41 + packets.ANSWER_BYTES[command])))
    stream = stream[lost:] + packets.answer(0x80, *wanted)
    pieces = [stream[i : i + 1] for i in range(len(stream))] if in_pieces else [stream]
    found = [a for piece in pieces if (a := reader.feed(piece)) is not None]
    assert found == [wanted]
    assert reader.faults == 0


def test_what_is_no_answer() -> None:
    reader = RoboClawReader(0x80)
    assert reader.feed(b"\xff\xff") is None
    assert (reader.acknowledged, reader.faults) == (2, 0)
    assert reader.feed(b"\x01") is None
    assert reader.faults == 1
    reader.asked(packets.BATTERY)
    assert reader.feed(packets.answer(0x81, packets.BATTERY, b"\0\x7b")) is None  # another controller's
    assert reader.open == packets.BATTERY
    reader.asked(packets.VERSION)
    for _ in range(40):
        assert reader.feed(b"x" * 10) is None
    assert reader.faults >= 4  # a flood is a fault again and again, and does not pile up
    assert reader.feed(packets.answer(0x80, packets.VERSION, b"v4\n\0")) == (packets.VERSION, b"v4\n\0")


def test_fault_names() -> None:
    assert packets.fault_names(0x0) == frozenset()
    assert packets.fault_names(0x010001) == {"emergency stop input", "M1 over current"}


# ---------------------------------------------------------------------------------------------- driver


@pytest.mark.parametrize(
    ("config", "drive", "m1", "m2"),
    [
        ({}, Drive(0.5, 0.0), 0.5, 0.5),
        ({}, Drive(0.5, 1.0), 0.35, 0.65),
        ({"left": "m2"}, Drive(0.5, 1.0), 0.65, 0.35),
        ({"right_reversed": True}, Drive(0.5, 1.0), 0.35, -0.65),
        ({"left": "m2", "left_reversed": True}, Drive(0.5, 1.0), 0.65, -0.35),
        # too fast by 1.3: the same curve, slower
        ({}, Drive(1.0, 2.0), 0.7 / 1.3, 1.0),
        ({"counts_per_turn": 2000.0}, Drive(0.25, 0.0), 0.5, 0.5),
        ({}, Drive(0.0, 0.0), 0.0, 0.0),
    ],
)
@virtual_time
async def test_wheels(config: dict[str, object], drive: Drive, m1: float, m2: float) -> None:
    fake = RoboClawFake()
    device, link, _ = motor(RoboClaw, fake, TWO_WHEELS, **config)
    await device.open()
    await hold(device, drive, 0.3)
    assert fake.speed_qpps(now_ns()) == (round(m1 * QPPS), round(m2 * QPPS))
    assert link.faults == []
    await device.close()


@virtual_time
async def test_time_limit_is_written_at_each_opening_and_read_back() -> None:
    fake = RoboClawFake()
    device, _, _ = motor(RoboClaw, fake, TWO_WHEELS, timeout_ms=200)
    for _ in range(2):
        fake.timeout_tenths = 0
        await device.open()
        assert fake.timeout_tenths == 2
        await device.close()


@virtual_time
async def test_time_limit_that_is_not_taken_is_refused() -> None:
    class Stubborn(RoboClawFake):
        def _obey(self, command: int, data: bytes) -> None:
            super()._obey(command, data)
            self.timeout_tenths = 0

    device, _, _ = motor(RoboClaw, Stubborn(), TWO_WHEELS)
    with pytest.raises(DeviceUnavailable, match="300 ms were written, 0 ms are read back"):
        await device.open()
    await device.close()


@virtual_time
async def test_command_that_nobody_renews_runs_into_the_time_limit() -> None:
    fake = RoboClawFake()
    device, link, _ = motor(RoboClaw, fake, TWO_WHEELS, silent_s=5.0)
    await device.open()
    await hold(device, Drive(0.5, 0.0), 0.5)
    # the act tick stands still, the driver's questions would feed the controller
    assert await when(lambda: fake.speed_qpps(now_ns()) == (0, 0)) <= 0.15 + 0.3 + 0.05
    await hold(device, Drive(0.5, 0.0), 0.1)
    assert fake.speed_qpps(now_ns()) != (0, 0)
    # while it stands, questions go on for ever
    device.halt()
    await asyncio.sleep(6.0)
    assert link.losses == []
    await device.close()


@pytest.mark.parametrize("config", [{}, {"left": "m2", "left_reversed": True, "right_reversed": True}])
@virtual_time
async def test_odometry_and_battery(config: dict[str, object]) -> None:
    fake = RoboClawFake()
    device, link, _ = motor(RoboClaw, fake, TWO_WHEELS, **config)
    await device.open()
    await hold(device, Drive(0.5, 0.5), math.pi)  # a quarter of a circle of radius 1 m
    device.halt()
    await asyncio.sleep(0.2)
    last = link.of(Odometry)[-1]
    assert (last.x_m, last.y_m) == (pytest.approx(1.0, abs=0.02), pytest.approx(1.0, abs=0.02))
    assert last.yaw_rad == pytest.approx(math.pi / 2, abs=0.02)
    assert (last.vx_mps, last.wz_radps) == (0.0, 0.0)
    moving = link.of(Odometry)[5:45]  # one reading jitters with the line's traffic
    assert fmean(m.vx_mps for m in moving) == pytest.approx(0.5, abs=0.01)
    assert fmean(m.wz_radps for m in moving) == pytest.approx(0.5, abs=0.02)
    assert all(abs(m.vx_mps - 0.5) < 0.1 for m in moving)
    assert 60 <= len(link.of(Odometry)) <= 70
    assert 3 <= len(link.of(Battery)) <= 4
    assert link.of(Battery)[-1].voltage_v == 12.3
    assert link.of(Battery)[-1].current_a == pytest.approx(1.2)
    await device.close()


@virtual_time
async def test_counter_runs_over_and_is_reset() -> None:
    fake = RoboClawFake()
    fake._counts = [2.0**31 - 100, 2.0**31 - 100]
    device, link, _ = motor(RoboClaw, fake, TWO_WHEELS)
    await device.open()
    await hold(device, Drive(0.5, 0.0), 1.0)
    assert link.of(Odometry)[-1].x_m == pytest.approx(0.5, abs=0.05)
    assert link.faults == []
    fake._counts = [0.0, 0.0]
    await hold(device, Drive(0.5, 0.0), 0.5)
    assert [name for name, _ in link.faults] == ["encoder jumped"]
    assert link.of(Odometry)[-1].x_m == pytest.approx(0.75, abs=0.08)
    await device.close()


@virtual_time
async def test_faults_are_told() -> None:
    fake = RoboClawFake()
    device, link, _ = motor(RoboClaw, fake, TWO_WHEELS)
    await device.open()
    fake.status = 0x080000
    await asyncio.sleep(2.5)
    fake.is_mute = True
    await asyncio.sleep(0.2)
    fake.is_mute = False
    await asyncio.sleep(0.2)
    device.received(b"\x13", now_ns())
    names = [name for name, _ in link.faults]
    assert names[0] == "main voltage low"
    assert set(names) == {"main voltage low", "no answer", "stray bytes"} or set(names) == {
        "main voltage low",
        "no answer",
    }
    await device.close()


@virtual_time
async def test_another_address_is_not_answered() -> None:
    device, _, _ = motor(RoboClaw, RoboClawFake(0x81), TWO_WHEELS)
    with pytest.raises(DeviceUnavailable, match="`address: 0x80`"):
        await device.open()
    await device.close()


@pytest.mark.parametrize("config", [{"timeout_ms": 0}, {"timeout_ms": 250}, {"address": 0x10}, {"left": "m3"}])
def test_config_refuses(config: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        RoboClawConfig.model_validate(config)


# ------------------------------------------------------------------------------------- answers that come late


class LateFake(RoboClawFake):
    """Its answers are `late_s` on their way, what is still on it also over a replug; `garble` changes them first."""

    def __init__(self) -> None:
        self.late_s = 0.0
        self.garble: Callable[[bytes], bytes] = lambda data: data
        self.on_their_way: list[tuple[int, bytes]] = []
        super().__init__()

    def tick(self, now_ns: int) -> bytes:
        if data := super().tick(now_ns):
            before_ns = self.on_their_way[-1][0] if self.on_their_way else 0  # none overtakes another
            self.on_their_way.append((max(before_ns, now_ns + round(self.late_s * 1e9)), self.garble(data)))
        come = [data for due_ns, data in self.on_their_way if due_ns <= now_ns]
        del self.on_their_way[: len(come)]
        return b"".join(come)


@pytest.mark.parametrize(("late_s", "at_least"), [(0.06, 10), (0.09, 7), (0.12, 5), (0.18, 3)])
@virtual_time
async def test_line_whose_answers_come_late_is_not_lost(late_s: float, at_least: int) -> None:
    fake = LateFake()
    device, link, _ = motor(RoboClaw, fake, TWO_WHEELS)
    await device.open()
    await hold(device, Drive(0.5, 0.3), 0.5, 80.0)
    fake.late_s = late_s
    await hold(device, Drive(0.5, 0.3), 1.0, 80.0)
    settled = len(link.of(Odometry))
    await hold(device, Drive(0.5, 0.3), 3.0, 80.0)
    assert link.losses == []
    assert len(link.of(Odometry)) - settled >= at_least
    # no count is taken for a later one
    assert all(o.vx_mps == pytest.approx(0.5, abs=0.02) for o in link.of(Odometry)[settled:])
    assert all(o.wz_radps == pytest.approx(0.3, abs=0.05) for o in link.of(Odometry)[settled:])
    await device.close()


@virtual_time
async def test_pauses_of_a_busy_machine_cost_a_question_each() -> None:
    fake = LateFake()
    device, link, _ = motor(RoboClaw, fake, TWO_WHEELS)
    await device.open()
    for late_s in (0.06, 0.1, 0.16, 0.19) * 3:
        fake.late_s = late_s
        await hold(device, Drive(0.5, 0.0), 0.1, 80.0)
        fake.late_s = 0.0
        await hold(device, Drive(0.5, 0.0), 0.2, 80.0)
    assert link.losses == []
    assert {name for name, _ in link.faults} == {"no answer"}
    device.halt()
    await asyncio.sleep(0.5)
    assert link.of(Odometry)[-1].x_m == pytest.approx(0.5 * 12 * 0.3, abs=0.05)
    await device.close()


@virtual_time
async def test_half_answers_cost_a_question_each() -> None:
    fake = LateFake()
    device, link, _ = motor(RoboClaw, fake, TWO_WHEELS)
    await device.open()
    count = 0

    def fifth(data: bytes) -> bytes:
        nonlocal count
        count += len(data) > 1
        return data[:4] if count % 5 == 0 else data

    fake.garble = fifth
    await hold(device, Drive(0.5, 0.0), 4.0, 80.0)
    assert link.losses == []
    assert len(link.of(Odometry)) >= 10
    assert all(o.vx_mps == pytest.approx(0.5, abs=0.1) for o in link.of(Odometry)[3:])
    await device.close()


@virtual_time
async def test_answer_to_a_question_from_before_the_replug_is_passed_over() -> None:
    fake = LateFake()
    device, link, line = motor(RoboClaw, fake, TWO_WHEELS)
    stale = packets.answer(0x80, packets.ENCODER_1, b"\0\xff\0\7\0")
    for cut in range(len(stale)):
        fake.on_their_way = [(now_ns(), stale[cut:])]
        opening_s = asyncio.get_running_loop().time()
        await device.open()
        assert asyncio.get_running_loop().time() - opening_s < 0.1  # the first questions are answered
        await hold(device, Drive(0.5, 0.0), 0.3)
        assert fake.speed_qpps(now_ns()) != (0, 0)
        line.unplug()
        await when(lambda: "went away" in str(link.losses[-1:]))
        await device.close()
        link.losses.clear()
        line.plug()
    assert {name for name, _ in link.faults} <= {"stray bytes"}


@virtual_time
async def test_commands_that_are_acknowledged_are_signs_of_life_though_no_question_is_answered() -> None:
    fake = LateFake()
    device, link, _ = motor(RoboClaw, fake, TWO_WHEELS)
    await device.open()
    fake.garble = lambda data: data if set(data) == {0xFF} else b""
    await hold(device, Drive(0.5, 0.0), 1.0)
    assert link.losses == []
    device.halt()
    await asyncio.sleep(0.8)  # here it repeats no stop: nothing is acknowledged
    assert len(link.losses) == 1
    await device.close()


@virtual_time
async def test_time_limit_that_was_forgotten_is_written_again() -> None:
    fake = RoboClawFake()
    device, link, _ = motor(RoboClaw, fake, TWO_WHEELS)
    await device.open()
    await hold(device, Drive(0.5, 0.0), 0.5)
    fake.timeout_tenths = 0  # switched off and on behind its adapter
    await hold(device, Drive(0.5, 0.0), 1.1)
    assert ["forgotten its time limit" in str(loss) for loss in link.losses] == [True]
    await device.close()
    await device.open()
    assert fake.timeout_tenths == 3
    await device.close()


@virtual_time
async def test_program_that_was_held_up_does_not_blame_the_controller() -> None:
    fake = RoboClawFake()
    device, link, _ = motor(RoboClaw, fake, TWO_WHEELS)
    await device.open()
    await asyncio.sleep(0.2)
    loop = asyncio.get_running_loop()
    device._next_s -= 0.6  # the loop did not come to it
    device._heard_ns -= 600_000_000
    device._beat.cancel()
    loop.call_soon(device._tick)
    await asyncio.sleep(0.2)
    assert link.losses == []
    fake.is_mute = True
    await asyncio.sleep(0.7)
    assert ["silent for 0.5 s" in str(loss) for loss in link.losses] == [True]
    await device.close()
