"""The revolution: split at the seam, true bearings and times, and lost, empty and near kept apart."""

from __future__ import annotations

import itertools
import math
import random

import numpy as np
import pytest

from robotd.world.messages import Float64s, LidarScan
from robotd.world.robot import Mount
from robotd_devices.lidar.ld19_fake import BoxRoom, Ld19Fake
from robotd_devices.lidar.ld_packets import LdPacket, LdParser, encode
from robotd_devices.lidar.ld_sweep import LdSweep

BYTE_NS = 43_403
WIRE_NS = 47 * BYTE_NS


def packets(fake: Ld19Fake, count: int) -> list[LdPacket]:
    """Packets as a parser gives them, each arriving when its last byte has crossed the wire."""
    return [
        fake.next_packet()._replace(arrival_ns=fake.ready_ns(index) + WIRE_NS, chained=index > 0)
        for index in range(count)
    ]


def scans(sweep: LdSweep, given: list[LdPacket]) -> list[LidarScan]:
    return [scan for packet in given if (scan := sweep.add(packet)) is not None]


def bearing_error(scan: LidarScan, room: BoxRoom, sign: float = 1.0) -> Float64s:
    """Difference in metres between a scan and its room, for the beams that returned."""
    hit = np.isfinite(scan.ranges_m)
    return np.abs(scan.ranges_m[hit] - room(sign * scan.angles_rad[hit].astype(np.float64)))


def test_a_room_to_the_last_digit() -> None:
    room = BoxRoom(front_m=2.0, back_m=1.0, left_m=1.5, right_m=0.8)
    got = scans(LdSweep(), packets(Ld19Fake(room, first_deg=33.3), 160))
    assert len(got) == 3
    for scan in got:
        assert scan.ranges_m.shape == (450,)
        # rounded to a millimetre at angles rounded to 0.01 degrees
        assert bearing_error(scan, room).max() <= 0.0006
        # REP-103: what the fake has on its left is at +90 degrees
        left = int(np.argmin(np.abs(scan.angles_rad - math.pi / 2)))
        assert scan.ranges_m[left] == pytest.approx(1.5, abs=0.001)
        assert scan.intensities is not None
        assert set(scan.intensities.tolist()) == {200}
        assert not scan.ranges_m.flags.writeable


def test_a_scan_is_one_turn_from_behind_to_behind() -> None:
    (scan,) = scans(LdSweep(), packets(Ld19Fake(first_deg=150.0), 45))
    assert np.all(np.diff(scan.angles_rad) < 0.0)
    assert scan.angles_rad[0] == pytest.approx(math.pi, abs=math.radians(0.8))
    assert scan.angles_rad[-1] == pytest.approx(-math.pi, abs=math.radians(0.8) + 1e-6)
    assert np.ptp(scan.angles_rad) <= math.tau


@pytest.mark.parametrize("seam_deg", [0.0, 90.0, 359.99])
def test_other_seams(seam_deg: float) -> None:
    got = scans(LdSweep(seam_deg=seam_deg), packets(Ld19Fake(), 120))
    assert len(got) == 2
    for scan in got:
        assert len(scan.ranges_m) == 450
        assert bearing_error(scan, BoxRoom()).max() <= 0.0006
        first = math.remainder(scan.angles_rad[0] + math.radians(seam_deg), math.tau)
        assert abs(first) <= math.radians(0.81)


def test_upside_down_turns_the_other_way() -> None:
    room = BoxRoom(left_m=1.5, right_m=0.8)
    (scan,) = scans(LdSweep(inverted=True), packets(Ld19Fake(room, first_deg=170.0), 44))
    assert bearing_error(scan, room, sign=-1.0).max() <= 0.0006
    assert np.all(np.diff(scan.angles_rad) > 0.0)


@pytest.mark.parametrize("rotation_hz", [5.0, 8.73, 10.0, 13.0])
@pytest.mark.parametrize("rate_hz", [2300.0, 4500.0, 21600.0])
def test_speed_and_rate_change_the_number_of_beams_only(rotation_hz: float, rate_hz: float) -> None:
    beams = rate_hz / rotation_hz
    count = round(beams / 12 * 3.5)
    got = scans(LdSweep(), packets(Ld19Fake(rotation_hz=rotation_hz, rate_hz=rate_hz), count))
    assert 2 <= len(got) <= 3
    for scan in got:
        assert len(scan.ranges_m) == pytest.approx(beams, abs=2)
        assert bearing_error(scan, BoxRoom()).max() <= 0.0006
        assert scan.stamp_ns - scan.start_ns == pytest.approx(1e9 / rotation_hz, rel=0.01)


def test_times_are_those_of_the_points_however_late_the_bytes_come() -> None:
    rng = random.Random(3)
    fake = Ld19Fake(first_deg=180.0)
    given = [p._replace(arrival_ns=p.arrival_ns + rng.randrange(0, 4_000_000)) for p in packets(fake, 200)]
    got = scans(LdSweep(), given)
    assert len(got) == 4  # the power-on revolution began before anybody looked, so it is not published
    for turn, scan in enumerate(got, 1):
        # beam 0 of this turn is point 450 * turn since power-on, 1/4500 s apart, the first after one such step
        first_ns = (450 * turn + 1) / 4500 * 1e9
        assert scan.start_ns == pytest.approx(first_ns, abs=250_000)
        assert scan.stamp_ns == pytest.approx(first_ns + 449 / 4500 * 1e9, abs=350_000)
    assert all(b.start_ns > a.stamp_ns for a, b in itertools.pairwise(got))


