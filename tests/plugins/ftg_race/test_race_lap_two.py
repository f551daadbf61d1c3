"""Who drives on lap 2: the learned line while all speaks for it, follow-the-gap from the very step in which not."""

from __future__ import annotations

import logging
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import stadium
from race_cars import F1TENTH, TICK_NS, S, corridor

from robotd import Steer
from robotd.authoring.explain import Text
from robotd.world.messages import LidarScan, Odometry
from robotd_devices.sim import single_track
from robotd_plugins.behaviours.ftg_race import FtgRace, FtgRaceConfig, Sees
from robotd_plugins.behaviours.ftg_race.line.laps import Laps
from robotd_plugins.toolkit.race_track import Located, RaceTrack

MPS = 4.0
TRACK = stadium.learned()


class Lap:
    """A car on the straight of the stadium, a step every 25 ms; what it sees may be changed before each step."""

    def __init__(self, **keys: Any) -> None:
        self.race = FtgRace(FtgRaceConfig(**keys), None, F1TENTH)
        self.now_ns = 0
        self.x_m = -10.0

    def step(self, track: RaceTrack | None = TRACK, speed_mps: float = MPS, box: bool = False, **changed: Any) -> Steer:
        self.now_ns += TICK_NS
        self.x_m += speed_mps * TICK_NS / S
        scan = corridor(stamp_ns=self.now_ns)
        if box:
            near = np.abs(scan.angles_rad) < 0.25
            scan = replace_ranges(scan, np.where(near, np.float32(1.0), scan.ranges_m))
        located = Located(self.now_ns, self.x_m, 0.0, 0.0, 0.01, 1.0, True, "", 1)
        gone = changed.pop("gone", False)
        located = replace(located, **changed)
        odometry = Odometry(self.now_ns, 0.0, 0.0, 0.0, speed_mps, 0.0, 0.0)
        seen = Sees(now_ns=self.now_ns, scan=scan, odometry=odometry, track=track, located=None if gone else located)
        result = self.race.step(seen)
        assert isinstance(result, Steer)
        return result

    @property
    def is_on(self) -> bool:
        return self.race.driven_by == "learned line"


def replace_ranges(scan: LidarScan, ranges: np.ndarray) -> LidarScan:
    return LidarScan(
        scan.stamp_ns, ranges.astype(np.float32), scan.angles_rad, scan.start_ns, scan.range_min_m, scan.range_max_m,
        scan.x_m, scan.y_m, scan.yaw_rad,
    )  # fmt: skip


def test_it_takes_to_the_line_and_says_so(caplog: pytest.LogCaptureFixture) -> None:
    lap = Lap()
    with caplog.at_level(logging.INFO, "robotd.ftg_race"):
        for _ in range(8):
            told = lap.step()
    assert lap.is_on and told.speed_mps > MPS and abs(told.steering_rad) < 0.02
    assert [r.getMessage().split(",")[0] for r in caplog.records] == ["on the learned line"]
    assert Text("driven by", "learned line") in lap.race.explain()


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"gone": True}, "nobody knows where the car is"),
        ({"is_sure": False, "reason": "residual 0.3 m"}, "the place is not sure: residual 0.3 m"),
        ({"version": 2}, "the place is on version 2 of the track, the line on 1"),
        ({"y_m": 0.6}, "off the line"),
        ({"yaw_rad": 0.6}, "off the line"),
        ({"box": True}, "free for"),
        ({"speed_mps": 9.5}, "too fast for the line"),
        ({"speed_mps": 8.0, "yaw_rad": 0.3}, "of the grip to hold it"),
    ],
)
def test_it_falls_back_in_the_same_step(changed: dict[str, Any], told: str, caplog: pytest.LogCaptureFixture) -> None:
    lap, plain = Lap(), Lap(learn=False)
    for _ in range(4):
        lap.step()
        plain.step()
    assert lap.is_on
    # follow-the-gap is as it would be without the line, but for what was told before
    plain.race._told = lap.race._told
    with caplog.at_level(logging.INFO, "robotd.ftg_race"):
        answer = lap.step(**changed)
    assert not lap.is_on
    assert told in lap.race.driven_by
    assert [told in r.getMessage() for r in caplog.records] == [True]
    assert answer == plain.step(**changed)


@pytest.mark.parametrize(
    ("turned_rad", "speed_mps", "joins"), [(0.0, 7.0, True), (0.25, 3.0, True), (0.25, 7.0, False)]
)
def test_it_comes_to_the_line_only_where_the_tyres_can_bring_it_there(
    turned_rad: float, speed_mps: float, joins: bool
) -> None:
    lap = Lap()
    for _ in range(4):
        lap.step(speed_mps=speed_mps, yaw_rad=turned_rad)
    assert lap.is_on is joins
    assert joins or "of the grip to hold it" in lap.race.driven_by


