"""The learned line under other than nominal conditions: laps at random, boxes, and what a plan on it costs."""

from __future__ import annotations

import gc
import math
import random
import time
from collections.abc import Iterator
from pathlib import Path
from statistics import median

import numpy as np

from benches import race_runs
from benches.harness import Context, Figure
from benches.race_boxes import box_on_the_line
from benches.race_drivers import Behaving, robot_of
from benches.race_plant import Conditions, Race
from benches.race_reference import PlainFollowTheGap
from benches.race_runs import Job, Row
from robotd_devices.sim.single_track import F1TENTH
from robotd_plugins.behaviours.ftg_race import FtgRace, FtgRaceConfig, Sees
from robotd_plugins.behaviours.ftg_race.line.lap_two import LINE

RANDOM, BOXES, COMPARED = 60, 60, 20
FRESH = (41, 43, 47, 53, 59, 61, 67, 71, 73, 79, 83, 89)
"""Seeds of tracks on which nothing was tuned; keep it so."""
_LAPS = 4
_TOLD_MU = 1.0489
"""The car is told the friction of the floor, but no more than its config has by itself."""
_SETTLED = 20
"""Views of a recorded drive that a new behaviour is given before its plans count."""

FIGURES = (
    Figure("fresh_lap3_gain", "", ">= 0.03", "as lap3_gain, worst of twelve tracks that nothing was tuned on"),
    Figure("learned_random_contacts", "", "= 0", "four laps, learning, random conditions: crashed, stuck, unfinished"),
    Figure("learned_random_on_line", "", "", "share of those runs that drove most of lap 4 on the line"),
    Figure("learned_random_gain", "", "", "reactive laps 2 to 4 over lap 4 with learning less 1, median of 20 runs"),
    Figure("learned_random_slower", "", "", "lap 4 over lap 1 less 1, the worst of those runs"),
    Figure("learned_box_contacts", "", "= 0", "boxes on the learned line: appearing, or standing behind a bend"),
    Figure("plan_line_us_p50", "us", "<= 200", "as plan_us, on the learned line"),
    Figure("plan_line_us_p99", "us", "<= 500", "the same"),
)


def jobs(quick: bool, tracks: list[str], data: Path) -> Iterator[Job]:
    """Laps and boxes, one row each. tracks: of the laps; boxes stand on our own and on AUT."""
    for seed in FRESH[: 1 if quick else None]:
        for car, learn in (("f1tenth", True), ("f1tenth", False), ("tt02d", True)):
            yield f"fresh {car} {learn} {seed}", lambda s=seed, c=car, on=learn: fresh(s, c, on, data)
    for seed in range(1 if quick else RANDOM):
        yield f"learned random {seed}", lambda s=seed: random_laps(s, tracks, data, not quick and s < COMPARED)
    ours = [name for name in tracks if name.isdecimal() or name == "aut"]
    for seed in range(1 if quick else BOXES):
        yield f"learned box {seed}", lambda s=seed: box(s, ours, data)


def fresh(seed: int, car: str, learn: bool, data: Path) -> Row:
    """A few laps on a track that nothing was tuned on."""
    return race_runs.laps(str(seed), car, _LAPS, data, learn, what="fresh")


def random_laps(seed: int, tracks: list[str], data: Path, compared: bool) -> Row:
    """Four laps from the start line with learning, and the same without where `compared`; the friction is told to the
    car and to the line's perceptor, the rest it must find out.
    """
    rng = random.Random(f"learned {seed}")
    name, back = rng.choice(tracks), rng.random() < 0.5
    conditions = race_runs.random_conditions(rng, seed)
    here = race_runs.ground(name, data, back)
    assert conditions.mu is not None
    mu = min(conditions.mu, _TOLD_MU)
    driver, on = Behaving(F1TENTH, learn=True, mu=mu), list[bool]()
    run = Race(here, F1TENTH, conditions).drive(
        driver, _LAPS, limit_s=_LAPS * 300.0, on_step=lambda now_s, pose, track: on.append(driver.is_on_line)
    )
    row = {
        "what": "learned_random", "seed": seed, "track": name, "back": back, **race_runs.told(conditions),
        **race_runs.row_of(run, _LAPS), "line": driver.line_told(),
    }  # fmt: skip
    if len(run.laps_s) == _LAPS:
        last = on[-round(run.laps_s[-1] / conditions.step_s) :]
        row["lap4_on_line"] = sum(last) / len(last)
    if compared:
        plain = Race(here, F1TENTH, conditions).drive(Behaving(F1TENTH, mu=mu), _LAPS, limit_s=_LAPS * 300.0)
        row["reactive_laps_s"] = plain.laps_s
    return row


def box(seed: int, tracks: list[str], data: Path) -> Row:
    """One box on the learned line of a random track."""
    name = random.Random(f"box track {seed}").choice(tracks)
    found = box_on_the_line(race_runs.ground(name, data), F1TENTH, seed)
    return {"what": "learned_box", "seed": seed, "track": name, **found}


