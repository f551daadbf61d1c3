"""The RPLIDAR as a device: found at its speed, asked, started, read; brought back from every fault, on virtual time."""

from __future__ import annotations

import asyncio
import math
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from robotd.authoring.device import DeviceLost, DeviceMisconfigured, DeviceUnavailable
from robotd.testing import FakeLink, check_sensor, connected, virtual_time
from robotd.world.messages import LidarScan
from robotd_devices.lidar import rplidar
from robotd_devices.lidar import rplidar_wire as wire
from robotd_devices.lidar.ld19_fake import BoxRoom
from robotd_devices.lidar.rplidar import Rplidar, RplidarConfig
from robotd_devices.lidar.rplidar_fake import MODELS, RplidarFake
from robotd_devices.ports.memory_host import MemoryHost
from robotd_devices.ports.pty_host import PtyHost


def device(
    monkeypatch: pytest.MonkeyPatch, fake: RplidarFake, **config: object
) -> tuple[Rplidar, FakeLink, MemoryHost]:
    """A driver on a line in memory, not yet opened."""
    line = MemoryHost(fake, fake.model.baud)
    monkeypatch.setattr(rplidar, "serial_port", line.port)
    lidar, link = connected(Rplidar, RplidarConfig.model_validate({"port": "/dev/lidar"} | config))
    return lidar, link, line


def faults(link: FakeLink) -> Counter[str]:
    return Counter(name for name, _ in link.faults)


def now_s() -> float:
    return asyncio.get_running_loop().time()


def check_room(scan: LidarScan, within_m: float = 0.008) -> None:
    off = np.abs(scan.ranges_m - BoxRoom()(scan.angles_rad.astype(np.float64)))
    assert np.quantile(off[np.isfinite(scan.ranges_m)], 0.995) <= within_m


@pytest.mark.parametrize("model", MODELS)
def test_each_model_is_found_turned_and_read(monkeypatch: pytest.MonkeyPatch, model: str) -> None:
    fake = RplidarFake(model, spin_up_s=1.0)
    lidar, link, line = device(monkeypatch, fake)

    @virtual_time
    async def story() -> None:
        await lidar.open()
        assert now_s() < 2.5
        assert lidar.scanning is not None
        assert lidar.scanning.motor == fake.model.motor
        best = fake.model.modes[fake.model.typical].answer if model != "a1-old" else 0x82
        assert lidar.scanning.mode.answer == best
        assert line.opened[-1][1].baud == fake.model.baud
        await link.received(4)
        assert link.faults == []
        for scan, arrived_ns in zip(link.of(LidarScan), link.arrived_ns, strict=True):
            check_room(scan)
            assert scan.stamp_ns < arrived_ns <= scan.stamp_ns + 40_000_000
        await lidar.close()
        assert fake.scanning is None
        assert fake.turning == (fake.model.motor == "none")
        opened = len(line.opened)
        await lidar.open()  # the speed that worked is tried first
        assert [s.baud for _, s in line.opened[opened:]] == [fake.model.baud]
        await lidar.close()
        assert line.ports == []

    story()


@pytest.mark.parametrize("model", ["a1", "s2"])
def test_contract(monkeypatch: pytest.MonkeyPatch, model: str) -> None:
    lidar, _, _ = device(monkeypatch, RplidarFake(model))
    virtual_time(check_sensor)(lidar, messages=4)


@pytest.mark.parametrize(
    ("model", "mode", "name"),
    [("a1", "standard", "Standard"), ("a1", "express", "Express"), ("s3", "DenseBoost", "DenseBoost")],
)
def test_a_mode_by_its_name(monkeypatch: pytest.MonkeyPatch, model: str, mode: str, name: str) -> None:
    lidar, link, _ = device(monkeypatch, RplidarFake(model), mode=mode)

    @virtual_time
    async def story() -> None:
        await lidar.open()
        assert lidar.scanning is not None
        assert lidar.scanning.mode.name == name
        await link.received(2)
        await lidar.close()

    story()


