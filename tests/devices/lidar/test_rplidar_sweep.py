"""RPLIDAR scans from bytes: every model and mode shows the fake's room, with true times, and gaps are kept apart."""

from __future__ import annotations

import itertools
import math
import random

import numpy as np
import pytest

from robotd.world.messages import Float64s, LidarScan
from robotd.world.robot import Mount
from robotd_devices.lidar.answers import AnswerReader
from robotd_devices.lidar.beam_sweep import Beams, BeamSweep
from robotd_devices.lidar.ld19_fake import BoxRoom, RangeOf
from robotd_devices.lidar.rplidar_capsules import FORMATS
from robotd_devices.lidar.rplidar_fake import MODELS, RplidarFake
from robotd_devices.lidar.rplidar_reader import RplidarReader
from robotd_devices.lidar.rplidar_wire import SCAN, express_scan, motor_pwm, motor_rpm, request
from robotd_devices.ports.fakes import DAMAGES, damage

CASES = [(name, mode.number or 0) for name, model in MODELS.items() for mode in model.modes]
PACKETS = {form.kind: (form.size, form.samples) for form in FORMATS.values()} | {0x81: (5, 1), 0x83: (781, 96)}
"""Type of data to bytes and samples of a packet."""
IDS = [f"{name} {MODELS[name].modes[mode].name}" for name, mode in CASES]


def recorded(fake: RplidarFake, mode: int, seconds: float) -> tuple[int, bytes]:
    """Type and bytes of a scan, as a whole."""
    fake.feed(motor_pwm(660) + motor_rpm(600), 0)
    fake.feed(express_scan(mode) if mode else request(SCAN), 0)
    head = AnswerReader(None)
    head.feed(fake.tick(round(seconds * 1e9)))
    assert head.descriptor is not None
    return head.descriptor.kind, head.rest


def reader(fake: RplidarFake, answer: int, **options: object) -> RplidarReader:
    given: dict[str, object] = {"range_min_m": 0.1, "range_max_m": 12.0} | options
    sweep = BeamSweep(beam_ns=fake.sample_ns, **given)  # type: ignore[arg-type]
    return RplidarReader(answer, sweep, 1e10 / fake.model.baud, fake.rotation_hz)


def error_m(scan: LidarScan, room: RangeOf, sign: float = 1.0) -> Float64s:
    hit = np.isfinite(scan.ranges_m)
    return np.abs(scan.ranges_m[hit] - room(sign * scan.angles_rad[hit].astype(np.float64)))


@pytest.mark.parametrize(("model", "mode"), CASES, ids=IDS)
def test_a_room_in_every_model_and_mode(model: str, mode: int) -> None:
    room = BoxRoom()
    fake = RplidarFake(model, room, first_deg=33.3)
    answer, data = recorded(fake, mode, 0.5)
    source = reader(fake, answer)
    scans = list(source.feed(data, 500_000_000))
    assert len(scans) == 4 - (model == "none")
    assert source.take_faults() == []
    per_turn = 1e6 / MODELS[model].modes[mode].sample_us / 10.0
    for scan in scans:
        assert len(scan.ranges_m) == pytest.approx(per_turn, abs=2)
        assert scan.stamp_ns - scan.start_ns == pytest.approx(1e8, rel=0.02)
        off = error_m(scan, room)
        assert len(off) == len(scan.ranges_m)
        # ultra codes differences of up to 4 mm, and angle depends on distance: a corner may be off
        assert np.quantile(off, 0.995) <= {0x84: 0.008, 0x86: 0.003}.get(answer, 0.0006)
        left = int(np.argmin(np.abs(scan.angles_rad - math.pi / 2)))
        assert scan.ranges_m[left] == pytest.approx(1.5, abs=0.004)
        assert (scan.intensities is not None) == (answer in (0x81, 0x83, 0x86))


