"""The same faults on the lidars that have no long conversation: YDLIDAR and LD19, on virtual time."""

from __future__ import annotations

import asyncio

import numpy as np
import pytest
from fault_lidar import LidarBench, now_s, off_m
from fault_matrix import answers

from robotd.testing import connected, virtual_time
from robotd_devices.lidar import ld19, ydlidar
from robotd_devices.lidar.ld19 import Ld19, Ld19Config
from robotd_devices.lidar.ld19_fake import Ld19Fake
from robotd_devices.lidar.ydlidar import Ydlidar, YdlidarConfig
from robotd_devices.lidar.ydlidar_fake import YdlidarFake
from robotd_devices.lidar.ydlidar_talk import RESET, SCAN, STOP
from robotd_devices.ports.memory_host import MemoryHost, now_ns

KINDS = pytest.mark.parametrize("kind", ["x4", "scl", "tmini_plus", "ld19"])


class Bench(LidarBench):
    """A driver, its fake and the line between them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
        if kind == "ld19":
            self.fake, self.samples = Ld19Fake(), 12
            self.line = MemoryHost(self.fake, 230_400)
            monkeypatch.setattr(ld19, "serial_port", self.line.port)
            self.lidar, self.link = connected(Ld19, Ld19Config(port="/dev/lidar"))
        else:
            self.fake, self.samples = YdlidarFake(kind), 40
            self.line = MemoryHost(self.fake, self.fake.model.baud)
            monkeypatch.setattr(ydlidar, "serial_port", self.line.port)
            config = YdlidarConfig.model_validate({"port": "/dev/lidar", "model": kind})
            self.lidar, self.link = connected(Ydlidar, config)


@KINDS
@answers(3, "split reads")
@virtual_time
async def test_nothing_is_lost_where_every_byte_is_a_read_of_its_own(
    monkeypatch: pytest.MonkeyPatch, kind: str, fault: str
) -> None:
    bench = Bench(monkeypatch, kind)
    bench.line.inject(fault)
    await bench.listen(3)
    assert bench.link.faults == []
    assert not any(np.isnan(scan.ranges_m).any() for scan in bench.scans)


@KINDS
@answers(4, "byte lost", "byte added", "bytes twice")
@virtual_time
async def test_a_lost_or_added_byte_costs_two_packets_at_most(
    monkeypatch: pytest.MonkeyPatch, kind: str, fault: str
) -> None:
    await check_damage(Bench(monkeypatch, kind), fault, 2)


@KINDS
@answers(5, "byte changed")
@virtual_time
async def test_a_changed_byte_costs_its_packet(monkeypatch: pytest.MonkeyPatch, kind: str, fault: str) -> None:
    # a changed header may go with the packet before it, which it was to prove
    await check_damage(Bench(monkeypatch, kind), fault, 2)


async def check_damage(bench: Bench, fault: str, most_lost: int) -> None:
    await bench.lidar.open()
    await bench.link.received(2)
    for _ in range(6):
        bench.line.inject(fault)
        count = len(bench.scans)
        await bench.link.received(count + 3)
        fresh = bench.scans[count:]
        assert sum(int(np.isnan(scan.ranges_m).sum()) for scan in fresh) <= most_lost * bench.samples + 1
        assert max(float(off_m(scan)[np.isfinite(scan.ranges_m)].max()) for scan in fresh) < 0.05
    assert len(bench.link.faults) >= 6, "the line was not damaged"
    assert bench.link.losses == []
    await bench.lidar.close()


@answers(6, "still scanning")
@virtual_time
async def test_measurements_of_an_earlier_program_hold_up_opening_by_1_2_s_at_most(
    monkeypatch: pytest.MonkeyPatch, fault: str
) -> None:
    bench = Bench(monkeypatch, "x4")
    bench.fake.inject(fault, now_ns())
    await asyncio.sleep(0.3)
    began_s = now_s()
    await bench.lidar.open()
    assert now_s() - began_s <= 1.2
    assert bench.fake.requests.index(STOP) < bench.fake.requests.index(SCAN)
    await bench.link.received(1)
    assert bench.link.faults == []
    await bench.lidar.close()


@answers(7, "health warning", "health error")
@virtual_time
async def test_health_is_told_and_an_error_reset_once_within_3_s(monkeypatch: pytest.MonkeyPatch, fault: str) -> None:
    bench = Bench(monkeypatch, "x4")
    bench.fake.inject(fault)
    await bench.lidar.open()
    assert now_s() <= 3.0
    assert bench.fake.requests.count(RESET) == (1 if fault == "health error" else 0)
    assert bench.faults == {fault: 1}
    await bench.link.received(1)
    await bench.lidar.close()


@answers(1, "head stalls")
@virtual_time
async def test_a_stalled_head_is_told_and_its_motor_stopped_until_it_is_opened_anew(
    monkeypatch: pytest.MonkeyPatch, fault: str
) -> None:
    bench = Bench(monkeypatch, "x4")
    await bench.lidar.open()
    await bench.link.received(3)
    count = len(bench.scans)
    bench.fake.inject(fault)
    await bench.link.until(lambda link: bool(link.faults), 0.5)
    await bench.link.until(lambda link: bool(link.losses), 7.0)
    assert "does not turn" in str(bench.link.losses[0])
    assert len(bench.scans) <= count + 1, "an old scan was given for a new one"
    await bench.lidar.close()
    assert not bench.fake.turning
    bench.fake.mend(fault)
    await bench.lidar.open()
    await bench.link.received(count + 2)
    await bench.lidar.close()


@KINDS
@answers(11, "cable out")
@virtual_time
async def test_plugged_in_again_it_scans_within_1_s(monkeypatch: pytest.MonkeyPatch, kind: str, fault: str) -> None:
    bench = Bench(monkeypatch, kind)
    await bench.lidar.open()
    await bench.link.received(2)
    bench.line.inject(fault)
    await bench.link.until(lambda link: bool(link.losses), 0.05)
    await bench.lidar.close()
    await asyncio.sleep(0.4)
    bench.line.mend(fault)
    back_ns, count = now_ns(), len(bench.scans)
    await bench.lidar.open()
    await bench.link.received(count + 1)
    assert now_ns() - back_ns <= 1_000_000_000
    first = bench.scans[count]
    assert first.start_ns is not None
    assert first.start_ns >= back_ns
    await bench.lidar.close()
