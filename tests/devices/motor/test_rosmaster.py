"""Rosmaster: vectors, damaged streams, signs, limits, the 2 ms between commands, and that it never stops by itself."""

from __future__ import annotations

import asyncio
import math
import random
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st
from serial_motors import MECANUM, hold, motor, now_ns

from robotd.testing import virtual_time
from robotd.world.messages import Battery, Drive, Imu, Odometry
from robotd_devices.motor import rosmaster_packets as packets
from robotd_devices.motor.rosmaster import Rosmaster
from robotd_devices.motor.rosmaster_fake import RosmasterFake
from robotd_devices.motor.rosmaster_packets import Report, RosmasterParser, Speed
from robotd_devices.ports.fakes import DAMAGES, damage


# research on devices, section 4.3
@pytest.mark.parametrize(
    ("text", "packet"),
    [
        ("fffc0a1201c8000000f401d6", packets.motion(1, 0.2, 0.0, 0.5)),
        ("fffc0a120100000000000019", packets.motion(1, 0.0, 0.0, 0.0)),
        ("fffc0515015f76", packets.car_type(1)),
        ("fffb0a0ac8000000f401794a", packets.report(packets.SPEED, packets.speed_data(Speed(0.2, 0.0, 0.5, 12.1)))),
    ],
)
def test_vectors(text: str, packet: bytes) -> None:
    assert packet.hex() == text


def test_report_vector_is_read() -> None:
    (report,) = RosmasterParser().feed(bytes.fromhex("fffb0a0ac8000000f401794a"))
    assert packets.speed_of(report.data) == Speed(0.2, 0.0, 0.5, 12.1)


REPORTS = st.sampled_from(sorted(packets.SIZES)).flatmap(
    lambda kind: st.builds(Report, st.just(kind), st.binary(min_size=packets.SIZES[kind], max_size=packets.SIZES[kind]))
)


@given(st.lists(REPORTS, max_size=8), st.lists(st.integers(0, 300)))
def test_any_chunking_gives_the_same_reports(reports: list[Report], cuts: list[int]) -> None:
    stream = b"".join(packets.report(*report) for report in reports)
    edges = sorted({min(cut, len(stream)) for cut in cuts} | {0, len(stream)})
    parser = RosmasterParser()
    assert [r for a, b in pairwise(edges) for r in parser.feed(stream[a:b])] == reports
    assert parser.faults == 0


def test_damaged_stream_gives_hardly_a_wrong_report() -> None:
    """Eight bits of sum alone would let one in 256 pass."""
    rng = random.Random(6)
    sent = [Report(packets.SPEED, rng.randbytes(7)) for _ in range(10_000)]
    for kind in DAMAGES:
        parser = RosmasterParser()
        found: list[Report] = []
        for i in range(0, len(sent), 10):
            data = b"".join(packets.report(*report) for report in sent[i : i + 10])
            found += parser.feed(damage(data, kind, rng, longest=20))
        wrong = len(set(found) - set(sent))
        assert wrong <= 2, kind
        assert len(sent) - len(set(found) & set(sent)) <= 3.2 * 1000, kind


def test_unknown_reports_are_passed_over() -> None:
    parser = RosmasterParser()
    stream = packets.report(0x51, b"\x03\x03") + packets.report(packets.ATTITUDE, bytes(6))
    assert [report.kind for report in parser.feed(stream)] == [0x51, packets.ATTITUDE]


# ---------------------------------------------------------------------------------------------- driver