@pytest.mark.parametrize("seam_deg", [0.0, 90.0, 180.0, 359.9])
@pytest.mark.parametrize(("model", "mode"), [("a1", 0), ("a1", 1), ("s2", 1)])
def test_other_seams_and_upside_down(model: str, mode: int, seam_deg: float) -> None:
    room = BoxRoom()
    fake = RplidarFake(model, room)
    answer, data = recorded(fake, mode, 0.45)
    scans = list(reader(fake, answer, seam_deg=seam_deg, inverted=True).feed(data, 450_000_000))
    assert len(scans) >= 3
    for scan in scans:
        assert error_m(scan, room, sign=-1.0).max() <= 0.0006
        first = math.degrees(math.remainder(scan.angles_rad[0] - math.radians(seam_deg), math.tau))
        assert abs(first) <= 9.0  # beams lag by up to 8 degrees behind the head
        assert np.ptp(np.unwrap(scan.angles_rad.astype(np.float64))) >= math.radians(350.0)


@pytest.mark.parametrize(("model", "mode"), [("a1", 1), ("a1", 2), ("s2", 1), ("s2-hq", 1), ("c1", 0)])
@pytest.mark.parametrize("chunk", [1, 62, 4095])
def test_stamps_are_when_it_was_measured(model: str, mode: int, chunk: int) -> None:
    """Bytes that come as they leave the wire, in chunks of a USB bridge: each beam is dated within a millisecond."""
    fake = RplidarFake(model, first_deg=180.0)
    answer, data = recorded(fake, mode, 0.45)
    source, sent = reader(fake, answer, seam_deg=0.0), len(data)
    byte_ns = 1e10 / fake.model.baud
    size, per = PACKETS[answer]
    scans = []
    for at in range(0, sent, chunk):
        end = min(at + chunk, sent)
        packet, within = divmod(end - 1, size)
        now_ns = ((packet + 1) * per + 0.5) * fake.sample_ns + (within + 1) * byte_ns
        scans += list(source.feed(data[at:end], fake.scan_ns + round(now_ns)))
    assert len(scans) >= 3
    for turn, scan in enumerate(scans):
        # from 180 the head needs half a turn to its first seam, and a turn to each other
        head_at_seam_ns = 5e7 + turn * 1e8
        # an A1's nodes say only where the beam went, which lags behind the head
        assert scan.start_ns == pytest.approx(head_at_seam_ns, abs=1.1 * fake.sample_ns + 100_000)
    assert all(b.start_ns > a.stamp_ns for a, b in itertools.pairwise(scans))


def test_a_backlog_is_dated_back() -> None:
    fake = RplidarFake("c1", first_deg=180.0)
    answer, data = recorded(fake, 0, 0.6)
    scans = list(reader(fake, answer, seam_deg=0.0).feed(data, 600_000_000))
    assert [round(scan.start_ns / 1e6) for scan in scans] == pytest.approx([50, 150, 250, 350, 450], abs=1)


