"""The LD19 as a device: from a paced pty to scans on a link, unplugged and plugged in again, on both back ends."""

from __future__ import annotations

import asyncio
import math
import random
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest
from pydantic import ValidationError
from waiting import until

from robotd.authoring.device import DeviceContext, DeviceError, DeviceLost, DeviceUnavailable
from robotd.world.clock import ManualClock
from robotd.world.messages import LidarScan, Message
from robotd.world.robot import Mount, Robot
from robotd_devices.lidar.ld19 import Ld19, Ld19Config
from robotd_devices.lidar.ld19_fake import BoxRoom, Ld19Fake
from robotd_devices.lidar.ld_packets import encode
from robotd_devices.ports.fakes import Faulty
from robotd_devices.ports.pty_host import PtyHost

BAUD = 230_400


class Link:
    """Collects what a device hands over, with the time at which it did."""

    def __init__(self) -> None:
        self.scans: list[LidarScan] = []
        self.published_ns: list[int] = []
        self.losses: list[tuple[int, DeviceError]] = []
        self.faults: Counter[str] = Counter()

    def publish(self, message: Message) -> None:
        assert isinstance(message, LidarScan)
        self.scans.append(message)
        self.published_ns.append(time.monotonic_ns())

    def lost(self, error: DeviceError) -> None:
        self.losses.append((time.monotonic_ns(), error))

    def fault(self, name: str, detail: str = "") -> None:
        self.faults[name] += 1


class MonotonicClock:
    def now_ns(self) -> int:
        return time.monotonic_ns()


def device(link: Link, clock: object = None, mount: Mount | None = None, **config: object) -> Ld19:
    config.setdefault("port", "/dev/none")
    robot = Robot(mounts=MappingProxyType({"lidar": mount or Mount()}))
    context = DeviceContext("lidar", clock or MonotonicClock(), robot, link)  # type: ignore[arg-type]
    return Ld19(Ld19Config.model_validate(config), context)


# ------------------------------------------------------------------------------- on a clock set by hand


def replayed(lidar: Ld19, clock: ManualClock, fake: Ld19Fake, until_ns: int, step_ns: int = 1_000_000) -> None:
    """Feed what a fake sends by `until_ns`, as if read every millisecond."""
    while clock.now_ns() < until_ns:
        clock.set_ns(clock.now_ns() + step_ns)
        data = fake.tick(clock.now_ns())
        if data:
            lidar.feed(data)


def test_publishes_one_scan_a_turn_in_the_call_that_brought_its_last_byte() -> None:
    link, clock = Link(), ManualClock()
    lidar = device(link, clock, Mount(x_m=0.05, yaw_rad=0.1))
    replayed(lidar, clock, Ld19Fake(first_deg=180.0), 1_000_000_000)
    assert len(link.scans) == 8
    assert link.faults == {}
    assert {(s.x_m, s.yaw_rad, s.range_min_m, s.range_max_m) for s in link.scans} == {(0.05, 0.1, 0.02, 12.0)}
    stamps = [s.stamp_ns for s in link.scans]
    assert stamps == sorted(set(stamps))
    assert stamps[-1] <= clock.now_ns()


def test_bad_line_is_counted_and_survived() -> None:
    link, clock = Link(), ManualClock()
    lidar = device(link, clock)
    faulty = Faulty(Ld19Fake(first_deg=180.0), seed=5, every_bytes=47 * 100)
    replayed(lidar, clock, faulty, 4_000_000_000)  # type: ignore[arg-type]
    assert faulty.injected >= 8
    assert len(link.scans) >= 36
    assert link.faults["lost packets"] >= 4
    assert link.faults["bad checksum"] >= 2
    for scan in link.scans:
        seen = np.isfinite(scan.ranges_m)
        assert seen.sum() >= 400
        assert np.abs(scan.ranges_m[seen] - BoxRoom()(scan.angles_rad[seen].astype(np.float64))).max() <= 0.0006


