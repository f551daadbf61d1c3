"""That `scripts/bench race` puts its boxes where it says, sees each contact with them, and counts no lost run good."""

from __future__ import annotations

import math
import random
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robotd.world.messages import Steer
from robotd_devices.sim.single_track import F1TENTH

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "scripts"))

from benches.harness import Context, Rows  # noqa: E402
from benches.race import BENCH  # noqa: E402
from benches.race_boxes import Lap, Place, Watch, chosen, places, seen_parts  # noqa: E402
from benches.race_cases import BOX_HALF_M, stopping_m, straight  # noqa: E402
from benches.race_drivers import Behaving  # noqa: E402
from benches.race_learned import _boxes, _fresh, _random, jobs  # noqa: E402
from benches.race_plant import Conditions, Ground, Race  # noqa: E402
from benches.race_tracks import procedural  # noqa: E402

MPS = 4.0


def corridor() -> Lap:
    """A lap along x, from 1 to 31 m."""
    lap = Lap([(float(x), 0.0, 0.0, MPS) for x in np.arange(1.0, 31.0, 0.02)])
    lap.close()
    return lap


def test_the_way_of_a_lap() -> None:
    lap = corridor()
    assert lap.length_m == pytest.approx(2.0 * 29.98, abs=0.01)  # a lap that ends elsewhere is closed by its chord
    assert lap.nearest(5.0, 0.7) == pytest.approx(200, abs=1)
    assert lap.at[lap.index(np.array([2.0, 2.0 + lap.length_m])), 0] == pytest.approx([3.0, 3.0], abs=0.03)


@pytest.mark.parametrize(
    ("hidden_by", "parts"),
    [
        (None, [True, True, True]),
        ((8.0, 0.6, 0.6), [True, False, False]),  # its left end and its middle are behind a corner
        ((8.0, 0.0, 1.2), [False, False, False]),
    ],
)
def test_what_is_seen_of_a_box(hidden_by: tuple[float, float, float] | None, parts: list[bool]) -> None:
    ground = Ground(straight())
    if hidden_by is not None:
        ground.add_box(*hidden_by)
    seen = seen_parts(ground, np.array([[2.0, 0.0, 0.0]]), 0.0, (14.0, 0.0), 0.0)
    assert seen[:, 0].tolist() == parts


def test_places_know_how_far_off_the_car_must_brake() -> None:
    lap = corridor()
    found = places(Ground(straight()), F1TENTH, Conditions(), lap, 0.2, 0.65)
    front = F1TENTH.footprint_m()[0][0]
    needed = stopping_m(F1TENTH, Conditions(), MPS) + front + BOX_HALF_M
    # seen from 14 m where the lap is long enough for it
    inside = [place for place in found if 15.0 < lap.way_m[place.point] < 29.0]
    assert len(inside) > 20
    for place in inside:
        assert place.y_m == pytest.approx(0.2)
        assert place.half_m == pytest.approx(BOX_HALF_M)
        assert needed - 0.2 <= place.needed_m <= needed
        assert place.seen_m == place.seen_part_m == pytest.approx(13.8)


@pytest.mark.parametrize(("aside_m", "room_m", "any_left"), [(0.2, 0.65, True), (0.2, 1.2, False), (0.84, 0.65, False)])
def test_a_box_stands_free_with_room_beside_it(aside_m: float, room_m: float, any_left: bool) -> None:
    found = places(Ground(straight()), F1TENTH, Conditions(), corridor(), aside_m, room_m)
    assert bool(found) == any_left


@pytest.mark.parametrize(
    ("stands", "points"),
    [
        (True, {900}),  # the one that is seen latest, of those far enough ahead
        (False, {700, 1100}),
    ],
)
def test_which_place_is_chosen(stands: bool, points: set[int]) -> None:
    def place(point: int, seen_m: float) -> Place:
        return Place(point, 0.0, 0.0, BOX_HALF_M, seen_m, seen_m, 2.0)

    found = [place(100, 0.5), place(700, 13.8), place(900, 1.5), place(1000, 2.9), place(1100, 3.0)]
    lap = corridor()
    drawn = {chosen(found, lap, 1.0, stands, random.Random(seed)) for seed in range(40)}
    assert {place.point for place in drawn if place is not None} == points


@pytest.mark.parametrize("stands", [True, False])
def test_no_place_ahead_is_none(stands: bool) -> None:
    assert chosen([], corridor(), 1.0, stands, random.Random(1)) is None


