"""Fakes of lidars prove themselves: clients that other people wrote read the fake's room, unmodified."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from robotd_devices.lidar.answers import AnswerReader
from robotd_devices.lidar.beam_sweep import BeamSweep
from robotd_devices.lidar.ld19_fake import BoxRoom, Ld19Fake
from robotd_devices.lidar.rplidar_fake import MODELS, RplidarFake
from robotd_devices.lidar.rplidar_reader import RplidarReader
from robotd_devices.lidar.ydlidar_fake import YdlidarFake
from robotd_devices.ports.pty_host import PtyHost

ROOM = BoxRoom()


class Recorded:
    """A fake whose sent bytes are kept."""

    def __init__(self, fake: Any) -> None:
        self.fake = fake
        self.sent = b""

    def power_on(self, now_ns: int) -> None:
        self.fake.power_on(now_ns)

    def feed(self, data: bytes, now_ns: int) -> None:
        self.fake.feed(data, now_ns)

    def tick(self, now_ns: int) -> bytes:
        data: bytes = self.fake.tick(now_ns)
        self.sent += data
        return data


def off_m(degrees: NDArray[np.float64], metres: NDArray[np.float64]) -> NDArray[np.float64]:
    """How far points (clockwise degrees, metres) lie from the room's walls; those without a return do not count."""
    seen = metres > 0.0
    assert seen.sum() > 0.9 * len(seen)
    return np.abs(metres[seen] - ROOM(-np.radians(degrees[seen])))


def our_beams(sent: bytes, model: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Angles (clockwise degrees in [0, 360), rising) and metres that our reader finds in what a fake sent."""
    head = AnswerReader(None)
    assert head.feed(sent)
    assert head.descriptor is not None
    known = MODELS[model]
    mode = next(mode for mode in known.modes if mode.answer == head.descriptor.kind)
    sweep = BeamSweep(beam_ns=mode.sample_us * 1e3, range_min_m=0.1, range_max_m=20.0, seam_deg=0.0)
    reader = RplidarReader(mode.answer, sweep, 1e10 / known.baud, 10.0)
    scans = list(reader.feed(head.rest, 10_000_000_000))
    degrees = np.degrees(-np.concatenate([scan.angles_rad for scan in scans]).astype(np.float64)) % 360.0
    metres = np.concatenate([scan.ranges_m for scan in scans]).astype(np.float64)
    order = np.argsort(degrees)
    return degrees[order], metres[order]


@pytest.mark.parametrize("model", ["a1", "a1-old", "s2", "s2-hq", "s3", "c1"])
def test_vendor_sdk_and_our_reader_agree(tmp_path: Path, run_client: Any, model: str) -> None:
    """pyrplidarsdk is the vendor's SDK: nodes, express, ultra, dense, ultra-dense within one least significant bit."""
    fake = Recorded(RplidarFake(model, ROOM))
    baud = fake.fake.model.baud
    with PtyHost(fake, tmp_path / "lidar", baud=baud) as host:
        told = run_client("sdk.py", host.link, baud, 6)
    assert told["model"] == fake.fake.model.info.model
    assert told["health"] == 0
    assert len(told["scans"]) == 6
    degrees, metres = our_beams(fake.sent, model)
    # 1/64 degree; a quarter of a mm, and the SDK's own smoothing of ultra-dense returns
    near_deg, near_m = 1.0 / 64.0 + 0.006, 0.0003 if model != "s3" else 0.0011
    # the first one may have begun before a seam; the last one ended with the bytes, before our reader saw the
    # header that proves its last packet
    for angles_rad, ranges_m in told["scans"][1:-1]:
        theirs_deg, theirs_m = np.degrees(np.array(angles_rad)), np.array(ranges_m)
        assert len(theirs_m) > 150
        low, high = np.searchsorted(degrees, theirs_deg - near_deg), np.searchsorted(degrees, theirs_deg + near_deg)
        inside = (theirs_deg > near_deg) & (theirs_deg < 360.0 - near_deg) & (theirs_m > 0.0)
        missed = [
            (theirs_deg[i], theirs_m[i])
            for i in np.flatnonzero(inside)
            if not np.any(np.abs(metres[low[i] : high[i]] - theirs_m[i]) <= near_m)
        ]
        assert missed == []


@pytest.mark.parametrize(
    ("model", "fake", "baud", "points", "within_m"),
    [
        ("RPLIDAR-A1", RplidarFake("a1", ROOM), 115_200, 1000, 0.0011),
        ("RPLIDAR-C1", RplidarFake("c1", ROOM), 460_800, 2500, 0.0011),
        ("LD19", Ld19Fake(ROOM), 230_400, 2200, 0.0006),
        ("YDLIDAR-X4", YdlidarFake("x4", ROOM), 128_000, 2500, 0.0015),
        ("YDLIDAR-X2", YdlidarFake("x2", ROOM), 115_200, 1500, 0.0015),
        ("YDLIDAR-SCL", YdlidarFake("scl", ROOM), 115_200, 1500, 0.0015),
        ("YDLIDAR-TMINI", YdlidarFake("tmini", ROOM), 230_400, 2000, 0.0015),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_lds2d(tmp_path: Path, run_client: Any, model: str, fake: Any, baud: int, points: int, within_m: float) -> None:
    with PtyHost(fake, tmp_path / "lidar", baud=baud) as host:
        got = np.array(run_client("points.py", model, host.link, points), dtype=np.float64)
    assert got.shape == (points, 2)
    assert np.quantile(off_m(got[:, 0], got[:, 1] / 1000.0), 0.995) <= within_m


def test_rplidar_of_pypi_with_its_motor_on_dtr(tmp_path: Path, run_client: Any) -> None:
    fake = RplidarFake("a1", ROOM)
    with PtyHost(fake, tmp_path / "lidar", baud=115_200) as host:
        told = run_client("rplidar_scans.py", host.link, 5, modem=True)
    assert (told["model"], told["health"]) == (0x18, "Good")
    got = np.array(told["points"])
    assert len(got) > 500
    assert off_m(got[:, 0], got[:, 1] / 1000.0).max() <= 0.0011
    lines = (tmp_path / "modem.log").read_text().split()
    # raised by opening (the motor stands), cleared to run, raised to stop
    changes = [line for line, before in zip(lines, ["", *lines], strict=False) if line != before]
    assert changes[-2:] == ["dtr=0", "dtr=1"]


@pytest.mark.parametrize(("mode", "points", "within_m"), [(0, 800, 0.0006), (1, 1500, 0.0015), (2, 3000, 0.012)])
def test_pyrplidar(tmp_path: Path, run_client: Any, mode: int, points: int, within_m: float) -> None:
    fake = RplidarFake("a1", ROOM)
    with PtyHost(fake, tmp_path / "lidar", baud=115_200) as host:
        told = run_client("pyrplidar_points.py", host.link, 115_200, mode, points, modem=True)
    got = np.array(told["points"])
    assert told["model"] == 0x18
    assert len(got) == points
    assert np.quantile(off_m(got[:, 0], got[:, 1] / 1000.0), 0.99) <= within_m
    assert math.isclose(np.ptp(got[:, 0]), 360.0, abs_tol=2.0)
