"""The MC protocol and its driver: vectors, damaged streams, time limits, the creep trap, KILL."""

from __future__ import annotations

import asyncio
import math
import random
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st
from serial_motors import CAR, hold, motor, now_ns, when

from robotd.testing import virtual_time
from robotd.world.messages import Imu, Odometry, Steer
from robotd_devices.motor import mc
from robotd_devices.motor.mc import Kind, McFrame, McParser
from robotd_devices.motor.mc_fake import McFake
from robotd_devices.motor.mc_motors import McConfig, McMotors
from robotd_devices.ports.fakes import DAMAGES, damage

# research on devices, section 4.2, checked there against the C++ simulator of the car's own project
VECTORS = [
    ("054d430104020101010349ef00", mc.ping(1), McFrame(Kind.PING, b"", 1)),
    ("074d430103010202010401e6d000", mc.mode_set(True, 2), McFrame(Kind.MODE_SET, b"\x01", 2, 1)),
    (
        "054d4301010203020806f401e80364010103b49400",
        mc.drive(500, 1000, 100, 3),
        McFrame(Kind.DRIVE, bytes.fromhex("f401e80364000000"), 3),
    ),
    ("054d4301020204010103edde00", mc.encode(McFrame(Kind.KILL, b"", 4)), McFrame(Kind.KILL, b"", 4)),
]


@pytest.mark.parametrize(("text", "encoded", "frame"), VECTORS)
def test_vectors(text: str, encoded: bytes, frame: McFrame) -> None:
    assert encoded.hex() == text
    assert McParser().feed(encoded) == [frame]


def test_checksum() -> None:
    assert mc.crc16(b"123456789") == 0x29B1


@given(st.binary(max_size=mc.MOST_PAYLOAD + 11))
def test_stuffing_is_undone_and_leaves_no_zero(data: bytes) -> None:
    stuffed = mc.cobs_encode(data)
    assert 0 not in stuffed
    assert mc.cobs_decode(stuffed) == data


@given(
    st.lists(
        st.builds(McFrame, st.sampled_from(Kind), st.binary(max_size=64), st.integers(0, 65535), st.integers(0, 1)),
        max_size=6,
    ),
    st.lists(st.integers(0, 500)),
)
def test_any_chunking_gives_the_same_frames(frames: list[McFrame], cuts: list[int]) -> None:
    stream = b"".join(map(mc.encode, frames))
    edges = sorted({min(cut, len(stream)) for cut in cuts} | {0, len(stream)})
    parser = McParser()
    found = [f for a, b in pairwise(edges) for f in parser.feed(stream[a:b])]
    assert found == frames
    assert parser.faults == 0


def test_damaged_stream_gives_no_wrong_frame() -> None:
    rng = random.Random(4)
    sent = [McFrame(Kind.STATUS, rng.randbytes(14), i) for i in range(1500)]
    known = set(sent)
    for kind in DAMAGES:
        parser = McParser()
        found: list[McFrame] = []
        faults = 0
        for i in range(0, len(sent), 10):
            data = b"".join(map(mc.encode, sent[i : i + 10]))
            found += parser.feed(damage(data, kind, rng, longest=20))
            faults += 1
        found += parser.feed(mc.DELIMITER)
        assert set(found) <= known, kind
        # a burst or a repetition of up to 20 bytes reaches over two frames
        assert len(sent) - len(set(found)) <= 2 * faults, kind


