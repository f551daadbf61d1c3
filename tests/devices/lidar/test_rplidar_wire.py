"""Requests, descriptors and answers of RPLIDARs: stated bytes, and answers found among other bytes."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotd_devices.lidar import answers
from robotd_devices.lidar import rplidar_wire as wire


@pytest.mark.parametrize(
    ("made", "stated"),
    [
        (wire.request(wire.SCAN), "a520"),
        (wire.request(wire.STOP), "a525"),
        (wire.express_scan(0), "a58205000000000022"),
        (wire.express_scan(1), "a58205010000000023"),
        (wire.express_scan(2), "a58205020000000020"),
        (wire.motor_pwm(660), "a5f0029402c1"),
        (wire.motor_pwm(0), "a5f002000057"),
        (wire.confirm_baud(256_000), "a590085f5f00e803000000d6"),
        (wire.motor_rpm(600), "a5a802580255"),
        (wire.request(wire.GET_BOARD_FLAG, bytes(4)), "a5ff04000000005e"),
        (wire.conf(wire.MODE_COUNT), "a584047000000055"),
        (wire.conf(wire.MODE_TYPICAL), "a584047c00000059"),
        (wire.conf(wire.MODE_US_PER_SAMPLE, 1), "a5840671000000010057"),
        (wire.conf(wire.MODE_NAME, 1), "a584067f000000010059"),
        (wire.request(0x90, struct.pack("<HIH", 0x5F5F, 256_000, 0)), "a590085f5f00e803000000d6"),
    ],
)
def test_requests(made: bytes, stated: str) -> None:
    assert made.hex() == stated


@pytest.mark.parametrize(
    ("stated", "size", "stream", "kind"),
    [
        ("a55a0500004081", 5, True, 0x81),
        ("a55a5400004082", 84, True, 0x82),
        ("a55a1400000004", 20, False, 0x04),
        ("a55a0300000006", 3, False, 0x06),
    ],
)
def test_descriptors(stated: str, size: int, stream: bool, kind: int) -> None:
    data = bytes.fromhex(stated)
    assert answers.decode_descriptor(data) == (size, stream, kind)
    assert answers.encode_descriptor(size, kind, stream=stream) == data


@pytest.mark.parametrize("data", [b"\xa5\x5a\x05", bytes.fromhex("a55b0500004081")])
def test_what_is_no_descriptor(data: bytes) -> None:
    with pytest.raises(ValueError, match="begins with a5 5a"):
        answers.decode_descriptor(data)


def test_info_and_health() -> None:
    info = wire.decode_info(bytes.fromhex("181d0107" + "ab" * 16))
    assert (info.model, info.family, info.version, info.hardware, info.serial) == (24, 1, "1.29", 7, "AB" * 16)
    assert wire.encode_info(info).hex() == "181d0107" + "ab" * 16
    # little-endian, unlike in the libraries that swap it
    assert wire.decode_health(b"\x02\x34\x12") == (2, 0x1234)


ANSWER = answers.encode_descriptor(20, wire.INFO) + bytes(range(20))


@pytest.mark.parametrize(
    "before",
    [
        b"",
        b"RP LIDAR System.\r\nFirmware Ver 1.29\r\n",
        bytes.fromhex("3d012da00f3e012da00fa5"),
        b"\xa5",
        b"\xa5\xa5\x5a",
        answers.encode_descriptor(3, wire.HEALTH) + b"\x00\x00\x00",
        answers.encode_descriptor(5, 0x81, stream=True) + bytes.fromhex("3d012da00f"),
    ],
    ids=["nothing", "boot text", "old nodes", "half a mark", "two marks", "another answer", "a stream"],
)
@given(cuts=st.lists(st.integers(1, 30), min_size=1, max_size=8))
def test_an_answer_among_other_bytes_in_any_chunks(before: bytes, cuts: list[int]) -> None:
    reader = answers.AnswerReader(wire.INFO)
    data, at, turn = before + ANSWER + b"rest", 0, 0
    while at < len(data):
        size = cuts[turn % len(cuts)]
        reader.feed(data[at : at + size])
        at, turn = at + size, turn + 1
    assert reader.answer == bytes(range(20))
    assert reader.rest == b"rest"


def test_the_beginning_of_a_stream() -> None:
    reader = answers.AnswerReader(None)
    assert not reader.feed(ANSWER + bytes.fromhex("a55a5400"))
    assert reader.feed(bytes.fromhex("004082a5590012"))
    assert reader.descriptor == (84, True, 0x82)
    assert (reader.answer, reader.rest) == (b"", bytes.fromhex("a5590012"))
    assert reader.feed(b"\x01")
    assert reader.rest == bytes.fromhex("a559001201")