def test_rolled_over_mount_means_upside_down() -> None:
    room = BoxRoom(left_m=1.5, right_m=0.8)
    for mount, inverted, sign in [
        (Mount(), False, 1.0),
        (Mount(roll_rad=math.pi), False, -1.0),
        (Mount(), True, -1.0),
        (Mount(roll_rad=math.pi), True, 1.0),
    ]:
        link, clock = Link(), ManualClock()
        replayed(device(link, clock, mount, inverted=inverted), clock, Ld19Fake(room), 300_000_000)
        scan = link.scans[0]
        assert np.abs(scan.ranges_m - room(sign * scan.angles_rad.astype(np.float64))).max() <= 0.0006


def test_after_a_stall_old_turns_are_dropped_and_the_newest_is_published() -> None:
    link, clock = Link(), ManualClock()
    lidar = device(link, clock)
    fake = Ld19Fake(first_deg=180.0)
    replayed(lidar, clock, fake, 450_000_000)
    before = len(link.scans)
    replayed(lidar, clock, fake, 950_000_000, step_ns=500_000_000)
    assert len(link.scans) == before + 1
    assert link.faults["old scan dropped"] == 4
    assert clock.now_ns() - link.scans[-1].stamp_ns <= 100_000_000
    # points 0..450 * 9 of 4500 a second; the first byte of a packet is fed when it leaves, so up to 2 ms early
    assert link.scans[-1].stamp_ns == pytest.approx(900_000_000, abs=2_500_000)


@pytest.mark.parametrize(
    ("world", "config", "fault"),
    [
        (lambda b: np.full_like(b, math.inf), {}, "no return anywhere"),
        (BoxRoom(), {"rotation_hz": 5.0}, "rotation off"),
    ],
)
def test_faults_of_whole_scans(world: Callable[..., object], config: dict[str, object], fault: str) -> None:
    link, clock = Link(), ManualClock()
    replayed(device(link, clock, **config), clock, Ld19Fake(world), 500_000_000)  # type: ignore[arg-type]
    assert link.faults == {fault: len(link.scans)}
    assert len(link.scans) >= 3


def test_two_lidars_in_one_process() -> None:
    rooms = BoxRoom(front_m=1.0), BoxRoom(front_m=4.0)
    links = Link(), Link()
    lidars = [device(link, ManualClock()) for link in links]
    fakes = [Ld19Fake(room, first_deg=first) for room, first in zip(rooms, (0.0, 123.0), strict=True)]
    for _ in range(100):
        data = [encode(fake.next_packet()) for fake in fakes]
        for cut in (slice(0, 20), slice(20, 47)):
            for lidar, raw in zip(lidars, data, strict=True):
                lidar.feed(raw[cut])
    for link, room in zip(links, rooms, strict=True):
        assert link.faults == {}
        assert len(link.scans) >= 1
        for scan in link.scans:
            assert np.abs(scan.ranges_m - room(scan.angles_rad.astype(np.float64))).max() <= 0.0006