@pytest.mark.parametrize(("turned_rad", "brakes"), [(0.0, False), (0.12, False), (0.15, True)])
def test_where_it_must_bend_back_hard_it_goes_no_faster_than_the_tyres_hold(turned_rad: float, brakes: bool) -> None:
    lap = Lap()
    for _ in range(5):
        lap.step(speed_mps=7.0)
    # off the motor first, then the brakes
    told = [lap.step(speed_mps=7.0, yaw_rad=turned_rad).speed_mps for _ in range(3)]
    assert lap.is_on
    assert (told[-1] < 7.0) is brakes


def test_it_comes_back_a_quarter_of_a_second_later() -> None:
    lap = Lap()
    for _ in range(4):
        lap.step()
    lap.step(gone=True)
    on = []
    for _ in range(14):
        lap.step()
        on.append(lap.is_on)
    assert on == [False] * 9 + [True] * 5


def test_before_a_box_it_stops_or_goes_round_as_follow_the_gap_does() -> None:
    lap = Lap()
    for _ in range(4):
        lap.step()
    told = [lap.step(box=True) for _ in range(4)]
    assert all(t.speed_mps < MPS for t in told)


@pytest.mark.parametrize("keys", [{"learn": False}, {"profile": "seed_safe"}, {"planner": "baseline"}])
def test_who_does_not_learn_never_takes_the_line(keys: dict[str, Any]) -> None:
    lap = Lap(**keys)
    for _ in range(6):
        lap.step()
    assert not lap.is_on


def test_a_track_without_a_line_changes_nothing() -> None:
    none = np.zeros(0)
    bare = replace(
        TRACK, s_m=none, x_m=none, y_m=none, yaw_rad=none, curvature_pm=none, speed_mps=none, length_m=0.0,
        reason="too narrow",
    )  # fmt: skip
    lap = Lap()
    for _ in range(4):
        lap.step(track=bare)
    assert lap.race.driven_by == "follow-the-gap: too narrow"


def drive_round(laps: Laps, on: bool, lap_s: float, start_ns: int) -> tuple[bool, int]:
    """One lap of 100 m at an even pace, a step a metre."""
    slower = False
    for metre in range(1, 101):
        now = start_ns + round(metre * lap_s * S / 100.0)
        slower |= laps.step(now, metre % 100.0, 100.0, on)
    return slower, start_ns + round(lap_s * S)


@pytest.mark.parametrize(
    ("first_s", "reactive_s", "line_s", "dropped"),
    [
        (20.0, [], 19.0, False),
        (20.0, [], 20.5, True),
        (20.0, [18.0], 19.0, True),
        (20.0, [22.0], 19.0, False),
        (None, [18.0], 18.5, True),
        (None, [], 30.0, False),
    ],
)
def test_a_lap_on_the_line_must_not_be_slower(
    first_s: float | None, reactive_s: list[float], line_s: float, dropped: bool
) -> None:
    laps, now = Laps(), S
    if first_s is not None:
        for metre in range(105):
            laps.drive(now + round(metre * first_s * S / 100.0), 100.0 / first_s)
        now += round(1.05 * first_s * S)
        laps.first_lap(100.0)
        assert laps.best_s == pytest.approx(first_s, rel=0.02)
    laps.step(now, 0.0, 100.0, False)
    for pace in reactive_s:
        slower, now = drive_round(laps, False, pace, now)
        assert not slower
    slower, now = drive_round(laps, True, line_s, now)
    assert slower is dropped
    assert math.isclose(laps.line_s, line_s, rel_tol=0.03)


def test_a_slow_line_is_dropped_until_there_is_a_newer_one(monkeypatch: pytest.MonkeyPatch) -> None:
    lap = Lap()
    for _ in range(4):
        lap.step()
    with monkeypatch.context() as slow:
        slow.setattr(Laps, "step", lambda *_: True)
        lap.step()
        assert lap.is_on
    lap.step()
    assert not lap.is_on and "follow-the-gap: a lap took" in lap.race.driven_by
    for _ in range(14):
        lap.step(track=replace(TRACK, version=2), version=2)
    assert lap.is_on


def test_three_laps_of_a_small_track() -> None:
    """The bench's plant, the three perceptors and the behaviour: lap 3 on the line, quicker and without contact."""
    from benches.race_drivers import Behaving
    from benches.race_plant import Conditions, Ground, Race
    from benches.race_tracks import procedural

    ground = Ground(procedural(3))
    driver = Behaving(single_track.F1TENTH, learn=True)
    run = Race(ground, single_track.F1TENTH, Conditions()).drive(driver, 3, limit_s=60.0)
    assert (run.crashed, run.stuck, len(run.laps_s)) == ("", "", 3)
    assert run.laps_s[2] < 0.95 * run.laps_s[0]
    assert run.over_grip_share <= 0.001
    assert driver.line_told()["share"] > 0.7
