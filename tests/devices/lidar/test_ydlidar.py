"""YDLIDARs as devices: every model shows the fake's room; asked, started, lost and back, on virtual time."""

from __future__ import annotations

import asyncio
import math
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from robotd.authoring.device import DeviceLost, DeviceUnavailable
from robotd.testing import FakeLink, check_sensor, connected, virtual_time
from robotd.world.messages import LidarScan
from robotd_devices.lidar import ydlidar
from robotd_devices.lidar.beam_sweep import BeamSweep
from robotd_devices.lidar.ld19_fake import BoxRoom
from robotd_devices.lidar.ydlidar import Ydlidar, YdlidarConfig
from robotd_devices.lidar.ydlidar_fake import YdlidarFake
from robotd_devices.lidar.ydlidar_models import MODELS
from robotd_devices.lidar.ydlidar_packets import YdParser, encode
from robotd_devices.lidar.ydlidar_sweep import YdSweep
from robotd_devices.lidar.ydlidar_talk import SCAN, STOP
from robotd_devices.ports.memory_host import MemoryHost
from robotd_devices.ports.pty_host import PtyHost


def device(
    monkeypatch: pytest.MonkeyPatch, fake: YdlidarFake, **config: object
) -> tuple[Ydlidar, FakeLink, MemoryHost]:
    """A driver on a line in memory, not yet opened."""
    line = MemoryHost(fake, fake.model.baud)
    monkeypatch.setattr(ydlidar, "serial_port", line.port)
    given = {"port": "/dev/lidar", "model": fake.model.name} | config
    lidar, link = connected(Ydlidar, YdlidarConfig.model_validate(given))
    return lidar, link, line


def check_room(scan: LidarScan, within_m: float = 0.0006) -> None:
    seen = np.isfinite(scan.ranges_m)
    assert seen.sum() > 0.7 * len(seen)
    assert np.abs(scan.ranges_m[seen] - BoxRoom()(scan.angles_rad[seen].astype(np.float64))).max() <= within_m


@pytest.mark.parametrize("model", MODELS)
def test_each_model_is_started_and_read(monkeypatch: pytest.MonkeyPatch, model: str) -> None:
    fake = YdlidarFake(model)
    lidar, link, _ = device(monkeypatch, fake)

    @virtual_time
    async def story() -> None:
        await lidar.open()
        await link.received(4)
        assert link.faults == []
        for scan, arrived_ns in zip(link.of(LidarScan), link.arrived_ns, strict=True):
            check_room(scan)
            assert len(scan.ranges_m) == pytest.approx(fake.model.rate_hz / 7.0, abs=2)
            assert scan.stamp_ns < arrived_ns <= scan.stamp_ns + 40_000_000
            left = int(np.argmin(np.abs(scan.angles_rad - math.pi / 2)))
            assert scan.ranges_m[left] == pytest.approx(1.5, abs=0.002)
            assert (scan.intensities is not None) == (model in ("scl", "tmini_plus"))
        await lidar.close()
        assert fake.turning != fake.model.commanded
        assert fake.requests[-1:] == ([STOP] if fake.model.commanded else [])

    story()


@pytest.mark.parametrize("model", ["x4", "x2"])
def test_contract(monkeypatch: pytest.MonkeyPatch, model: str) -> None:
    lidar, _, _ = device(monkeypatch, YdlidarFake(model))
    virtual_time(check_sensor)(lidar, messages=4)


@pytest.mark.parametrize("first_lost", range(20, 38, 3))
@pytest.mark.parametrize("lost", [1, 2, 4])
def test_lost_packets_are_beams_not_measured(first_lost: int, lost: int) -> None:
    fake = YdlidarFake("x4", first_deg=170.0)
    model, gone = fake.model, 0
    sweep = BeamSweep(beam_ns=fake.sample_ns, range_min_m=0.1, range_max_m=10.0)
    parser, turn = YdParser(2, 78_125, fake.sample_ns), YdSweep(model, sweep, 78_125)
    scans, time_ns = [], 0.0
    for index in range(75):
        packet = fake.next_packet()
        time_ns += packet.samples * fake.sample_ns
        if first_lost <= index < first_lost + lost:
            gone += packet.samples
            continue
        for good in parser.feed(encode(packet, 2), round(time_ns) + 7_000_000):
            scans += turn.add(good)
    assert len(scans) == 3
    for scan in scans:
        assert len(scan.ranges_m) == pytest.approx(714, abs=2)
        check_room(scan)
        assert np.all(np.diff(np.unwrap(scan.angles_rad.astype(np.float64))) < 0.2)
    assert sum(int(np.isnan(scan.ranges_m).sum()) for scan in scans) == pytest.approx(gone, abs=2)


@pytest.mark.parametrize("back", [1, 2, 4])
def test_packets_that_come_again_are_no_second_turn(back: int) -> None:
    fake = YdlidarFake("x4", first_deg=170.0)
    sweep = BeamSweep(beam_ns=fake.sample_ns, range_min_m=0.1, range_max_m=10.0)
    turn = YdSweep(fake.model, sweep, 78_125)
    sent, time_ns = [], 0.0
    for _ in range(75):
        packet = fake.next_packet()
        time_ns += packet.samples * fake.sample_ns
        sent.append(packet._replace(arrival_ns=round(time_ns), chained=True))
    again = [packet._replace(arrival_ns=sent[29].arrival_ns, chained=False) for packet in sent[30 - back : 30]]
    scans = [scan for packet in [*sent[:30], *again, *sent[30:]] for scan in turn.add(packet)]
    assert [len(scan.ranges_m) for scan in scans] == pytest.approx([714] * 3, abs=2)
    assert not any(np.isnan(scan.ranges_m).any() for scan in scans)