@pytest.mark.parametrize(
    ("config", "words"),
    [
        ({"port": ""}, "port"),
        ({"port": "a", "bauds": 1}, "bauds"),
        ({"port": "a", "backend": "fast"}, "backend"),
        ({"port": "a", "range_min_m": 1.0, "range_max_m": 0.5}, "must be below range_max_m"),
        ({"port": "a", "seam_deg": 360.0}, "seam_deg"),
    ],
)
def test_config_refuses(config: dict[str, object], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        Ld19Config.model_validate(config)


def test_declares_itself() -> None:
    assert Ld19.emits == (LidarScan,)
    assert Ld19.config_type is Ld19Config
    assert Ld19.sim_twin == "sim_lidar"
    assert Ld19.publish_period_s(Ld19Config(port="a", rotation_hz=8.0)) == 0.125


# ---------------------------------------------------------------------------------- on a pty, in real time


@pytest.mark.parametrize("backend", ["pyserial", "raw"])
async def test_unplugged_and_plugged_in_again(tmp_path: Path, backend: str) -> None:
    room = BoxRoom()
    link = Link()
    port = tmp_path / "lidar"
    with PtyHost(Ld19Fake(room, first_deg=90.0), port, baud=BAUD) as host:
        lidar = device(link, port=str(port), backend=backend)
        Ld19.load(lidar.config)
        await lidar.open()
        await until(lambda: len(link.scans) >= 5)
        assert host.overrun == 0
        assert link.faults == {}
        seconds = (link.scans[-1].stamp_ns - link.scans[0].stamp_ns) / 1e9
        assert (len(link.scans) - 1) / seconds == pytest.approx(10.0, rel=0.05)
        for scan, published_ns in zip(link.scans, link.published_ns, strict=True):
            assert len(scan.ranges_m) == 450
            assert np.abs(scan.ranges_m - room(scan.angles_rad.astype(np.float64))).max() <= 0.0006
            assert scan.start_ns < scan.stamp_ns < published_ns
            # a packet is 2.7 ms of points and 2.0 ms on the wire; the rest is this machine's scheduling
            assert published_ns - scan.stamp_ns < 60_000_000

        unplugged_ns = time.monotonic_ns()
        host.unplug()
        await until(lambda: bool(link.losses))
        (lost_ns, error), *more = link.losses
        assert lost_ns - unplugged_ns < 50_000_000
        assert more == []
        assert isinstance(error, DeviceLost)
        assert str(error).startswith("lidar: ")
        assert "went away" in str(error)
        await lidar.close()
        with pytest.raises(DeviceUnavailable, match="no serial port"):
            await lidar.open()
        await lidar.close()

        before = len(link.scans)
        host.plug()
        await lidar.open()
        await until(lambda: len(link.scans) >= before + 2)
        assert link.scans[before].start_ns > lost_ns
        await lidar.close()
        await asyncio.sleep(0)
    assert len(link.losses) == 1


async def test_stamps_are_when_it_was_measured(tmp_path: Path) -> None:
    link = Link()
    fake = Ld19Fake(first_deg=180.0)
    with PtyHost(fake, tmp_path / "lidar", baud=BAUD, chunk=62):
        lidar = device(link, port=str(tmp_path / "lidar"), backend="raw")
        await lidar.open()
        await until(lambda: len(link.scans) >= 6)
        await lidar.close()
    powered_ns = fake.ready_ns(-1)
    errors = []
    for scan in link.scans:
        turn = round((scan.start_ns - powered_ns) / 1e8)
        errors.append(scan.start_ns - powered_ns - (450 * turn + 1) / 4500 * 1e9)
    assert abs(float(np.median(errors))) < 2_000_000


@pytest.mark.parametrize(
    ("sends", "words"),
    [
        (lambda rng: b"", "no byte came: is the lidar powered"),
        (lambda rng: rng.randbytes(20), "no packet of this family: is `baud: 230400` right"),
        (
            lambda rng: encode(Ld19Fake().next_packet()._replace(span_cdeg=0, speed_dps=0)),
            "it sends but does not turn",
        ),
    ],
    ids=["nothing", "noise", "blocked"],
)
async def test_silence_is_a_loss_that_says_why(
    tmp_path: Path, sends: Callable[[random.Random], bytes], words: str
) -> None:
    class Noisy:
        def __init__(self) -> None:
            self.rng = random.Random(1)
            self.next_ns = 0

        def power_on(self, now_ns: int) -> None:
            self.next_ns = now_ns

        def feed(self, data: bytes, now_ns: int) -> None:
            pass

        def tick(self, now_ns: int) -> bytes:
            if now_ns < self.next_ns:
                return b""
            self.next_ns += 5_000_000
            return sends(self.rng)

    link = Link()
    with PtyHost(Noisy(), tmp_path / "lidar", baud=BAUD):
        lidar = device(link, port=str(tmp_path / "lidar"), backend="raw", silent_s=0.5)
        await lidar.open()
        await until(lambda: bool(link.losses))
        await lidar.close()
    assert words in str(link.losses[0][1])
    assert link.scans == []


async def test_close_before_open_and_twice() -> None:
    lidar = device(Link())
    await lidar.close()
    with pytest.raises(DeviceUnavailable):
        await lidar.open()
    await lidar.close()
    await lidar.close()
