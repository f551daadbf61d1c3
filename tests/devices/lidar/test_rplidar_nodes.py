"""RPLIDAR nodes: known bytes, alignment kept and found again, damage bounded where no checksum can find it."""

from __future__ import annotations

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotd_devices.lidar.answers import AnswerReader
from robotd_devices.lidar.rplidar_fake import RplidarFake
from robotd_devices.lidar.rplidar_nodes import NodeParser, NodeRun, decode_node, encode_node
from robotd_devices.lidar.rplidar_wire import SCAN, motor_pwm, motor_rpm, request
from robotd_devices.ports.fakes import DAMAGES, Damage, damage

STEP_DEG = 0.72


def stream(model: str, nodes: int, first_deg: float = 0.0) -> list[bytes]:
    fake = RplidarFake(model, first_deg=first_deg)
    fake.feed(motor_pwm(660) + motor_rpm(600) + request(SCAN), 0)
    reader = AnswerReader(None)
    reader.feed(fake.tick(round((nodes + 2) * fake.sample_ns)))
    return [reader.rest[at : at + 5] for at in range(0, 5 * nodes, 5)]


def parser(step_deg: float = STEP_DEG) -> NodeParser:
    return NodeParser(21_701, 200_000, step_deg)


def nodes(runs: list[NodeRun]) -> list[bytes]:
    return [run.data[at : at + 5] for run in runs for at in range(0, len(run.data), 5)]


def test_known_nodes() -> None:
    assert decode_node(bytes.fromhex("3d012da00f")) == (90 * 64, 4000, 15, True)
    assert decode_node(bytes.fromhex("3e012da00f")) == (90 * 64, 4000, 15, False)
    assert encode_node(90 * 64, 4000, 15, True).hex() == "3d012da00f"


@pytest.mark.parametrize("raw", ["3f012da00f", "3c012da00f", "3d002da00f", "3d01ffa00f", "3d012da0"])
def test_what_cannot_be_a_node(raw: str) -> None:
    with pytest.raises(ValueError, match="node"):
        decode_node(bytes.fromhex(raw))


@pytest.mark.parametrize("model", ["a1", "a3", "c1", "s2"])
def test_a_clean_stream_is_whole_and_one_node_late(model: str) -> None:
    sent = stream(model, 1500)
    reader = parser(1.8)
    got: list[NodeRun] = []
    for index, raw in enumerate(sent):
        got += reader.feed(raw, 0)
        assert len(nodes(got)) == (index if index >= 3 else 0)
    assert nodes(got) == sent[:-1]
    assert [run.missing for run in got] == [-1] + [0] * (len(got) - 1)
    assert reader.faults == []


def test_one_senseless_node_is_dropped_by_itself() -> None:
    sent = stream("c1", 100)
    reader = parser()
    got = reader.feed(b"".join([*sent[:50], b"\x3f" + sent[50][1:], *sent[51:]]), 0)
    assert nodes(got) == sent[:50] + sent[51:-1]
    assert [run.missing for run in got] == [-1, 1]
    assert reader.faults == ["senseless node"]


@pytest.mark.parametrize("cut", [1, 2, 3, 4, 7, 13])
def test_alignment_is_found_again_within_eight_nodes(cut: int) -> None:
    sent = stream("c1", 300)
    for at in range(100, 110):
        data = b"".join(sent)
        reader = parser()
        got = nodes(reader.feed(data[: 5 * at + 2] + data[5 * at + 2 + cut :], 0))
        # a cut that happens to leave a likely node behind cannot be told from a node
        assert len(set(got) - set(sent)) <= 1
        assert len(set(got) & set(sent)) >= len(sent) - 1 - 8
        assert reader.faults == ["lost alignment"]


def test_noise_gives_next_to_nothing() -> None:
    assert len(nodes(parser().feed(random.Random(3).randbytes(100_000), 0))) <= 60


@given(
    st.lists(st.integers(1, 60), min_size=1, max_size=20),
    st.integers(0, 2**32),
    st.sampled_from(DAMAGES),
    st.integers(0, 3),
)
def test_chunks_do_not_matter(cuts: list[int], seed: int, kind: Damage, faults: int) -> None:
    rng = random.Random(seed)
    data = b"".join(SENT)
    for _ in range(faults):
        data = damage(data, kind, rng)
    one, other = parser(), parser()
    expected = nodes(one.feed(data, 0))
    got: list[NodeRun] = []
    at = turn = 0
    while at < len(data):
        size = cuts[turn % len(cuts)]
        got += other.feed(data[at : at + size], 0)
        at, turn = at + size, turn + 1
    assert nodes(got) == expected
    assert other.faults == one.faults


SENT = stream("c1", 100, 350.0)


@pytest.mark.parametrize("kind", DAMAGES)
def test_damage_is_bounded(kind: Damage) -> None:
    """A changed distance cannot be seen; what can: at most 0.6 wrong nodes a fault, and eight lost to find the way."""
    rng = random.Random(f"nodes {kind}")
    sent = stream("c1", 20_000)
    known = {raw[1:] for raw in sent}
    pieces, faults, touched = [], 0, 0
    for at in range(0, len(sent), 200):
        group = b"".join(sent[at : at + 200])
        bad = damage(group, kind, rng)
        faults += 1
        touched += max(0, len(group) - len(bad)) // 5
        pieces.append(bad)
    got = nodes(parser().feed(b"".join(pieces), 0))
    wrong = sum(raw[1:] not in known for raw in got)
    assert wrong <= 0.6 * faults
    assert len(sent) - len(got) - touched <= 8 * faults