@pytest.mark.parametrize(("model", "mode", "lost"), [("a1", 1, 32), ("s2", 1, 40), ("s3", 2, 64)])
@pytest.mark.parametrize("first", range(0, 24, 5))
@pytest.mark.parametrize("count", [1, 2, 4])
def test_lost_capsules_are_beams_not_measured(model: str, mode: int, lost: int, first: int, count: int) -> None:
    room = BoxRoom()
    fake = RplidarFake(model, room, first_deg=190.0)
    answer, data = recorded(fake, mode, 0.55)
    size = FORMATS[answer].size
    first = (first * len(data) // size // 45 + len(data) // size // 5) * size
    bad = data[:first] + b"\xff" * (count * size) + data[first + count * size :]
    scans = list(reader(fake, answer).feed(bad, 550_000_000))
    whole = list(reader(fake, answer).feed(data, 550_000_000))
    assert len(scans) == len(whole) >= 4
    for scan, sound in zip(scans, whole, strict=True):
        assert len(scan.ranges_m) == pytest.approx(len(sound.ranges_m), abs=1)
        assert error_m(scan, room).max() <= 0.003
    missing = sum(int(np.isnan(scan.ranges_m).sum()) for scan in scans)
    # the capsule before a broken header may go with it, and a beam of the rounding
    assert count * lost - 1 <= missing <= (count + 1) * lost + 1


@pytest.mark.parametrize(("model", "mode"), [("a1", 1), ("a1", 2), ("s2", 1), ("s2-hq", 1), ("s3", 2)])
@pytest.mark.parametrize("seed", range(3))
def test_a_bad_line_never_shows_a_wrong_wall(model: str, mode: int, seed: int) -> None:
    """A fault a turn, of every kind, whole capsules twice among them: what is there is right, the rest not measured."""
    room = BoxRoom()
    fake = RplidarFake(model, room, first_deg=190.0)
    answer, data = recorded(fake, mode, 3.0)
    rng = random.Random(f"{model} {mode} {seed}")
    (size, samples), turn = PACKETS[answer], round(len(data) / 30)
    source, scans = reader(fake, answer), []
    for index, at in enumerate(range(0, len(data) - turn, turn)):
        group = data[at : at + turn]
        if rng.random() < 0.3:
            cut = rng.randrange(0, len(group) - 2 * size)
            bad = group[: cut + size] + group[cut:]
        else:
            bad = damage(group, rng.choice(DAMAGES), rng)
        scans += list(source.feed(bad, (index + 1) * 100_000_000))
    assert 27 <= len(scans) <= 29
    per_turn = 1e8 / fake.sample_ns
    for scan in scans:
        assert len(scan.ranges_m) == pytest.approx(per_turn, abs=0.01 * per_turn + 3)
        assert np.quantile(error_m(scan, room), 0.99) <= (0.012 if answer == 0x84 else 0.003)
        assert error_m(scan, room).max() <= (0.2 if answer == 0x84 else 0.003)  # the fake's ultra corners are rough
        assert np.isfinite(scan.ranges_m).mean() >= 1.0 - 4.5 * samples / per_turn
    assert sum(int(np.isnan(scan.ranges_m).sum()) for scan in scans) <= 60 * samples


def test_lost_nodes_are_beams_not_measured() -> None:
    room = BoxRoom()
    fake = RplidarFake("c1", room, first_deg=190.0)
    answer, data = recorded(fake, 0, 0.4)
    at = 5 * 700
    scans = list(reader(fake, answer).feed(data[:at] + data[at + 5 * 20 + 2 :], 400_000_000))
    assert [len(scan.ranges_m) for scan in scans] == pytest.approx([500, 500, 500], abs=2)
    lost = np.isnan(scans[0].ranges_m)
    assert 20 <= lost.sum() <= 24
    assert all(error_m(scan, room).max() <= 0.0006 for scan in scans)


@pytest.mark.parametrize("model", ["a1", "c1"])
def test_bad_nodes_do_not_change_the_number_of_beams(model: str) -> None:
    """One in forty is senseless; an A1's angles leap forward and back, and no leap back is a gap of a turn."""
    room = BoxRoom(front_m=6.0)
    fake = RplidarFake(model, room)
    answer, data = recorded(fake, 0, 1.0)
    spoiled = bytearray(data)
    spoiled[20 * 5 :: 40 * 5] = b"\x03" * len(spoiled[20 * 5 :: 40 * 5])
    source = reader(fake, answer)
    scans = list(source.feed(bytes(spoiled), 1_000_000_000))
    assert len(scans) == 9
    for scan in scans:
        assert len(scan.ranges_m) == pytest.approx(1e8 / fake.sample_ns, abs=6)
        assert np.isnan(scan.ranges_m).mean() <= 0.06
        assert error_m(scan, room).max() <= 0.0006
    assert set(source.take_faults()) == {"senseless node"}


@pytest.mark.parametrize(("model", "mode"), [("a1", 1), ("s2", 1)])
def test_a_restarted_device_drops_the_open_turn(model: str, mode: int) -> None:
    fake = RplidarFake(model, first_deg=190.0)
    answer, data = recorded(fake, mode, 0.25)
    second = RplidarFake(model, first_deg=100.0)
    _, more = recorded(second, mode, 0.25)
    size = FORMATS[answer].size
    source = reader(fake, answer)
    scans = list(source.feed(data[: len(data) // size * size], 250_000_000))
    scans += list(source.feed(more, 500_000_000))
    for scan in scans:
        assert np.ptp(np.unwrap(scan.angles_rad.astype(np.float64))) <= math.tau + 0.01
        assert len(scan.ranges_m) == pytest.approx(1e8 / fake.sample_ns, abs=2)


def test_no_return_far_and_touching() -> None:
    def world(bearing_rad: Float64s) -> Float64s:
        degrees = np.degrees(bearing_rad) % 360.0
        return np.select([degrees < 90.0, degrees < 180.0, degrees < 270.0], [math.inf, 20.0, 0.05], 3.0)

    fake = RplidarFake("c1", world, range_max_m=25.0)
    answer, data = recorded(fake, 0, 0.4)
    scan = next(iter(reader(fake, answer).feed(data, 400_000_000)))
    degrees = np.degrees(scan.angles_rad.astype(np.float64)) % 360.0
    inside = np.abs(degrees % 90.0 - 45.0) < 44.0
    # a node holds no more than 16.4 m
    expected = np.select([degrees < 90.0, degrees < 180.0, degrees < 270.0], [math.inf, 3.616, 0.05], 3.0)
    np.testing.assert_allclose(scan.ranges_m[inside], expected[inside], rtol=1e-3)


@pytest.mark.parametrize(("trust_empty", "value"), [(False, math.nan), (True, math.inf)])
def test_a_turn_without_any_return_is_not_free_space(trust_empty: bool, value: float) -> None:
    fake = RplidarFake("s2", lambda bearing_rad: np.full_like(bearing_rad, math.inf))
    answer, data = recorded(fake, 1, 0.3)
    source = reader(fake, answer, trust_empty=trust_empty)
    scan = next(iter(source.feed(data, 300_000_000)))
    np.testing.assert_array_equal(scan.ranges_m, np.full(len(scan.ranges_m), value, dtype=np.float32))
    assert source.sweep.empty_share == 1.0


def test_mount_is_carried() -> None:
    fake = RplidarFake("c1")
    answer, data = recorded(fake, 0, 0.3)
    scan = next(iter(reader(fake, answer, mount=Mount(x_m=0.1, y_m=-0.02, yaw_rad=math.pi)).feed(data, 300_000_000)))
    assert (scan.x_m, scan.y_m, scan.yaw_rad) == (0.1, -0.02, math.pi)


# ------------------------------------------------------------------------------------------- the sweep alone


def beams(first_deg: float, count: int, step_deg: float = 1.0) -> Beams:
    head = (first_deg + step_deg * np.arange(count)) % 360.0
    return Beams(head, head, np.ones(count, dtype=np.float32))


def new_sweep() -> BeamSweep:
    return BeamSweep(beam_ns=1e5, range_min_m=0.1, range_max_m=10.0)


def test_a_turn_that_ends_with_its_beams_is_not_kept_back() -> None:
    sweep = new_sweep()
    assert sweep.add(beams(170.0, 10), [(9, 1_000_000)], 180.0) is None
    assert sweep.add(beams(180.0, 300), [(299, 31_000_000)], 120.0) is None
    scan = sweep.add(beams(120.0, 60), [(59, 37_000_000)], 180.0)
    assert scan is not None
    assert len(scan.ranges_m) == 360
    assert (scan.start_ns, scan.stamp_ns) == pytest.approx((1_100_000, 37_000_000), abs=100)


def test_a_guess_just_over_the_seam_makes_no_second_turn() -> None:
    sweep = new_sweep()
    sweep.add(beams(170.0, 100), [(99, 10_000_000)], 270.0)
    sweep.gap(170.0, 1.0)
    assert sweep.add(beams(170.0, 11), [(10, 37_000_000)], 181.0) is not None
    assert sweep.add(beams(179.0, 3), [], 182.0) is None  # behind the guess, on the other side of the seam
    assert sweep.add(beams(182.0, 350), [(349, 73_000_000)], 172.0) is None
    scan = sweep.add(beams(172.0, 10), [], 182.0)
    assert scan is not None
    assert len(scan.ranges_m) == 362


def test_more_than_a_turn_at_once_is_dropped() -> None:
    sweep = new_sweep()
    sweep.add(beams(170.0, 20), [(0, 0)], 190.0)
    assert sweep.add(beams(190.0, 720), [(0, 1)], 190.0) is None
    assert sweep.add(beams(190.0, 360), [(0, 2)], 190.0) is None
    assert sweep.add(beams(190.0, 360), [(0, 3)], 190.0) is not None
