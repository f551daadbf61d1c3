"""YDLIDAR packets: known bytes decode to stated values, and no damaged byte ever becomes a measurement."""

from __future__ import annotations

import math
import random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotd_devices.lidar.ydlidar_fake import YdlidarFake
from robotd_devices.lidar.ydlidar_models import MODELS, decode_samples, encode_samples, lens_deg
from robotd_devices.lidar.ydlidar_packets import YdPacket, YdParser, check, decode, encode
from robotd_devices.ports.fakes import DAMAGES, Damage, damage

# one of the vendor's manual, two computed; sources in docs/devices/ydlidar.md
MANUAL = bytes.fromhex("aa55010153ae53aeab540000")
FOUR = bytes.fromhex("aa5500040105c1055a511f10331047105b10")
START = bytes.fromhex("aa558d010100010027540000")


def stream(model: str, packets: int, first_deg: float = 0.0) -> list[bytes]:
    fake = YdlidarFake(model, first_deg=first_deg)
    return [encode(fake.next_packet(), fake.model.sample_bytes) for _ in range(packets)]


def parser(model: str) -> YdParser:
    known = MODELS[model]
    return YdParser(known.sample_bytes, 1e10 / known.baud, 1e9 / known.rate_hz)


def bare(packets: list[YdPacket]) -> list[YdPacket]:
    return [packet._replace(arrival_ns=0, chained=False) for packet in packets]


@pytest.mark.parametrize(
    ("raw", "first_q6", "last_q6", "millimetres", "begins", "speed_dhz"),
    [
        (MANUAL, 22313, 22313, [0.0], True, 0),
        (FOUR, 640, 736, [1031.75, 1036.75, 1041.75, 1046.75], False, 0),
        (START, 0, 0, [0.0], True, 70),
    ],
    ids=["manual", "four", "start"],
)
def test_known_packets(
    raw: bytes, first_q6: int, last_q6: int, millimetres: list[float], begins: bool, speed_dhz: int
) -> None:
    packet = decode(raw, 2)
    assert (packet.first_q6, packet.last_q6, packet.begins, packet.speed_dhz) == (first_q6, last_q6, begins, speed_dhz)
    mm, intensity = decode_samples(MODELS["x4"], packet.data)
    assert mm.tolist() == millimetres
    assert intensity is None
    assert encode(packet, 2) == raw
    assert check(raw, 2) == 0


