"""HQ packets: layout, checksum, any chunking, and what a damaged stream gives."""

from __future__ import annotations

import itertools
import random
import struct
import zlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotd_devices.lidar.rplidar_fake import RplidarFake
from robotd_devices.lidar.rplidar_hq import NODES, PACKET_BYTES, HqParser, is_sound, seal
from robotd_devices.lidar.rplidar_nodes import NodeRun
from robotd_devices.lidar.rplidar_wire import express_scan, motor_rpm
from robotd_devices.ports.fakes import DAMAGES, Damage, damage

_DESCRIPTOR_BYTES = 7


def stream(packets: int) -> bytes:
    """So many packets of a fake's scan."""
    fake = RplidarFake("s2-hq")
    fake.tick(0)
    fake.feed(motor_rpm(600) + express_scan(1), 0)
    period_ns = round(NODES * fake.sample_ns)
    return fake.tick((packets + 1) * period_ns)[_DESCRIPTOR_BYTES : _DESCRIPTOR_BYTES + packets * PACKET_BYTES]


STREAM = stream(6)


def parser() -> HqParser:
    return HqParser(byte_ns=1e4, sample_ns=125_000.0)


def data_of(runs: list[NodeRun]) -> list[bytes]:
    return [run.data for run in runs]


def test_layout() -> None:
    nodes = struct.pack("<HIBB", 16_384, 4000, 200, 1) + bytes(8 * (NODES - 1))
    packet = seal(7, nodes)
    assert len(packet) == PACKET_BYTES
    assert packet[:17].hex(" ") == "a5 07 00 00 00 00 00 00 00 00 40 a0 0f 00 00 c8 01"
    assert packet[777:] == zlib.crc32(packet[:777] + b"\0\0\0").to_bytes(4, "little")
    assert is_sound(packet)
    assert not is_sound(packet[:-1] + bytes((packet[-1] ^ 1,)))
    with pytest.raises(ValueError, match="96 nodes of 8 bytes, not 8"):
        seal(0, bytes(8))


@given(st.lists(st.integers(0, len(STREAM)), max_size=12))
def test_any_chunking_gives_the_same_nodes(cuts: list[int]) -> None:
    edges = sorted({0, len(STREAM), *cuts})
    reader = parser()
    found = [run for a, b in itertools.pairwise(edges) for run in reader.feed(STREAM[a:b], b)]
    assert data_of(found) == [STREAM[i + 9 : i + 777] for i in range(0, len(STREAM), PACKET_BYTES)]
    assert reader.faults == []
    assert [run.missing for run in found] == [-1, 0, 0, 0, 0, 0]


@pytest.mark.parametrize("kind", DAMAGES)
@pytest.mark.parametrize("seed", range(8))
def test_a_fault_costs_two_packets_at_most_and_no_wrong_node(kind: Damage, seed: int) -> None:
    reader = parser()
    found = reader.feed(damage(STREAM, kind, random.Random(seed), longest=300) + STREAM[:PACKET_BYTES], 0)
    sent = {STREAM[i + 9 : i + 777] for i in range(0, len(STREAM), PACKET_BYTES)}
    assert set(data_of(found)) <= sent
    assert len(found) >= 5
    assert len(reader.faults) <= 1 + (reader.faults[-1:] == ["repeated packet"])


def test_the_same_packet_twice_counts_once() -> None:
    reader = parser()
    first = STREAM[:PACKET_BYTES]
    assert len(reader.feed(first + first + STREAM[PACKET_BYTES:], 0)) == 6
    assert reader.faults == ["repeated packet"]