@pytest.mark.parametrize(
    ("model", "change", "config", "error", "words"),
    [
        ("a1", {}, {"mode": "Turbo"}, DeviceMisconfigured, "no scan mode `Turbo`.*it has: Standard, Express, Boost"),
        ("a1-old", {}, {"mode": "Boost"}, DeviceMisconfigured, "it has: Standard, Express"),
        ("a1", {"mute": True}, {}, DeviceUnavailable, "at 115200, 256000, 460800, 1000000 baud; no byte came"),
        ("a1", {}, {"baud": 256_000}, DeviceUnavailable, "at 256000 baud; [0-9]+ bytes came but no answer"),
        ("a2", {"health": wire.Health(2, 0x8001), "stubborn": True}, {}, DeviceUnavailable, "code 0x8001, also after"),
    ],
    ids=["mode", "mode of old firmware", "no power", "wrong baud", "protection stop"],
)
def test_opening_says_what_is_wrong(
    monkeypatch: pytest.MonkeyPatch,
    model: str,
    change: dict[str, object],
    config: dict[str, object],
    error: type[Exception],
    words: str,
) -> None:
    fake = RplidarFake(model)
    for name, value in change.items():
        setattr(fake, name, value)
    lidar, _, line = device(monkeypatch, fake, **config)
    if config.get("baud"):
        fake.feed(wire.request(wire.SCAN), 0)  # it sends, at another speed

    @virtual_time
    async def story() -> None:
        with pytest.raises(error, match=words):
            await lidar.open()
        assert now_s() < 5.0
        await lidar.close()
        assert line.ports == []

    story()


def test_a_protection_stop_is_left_by_one_reset(monkeypatch: pytest.MonkeyPatch) -> None:
    fake = RplidarFake("a1")
    fake.health = wire.Health(2, 0x0102)
    lidar, link, _ = device(monkeypatch, fake, baud=115_200)

    @virtual_time
    async def story() -> None:
        await lidar.open()
        assert now_s() < 3.0
        assert faults(link) == {"protection stop": 1}
        assert fake.requests.count(wire.RESET) == 1
        await link.received(2)
        await lidar.close()

    story()


def test_a_health_warning_is_counted_and_it_scans(monkeypatch: pytest.MonkeyPatch) -> None:
    fake = RplidarFake("a1")
    fake.health = wire.Health(1, 7)
    lidar, link, _ = device(monkeypatch, fake)

    @virtual_time
    async def story() -> None:
        await lidar.open()
        await link.received(2)
        assert link.faults == [("health warning", "code 0x0007")]
        await lidar.close()

    story()


@pytest.mark.parametrize("model", ["a1", "c1", "s2"])
def test_measurements_of_an_earlier_program_are_no_answer(monkeypatch: pytest.MonkeyPatch, model: str) -> None:
    """The top question of every Python library: the lidar still scans when the port is opened."""
    fake = RplidarFake(model)
    fake.feed(wire.motor_rpm(600) + wire.request(wire.SCAN), 0)
    lidar, link, _ = device(monkeypatch, fake, baud=fake.model.baud)

    @virtual_time
    async def story() -> None:
        await asyncio.sleep(0.3)
        began_s = now_s()
        await lidar.open()
        assert now_s() - began_s < 2.5
        await link.received(2)
        assert link.faults == []
        await lidar.close()

    story()


