"""The LD parser: known packets decode to stated values, and no damaged byte ever becomes a measurement."""

from __future__ import annotations

import random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotd_devices.lidar.ld19_fake import Ld19Fake
from robotd_devices.lidar.ld_packets import PACKET_BYTES, LdPacket, LdParser, crc8, decode, encode, is_sound
from robotd_devices.ports.fakes import DAMAGES, Damage, damage

# two packets that real units sent, and one computed by hand; sources in docs/devices/ld19.md
MANUAL = bytes.fromhex("542c6808ab7ee000e4dc00e2d900e5d500e3d300e4d000e9cd00e4ca00e2c700e9c500e5c200e5c000e5be823a1a50")
ZEROS = bytes.fromhex("542c7408b0860000d40000d40000d40000d40000d40000d50000d500004900005f0000b00000d20000d402891e091f")
COMPUTED = bytes.fromhex(
    "542c100e0000e803c8f003c8f803c80004c80804c81004c81804c82004c82804c83004c83804c84004c870030000af"
)


def stream(packets: int, **fake: object) -> list[bytes]:
    source = Ld19Fake(**fake)  # type: ignore[arg-type]
    return [encode(source.next_packet()) for _ in range(packets)]


def parse(data: bytes, chunk: int = 0) -> list[LdPacket]:
    parser = LdParser()
    if not chunk:
        return parser.feed(data, 0)
    return [p for at in range(0, len(data), chunk) for p in parser.feed(data[at : at + chunk], 0)]


def values(packets: list[LdPacket]) -> list[tuple[object, ...]]:
    return [p._replace(arrival_ns=0) for p in packets]


def test_crc_check_value() -> None:
    assert crc8(b"123456789") == 0xC3


@pytest.mark.parametrize(
    ("raw", "speed", "start", "end", "stamp", "first", "last"),
    [
        (MANUAL, 2152, 32427, 33470, 6714, (224, 228), (192, 229)),
        (ZEROS, 2164, 34480, 35074, 2334, (0, 212), (0, 212)),
        (COMPUTED, 3600, 0, 880, 0, (1000, 200), (1088, 200)),
    ],
    ids=["manual", "zeros", "computed"],
)
def test_known_packets(
    raw: bytes, speed: int, start: int, end: int, stamp: int, first: tuple[int, int], last: tuple[int, int]
) -> None:
    packet = decode(raw)
    assert (packet.speed_dps, packet.start_cdeg, packet.end_cdeg, packet.device_ms) == (speed, start, end, stamp)
    points = list(zip(packet.distances_mm, packet.intensities, strict=True))
    assert (len(points), points[0], points[-1]) == (12, first, last)
    assert encode(packet) == raw
    assert values(LdParser().feed(raw + b"\x54\x2c", 0)) == [packet]


def test_computed_distances() -> None:
    assert decode(COMPUTED).distances_mm == tuple(range(1000, 1089, 8))


@pytest.mark.parametrize(
    ("raw", "words"),
    [
        (MANUAL[:-1], "47 bytes"),
        (b"\x55" + MANUAL[1:], "begins with 54 2c"),
        (MANUAL[:-1] + b"\x51", "checksum 51, computed 50"),
    ],
)
def test_decode_says_what_is_wrong(raw: bytes, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        decode(raw)


@given(st.binary(min_size=PACKET_BYTES, max_size=PACKET_BYTES), st.booleans())
def test_parity_masks_are_the_checksum(data: bytes, mend: bool) -> None:
    if mend:
        data = data[:-1] + bytes((crc8(data[:-1]),))
    assert is_sound(data) == (crc8(data[:-1]) == data[-1])


def test_clean_stream_is_whole_and_not_delayed() -> None:
    sent = stream(400)
    parser = LdParser()
    first = parser.feed(sent[0], 0)
    assert first == []  # the very first one waits for the header behind it
    for index, raw in enumerate(sent[1:], 1):
        got = parser.feed(raw, index)
        assert [encode(p) for p in got] == (sent[:2] if index == 1 else [raw])
    assert parser.faults == []


def test_begins_in_the_middle_of_a_packet_without_a_fault() -> None:
    sent = stream(5)
    parser = LdParser()
    got = parser.feed(b"".join(sent)[20:], 0)
    assert [encode(p) for p in got] == sent[1:]
    assert parser.faults == []


def test_a_lone_header_byte_before_the_header() -> None:
    sent = stream(6)
    data = b"".join(sent[:3]) + b"\x54" + b"".join(sent[3:])
    parser = LdParser()
    assert [encode(p) for p in parser.feed(data, 0)] == sent
    assert parser.faults == ["stray bytes"]


def test_a_cut_packet_does_not_take_the_next_one_with_it() -> None:
    sent = stream(6)
    parser = LdParser()
    got = parser.feed(b"".join(sent[:2]) + sent[2][:30] + b"".join(sent[3:]), 0)
    assert [encode(p) for p in got] == [*sent[:2], *sent[3:]]
    assert parser.faults == ["bad checksum"]


def test_a_header_inside_the_points_is_no_packet() -> None:
    packet = Ld19Fake().next_packet()
    points = (b"\x54\x2c\x10" * 12)[:36]
    sent = []
    source = Ld19Fake()
    for _ in range(8):
        packet = source.next_packet()
        sent.append(encode(packet._replace(points=points)))
    assert [encode(p) for p in parse(b"".join(sent)[2:])] == sent[1:]


def test_repeated_packet_is_taken_once() -> None:
    sent = stream(6)
    parser = LdParser()
    got = parser.feed(b"".join([*sent[:3], sent[2], *sent[3:]]), 0)
    assert [encode(p) for p in got] == sent
    assert parser.faults == ["repeated packet"]


def test_two_right_packets_after_a_jump_of_the_clock() -> None:
    before, after = stream(4, first_ms=100), stream(5, first_ms=20_000, first_deg=200.0)
    parser = LdParser()
    got = parser.feed(b"".join(before + after), 0)
    assert [encode(p) for p in got] == before + after[1:]
    assert [p.chained for p in got] == [False, True, True, True, False, True, True, True]
    assert parser.faults == ["jump of the device's clock or speed"]


def test_the_clock_wraps_at_thirty_seconds() -> None:
    sent = stream(12, first_ms=29_990)
    assert [encode(p) for p in parse(b"".join(sent))] == sent


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({"speed_dps": 0, "span_cdeg": 0}, "not turning"),
        ({"speed_dps": 3600, "span_cdeg": 0}, "not turning"),
        ({"speed_dps": 40}, "speed and angles disagree"),
    ],
)
def test_sound_packets_that_cannot_be_true(change: dict[str, Any], fault: str) -> None:
    source = Ld19Fake()
    good = [encode(source.next_packet()) for _ in range(3)]
    odd = [encode(source.next_packet()._replace(**change)) for _ in range(3)]
    parser = LdParser()
    assert [encode(p) for p in parser.feed(b"".join(good + odd), 0)] == good
    assert parser.faults == [fault]
    assert parser.trouble == fault


