"""VESC: vectors, damaged streams, the driver's conversions, its odometry, and the controller's time limit."""

from __future__ import annotations

import asyncio
import math
import random
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from serial_motors import CAR, hold, motor, now_ns, when

from robotd.testing import virtual_time
from robotd.world.messages import Battery, Odometry, Steer
from robotd_devices.motor import vesc_packets as packets
from robotd_devices.motor.vesc import Vesc, VescConfig
from robotd_devices.motor.vesc_fake import VescFake
from robotd_devices.motor.vesc_packets import Values, VescParser
from robotd_devices.ports.fakes import DAMAGES, damage


# research on devices, section 4.3; speed, servo and the question agree there with PyVESC's bytes
@pytest.mark.parametrize(
    ("text", "packet"),
    [
        ("020104408403", packets.ask_values()),
        ("020100000003", packets.ask_version()),
        ("02050800000bb8f80403", packets.set_rpm(3000)),
        ("02050500002710ae1703", packets.set_duty(0.1)),
        ("02050600000000cd8503", packets.set_current(0.0)),
        ("02050700002710ea9403", packets.set_brake(10.0)),
        ("02030c01f4e9cb03", packets.set_servo(0.5)),
        ("02011ef3ff03", packets.alive()),
    ],
)
def test_vectors(text: str, packet: bytes) -> None:
    assert packet.hex() == text
    assert VescParser().feed(packet) == [packet[2:-3]]


def test_checksum() -> None:
    assert packets.crc16(b"123456789") == 0x31C3


def test_values_there_and_back() -> None:
    values = Values(31.5, 40.0, -2.25, 1.5, -0.125, -12345, 11.1, -700, 4)
    assert packets.values_of(packets.values_payload(values)) == values
    assert values.fault_names == {"over current"}
    assert values._replace(fault=99).fault_names == {"fault 99"}
    assert packets.values_of(b"\x04short") is None
    assert packets.values_of(b"\x00" * 60) is None


@given(st.lists(st.binary(min_size=1, max_size=80), max_size=6), st.lists(st.integers(0, 500)))
def test_any_chunking_gives_the_same_packets(payloads: list[bytes], cuts: list[int]) -> None:
    stream = b"".join(map(packets.encode, payloads))
    edges = sorted({min(cut, len(stream)) for cut in cuts} | {0, len(stream)})
    parser = VescParser()
    assert [p for a, b in pairwise(edges) for p in parser.feed(stream[a:b])] == payloads
    assert parser.faults == 0


def test_damaged_stream_gives_no_wrong_packet() -> None:
    rng = random.Random(5)
    sent = [b"\x04" + rng.randbytes(53) for _ in range(1500)]
    for kind in DAMAGES:
        parser = VescParser()
        found: list[bytes] = []
        for i in range(0, len(sent), 10):
            found += parser.feed(damage(b"".join(map(packets.encode, sent[i : i + 10])), kind, rng, longest=20))
        assert set(found) <= set(sent), kind
        # what begins like a packet inside of a damaged one hides up to 260 bytes behind it
        assert len(sent) - len(set(found)) <= 2.0 * 150, kind


# ---------------------------------------------------------------------------------------------- driver


@pytest.mark.parametrize(
    ("config", "steer", "erpm", "servo"),
    [
        ({}, Steer(1.0, 0.0), 4614, 0.530),
        ({}, Steer(-0.5, 0.2), -2307, 0.288),  # to the left: 0.5304 - 1.2135 * 0.2
        ({}, Steer(1.0, -0.2), 4614, 0.773),
        ({}, Steer(1.0, 1.0), 4614, 0.150),
        ({}, Steer(1.0, -1.0), 4614, 0.850),
        ({}, Steer(99.0, 0.0), 23070, 0.530),
        ({"speed_reversed": True}, Steer(1.0, 0.0), -4614, 0.530),
        ({"erpm_offset": 100.0}, Steer(1.0, 0.0), 4714, 0.530),
        ({"servo_per_rad": 1.0, "servo_centre": 0.5}, Steer(1.0, 0.2), 4614, 0.700),
        ({}, Steer(0.01, 0.2), 0, 0.288),
    ],
)
@virtual_time
async def test_conversions(config: dict[str, object], steer: Steer, erpm: int, servo: float) -> None:
    fake = VescFake()
    device, link, _ = motor(Vesc, fake, CAR, **config)
    await device.open()
    await hold(device, steer, 0.1)
    assert fake.erpm(now_ns()) == erpm
    assert fake.servo == pytest.approx(servo, abs=0.0006)
    assert link.faults == []
    await device.close()


