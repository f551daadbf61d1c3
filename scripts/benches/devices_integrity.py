"""Damaged streams of every checked lidar protocol, and of the one without a check: what is accepted, what is lost."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from benches.harness import Context
from robotd_devices.lidar import ld_packets, rplidar_capsules, ydlidar_packets
from robotd_devices.lidar.answers import AnswerReader
from robotd_devices.lidar.ld19_fake import Ld19Fake
from robotd_devices.lidar.rplidar_fake import RplidarFake
from robotd_devices.lidar.rplidar_nodes import NODE_BYTES, NodeParser
from robotd_devices.lidar.rplidar_wire import SCAN, express_scan, motor_rpm, request
from robotd_devices.lidar.ydlidar_fake import YdlidarFake
from robotd_devices.ports.fakes import DAMAGES, Damage, damage

#: One fault in so many packets.
EVERY = 100
#: What two changed bytes of one packet pass an eight-bit check with; the sixteen-bit exclusive or of YDLIDAR has two
#: lanes of eight.
THEORY = 1.0 / 256.0


@dataclass(frozen=True)
class Protocol:
    """A stream that can go round and round, and a reader of it: bytes to those of the packets that it accepted."""

    name: str
    packets: Sequence[bytes]
    reader: Callable[[], Callable[[bytes], list[bytes]]]


def protocols() -> list[Protocol]:
    """LD, the four capsule formats, and YDLIDAR with two and with three bytes a sample."""
    return [_ld(), *(_capsules(form) for form in rplidar_capsules.FORMATS.values()), _yd("x4"), _yd("scl")]


def _ld() -> Protocol:
    fake = Ld19Fake()
    packets = [ld_packets.encode(fake.next_packet()) for _ in range(11_250)]  # 30 s: the device's clock goes round

    def reader() -> Callable[[bytes], list[bytes]]:
        parser = ld_packets.LdParser()
        return lambda data: [ld_packets.encode(packet) for packet in parser.feed(data, 0)]

    return Protocol("ld", packets, reader)


def _capsules(form: rplidar_capsules.CapsuleFormat) -> Protocol:
    model, mode, turn = {0x82: ("a1", 1, 24), 0x84: ("a1", 2, 16), 0x85: ("s2", 1, 80), 0x86: ("s3", 2, 50)}[form.kind]
    sample_ns = RplidarFake(model).model.modes[mode].sample_us * 1e3
    # a whole number of capsules a turn, so that the stream goes round
    fake = RplidarFake(model, rotation_hz=1e9 / (turn * form.samples * sample_ns))
    fake.feed(motor_rpm(600) + express_scan(mode), 0)
    packets = [fake.next_capsule(form) for _ in range(turn + 1)][1:]
    # the last of them is the first of a turn again, without the mark of a beginning
    packets = [packets[-1], *packets[:-1]]

    def reader() -> Callable[[bytes], list[bytes]]:
        parser = rplidar_capsules.CapsuleParser(form, 40_000, sample_ns)
        return lambda data: [c.start_q6.to_bytes(2, "little") + c.data for c in parser.feed(data, 0)]

    return Protocol(form.name, packets, reader)


def _yd(model: str) -> Protocol:
    fake = YdlidarFake(model)
    width = fake.model.sample_bytes
    packets = [ydlidar_packets.encode(fake.next_packet(), width) for _ in range(4000)]

    def reader() -> Callable[[bytes], list[bytes]]:
        parser = ydlidar_packets.YdParser(width, 40_000, fake.sample_ns)
        return lambda data: [ydlidar_packets.encode(packet, width) for packet in parser.feed(data, 0)]

    return Protocol(f"ydlidar {model}", packets, reader)


def _told(protocol: Protocol, packet: bytes) -> bytes:
    """A sent packet as the protocol's reader gives it back."""
    for form in rplidar_capsules.FORMATS.values():
        if form.name == protocol.name:
            return packet[form.angle_at : form.angle_at + 2] + packet[form.data_at :]
    return packet


def _run(protocol: Protocol, count: int, spoil: Callable[[list[bytes]], tuple[bytes, int]]) -> dict[str, Any]:
    """Send `count` packets in groups of EVERY, each spoiled once; `spoil` gives the bytes and how many it destroyed."""
    known = {_told(protocol, packet) for packet in protocol.packets}
    feed = protocol.reader()
    corrupt = accepted = destroyed = faults = at = sent = 0
    while sent < count:
        group = [protocol.packets[(at + i) % len(protocol.packets)] for i in range(EVERY)]
        at, sent, faults = at + EVERY, sent + EVERY, faults + 1
        data, gone = spoil(group)
        destroyed += gone
        for packet in feed(data):
            accepted += 1
            corrupt += packet not in known
    return {
        "packets": sent,
        "faults": faults,
        "corrupt": corrupt,
        # the packet that was hit, and those that the reader lost beside what the fault itself destroyed
        "lost_per_fault": 1.0 + max(0.0, (sent - 1 - (accepted - corrupt) - destroyed) / faults),
    }