class OnLine(Behaving):
    """Follow-the-gap that is taken for a car on its line."""

    @property
    def is_on_line(self) -> bool:
        return True


@pytest.mark.parametrize(("stands", "blocks"), [(False, True), (True, False)])
def test_after_a_lap_a_box_is_in_the_way(stands: bool, blocks: bool) -> None:
    here = Ground(procedural(3))
    conditions = Conditions(rate_hz=20.0, beams=361)
    race, driver = Race(here, F1TENTH, conditions), OnLine()
    watch = Watch(race, driver, random.Random(5), stands, blocks)
    put_s: list[float] = []

    def step(now_s: float, pose: tuple[float, float, float], track: Any) -> None:
        watch.step(now_s, pose, track)
        if here.changes and not put_s:
            put_s.append(now_s)

    run = race.drive(driver, 3, limit_s=60.0, stop_when=watch.over, on_step=step)
    told = watch.told
    assert (run.crashed, len(run.laps_s)) == ("", 1)
    assert told["on_line"] and told["gap_m"] > 0.3
    assert (put_s[0] < told["s"]) is stands
    assert watch.passed is not blocks and (watch.stood or not blocks)
    if not stands:
        needed = stopping_m(F1TENTH, conditions, told["speed_mps"])
        assert needed - 0.1 < told["gap_m"] < needed + 1.0


# ------------------------------------------------------------------------------------------------ the plant


@pytest.mark.parametrize("ahead_m", [0.30, 0.45, 0.60])
def test_a_box_that_appears_near_a_car_in_a_wide_place_is_met_at_its_face(ahead_m: float) -> None:
    """What was known to be free before is not free afterwards."""
    ground = Ground(straight(20.0, 6.0))
    # past something narrow first: only what could be nearer than that is looked at in each step
    ground.add_box(2.5, 0.4, BOX_HALF_M)
    race = Race(ground, F1TENTH, Conditions())
    front = F1TENTH.footprint_m()[0][0]
    face_m: list[float] = []

    def appear(now_s: float, pose: tuple[float, float, float], track: object) -> None:
        if not face_m and pose[0] > 4.0:
            face_m.append(pose[0] + front + ahead_m)
            ground.add_box(face_m[0] + BOX_HALF_M, 0.0, BOX_HALF_M)

    run = race.drive(lambda *_: Steer(5.0), 9, (2.0, 0.0, 0.0), 4.0, speed_mps=5.0, on_step=appear)
    assert run.crashed
    assert race.at_m + front == pytest.approx(face_m[0], abs=0.1)


def test_boxes_are_put_on_a_copy_only() -> None:
    import copy

    ground = Ground(straight())
    other = copy.copy(ground)
    other.add_boxes([(9.0, 0.0), (9.0, 0.3)], BOX_HALF_M)
    ahead = np.zeros(1)
    assert other.ranges_m(2.0, 0.0, ahead, 30.0)[0] == pytest.approx(7.0 - BOX_HALF_M, abs=0.1)
    assert other.ranges_m(2.0, 0.4, ahead, 30.0)[0] == pytest.approx(7.0 - BOX_HALF_M, abs=0.1)
    assert ground.ranges_m(2.0, 0.0, ahead, 30.0)[0] > 20.0
    assert (ground.changes, other.changes) == (0, 1)


def test_progress_is_told_while_it_drives() -> None:
    race = Race(Ground(straight()), F1TENTH, Conditions())
    told: list[float] = []
    race.drive(lambda *_: Steer(3.0), 9, (2.0, 0.0, 0.0), 2.0, on_step=lambda *_: told.append(race.progress_m))
    assert told == sorted(told)
    assert told[-1] == pytest.approx(race.at_m - 2.0, abs=0.2)


def test_what_the_car_knows_of_its_floor_the_perceptor_of_the_line_knows_too() -> None:
    learning = Behaving(F1TENTH, learn=True, mu=0.7, v_max_mps=3.0, line_clear_m=0.1).learning
    assert learning is not None
    config = learning._learn.config
    assert (config.mu, config.v_max_mps) == (0.7, 3.0)


# ------------------------------------------------------------------------------------------------ jobs and figures


@pytest.mark.parametrize(("quick", "count"), [(True, 5), (False, 156)])
def test_each_job_has_a_key_of_its_own(quick: bool, count: int) -> None:
    keys = [key for key, _ in jobs(quick, ["aut", "esp", "3"], Path())]
    assert len(set(keys)) == len(keys) == count


