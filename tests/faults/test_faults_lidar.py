"""What a spinning lidar does wrong, on virtual time: each fault is answered within its bound, seen from the fake."""

from __future__ import annotations

import asyncio
import itertools

import numpy as np
import pytest
from fault_lidar import LidarBench, now_s, off_m
from fault_matrix import answers
from fault_robot import STALE_S, FaultRobot

from robotd.authoring.device import DeviceUnavailable
from robotd.safety.settings import GuardConfig
from robotd.testing import connected, virtual_time
from robotd.world.messages import LidarScan
from robotd_devices.lidar import rplidar
from robotd_devices.lidar import rplidar_wire as wire
from robotd_devices.lidar.rplidar import Rplidar, RplidarConfig
from robotd_devices.lidar.rplidar_fake import RplidarFake
from robotd_devices.ports.memory_host import MemoryHost, now_ns

MODELS = pytest.mark.parametrize("model", ["a1", "c1", "s2", "s2-hq"])
"""Triangulating with capsules, nodes without any checksum, the fastest, packets of whole nodes."""
TURN_S = 0.1


class Bench(LidarBench):
    """A driver, its fake and the line between them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, model: str, **config: object) -> None:
        self.fake = RplidarFake(model)
        self.line = MemoryHost(self.fake, self.fake.model.baud)
        monkeypatch.setattr(rplidar, "serial_port", self.line.port)
        self.lidar, self.link = connected(Rplidar, RplidarConfig.model_validate({"port": "/dev/lidar"} | config))

    def heard(self, command: int, since_s: float) -> list[float]:
        """When the fake heard a command, in seconds since an instant."""
        return [ns / 1e9 - since_s for ns, what in self.fake.heard if what == command and ns >= since_s * 1e9]


def scan_command(model: str) -> int:
    return wire.SCAN if model == "c1" else wire.EXPRESS_SCAN


# ------------------------------------------------------------------------------------------------ 1, 2: silence


@MODELS
@answers(1, "head stalls")
@virtual_time
async def test_a_stalled_head_is_told_within_500_ms_and_its_motor_switched_off_and_on_three_times(
    monkeypatch: pytest.MonkeyPatch, model: str, fault: str
) -> None:
    bench = Bench(monkeypatch, model)
    motor_was_on: list[tuple[float, bool]] = []
    await bench.lidar.open()
    await bench.link.received(3)
    began_s = now_s()
    bench.fake.inject(fault)
    await bench.link.until(lambda link: bench.faults["not turning"] > 0, 2.0)
    assert now_s() - began_s <= 0.5
    count = len(bench.scans)
    async with asyncio.timeout(10.0):
        while True:
            if bench.link.losses:
                break
            await asyncio.sleep(0.01)
            motor_was_on.append((now_s(), bench.fake.turning))
    assert len(bench.scans) == count, "an old scan was given for a new one"
    scans = bench.heard(scan_command(model), began_s)
    assert len(scans) == 3
    assert scans[0] <= 1.8  # a second of patience, half a second without the motor
    assert 5.9 <= now_s() - began_s <= 7.0
    assert "does not turn" in str(bench.link.losses[0])
    await bench.lidar.close()
    if model != "c1":  # whose motor nobody can switch off
        offs = [b for (_, a), (_, b) in itertools.pairwise(motor_was_on) if a != b]
        assert offs.count(False) == 3
        assert not bench.fake.turning


@MODELS
@answers(2, "bytes stop")
@virtual_time
async def test_a_silent_lidar_is_started_anew_at_1_s_reset_at_3_s_opened_anew_at_6_s(
    monkeypatch: pytest.MonkeyPatch, model: str, fault: str
) -> None:
    bench = Bench(monkeypatch, model)
    await bench.lidar.open()
    await bench.link.received(3)
    began_s = now_s()
    bench.fake.inject(fault)
    await bench.link.until(lambda link: bool(link.losses), 10.0)
    assert 5.9 <= now_s() - began_s <= 6.5
    assert bench.heard(wire.STOP, began_s)[0] == pytest.approx(1.0, abs=0.25)
    assert bench.heard(scan_command(model), began_s)[0] == pytest.approx(1.1, abs=0.35)
    assert bench.heard(wire.RESET, began_s)[0] == pytest.approx(3.0, abs=0.25)
    assert len(bench.heard(wire.RESET, began_s)) == 1
    await bench.lidar.close()


@answers(2, "bytes stop", "head stalls")
def test_a_robot_whose_lidar_falls_silent_stands_within_250_ms_and_drives_when_it_is_back(
    monkeypatch: pytest.MonkeyPatch, fault: str
) -> None:
    robot = FaultRobot(monkeypatch)
    robot.run(6.0, (2.0, lambda: robot.lidar.inject(fault)), (2.9, lambda: robot.lidar.mend(fault)))
    newest_s = max(scan.stamp_ns for now, scan in robot.scans if now < 2.1e9) / 1e9
    assert robot.stood_after(2.0) <= newest_s + STALE_S + 0.03 - 2.0
    assert robot.drove_at(5.9), "the robot did not go on by itself"


# ----------------------------------------------------------------------------------------------- 3 to 5: bytes


@MODELS
@answers(3, "split reads")
def test_nothing_is_lost_where_every_byte_is_a_read_of_its_own(
    monkeypatch: pytest.MonkeyPatch, model: str, fault: str
) -> None:
    def scans(splits: bool) -> list[LidarScan]:
        bench = Bench(monkeypatch, model, baud=RplidarFake(model).model.baud)

        @virtual_time
        async def story() -> None:
            if splits:
                bench.line.inject(fault)
            await bench.lidar.open()
            await bench.link.received(3)
            await bench.lidar.close()

        story()
        assert bench.link.faults == []
        return bench.scans[:3]

    for whole, split in zip(scans(False), scans(True), strict=True):
        assert np.array_equal(whole.ranges_m, split.ranges_m, equal_nan=True)
        assert np.array_equal(whole.angles_rad, split.angles_rad)
        assert abs(whole.stamp_ns - split.stamp_ns) <= 1_000_000


@MODELS
@answers(4, "byte lost", "byte added", "bytes twice")
@virtual_time
async def test_a_lost_or_added_byte_costs_two_packets_at_most_and_no_wrong_distance(
    monkeypatch: pytest.MonkeyPatch, model: str, fault: str
) -> None:
    await check_damage(
        Bench(monkeypatch, model), fault, *{"a1": (96, 2), "s2": (40, 2), "s2-hq": (96, 2), "c1": (1, 8)}[model]
    )


@MODELS
@answers(5, "byte changed")
@virtual_time
async def test_a_changed_byte_costs_its_packet_and_the_scan_goes_on(
    monkeypatch: pytest.MonkeyPatch, model: str, fault: str
) -> None:
    # of an ultra capsule the last two samples are coded against the one behind, and lost with it
    await check_damage(
        Bench(monkeypatch, model), fault, *{"a1": (98, 1), "s2": (40, 1), "s2-hq": (96, 1), "c1": (1, 3)}[model]
    )


async def check_damage(bench: Bench, fault: str, packet: int, most_lost: int) -> None:
    """Damage the line six times: so many packets of so many beams are missing each time, and none is wrong."""
    await bench.lidar.open()
    await bench.link.received(2)
    for _ in range(6):
        bench.line.inject(fault)
        count = len(bench.scans)
        await bench.link.received(count + 4)
        fresh = bench.scans[count:]
        lost = sum(int(np.isnan(scan.ranges_m).sum()) for scan in fresh)
        assert lost <= most_lost * packet
        wrong = sum(int((off_m(scan)[np.isfinite(scan.ranges_m)] > 0.05).sum()) for scan in fresh)
        assert wrong <= (1 if packet == 1 else 0), "only nodes have no checksum: one of them may be wrong"
        assert fresh[-1].stamp_ns - fresh[0].stamp_ns == pytest.approx(3 * TURN_S * 1e9, rel=0.02)
    assert bench.link.losses == []
    await bench.lidar.close()


# --------------------------------------------------------------------------------------------- 6 to 9: opening


@MODELS
@answers(6, "still scanning")
@virtual_time
async def test_measurements_of_an_earlier_program_hold_up_opening_by_1_2_s_at_most(
    monkeypatch: pytest.MonkeyPatch, model: str, fault: str
) -> None:
    bench = Bench(monkeypatch, model, baud=RplidarFake(model).model.baud)
    bench.fake.inject(fault, now_ns())
    await asyncio.sleep(0.3)
    assert bench.fake.scanning is not None
    began_s = now_s()
    await bench.lidar.open()
    assert bench.heard(wire.STOP, began_s)[0] < 0.01
    assert bench.heard(scan_command(model), began_s)[0] <= 1.2
    await bench.link.received(2)
    assert float(np.nanmax(off_m(bench.scans[0]))) < 0.02
    assert bench.link.faults == []
    await bench.lidar.close()


@answers(7, "health warning", "health error", "health error stays")
@virtual_time
async def test_health_is_told_and_an_error_reset_once_within_3_s(monkeypatch: pytest.MonkeyPatch, fault: str) -> None:
    bench = Bench(monkeypatch, "a1", baud=115_200)
    bench.fake.inject(fault)
    stays = fault == "health error stays"
    began_s = now_s()
    if stays:
        with pytest.raises(DeviceUnavailable, match="code 0x0102, also after a reset"):
            await bench.lidar.open()
    else:
        await bench.lidar.open()
    assert now_s() - began_s <= 3.0
    assert len(bench.heard(wire.RESET, began_s)) == (0 if fault == "health warning" else 1)
    assert bench.faults == {"health warning" if fault == "health warning" else "protection stop": 1}
    if not stays:
        await bench.link.received(2)
    await bench.lidar.close()
    assert not bench.fake.turning


@answers(8, "other speed")
@virtual_time
async def test_the_speed_at_which_it_answers_is_found_within_2_5_s(monkeypatch: pytest.MonkeyPatch, fault: str) -> None:
    bench = Bench(monkeypatch, "s2")
    bench.line.inject(fault)
    bench.fake.inject("still scanning", now_ns())  # it sends while the wrong speeds are tried
    await bench.lidar.open()
    assert bench.heard(wire.GET_INFO, 0.0)[0] <= 2.5
    assert bench.line.opened[-1][1].baud == bench.line.baud
    await bench.link.received(2)
    await bench.lidar.close()


@MODELS
@answers(9, "brown-out")
@virtual_time
async def test_after_a_brown_out_it_turns_and_scans_again_within_2_s(
    monkeypatch: pytest.MonkeyPatch, model: str, fault: str
) -> None:
    bench = Bench(monkeypatch, model)
    await bench.lidar.open()
    await bench.link.received(3)
    began_s = now_s()
    bench.fake.inject(fault, now_ns())
    assert bench.fake.scanning is None
    count = len(bench.scans)
    await bench.link.received(count + 1, 2.0)
    assert bench.heard(scan_command(model), began_s)[0] <= 2.0 - TURN_S
    assert bench.fake.turning
    scan = bench.scans[-1]
    assert scan.start_ns is not None
    assert scan.start_ns > began_s * 1e9, "the open scan of before was joined to the new one"
    assert float(np.nanmax(off_m(scan))) < 0.02
    await bench.lidar.close()


# --------------------------------------------------------------------------------------------- 13 to 16: scans


@MODELS
@answers(13, "uneven turning")
@virtual_time
async def test_however_many_points_a_turn_has_each_has_its_true_angle(
    monkeypatch: pytest.MonkeyPatch, model: str, fault: str
) -> None:
    bench = Bench(monkeypatch, model)
    bench.fake.inject(fault)
    await bench.listen(24)
    counts = [len(scan.ranges_m) for scan in bench.scans[1:]]
    assert max(counts) > 1.25 * min(counts), "the fake turned evenly"
    assert bench.link.faults == []
    for scan in bench.scans:
        assert float(np.quantile(off_m(scan), 0.995)) < 0.02
        assert not np.isnan(scan.ranges_m).any()


@answers(14, "no start of turn", "bytes twice")
@virtual_time
async def test_a_scan_is_one_turn_whatever_the_marks_say(monkeypatch: pytest.MonkeyPatch, fault: str) -> None:
    bench = Bench(monkeypatch, "c1")
    await bench.lidar.open()
    if fault in bench.fake.breaks:
        bench.fake.inject(fault)
    await bench.link.received(2)
    for _ in range(5):
        if fault in bench.line.breaks:
            bench.line.inject(fault)
        await asyncio.sleep(4 * TURN_S)
    await bench.lidar.close()
    per_turn = TURN_S * 1e6 / bench.fake.model.modes[0].sample_us
    assert len(bench.scans) >= 20
    for scan in bench.scans:
        assert scan.start_ns is not None
        assert scan.stamp_ns - scan.start_ns <= 1.1 * TURN_S * 1e9
        assert len(scan.ranges_m) <= 1.1 * per_turn


@MODELS
@answers(15, "no return")
@virtual_time
async def test_no_return_is_neither_missing_nor_a_distance(
    monkeypatch: pytest.MonkeyPatch, model: str, fault: str
) -> None:
    bench = Bench(monkeypatch, model)
    bench.fake.inject(fault)
    await bench.listen(3)
    clockwise_deg = -np.degrees(bench.scans[-1].angles_rad) % 360.0
    ranges_m = bench.scans[-1].ranges_m
    inside = (clockwise_deg > 41.0) & (clockwise_deg < 129.0)
    outside = (clockwise_deg < 39.0) | (clockwise_deg > 131.0)
    assert np.isposinf(ranges_m[inside]).all()
    assert np.isfinite(ranges_m[outside]).all()
    assert bench.link.faults == []


@answers(16, "nothing returns")
def test_a_blinded_lidar_is_told_within_0_5_s_and_nothing_counts_as_free(
    monkeypatch: pytest.MonkeyPatch, fault: str
) -> None:
    robot = FaultRobot(monkeypatch, guard=GuardConfig())
    robot.lidar.range_of = lambda bearing_rad: np.full(len(bearing_rad), 4.0)
    robot.run(4.0, (2.0, lambda: robot.lidar.inject(fault)))
    blind = [scan for now, scan in robot.scans if now > 2.2e9]
    assert all(np.isnan(scan.ranges_m).all() for scan in blind)
    assert robot.device("lidar").faults["no return anywhere"] >= 3
    assert robot.stood_after(2.0) <= 0.5