def test_after_bytes_that_came_late_one_by_one_scans_are_dated_as_before() -> None:
    """Two turns arrive in one moment, but not in one read: the next scans are not pushed into the future by them."""
    given = packets(Ld19Fake(), 300)
    stalled_ns = given[110].arrival_ns
    given = [p._replace(arrival_ns=max(p.arrival_ns, stalled_ns)) if i >= 30 else p for i, p in enumerate(given)]
    on_time = [scan.stamp_ns for scan in scans(LdSweep(), packets(Ld19Fake(), 300))]
    assert [scan.stamp_ns for scan in scans(LdSweep(), given)][-4:] == pytest.approx(on_time[-4:], abs=1000)


def test_lost_packets_are_beams_not_measured() -> None:
    given = packets(Ld19Fake(first_deg=170.0), 60)
    whole = scans(LdSweep(), given)[0]
    sweep = LdSweep()
    (scan, *_) = scans(sweep, given[:10] + given[12:20] + given[21:])
    lost = np.isnan(scan.ranges_m)
    assert lost.sum() == 36
    assert len(scan.ranges_m) == len(whole.ranges_m)
    np.testing.assert_allclose(scan.angles_rad, whole.angles_rad, atol=2e-4)
    np.testing.assert_array_equal(scan.ranges_m[~lost], whole.ranges_m[~lost])
    assert (scan.start_ns, scan.stamp_ns) == pytest.approx((whole.start_ns, whole.stamp_ns), abs=100_000)
    assert sweep.lost_share == pytest.approx(36 / 450)


@pytest.mark.parametrize("first_lost", range(34, 40))
@pytest.mark.parametrize("lost", [1, 2, 5, 15])
def test_packets_lost_around_the_seam(first_lost: int, lost: int) -> None:
    """Whatever is missing where a revolution ends, the next scans have one turn each and no wrong range."""
    given = packets(Ld19Fake(first_deg=180.0), 37 * 4 + 10)
    got = scans(LdSweep(), given[:first_lost] + given[first_lost + lost :])
    assert len(got) == 3
    for scan in got:
        assert len(scan.ranges_m) == pytest.approx(450, abs=1)
        assert np.all(np.diff(scan.angles_rad) < 0.0)
        assert bearing_error(scan, BoxRoom()).max() <= 0.0006
    assert sum(int(np.isnan(scan.ranges_m).sum()) for scan in got) <= 12 * lost


def test_after_a_jump_the_open_turn_is_dropped() -> None:
    given = packets(Ld19Fake(first_deg=180.0), 200)
    given[100] = given[100]._replace(chained=False)
    got = scans(LdSweep(), given)
    # five whole turns of 0.1 s: the beginning of the first was not seen, the third was cut
    assert [round(scan.stamp_ns / 1e8) for scan in got] == [2, 4, 5]
    assert not any(np.isnan(scan.ranges_m).any() for scan in got)


def test_no_return_far_and_touching() -> None:
    def world(bearing_rad: Float64s) -> Float64s:
        degrees = np.degrees(bearing_rad) % 360.0
        return np.select(
            [degrees < 90.0, degrees < 180.0, degrees < 270.0], [math.inf, 20.0, 0.011], default=3.0
        ).astype(np.float64)

    (scan,) = scans(LdSweep(range_max_m=12.0), packets(Ld19Fake(world, range_max_m=25.0, first_deg=179.0), 42))
    degrees = np.degrees(scan.angles_rad.astype(np.float64)) % 360.0
    inside = np.abs(degrees % 90.0 - 45.0) < 44.0
    expected = np.select([degrees < 90.0, degrees < 180.0, degrees < 270.0], [math.inf, math.inf, 0.011], default=3.0)
    np.testing.assert_allclose(scan.ranges_m[inside], expected[inside], rtol=1e-6)
    assert scan.range_min_m == 0.02


@pytest.mark.parametrize(("trust_empty", "value"), [(False, math.nan), (True, math.inf)])
def test_a_turn_without_any_return_is_not_free_space(trust_empty: bool, value: float) -> None:
    sweep = LdSweep(trust_empty=trust_empty)
    fake = Ld19Fake(lambda bearing_rad: np.full_like(bearing_rad, math.inf))
    (scan, *_) = scans(sweep, packets(fake, 80))
    np.testing.assert_array_equal(scan.ranges_m, np.full(len(scan.ranges_m), value, dtype=np.float32))
    assert sweep.empty_share == 1.0


def test_mount_is_carried() -> None:
    (scan, *_) = scans(LdSweep(mount=Mount(x_m=0.1, y_m=-0.02, yaw_rad=math.pi)), packets(Ld19Fake(), 80))
    assert (scan.x_m, scan.y_m, scan.yaw_rad) == (0.1, -0.02, math.pi)


def test_parser_and_sweep_agree_on_a_backlog() -> None:
    """Half a second read at once, as after a stall of the loop: the stamps are those of the measurements."""
    fake = Ld19Fake(first_deg=180.0)
    count = 188
    data = b"".join(encode(fake.next_packet()) for _ in range(count))
    now_ns = fake.ready_ns(count - 1) + WIRE_NS
    got = scans(LdSweep(), LdParser(BYTE_NS).feed(data, now_ns))
    for turn, scan in enumerate(got, 1):
        assert scan.stamp_ns == pytest.approx((450 * (turn + 1)) / 4500 * 1e9, abs=1_000_000)