@pytest.mark.parametrize(
    ("config", "drive", "told"),
    [
        ({}, Drive(0.2, 0.5, 0.1), (0.2, 0.1, 0.5)),
        ({"vy_reversed": True}, Drive(0.2, 0.5, 0.1), (0.2, -0.1, 0.5)),
        ({"vx_reversed": True, "wz_reversed": True}, Drive(0.2, 0.5, 0.1), (-0.2, 0.1, -0.5)),
        # twice too fast: all three are halved, the direction stays
        ({}, Drive(2.0, 1.0, 0.5), (1.0, 0.25, 0.5)),
        ({"vy_limit_mps": 0.3}, Drive(0.4, 0.5, 0.6), (0.2, 0.3, 0.25)),
    ],
)
@virtual_time
async def test_signs_and_limits(config: dict[str, object], drive: Drive, told: tuple[float, ...]) -> None:
    fake = RosmasterFake()
    device, link, _ = motor(Rosmaster, fake, MECANUM, **config)
    await device.open()
    await hold(device, drive, 0.3)
    assert fake.velocity == pytest.approx(told)
    if told[0] == drive.vx_mps:
        last = link.of(Odometry)[-1]
        assert (last.vx_mps, last.vy_mps, last.wz_radps) == (drive.vx_mps, drive.vy_mps, drive.wz_radps)
    await device.close()


@virtual_time
async def test_commands_keep_their_distance() -> None:
    fake = RosmasterFake()
    device, link, _ = motor(Rosmaster, fake, MECANUM)
    await device.open()
    for i in range(200):
        # far more often than the board takes: what counts is the newest
        device.apply(Drive(0.001 * i, 0.0))
        await asyncio.sleep(0.0007)
        if i % 50 == 49:
            device.halt()
    await asyncio.sleep(0.02)
    device.apply(Drive(0.5, 0.0))
    await asyncio.sleep(0.02)
    assert fake.velocity == (0.5, 0.0, 0.0)
    # a stop does not wait for the gap, and may be the one that is lost: hence the second one
    assert fake.dropped <= 4
    assert link.faults == []
    await device.close()


@virtual_time
async def test_stop_is_heard_even_where_the_first_one_is_lost() -> None:
    fake = RosmasterFake()
    device, _, _ = motor(Rosmaster, fake, MECANUM)
    await device.open()
    await hold(device, Drive(0.3, 0.0), 0.2)
    device.apply(Drive(0.3, 0.0))
    await asyncio.sleep(0.001)
    dropped = fake.dropped
    device.halt()
    await asyncio.sleep(0.015)
    assert fake.moving == 0.0
    await asyncio.sleep(0.05)
    assert fake.dropped - dropped <= 1
    await device.close()


@virtual_time
async def test_nothing_else_stops_it() -> None:
    """What `watchdog: none` means; the guardian has to."""
    fake = RosmasterFake()
    device, _, _ = motor(Rosmaster, fake, MECANUM)
    await device.open()
    await hold(device, Drive(0.3, 0.0), 0.1)
    await asyncio.sleep(60.0)
    assert fake.velocity == (0.3, 0.0, 0.0)
    assert Rosmaster.watchdog.kind == "none"
    await device.close()
    assert fake.moving == 0.0


@virtual_time
async def test_reports_are_switched_on_and_published() -> None:
    fake = RosmasterFake(reports=False)
    device, link, _ = motor(Rosmaster, fake, MECANUM)
    await device.open()
    await hold(device, Drive(0.2, 0.4, 0.1), 2.0)
    assert 48 <= len(link.of(Odometry)) <= 51
    assert 48 <= len(link.of(Imu)) <= 51
    assert 4 <= len(link.of(Battery)) <= 5
    assert link.of(Battery)[-1].voltage_v == 11.8
    imu = link.of(Imu)[-1]
    assert (imu.wz_radps, imu.az_mps2) == (pytest.approx(0.4, abs=0.001), pytest.approx(9.807, abs=0.001))
    last = link.of(Odometry)[-1]
    assert last.yaw_rad == pytest.approx(0.8, abs=0.03)
    # on an arc around the point that the base turns about
    assert math.hypot(last.x_m, last.y_m) == pytest.approx(2.0 * math.hypot(0.2, 0.1) / 0.4 * math.sin(0.4), abs=0.02)
    device.received(b"noise", now_ns())
    assert link.faults == [("bad packet", "noise on the line, or the wrong baud")]
    await device.close()


def test_icm_is_read_in_thousandths() -> None:
    data = b"".join(value.to_bytes(2, "little", signed=True) for value in (100, -200, 300, -400, 500, 9807, 0, 0, 0))
    assert packets.imu_of(Report(packets.ICM, data)) == pytest.approx((0.1, -0.2, 0.3, -0.4, 0.5, 9.807))
