"""RoboClaw: vectors, answers among acknowledgements, wheels and signs, its time limit, odometry, faults."""

from __future__ import annotations

import asyncio
import math
from itertools import pairwise
from statistics import fmean

import pytest
from hypothesis import given
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
    assert reader.is_free
    assert reader.faults == 0


def test_what_is_no_answer() -> None:
    reader = RoboClawReader(0x80)
    assert reader.feed(b"\xff\xff") is None
    assert (reader.acknowledged, reader.faults) == (2, 0)
    assert reader.feed(b"\x01") is None
    assert reader.faults == 1
    reader.asked(packets.BATTERY)
    assert reader.feed(packets.answer(0x81, packets.BATTERY, b"\0\x7b")) is None  # another controller's
    assert not reader.is_free
    reader.give_up()
    reader.asked(packets.VERSION)
    for _ in range(10):
        assert reader.feed(b"x" * 10) is None
    assert reader.faults >= 2  # a flood closes the question, and is a fault behind it


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
