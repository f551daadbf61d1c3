"""`track_position`: where the car is, and within one scan that it is not to be believed."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from race_laps import CAR, Lap, Pose, S

from robotd.testing import check_perceptor
from robotd.world.geometry import compose, inverse
from robotd.world.messages import LidarScan, Odometry
from robotd_plugins.perception.track_position import Sees, TrackPosition, TrackPositionConfig
from robotd_plugins.toolkit.race_track import Located, RaceTrack

HERE: Pose = (0.0, 0.0, 0.0)
Scans = Callable[[float], LidarScan]


class Follower:
    """A car on its second lap with a track that came when the first was done."""

    def __init__(self, lap: Lap, track: RaceTrack | None, **config: Any) -> None:
        self.lap, self.track = lap, track
        self.perceptor = TrackPosition(TrackPositionConfig(**config), CAR)

    def drive(
        self,
        from_s: float,
        to_s: float,
        scan: Scans | None = None,
        odometry: Callable[[Odometry], Odometry] | None = None,
    ) -> list[Located]:
        """What it says to each scan; between slow ones it is told the odometry, as the runtime does at 50 Hz."""
        said, newest = [], None
        for at_s in self.lap.times(from_s, to_s):
            before = round(50.0 / self.lap.rate_hz) if newest is not None else 1
            for tick in range(1 - before, 1):
                now_s = at_s + tick / 50.0
                told = self.lap.odometry(now_s)
                newest = (scan or self.lap.scan)(at_s) if tick == 0 or newest is None else newest
                seen = Sees(
                    now_ns=round(now_s * S),
                    scan=newest,
                    odometry=odometry(told) if odometry is not None else told,
                    applied=None,
                    track=self.track,
                )
                located = self.perceptor.step(seen)
                if located is not None:
                    said.append(located)
        return said


def true_pose(lap: Lap, at_s: float) -> Pose:
    """In the frame `track`, which begins where the surveyed car's first scan ended: 0.2 m after the start line."""
    return compose(inverse(lap.pose(0.2 / lap.speed_mps)), lap.pose(at_s))


def error(lap: Lap, located: Located) -> Pose:
    """Of a place, in the car's frame; what the map is bent by over its length is in it."""
    return compose(inverse(true_pose(lap, located.stamp_ns / S)), (located.x_m, located.y_m, located.yaw_rad))


@pytest.fixture
def sure(lap: Lap, track: RaceTrack) -> Follower:
    """A second after the survey it knows where it is."""
    follower = Follower(lap, track)
    follower.drive(track.at_ns / S, track.at_ns / S + 2.0)
    return follower


def test_without_a_track_it_says_nothing(lap: Lap) -> None:
    assert Follower(lap, None).drive(0.0, 1.0) == []


@pytest.mark.parametrize(
    ("what", "change"),
    [
        ("as it was surveyed", {}),
        ("noise and dropout", {"noise_m": 0.05, "dropout": 0.1}),
        ("40 Hz and 6 m/s", {"rate_hz": 40.0, "speed_mps": 6.0}),
        ("a turning lidar of 10 Hz", {"rate_hz": 10.0, "sweep": True}),
    ],
)
def test_it_is_sure_and_right_all_round(lap: Lap, track: RaceTrack, what: str, change: dict[str, Any]) -> None:
    """From where the survey has ended; a faster car is there at another time."""
    driven = Lap(lap.ground, **change)
    begin_s = track.at_ns / S * lap.speed_mps / driven.speed_mps
    moved = replace(track, at_ns=round(begin_s * S))
    said = Follower(driven, moved).drive(begin_s, begin_s + driven.lap_s)
    assert np.mean([located.is_sure for located in said]) > 0.9, what
    errors = np.abs([error(driven, located) for located in said if located.is_sure])
    along, across, turn = np.percentile(errors, 95, axis=0)
    assert across < 0.05 and along < 0.15 and turn < math.radians(1.5), what


@pytest.mark.parametrize(
    "jump", [(0.0, 0.5, 0.0), (0.0, -0.5, 0.0), (0.5, 0.0, 0.0), (-0.5, 0.0, 0.0), (0.0, 0.0, 0.2)]
)
@pytest.mark.parametrize("after_s", [2.5, 4.0, 6.0])
def test_a_kidnapped_car_is_not_sure_within_one_scan(
    sure: Follower, track: RaceTrack, jump: Pose, after_s: float
) -> None:
    begin_s = track.at_ns / S
    assert sure.drive(begin_s + 2.0, begin_s + after_s)[-1].is_sure
    at_s = next(iter(sure.lap.times(begin_s + after_s + 0.01, 1e3)))
    (located,) = sure.drive(at_s, at_s, lambda at: sure.lap.scan(at, jump))
    assert not located.is_sure and located.reason