@pytest.mark.parametrize(
    ("raw", "words"),
    [
        (FOUR[:-1], "right check"),
        (b"\xab" + FOUR[1:], "begins with aa 55"),
        (FOUR[:-1] + b"\x11", "right check"),
        (FOUR[:3] + b"\x00" + FOUR[4:], "no number of samples"),
        (FOUR[:4] + b"\x00" + FOUR[5:], "no angles"),
    ],
)
def test_decode_says_what_is_wrong(raw: bytes, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        decode(raw, 2)


@pytest.mark.parametrize(
    ("model", "mm", "degrees"),
    [("x4", 1000.0, -6.76), ("x4", 8000.0, -7.84), ("x4", 0.0, 0.0), ("scl", 1000.0, 1.0198), ("tmini", 1000.0, 0.0)],
)
def test_beams_leave_the_head_under_the_angle_of_the_lens(model: str, mm: float, degrees: float) -> None:
    assert lens_deg(MODELS[model], np.array([mm]))[0] == pytest.approx(degrees, abs=0.005)
    if model == "x4" and mm:
        assert degrees == pytest.approx(math.degrees(math.atan(21.8 * (155.3 - mm) / (155.3 * mm))), abs=0.005)


# a sample of a T-mini Plus that took what it saw for glass (2 in the two lowest bits), and one like it of an SCL
@pytest.mark.parametrize(("model", "brightness"), [("tmini_plus", 0x83), ("scl", (0x83 | 2 << 8) >> 2)])
def test_two_bits_below_the_distance_belong_to_the_intensity_or_not(model: str, brightness: int) -> None:
    mm, intensity = decode_samples(MODELS[model], b"\x83" + (1234 << 2 | 2).to_bytes(2, "little"))
    assert mm.tolist() == [1234.0]
    assert intensity is not None
    assert intensity.tolist() == [brightness]


@pytest.mark.parametrize("model", MODELS)
@given(st.lists(st.integers(0, 16_000), min_size=1, max_size=80))
def test_what_is_encoded_is_decoded(model: str, values: list[int]) -> None:
    known = MODELS[model]
    mm = np.array(values, dtype=np.float64) % (16_384 if known.shift == 0 else 8_192)
    got, intensity = decode_samples(known, encode_samples(known, mm, 700))
    np.testing.assert_array_equal(got, mm)
    if intensity is not None:
        np.testing.assert_array_equal(intensity, np.where(mm > 0, 175, 0))


@pytest.mark.parametrize("model", MODELS)
def test_a_clean_stream_is_whole_and_two_bytes_late(model: str) -> None:
    sent = stream(model, 80, 100.0)
    reader = parser(model)
    got: list[YdPacket] = []
    for index, raw in enumerate(sent):
        got += reader.feed(raw[:2], 0)
        assert len(got) == index
        got += reader.feed(raw[2:], 0)
    assert [encode(packet, MODELS[model].sample_bytes) for packet in got] == sent[:-1]
    assert [packet.chained for packet in got] == [False] + [True] * 78
    assert reader.faults == []


def test_time_stamps_are_passed_over() -> None:
    sent = stream("x4", 30)
    stamp = bytes.fromhex("aa66011122334455")
    reader = parser("x4")
    got = reader.feed(b"".join(raw + stamp for raw in sent), 0)
    assert [encode(packet, 2) for packet in got] == sent
    assert all(packet.chained for packet in got[1:])
    assert reader.faults == []


@pytest.mark.parametrize(
    ("change", "fault"),
    [({"span_q6": 0}, "not turning"), ({"span_q6": 20_000}, "impossible angles")],
)
def test_sound_packets_that_cannot_be_true(change: dict[str, int], fault: str) -> None:
    fake = YdlidarFake("x4")
    good = [fake.next_packet() for _ in range(3)]
    odd = [fake.next_packet()._replace(**change) for _ in range(2)]
    reader = parser("x4")
    got = reader.feed(b"".join(encode(packet, 2) for packet in good + odd), 0)
    assert bare(got) == good
    assert reader.faults == [fault]


def test_a_repeated_packet_is_taken_once() -> None:
    sent = stream("x4", 10)
    reader = parser("x4")
    got = reader.feed(b"".join([*sent[:4], sent[3], *sent[4:]]), 0)
    assert [encode(packet, 2) for packet in got] == sent[:-1]
    assert reader.faults == ["repeated packet"]


def test_noise_gives_nothing() -> None:
    assert parser("x4").feed(random.Random(7).randbytes(200_000), 0) == []


SENT = {model: stream(model, 14, 350.0) for model in MODELS}


@given(
    st.sampled_from(["x4", "scl"]),
    st.lists(st.integers(1, 150), min_size=1, max_size=20),
    st.integers(0, 2**32),
    st.sampled_from(DAMAGES),
    st.integers(0, 3),
)
def test_chunks_do_not_matter(model: str, cuts: list[int], seed: int, kind: Damage, faults: int) -> None:
    rng = random.Random(seed)
    data = b"".join(SENT[model])
    for _ in range(faults):
        data = damage(data, kind, rng)
    one, other = parser(model), parser(model)
    expected = one.feed(data, 0)
    got: list[YdPacket] = []
    at = turn = 0
    while at < len(data):
        size = cuts[turn % len(cuts)]
        got += other.feed(data[at : at + size], 0)
        at, turn = at + size, turn + 1
    assert bare(got) == bare(expected)
    assert [packet.chained for packet in got] == [packet.chained for packet in expected]
    assert other.faults == one.faults


@pytest.mark.parametrize("kind", DAMAGES)
@pytest.mark.parametrize("model", ["x4", "scl"])
def test_no_damaged_packet_is_accepted(model: str, kind: Damage) -> None:
    """One fault in fifty packets: nothing false comes through, and little that is true is lost."""
    rng = random.Random(f"{model} {kind}")
    sent = stream(model, 1500)
    known = set(sent)
    pieces, faults, touched = [], 0, 0
    for at in range(0, len(sent), 50):
        bad = damage(b"".join(sent[at : at + 50]), kind, rng)
        faults += 1
        touched += sum(raw not in bad for raw in sent[at : at + 50])
        pieces.append(bad)
    got = [encode(packet, MODELS[model].sample_bytes) for packet in parser(model).feed(b"".join(pieces), 0)]
    assert [raw for raw in got if raw not in known] == []
    assert len(sent) - 1 - len(got) - touched <= 0.1 * faults