# ----------------------------------------------------------------------------------------------- figures


def figures(ctx: Context) -> None:
    """All of `FIGURES`, from the rows and from a drive of its own."""
    _fresh(ctx, [r for r in ctx.rows.all if r["what"] == "fresh" and r["car"] == "f1tenth"])
    _random(ctx, [r for r in ctx.rows.all if r["what"] == "learned_random"])
    _boxes(ctx, [r for r in ctx.rows.all if r["what"] == "learned_box"])
    _plan_times(ctx)


def _fresh(ctx: Context, rows: list[Row]) -> None:
    lap3 = {(r["track"], r["learn"]): r["laps_s"][2] for r in rows if len(r["laps_s"]) >= 3}
    gains = [plain / lap3[track, True] - 1.0 for (track, on), plain in lap3.items() if not on and (track, True) in lap3]
    lost = len(rows) // 2 - len(gains)
    none = f"{lost} tracks were not driven three times round by both" if lost else None
    ctx.figure("fresh_lap3_gain", None if none else min(gains), runs=len(gains), why=none)


def _random(ctx: Context, rows: list[Row]) -> None:
    lost = sum(bool(r["crashed"] or r["stuck"] or r["unfinished"]) for r in rows)
    ctx.figure("learned_random_contacts", lost, runs=len(rows))
    whole = [r for r in rows if len(r["laps_s"]) == _LAPS]
    on = [r["lap4_on_line"] >= 0.5 for r in whole]
    ctx.figure("learned_random_on_line", sum(on) / len(rows), runs=len(rows))
    slower = [r["laps_s"][3] / r["laps_s"][0] - 1.0 for r in whole]
    none = None if slower else "no run was finished"
    ctx.figure("learned_random_slower", max(slower, default=None), runs=len(slower), why=none)
    both = [r for r in whole if len(r.get("reactive_laps_s", ())) == _LAPS]
    gains = [median(r["reactive_laps_s"][1:]) / r["laps_s"][3] - 1.0 for r in both]
    none = None if gains else "no run was compared"
    ctx.figure("learned_random_gain", median(gains) if gains else None, runs=len(gains), why=none)
    if gains:
        ctx.note(f"learned_random_gain: from {min(gains):.3f} to {max(gains):.3f}")


def _boxes(ctx: Context, rows: list[Row]) -> None:
    ctx.figure("learned_box_contacts", sum(bool(r["crashed"]) for r in rows), runs=len(rows))
    placed = [r for r in rows if "box" in r]
    on, passed = sum(r["on_line"] for r in placed), sum(r["passed"] for r in placed)
    ctx.note(
        f"learned_box_contacts: {len(placed)} of {len(rows)} boxes came to count, {on} before a car on its line; "
        f"{passed} passed, {sum(r['stood'] and not r['passed'] for r in placed)} stood before"
    )


def _plan_times(ctx: Context) -> None:
    """Views of a drive on the line, given to new behaviours and to the plain follow-the-gap in turn."""
    views = recorded(1000 if ctx.quick else 4000)
    took, took_plain = list[float](), list[float]()
    gc.collect()
    for turn in range(3 if ctx.quick else 10):
        race, plain, scan = FtgRace(FtgRaceConfig(), None, robot_of(F1TENTH)), PlainFollowTheGap(), None
        for at, seen in enumerate(views):
            is_new, scan = seen.scan is not scan, seen.scan
            begin = time.thread_time_ns()
            race.step(seen)
            us = (time.thread_time_ns() - begin) / 1e3
            if not is_new or seen.odometry is None:
                continue
            begin = time.thread_time_ns()
            plain(seen.scan, seen.odometry, seen.now_ns)
            plain_us = (time.thread_time_ns() - begin) / 1e3
            if turn > 0 and at >= _SETTLED and race.driven_by == LINE:
                took.append(us)
                took_plain.append(plain_us)
    why = None if took else "the line was not driven again from the recorded views"
    for name, q in (("plan_line_us_p50", 50), ("plan_line_us_p99", 99)):
        value, baseline = (float(np.percentile(us, q)) if us else math.nan for us in (took, took_plain))
        ctx.figure(name, None if why else value, baseline=baseline, runs=len(took), why=why)


def recorded(most: int) -> list[Sees]:
    """What the behaviour saw in lap 3 of a drive on one of our own tracks, from when the line was driven in it."""
    driver, views = Behaving(F1TENTH, learn=True), list[Sees]()
    race = Race(race_runs.ground("3", Path()), F1TENTH, Conditions())

    def watch(now_s: float, pose: tuple[float, float, float], track: object) -> None:
        if driver.views is None and race.progress_m > 2.0 * race.length_m and driver.is_on_line:
            driver.views = views

    race.drive(driver, 3, limit_s=120.0, stop_when=lambda now_s, track: len(views) >= most, on_step=watch)
    return views