@pytest.mark.parametrize(
    ("jump", "within_s"), [((0.0, 0.3, 0.0), 1.0), ((3.0, 0.0, 0.0), 5.0), ((20.0, 0.0, 0.0), 5.0)]
)
def test_it_finds_itself_again(lap: Lap, track: RaceTrack, jump: Pose, within_s: float) -> None:
    """Carried aside, or on along the track."""
    follower = Follower(lap, track)
    begin_s = track.at_ns / S
    follower.drive(begin_s, begin_s + 2.0)
    on_s, aside = jump[0] / lap.speed_mps, (0.0, jump[1], 0.0)

    def carried(at_s: float) -> LidarScan:
        scan = lap.scan(at_s + on_s, aside)
        return replace(scan, stamp_ns=round(at_s * S), start_ns=round(at_s * S))

    def told(odometry: Odometry) -> Odometry:
        return replace(lap.odometry(odometry.stamp_ns / S + on_s, aside), stamp_ns=odometry.stamp_ns)

    said = follower.drive(begin_s + 2.01, begin_s + 2.0 + within_s, carried, told)
    assert not said[0].is_sure
    assert said[-1].is_sure
    true = compose(true_pose(lap, said[-1].stamp_ns / S + on_s), aside)
    assert math.dist(true[:2], (said[-1].x_m, said[-1].y_m)) < 0.3


def test_a_box_on_the_track_is_something_new(sure: Follower, track: RaceTrack) -> None:
    begin_s = track.at_ns / S + 2.0
    x, y, _ = sure.lap.pose(begin_s + 0.75)
    boxed = copy.copy(sure.lap.ground)
    boxed.add_box(x, y, 0.15)
    (located,) = sure.drive(begin_s + 0.03, begin_s + 0.06, lambda at: sure.lap.scan(at, HERE, boxed))
    assert not located.is_sure and "stands" in located.reason


def test_odometry_that_lies_is_found_out(sure: Follower, track: RaceTrack) -> None:
    begin_s = track.at_ns / S + 2.0
    said = sure.drive(begin_s + 0.01, begin_s + 1.0, None, lambda told: replace(told, vx_mps=2.0 * told.vx_mps))
    assert [located.is_sure for located in said].index(False) <= 3


def test_a_new_track_is_proven_before_it_is_driven_by(lap: Lap, track: RaceTrack) -> None:
    begin_s = track.at_ns / S
    said = Follower(lap, track, prove_m=2.0).drive(begin_s, begin_s + 2.0)
    first = [located.is_sure for located in said].index(True)
    assert 2.0 <= (first + 1) / lap.rate_hz * lap.speed_mps < 4.0
    assert said[0].reason == "found, not yet proven"


@pytest.mark.parametrize("along_m", [0.8, -0.8, 1.0])
@pytest.mark.parametrize("from_m", [0.0, 32.0, 40.0, 44.0])
def test_a_car_that_was_found_farther_along_is_moved_before_it_is_sure(
    lap: Lap, track: RaceTrack, along_m: float, from_m: float
) -> None:
    """On a straight a scan fits there as well, but not as well as where the car is."""
    driven = Lap(lap.ground, noise_m=0.05)
    begin_s = track.at_ns / S + from_m / lap.speed_mps
    follower = Follower(driven, replace(track, at=true_pose(lap, begin_s), at_ns=round(begin_s * S)))
    follower.drive(begin_s, begin_s + 0.06)
    locator = follower.perceptor._locator
    assert locator.pose is not None
    locator.pose = compose(locator.pose, (along_m, 0.0, 0.0))
    said = follower.drive(begin_s + 0.06, begin_s + 1.5)
    sure = [error(driven, located) for located in said if located.is_sure]
    assert len(sure) > 10 and max(math.hypot(along, across) for along, across, _ in sure) < 0.2


def test_a_scan_that_sees_nothing_is_no_proof(sure: Follower, track: RaceTrack) -> None:
    at_s = next(iter(sure.lap.times(track.at_ns / S + 2.01, 1e3)))
    scan = sure.lap.scan(at_s)
    blind = replace(scan, ranges_m=np.full_like(scan.ranges_m, math.nan))
    (located,) = sure.drive(at_s, at_s, lambda at: blind)
    assert not located.is_sure


def test_after_a_pause_it_looks_for_itself(sure: Follower, track: RaceTrack) -> None:
    begin_s = track.at_ns / S + 2.0
    said = sure.drive(begin_s + 3.0, begin_s + 6.0)
    assert not said[0].is_sure and said[-1].is_sure


def test_it_draws_and_keeps_the_contract(sure: Follower, lap: Lap, track: RaceTrack) -> None:
    names = {drawn.name for drawn in sure.perceptor.explain()}
    assert {"track_position", "learned lap", "explained", "residual"} <= names
    begin = round(track.at_ns / S * lap.rate_hz)

    def view(number: int) -> Sees:
        at_s = (begin + number + 1) / lap.rate_hz
        return Sees(
            now_ns=round(at_s * S), scan=lap.scan(at_s), odometry=lap.odometry(at_s), applied=None,
            track=track if number else None,
        )  # fmt: skip

    check_perceptor(TrackPosition, make_view=view, robot=CAR)