@pytest.mark.parametrize("model", ["a1", "c1", "s2"])
@pytest.mark.parametrize("fault", ["mute", "stalled", "brown-out"])
def test_a_silent_lidar_is_brought_back(monkeypatch: pytest.MonkeyPatch, model: str, fault: str) -> None:
    fake = RplidarFake(model)
    lidar, link, _ = device(monkeypatch, fake)

    @virtual_time
    async def story() -> None:
        await lidar.open()
        await link.received(3)
        began_s = now_s()
        if fault == "brown-out":
            fake.brown_out(round(began_s * 1e9))
        else:
            setattr(fake, fault, True)
            asyncio.get_running_loop().call_later(1.4, setattr, fake, fault, False)
        await link.until(lambda link: faults(link)["scan restarted"] >= 1, 1.3)
        count = len(link.messages)
        await link.received(count + 1, 4.0)
        assert now_s() - began_s < (2.0 if fault != "stalled" else 3.0)
        await link.received(count + 4)
        assert link.losses == []
        assert faults(link)["lidar reset"] == 0
        check_room(link.of(LidarScan)[-1])
        stamps = [scan.stamp_ns for scan in link.of(LidarScan)]
        assert stamps == sorted(set(stamps))
        if fault == "stalled":
            assert "does not turn" in dict(link.faults)["scan restarted"]
        await lidar.close()

    story()


def test_the_ladder_of_silence(monkeypatch: pytest.MonkeyPatch) -> None:
    """Restart after 1 s, reset after 3 s, given up after 6 s; each once."""
    fake = RplidarFake("a1")
    lidar, link, _ = device(monkeypatch, fake)

    @virtual_time
    async def story() -> None:
        await lidar.open()
        await link.received(3)
        fake.mute = True
        began_s = now_s()
        for fault, after_s in (("scan restarted", 1.0), ("lidar reset", 3.0)):
            await link.until(lambda link, fault=fault: faults(link)[fault] == 1, 4.0)  # type: ignore[misc]
            assert now_s() - began_s == pytest.approx(after_s, abs=0.25)
        await link.until(lambda link: bool(link.losses), 10.0)
        assert 6.0 <= now_s() - began_s <= 8.0
        assert "silent for 6 s: no byte came" in str(link.losses[0])
        assert fake.requests.count(wire.RESET) == 1
        await lidar.close()

    story()


def test_unplugged_and_plugged_in_again(monkeypatch: pytest.MonkeyPatch) -> None:
    fake = RplidarFake("a1")
    lidar, link, line = device(monkeypatch, fake)

    @virtual_time
    async def story() -> None:
        await lidar.open()
        await link.received(2)
        for turn in range(20):
            line.inject("cable out")
            await link.until(lambda link, turn=turn: len(link.losses) == turn + 1, 0.05)  # type: ignore[misc]
            assert isinstance(link.losses[-1], DeviceLost)
            await lidar.close()
            with pytest.raises(DeviceUnavailable, match="no serial port"):
                await lidar.open()
            await lidar.close()
            line.mend("cable out")
            back_s, count = now_s(), len(link.messages)
            await lidar.open()
            await link.received(count + 1)
            assert now_s() - back_s < 1.0
        await lidar.close()
        assert line.ports == []
        assert len(asyncio.all_tasks()) == 1

    story()


@pytest.mark.parametrize("after_s", [0.02, 0.1, 0.3, 0.5])
def test_unplugged_while_opening(monkeypatch: pytest.MonkeyPatch, after_s: float) -> None:
    lidar, link, line = device(monkeypatch, RplidarFake("a2"), rotation_hz=10.0)

    @virtual_time
    async def story() -> None:
        asyncio.get_running_loop().call_later(after_s, line.inject, "cable out")
        try:
            await lidar.open()
        except (DeviceLost, DeviceUnavailable):
            assert link.losses == []
        else:
            await link.until(lambda link: bool(link.losses), 1.0)
        await lidar.close()
        assert line.ports == []

    story()


@pytest.mark.parametrize("after_s", [0.003, 0.05, 0.4])
def test_opening_can_be_cancelled(monkeypatch: pytest.MonkeyPatch, after_s: float) -> None:
    lidar, _, line = device(monkeypatch, RplidarFake("s2"))

    @virtual_time
    async def story() -> None:
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(after_s):
                await lidar.open()
        await lidar.close()
        assert line.ports == []

    story()