def test_parsers_do_not_share_state() -> None:
    one, other = stream(5, first_deg=10.0), stream(5, first_deg=190.0)
    left, right = LdParser(), LdParser()
    got: tuple[list[LdPacket], list[LdPacket]] = ([], [])
    for a, b in zip(one, other, strict=True):
        for at in range(0, PACKET_BYTES, 10):
            got[0].extend(left.feed(a[at : at + 10], 0))
            got[1].extend(right.feed(b[at : at + 10], 0))
    assert ([encode(p) for p in got[0]], [encode(p) for p in got[1]]) == (one, other)


@given(
    st.lists(st.integers(1, 200), min_size=1, max_size=40),
    st.integers(0, 2**32),
    st.sampled_from(DAMAGES),
    st.integers(0, 3),
)
def test_chunks_do_not_matter(cuts: list[int], seed: int, kind: Damage, faults: int) -> None:
    rng = random.Random(seed)
    data = b"".join(stream(20, first_deg=rng.uniform(0.0, 360.0)))
    for _ in range(faults):
        data = damage(data, kind, rng)
    whole = LdParser()
    expected = whole.feed(data, 0)
    pieces = LdParser()
    got, at = [], 0
    while at < len(data):
        size = cuts[at % len(cuts)]
        got += pieces.feed(data[at : at + size], 0)
        at += size
    assert values(got) == values(expected)
    assert pieces.faults == whole.faults


@pytest.mark.parametrize("kind", DAMAGES)
def test_no_damaged_packet_is_accepted(kind: Damage) -> None:
    """One fault in fifty packets: nothing false comes through, and little that is true is lost."""
    rng = random.Random(f"ld {kind}")
    sent = stream(6000, first_ms=25_000)
    place = {raw: index for index, raw in enumerate(sent)}
    pieces, faults, touched = [], 0, 0
    for at in range(0, len(sent), 50):
        group = b"".join(sent[at : at + 50])
        bad = damage(group, kind, rng)
        faults += 1
        touched += sum(raw not in bad for raw in sent[at : at + 50])
        pieces.append(bad)
    parser = LdParser()
    got = [encode(p) for p in parser.feed(b"".join(pieces), 0)]
    assert [raw for raw in got if raw not in place] == []
    assert got == sorted(set(got), key=place.__getitem__)  # none twice, none out of order
    # what the fault itself spoiled is gone; beyond that hardly anything
    assert len(sent) - len(got) - touched <= 0.1 * faults
    assert 0 < len(parser.faults) <= 1.5 * faults  # a repeated run may hold a whole packet and a piece


@pytest.mark.parametrize("lost", [1, 3, 20])
def test_resync_after_missing_packets(lost: int) -> None:
    sent = stream(60)
    got = parse(b"".join(sent[:10] + sent[10 + lost :]))
    assert [encode(p) for p in got] == sent[:10] + sent[10 + lost :]
    assert all(p.chained for p in got[1:])


def test_noise_gives_nothing() -> None:
    rng = random.Random(7)
    assert parse(rng.randbytes(200_000)) == []


def test_arrival_counts_back_through_a_backlog() -> None:
    sent = stream(40)
    parser = LdParser(byte_ns=43_403)
    parser.feed(b"".join(sent[:2]), 1_000_000)
    got = parser.feed(b"".join(sent[2:]), 200_000_000)
    # 37 packets behind the first of these, one every 2.667 ms, though the wire could carry them faster
    assert got[-1].arrival_ns == 200_000_000
    assert got[0].arrival_ns == pytest.approx(200_000_000 - 37 * 8_000_000 / 3, abs=60_000)


def test_arrival_of_a_packet_that_waited_for_its_successor() -> None:
    sent = stream(3)
    parser = LdParser(byte_ns=43_403)
    assert parser.feed(sent[0] + b"\x54", 5_000_000) == []
    (packet,) = parser.feed(sent[1][1:10], 9_000_000)
    assert packet.arrival_ns == 5_000_000 - 43_403