def lapped(**changed: Any) -> dict[str, Any]:
    row = {"crashed": "", "stuck": "", "unfinished": False, "laps_s": [12.0, 11.0, 10.0, 10.0], "lap4_on_line": 0.9}
    return {**row, **changed}


def boxed(**changed: Any) -> dict[str, Any]:
    return {"crashed": "", "box": (0.0, 0.0), "on_line": True, "passed": True, "stood": False, **changed}


def context() -> Context:
    return Context(BENCH, False, Path(), Rows("race", None, "", print), print)


def driven(track: str, learn: bool, *laps_s: float) -> dict[str, Any]:
    return {"track": track, "learn": learn, "laps_s": list(laps_s)}


@pytest.mark.parametrize(
    ("rows", "gain"),
    [
        ([driven("41", True, 12.0, 11.0, 10.0), driven("41", False, 12.0, 11.5, 11.0)], 0.1),
        (
            [
                driven("41", True, 12.0, 11.0, 10.0), driven("41", False, 12.0, 11.5, 11.0),
                driven("43", True, 12.0, 11.0, 10.0), driven("43", False, 12.0, 11.5, 9.5),
            ],
            -0.05,
        ),
        ([driven("41", True, 12.0, 11.0), driven("41", False, 12.0, 11.5, 11.0)], None),
    ],
)  # fmt: skip
def test_the_gain_on_fresh_tracks_is_the_worst_and_none_where_one_was_not_finished(
    rows: list[dict[str, Any]], gain: float | None
) -> None:
    ctx = context()
    _fresh(ctx, rows)
    assert ctx.found["fresh_lap3_gain"].value == (gain if gain is None else pytest.approx(gain))


@pytest.mark.parametrize(
    ("rows", "lost", "on_line", "slower", "gain"),
    [
        ([lapped()], 0, 1.0, -1.0 / 6.0, None),
        ([lapped(reactive_laps_s=[13.0, 12.5, 12.0, 11.0])], 0, 1.0, -1.0 / 6.0, 0.2),
        ([lapped(), lapped(crashed="contact", laps_s=[12.0])], 1, 0.5, -1.0 / 6.0, None),
        ([lapped(), lapped(stuck="no progress", laps_s=[12.0])], 1, 0.5, -1.0 / 6.0, None),
        ([lapped(lap4_on_line=0.4), lapped(unfinished=True, laps_s=[])], 1, 0.0, -1.0 / 6.0, None),
        ([lapped(crashed="contact", laps_s=[])], 1, 0.0, None, None),
        ([lapped(), lapped(laps_s=[10.0, 11.0, 11.0, 10.5])], 0, 1.0, 0.05, None),
    ],
)
def test_figures_of_random_laps(
    rows: list[dict[str, Any]], lost: int, on_line: float, slower: float | None, gain: float | None
) -> None:
    ctx = context()
    _random(ctx, rows)
    found = {name: measured.value for name, measured in ctx.found.items()}
    assert found == {
        "learned_random_contacts": lost,
        "learned_random_on_line": on_line,
        "learned_random_slower": slower if slower is None else pytest.approx(slower),
        "learned_random_gain": gain if gain is None else pytest.approx(gain),
    }


@pytest.mark.parametrize(
    ("rows", "lost"),
    [
        ([boxed(), boxed(passed=False, stood=True)], 0),
        ([boxed(), boxed(crashed="contact", passed=False)], 1),
        ([boxed(), {"crashed": "contact before any box", "unfinished": False}], 1),
        ([boxed(), {"crashed": "", "unfinished": True}], 0),  # counted as unfinished, and told in the note
    ],
)
def test_figures_of_boxes(rows: list[dict[str, Any]], lost: int) -> None:
    ctx = context()
    _boxes(ctx, rows)
    assert ctx.found["learned_box_contacts"].value == lost
    assert f"of {len(rows)} boxes" in ctx.notes[0]


def test_the_stopping_way_grows_with_all_that_delays() -> None:
    plain = stopping_m(F1TENTH, Conditions(), MPS)
    assert plain == pytest.approx(MPS * 0.125 + MPS**2 / (2.0 * 0.583 * F1TENTH.mu * 9.81), rel=1e-3)
    for harder in (replace(Conditions(), rate_hz=10.0), replace(Conditions(), latency_s=0.06), Conditions(mu=0.7)):
        assert stopping_m(F1TENTH, harder, MPS) > plain
    assert math.isclose(stopping_m(F1TENTH, Conditions(), 0.0), 0.0)