@pytest.mark.parametrize(("model", "can"), [("a1", False), ("a2", True), ("s2", True)])
def test_a_lidar_is_asked_to_take_another_speed_over(monkeypatch: pytest.MonkeyPatch, model: str, can: bool) -> None:
    """The A1 here has firmware 1.29, one too old."""
    fake = RplidarFake(model)
    line = MemoryHost(fake, fake.model.baud)
    monkeypatch.setattr(rplidar, "serial_port", line.port)
    lidar, link = connected(Rplidar, RplidarConfig(port="/dev/lidar", baud=460_800, negotiate=True))

    @virtual_time
    async def story() -> None:
        if can:
            await lidar.open()
            assert now_s() < 3.0
            confirm = next(at for at, (_, data) in enumerate(line.written) if data == wire.confirm_baud(460_800))
            assert len(line.opened) == 2
            assert line.written[confirm][0] > line.opened[1][0]
            await link.received(2)
            assert link.faults == []
        else:
            with pytest.raises(DeviceUnavailable, match="at 460800 baud"):
                await lidar.open()
            assert now_s() < 5.0
        await lidar.close()
        assert not fake.turning

    story()


@pytest.mark.parametrize("model", ["a1", "a2", "s2"])
@pytest.mark.parametrize("ending", ["no scan", "cancelled", "no answer any more"])
def test_the_motor_stands_after_an_opening_that_failed_behind_its_start(
    monkeypatch: pytest.MonkeyPatch, model: str, ending: str
) -> None:
    fake = RplidarFake(model)
    lidar, _, line = device(monkeypatch, fake, baud=fake.model.baud)

    @virtual_time
    async def story() -> None:
        if ending == "no scan":
            fake.refuses = True
            with pytest.raises(DeviceUnavailable, match="does not begin its scan"):
                await lidar.open()
        elif ending == "no answer any more":
            fake.mute = True
            with pytest.raises(DeviceUnavailable, match="no RPLIDAR answers"):
                await lidar.open()
        else:
            fake.refuses = True
            with pytest.raises(TimeoutError):
                async with asyncio.timeout(1.5):
                    await lidar.open()
            assert fake.turning
        await lidar.close()
        assert not fake.turning
        assert line.ports == []

    story()


@pytest.mark.parametrize(
    ("config", "words"),
    [
        ({"port": ""}, "port"),
        ({"baud": 5}, "no speed of an RPLIDAR"),
        ({"motor": "diesel"}, "motor"),
        ({"range_min_m": 1.0, "range_max_m": 0.5}, "must be below range_max_m"),
        ({"bauds": 1}, "bauds"),
        ({"negotiate": True}, "needs a `baud`"),
    ],
)
def test_config_refuses(config: dict[str, object], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        RplidarConfig.model_validate({"port": "a"} | config)


def test_declares_itself() -> None:
    assert Rplidar.emits == (LidarScan,)
    assert Rplidar.sim_twin == "sim_lidar"
    assert Rplidar.publish_period_s(RplidarConfig(rotation_hz=5.0)) == 0.2


@pytest.mark.parametrize("backend", ["pyserial", "raw"])
async def test_on_a_pty_in_real_time(tmp_path: Path, backend: str) -> None:
    fake = RplidarFake("a1")
    with PtyHost(fake, tmp_path / "lidar", baud=115_200) as host:
        config = RplidarConfig.model_validate({"port": str(tmp_path / "lidar"), "backend": backend, "baud": 115_200})
        lidar, link = connected(Rplidar, config)
        Rplidar.load(config)
        await lidar.open()
        await link.received(4)
        host.unplug()
        await link.until(lambda link: bool(link.losses), 1.0)
        await lidar.close()
    assert link.faults == []
    assert host.overrun == 0
    for scan, arrived_ns in zip(link.of(LidarScan), link.arrived_ns, strict=True):
        check_room(scan)
        assert scan.stamp_ns < arrived_ns < scan.stamp_ns + 100_000_000
        assert abs(1e9 / (scan.stamp_ns - scan.start_ns) - 10.0) < 0.2
        assert abs(scan.angles_rad[0]) > math.radians(170.0)