def _damaged(kind: Damage, rng: random.Random) -> Callable[[list[bytes]], tuple[bytes, int]]:
    def spoil(group: list[bytes]) -> tuple[bytes, int]:
        good = b"".join(group)
        bad = damage(good, kind, rng)
        return bad, _touched(group, good, bad)

    return spoil


def _touched(group: list[bytes], good: bytes, bad: bytes) -> int:
    """How many packets are not whole any more, by what is the same from the beginning and from the end."""
    shorter = min(len(good), len(bad))
    before = next((i for i in range(shorter) if good[i] != bad[i]), shorter)
    behind = next((i for i in range(shorter - before) if good[-1 - i] != bad[-1 - i]), shorter - before)
    at = whole = 0
    for packet in group:
        whole += at + len(packet) <= before or at >= len(good) - behind
        at += len(packet)
    return len(group) - whole


def _two_flips(rng: random.Random) -> Callable[[list[bytes]], tuple[bytes, int]]:
    """Two different bytes of one packet changed."""

    def spoil(group: list[bytes]) -> tuple[bytes, int]:
        victim = rng.randrange(len(group))
        packet = bytearray(group[victim])
        for place in rng.sample(range(len(packet)), 2):
            packet[place] ^= rng.randint(1, 255)
        return b"".join([*group[:victim], bytes(packet), *group[victim + 1 :]]), 1

    return spoil


def measure(ctx: Context) -> None:
    """corrupt_accepted, good_lost_per_fault, multibyte_over_theory."""
    per_kind = 10_000 if ctx.quick else 200_000
    flips = 50_000 if ctx.quick else 1_000_000
    for protocol in protocols():
        for kind in DAMAGES:
            key = f"{protocol.name} {kind}"
            ctx.progress(0, None, key)
            if ctx.saved(key) is None:
                found = _run(protocol, per_kind, _damaged(kind, random.Random(key)))
                ctx.row({"what": "damage", "protocol": protocol.name, "kind": kind, **found}, key=key)
        key = f"{protocol.name} two flips"
        ctx.progress(0, None, key)
        if ctx.saved(key) is None:
            found = _run(protocol, flips, _two_flips(random.Random(key)))
            share = found["corrupt"] / found["faults"] / THEORY
            ctx.row({"what": "two flips", "protocol": protocol.name, "over_theory": share, **found}, key=key)
    damaged = [row for row in ctx.rows.all if row.get("what") == "damage"]
    flipped = [row for row in ctx.rows.all if row.get("what") == "two flips"]
    runs = sum(row["faults"] for row in damaged)
    ctx.figure("corrupt_accepted", sum(row["corrupt"] for row in damaged), runs=runs)
    ctx.figure("good_lost_per_fault", max(row["lost_per_fault"] for row in damaged), runs=runs)
    total = sum(row["corrupt"] for row in flipped) / sum(row["faults"] for row in flipped) / THEORY
    ctx.figure("multibyte_over_theory", total, runs=sum(row["faults"] for row in flipped))


def measure_nodes(ctx: Context) -> None:
    """legacy_wrong_per_fault: the worst kind of fault; a row for each."""
    for model in ("c1", "a1"):
        fake = RplidarFake(model)
        fake.feed(request(SCAN), 0)
        count = 20_000 if ctx.quick else 200_000
        head = AnswerReader(None)
        head.feed(fake.tick(round((count + 2) * fake.sample_ns)))
        sent = [head.rest[i : i + NODE_BYTES] for i in range(0, count * NODE_BYTES, NODE_BYTES)]
        # the quality of a node is no measurement; angle and distance are
        known = {node[1:] for node in sent}
        for kind in DAMAGES:
            key = f"nodes {model} {kind}"
            if ctx.saved(key) is None:
                rng = random.Random(key)
                parser = NodeParser(40_000, fake.sample_ns, 3600e-9 * fake.sample_ns)
                wrong = good = faults = 0
                for at in range(0, len(sent), EVERY):
                    faults += 1
                    for run in parser.feed(damage(b"".join(sent[at : at + EVERY]), kind, rng), 0):
                        nodes = [run.data[i + 1 : i + NODE_BYTES] for i in range(0, len(run.data), NODE_BYTES)]
                        bad = sum(node not in known for node in nodes)
                        wrong, good = wrong + bad, good + len(nodes) - bad
                ctx.row(
                    {"what": "nodes", "model": model, "kind": kind, "wrong_per_fault": wrong / faults,
                     "lost_per_fault": (len(sent) - good) / faults, "faults": faults},
                    key=key,
                )  # fmt: skip
    rows = [row for row in ctx.rows.all if row.get("what") == "nodes"]
    ctx.figure(
        "legacy_wrong_per_fault", max(row["wrong_per_fault"] for row in rows), runs=sum(row["faults"] for row in rows)
    )