@pytest.mark.parametrize(
    ("block", "words"),
    [
        ("00", "COBS"),
        ("ff", "COBS"),
        ("034d43", "too short"),
        ("054d430104020101010349ee", "checksum"),
        # right checksum, but version 2; and a length that is not the payload's
        (
            mc.cobs_encode(b"MC\x02\x04\0\1\0\0\0" + mc.crc16(b"MC\x02\x04\0\1\0\0\0").to_bytes(2, "little")).hex(),
            "no frame",
        ),
        (
            mc.cobs_encode(b"MC\x01\x04\0\1\0\1\0" + mc.crc16(b"MC\x01\x04\0\1\0\1\0").to_bytes(2, "little")).hex(),
            "no frame",
        ),
    ],
)
def test_what_is_no_frame_is_refused(block: str, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        mc.decode(bytes.fromhex(block))


def test_a_flood_without_delimiters_is_not_kept() -> None:
    parser = McParser()
    for _ in range(100):
        assert parser.feed(b"\x05" * 1000) == []
    assert len(parser._rest) <= 256
    assert parser.feed(b"\x00" + mc.ping(1)) == [McFrame(Kind.PING, b"", 1)]


# ---------------------------------------------------------------------------------------------- driver


@virtual_time
async def test_drives_and_stops_for_good() -> None:
    fake = McFake()
    device, link, line = motor(McMotors, fake, CAR)
    await device.open()
    assert line.writes[0][1] == mc.STOP == b"\x00" + mc.mode_set(False)
    await hold(device, Steer(1.0, math.radians(5.0)), 0.5)
    assert fake.speed_mm_s(now_ns()) == 1000
    assert fake.steer_cdeg(now_ns()) == 500
    device.halt()
    assert await when(lambda: not fake.auto) <= 0.002
    # no DRIVE comes behind the stop, which this firmware would make a creep of
    count = len(fake.log)
    await asyncio.sleep(1.0)
    assert {frame.kind for _, frame in fake.log[count:]} <= {Kind.MODE_SET, Kind.PING}
    assert fake.speed_mm_s(now_ns()) == 0
    await hold(device, Steer(1.0, 0.0), 0.1)
    assert fake.speed_mm_s(now_ns()) == 1000
    await device.close()
    assert not fake.auto
    assert link.faults == []


@virtual_time
async def test_standing_still_is_never_the_creep() -> None:
    fake = McFake()
    device, link, _ = motor(McMotors, fake, CAR)
    await device.open()
    await hold(device, Steer(0.5, 0.0), 0.3)
    for slow in (0.0, 0.01, -0.01, -1.0):
        await hold(device, Steer(slow, 0.2), 0.2)
        assert fake.speed_mm_s(now_ns()) == 0
    assert {name for name, _ in link.faults} == {"cannot reverse"}
    await device.close()


@virtual_time
async def test_speed_zero_would_creep() -> None:
    """What the fake does to those who write DRIVE with speed 0; it is why the driver never does."""
    fake = McFake()
    fake.feed(mc.mode_set(True) + mc.ping(1) + mc.drive(0, 0, 100, 2), 0)
    assert fake.speed_mm_s(50_000_000) == mc.CREEP_MM_S
    assert fake.speed_mm_s(150_000_000) == 0
    assert McFake(creeps=False).speed_mm_s(0) == 0


@virtual_time
async def test_silence_of_the_program_stops_the_car_within_the_ttl() -> None:
    fake = McFake()
    device, _, _ = motor(McMotors, fake, CAR, ttl_ms=60)
    await device.open()
    await hold(device, Steer(1.0, 0.0), 0.3)
    last_ns = max(at_ns for at_ns, frame in fake.log if frame.kind == Kind.DRIVE)
    # the heartbeat goes on, the commands do not: the act tick stands still
    await when(lambda: fake.speed_mm_s(now_ns()) == 0)
    assert now_ns() - last_ns <= 61_000_000
    assert McMotors.watchdog.timeout_ms == 200
    await device.close()


@virtual_time
async def test_heartbeat_keeps_its_rate_whatever_is_driven() -> None:
    fake = McFake()
    device, _, _ = motor(McMotors, fake, CAR, heartbeat_hz=20.0)
    await device.open()
    began_ns = now_ns()
    await asyncio.sleep(1.0)
    await hold(device, Steer(1.0, 0.0), 1.0)
    pings = [at_ns for at_ns, frame in fake.log if frame.kind == Kind.PING and at_ns > began_ns]
    assert 38 <= len(pings) <= 41
    assert max(b - a for a, b in pairwise(pings)) < 110_000_000
    await device.close()


@virtual_time
async def test_auto_mode_that_the_controller_lost_is_switched_on_again() -> None:
    fake = McFake()
    device, _, _ = motor(McMotors, fake, CAR)
    await device.open()
    await hold(device, Steer(1.0, 0.0), 0.3)
    modes = sum(frame.kind == Kind.MODE_SET for _, frame in fake.log)
    await hold(device, Steer(1.0, 0.0), 0.3)
    assert sum(frame.kind == Kind.MODE_SET for _, frame in fake.log) == modes  # only until it is on
    fake.restart(now_ns())
    await hold(device, Steer(1.0, 0.0), 0.1)
    assert fake.speed_mm_s(now_ns()) == 1000
    await device.close()


@virtual_time
async def test_kill_only_when_asked_for() -> None:
    for wanted in (False, True):
        fake = McFake()
        device, link, _ = motor(McMotors, fake, CAR, kill_on_estop=wanted)
        await device.open()
        await hold(device, Steer(1.0, 0.0), 0.2)
        device.estop()
        await asyncio.sleep(0.05)
        assert fake.is_killed is wanted
        assert fake.speed_mm_s(now_ns()) == 0
        await hold(device, Steer(1.0, 0.0), 0.2)
        assert fake.speed_mm_s(now_ns()) == (0 if wanted else 1000)
        assert [name for name, _ in link.faults] == (["kill latched"] if wanted else [])
        if wanted:
            fake.restart(now_ns())
            device.halt()
            await hold(device, Steer(1.0, 0.0), 0.2)
            assert fake.speed_mm_s(now_ns()) == 1000  # a plain stop does not kill
        await device.close()


@virtual_time
async def test_signs_and_limits() -> None:
    for reversed_, sign in ((False, 1), (True, -1)):
        fake = McFake()
        device, _, _ = motor(McMotors, fake, CAR, steering_reversed=reversed_, top_speed_mps=1.5)
        await device.open()
        await hold(device, Steer(9.0, 1.0), 0.2)
        assert fake.speed_mm_s(now_ns()) == 1500
        assert fake.steer_cdeg(now_ns()) == sign * 2500
        await device.close()


@pytest.mark.parametrize("source", ["imu", "status", "off"])
@virtual_time
async def test_odometry(source: str) -> None:
    fake = McFake()
    device, link, _ = motor(McMotors, fake, CAR, odometry=source)
    await device.open()
    await hold(device, Steer(1.0, math.radians(5.0)), 1.0)
    told = link.of(Odometry)
    assert len(link.of(Imu)) >= 95
    if source == "off":
        assert told == []
    else:
        # 1 m along a left curve of radius 2.9 m
        assert told[-1].vx_mps == 1.0
        assert told[-1].wz_radps == pytest.approx(math.tan(math.radians(5.0)) / 0.257, rel=0.02)
        assert told[-1].yaw_rad == pytest.approx(0.34, abs=0.02)
        assert math.hypot(told[-1].x_m, told[-1].y_m) == pytest.approx(1.0, abs=0.03)
        assert told[-1].y_m > 0.1
    assert McMotors.publish_period_s(McConfig(odometry=source)) == (None if source == "off" else 0.05)
    await device.close()


@virtual_time
async def test_short_status_and_noise() -> None:
    fake = McFake(long_status=False)
    device, link, _ = motor(McMotors, fake, CAR, odometry="status")
    await device.open()
    await hold(device, Steer(1.0, 0.0), 0.1)
    assert link.of(Odometry)[-1].vx_mps == 1.0
    device.received(b"\x07noise\x00", now_ns())
    assert [name for name, _ in link.faults] == ["bad frame"]
    await device.close()