def test_stamps_are_when_it_was_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    fake = YdlidarFake("x4", first_deg=180.0)
    lidar, link, _ = device(monkeypatch, fake)

    @virtual_time
    async def story() -> None:
        await lidar.open()
        await link.received(4)
        for turn, scan in enumerate(link.of(LidarScan), 1):
            # the head passes the seam once a turn; the first turn's beginning was not seen
            expected_ns = fake.scan_ns + turn * 1e9 / 7.0
            assert scan.start_ns == pytest.approx(expected_ns, abs=1_500_000)
            assert scan.stamp_ns - scan.start_ns == pytest.approx(1e9 / 7.0, rel=0.01)
        await lidar.close()

    story()


@pytest.mark.parametrize(
    ("model", "change", "words"),
    [
        ("x4", {"mute": True}, "YDLIDAR x4 on /dev/lidar at 128000 baud: it does not say.*no byte came"),
        ("g4", {"status": 2, "stubborn": True}, "reports an error, code 0x0000, also after a reset"),
    ],
)
def test_opening_says_what_is_wrong(
    monkeypatch: pytest.MonkeyPatch, model: str, change: dict[str, object], words: str
) -> None:
    fake = YdlidarFake(model)
    for name, value in change.items():
        setattr(fake, name, value)
    lidar, _, line = device(monkeypatch, fake)

    @virtual_time
    async def story() -> None:
        with pytest.raises(DeviceUnavailable, match=words):
            await lidar.open()
        await lidar.close()
        assert line.ports == []

    story()


@pytest.mark.parametrize(
    ("model", "change", "config", "words"),
    [
        ("x2", {"mute": True}, {}, "silent for 3 s: no byte came"),
        ("x4", {"stalled": True}, {}, "sends but does not turn"),
        ("x2", {}, {"model": "scl"}, "no packet of this family: are `model: scl` and 115200 baud right"),
        ("x2", {}, {"baud": 230_400}, "at|230400 baud right"),
    ],
    ids=["nothing", "blocked", "another model", "another speed"],
)
def test_silence_is_a_loss_that_says_why(
    monkeypatch: pytest.MonkeyPatch, model: str, change: dict[str, object], config: dict[str, object], words: str
) -> None:
    fake = YdlidarFake(model)
    for name, value in change.items():
        setattr(fake, name, value)
    lidar, link, _ = device(monkeypatch, fake, **config)

    @virtual_time
    async def story() -> None:
        await lidar.open()
        await link.until(lambda link: bool(link.losses), 8.0)
        await lidar.close()

    story()
    assert isinstance(link.losses[0], DeviceLost)
    assert any(part in str(link.losses[0]) for part in words.split("|")[-1:])
    assert link.messages == []


def test_unplugged_and_plugged_in_again(monkeypatch: pytest.MonkeyPatch) -> None:
    fake = YdlidarFake("x4")
    lidar, link, line = device(monkeypatch, fake)

    @virtual_time
    async def story() -> None:
        await lidar.open()
        await link.received(2)
        for turn in range(20):
            line.inject("cable out")
            await link.until(lambda link, turn=turn: len(link.losses) == turn + 1, 0.05)  # type: ignore[misc]
            await lidar.close()
            with pytest.raises(DeviceUnavailable, match="no serial port"):
                await lidar.open()
            await lidar.close()
            line.mend("cable out")
            back_s, count = asyncio.get_running_loop().time(), len(link.messages)
            await lidar.open()
            await link.received(count + 1)
            assert asyncio.get_running_loop().time() - back_s < 1.0
        await lidar.close()
        assert fake.requests.count(SCAN) == 1  # since power came back
        assert len(asyncio.all_tasks()) == 1

    story()


def test_health_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    fake = YdlidarFake("x4")
    fake.status = 1
    lidar, link, _ = device(monkeypatch, fake)

    @virtual_time
    async def story() -> None:
        await lidar.open()
        await link.received(2)
        await lidar.close()

    story()
    assert Counter(name for name, _ in link.faults) == {"health warning": 1}


@pytest.mark.parametrize(
    ("config", "words"),
    [
        ({"port": ""}, "port"),
        ({"model": "z9"}, "model"),
        ({"range_min_m": 1.0, "range_max_m": 0.5}, "must be below range_max_m"),
    ],
)
def test_config_refuses(config: dict[str, object], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        YdlidarConfig.model_validate({"port": "a"} | config)


async def test_on_a_pty_in_real_time(tmp_path: Path) -> None:
    with PtyHost(YdlidarFake("x4"), tmp_path / "lidar", baud=128_000) as host:
        lidar, link = connected(Ydlidar, YdlidarConfig(port=str(tmp_path / "lidar"), backend="raw"))
        await lidar.open()
        await link.received(3)
        host.unplug()
        await link.until(lambda link: bool(link.losses), 1.0)
        await lidar.close()
    assert link.faults == []
    for scan in link.of(LidarScan):
        check_room(scan)