@virtual_time
async def test_stop_lets_go_or_brakes() -> None:
    for brake_a in (0.0, 10.0):
        fake = VescFake()
        device, _, _ = motor(Vesc, fake, CAR, brake_a=brake_a)
        await device.open()
        await hold(device, Steer(1.0, 0.0), 0.1)
        device.halt()
        await asyncio.sleep(0.01)
        assert (fake.erpm(now_ns()), fake.brake_a) == (0, brake_a)
        await device.close()


@virtual_time
async def test_controllers_own_time_limit_is_not_fed_by_questions() -> None:
    fake = VescFake()
    device, _, _ = motor(Vesc, fake, CAR)
    await device.open()
    await hold(device, Steer(1.0, 0.0), 0.5)
    # the act tick stands still while the driver's own questions go on
    assert await when(lambda: fake.erpm(now_ns()) == 0) <= 1.001
    await device.close()
    # one that has the limit switched off never stops by itself: what the trial on a stand must find
    fake = VescFake(times_out=False)
    fake.feed(packets.set_rpm(3000), 0)
    assert fake.erpm(10**10) == 3000


@pytest.mark.parametrize("reversed_", [False, True])
@virtual_time
async def test_odometry_and_battery(reversed_: bool) -> None:
    fake = VescFake()
    device, link, _ = motor(Vesc, fake, CAR, speed_reversed=reversed_)
    await device.open()
    steering = math.atan(CAR.wheelbase_m / 2.0)
    await hold(device, Steer(1.0, steering), math.pi)  # half a circle of radius 2 m has 2 pi m: a quarter
    device.halt()
    await asyncio.sleep(0.1)
    last = link.of(Odometry)[-1]
    assert (last.x_m, last.y_m) == (pytest.approx(2.0, abs=0.03), pytest.approx(2.0, abs=0.03))
    assert last.yaw_rad == pytest.approx(math.pi / 2, abs=0.02)
    assert (last.vx_mps, last.wz_radps) == (0.0, 0.0)
    moving = link.of(Odometry)[60]
    assert (moving.vx_mps, moving.wz_radps) == (pytest.approx(1.0, abs=0.001), pytest.approx(0.5, abs=0.01))
    assert 6 <= len(link.of(Battery)) <= 8
    assert link.of(Battery)[-1].voltage_v == 11.1
    assert link.of(Battery)[-1].current_a == 1.5
    assert 150 <= len(link.of(Odometry)) <= 170
    await device.close()


@virtual_time
async def test_way_of_lost_answers_is_not_lost() -> None:
    fake = VescFake()
    device, link, _ = motor(Vesc, fake, CAR, silent_s=2.0)
    await device.open()
    await hold(device, Steer(1.0, 0.0), 0.5)
    fake.is_mute = True
    await hold(device, Steer(1.0, 0.0), 1.0)
    fake.is_mute = False
    await hold(device, Steer(1.0, 0.0), 0.5)
    assert link.of(Odometry)[-1].x_m == pytest.approx(2.0, abs=0.06)
    await device.close()


@virtual_time
async def test_a_fault_is_told_once_and_ends_the_drive_until_it_is_opened_anew() -> None:
    fake = VescFake()
    device, link, _ = motor(Vesc, fake, CAR)
    for code, name in ((2, "under voltage"), (5, "controller too hot")):
        await device.open()
        await asyncio.sleep(0.1)
        fake.fault = code
        await asyncio.sleep(0.1)
        assert link.faults[-1][0] == name
        assert f"the VESC reports {name}" in str(link.losses[-1])
        await device.close()
        fake.fault = 0
    assert (len(link.faults), len(link.losses)) == (2, 2)
    await device.open()
    device.received(b"noise", now_ns())
    assert link.faults[-1][0] == "bad packet"
    await device.close()


@pytest.mark.parametrize("config", [{"servo_centre": 0.9}, {"servo_per_rad": 0.0}, {"erpm_per_mps": 0.0}])
def test_config_refuses(config: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        VescConfig.model_validate(config)
