"""`scripts/bench race`: laps, crashes and times of `ftg_race` on tracks that it has no map of, beside plain rules."""

from __future__ import annotations

import gc
import math
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any, ClassVar

import numpy as np

from benches import race_cases, race_learned, race_runs
from benches.harness import Bench, Context, Figure
from benches.race_drivers import Behaving
from benches.race_plant import Conditions, Ground, Race
from benches.race_reference import PlainFollowTheGap
from benches.race_runs import Job
from benches.race_tracks import EVANS, SEEDS, evans, procedural
from robotd.world.messages import LidarScan, Odometry
from robotd_devices.sim.single_track import F1TENTH


class RaceBench(Bench):
    """Every run is one row; crashed runs are listed, never left out of a mean."""

    name: ClassVar[str] = "race"
    about: ClassVar[str] = "ftg_race in closed loop; the baseline of a lap is the published follow-the-gap"
    figures: ClassVar[tuple[Figure, ...]] = (
        Figure("harness_off_share", "", "<= 0.03", "plain follow-the-gap at 25 Hz, linear tyres, from published times"),
        Figure("circle_off_share", "", "", "the same with our friction circle"),
        Figure("collisions", "", "= 0", "in all runs below"),
        Figure("stuck", "", "= 0", "no progress for 10 s"),
        Figure("unfinished", "", "= 0", "laps not driven to their end for another reason"),
        Figure("lap_s_aut", "s", "<= 17.6", "first lap from a standstill, f1tenth car"),
        Figure("lap_s_esp", "s", "<= 37.7", "the same"),
        Figure("lap_s_gbr", "s", "<= 32.8", "the same"),
        Figure("lap_s_mco", "s", "<= 29.4", "the same"),
        Figure(
            "over_grip_share",
            "",
            "<= 0.001",
            "time with |v yaw rate| above mu g, first laps and twenty, worst of the four",
        ),
        Figure("clearance_m", "m", "", "least of the whole footprint in all laps at 40 Hz"),
        Figure("steer_rate_radps", "rad/s", "", "mean of the wheels, median of the tracks"),
        Figure("limit_ratio", "x", "", "flying lap over the friction-limited time, median of the tracks"),
        Figure("tt02d_limit_ratio", "x", "<= 1.15", "the same for the TT-02D at 10 Hz, worst track"),
        Figure("lap3_gain", "", ">= 0.03", "reactive lap 3 over lap 3 on the learned line less 1, worst track"),
        Figure("line_share", "", "", "steps driven on the line once it is known, least of all tracks and both cars"),
        Figure("perceptors_us_p50", "us", "", "survey and place together, a scan, median of the tracks"),
        Figure("solve_s", "s", "<= 5", "track and line from a survey, longest"),
        Figure("random_ratio_worst", "x", "<= 1.5", "first lap under random conditions over their limit"),
        Figure("walls_left_alone", "", "= 0", "noses before a wall that did not race again within 8 s without contact"),
        Figure("box_contacts", "", "= 0", "boxes that appear beyond stopping distance and latency"),
        Figure("seed_lap_s_aut", "s", "", "the seed's literal rules; none where they do not finish"),
        Figure("ab_ftg_over_baseline", "x", "", "seed_safe: mean speed asked by ftg over baseline on the same scans"),
        Figure("plan_us_p50", "us", "<= 200", "perception to command, 1081 beams, beside the plain follow-the-gap"),
        Figure("plan_us_p99", "us", "<= 500", "the same"),
        Figure("plan_growth", "x", "<= 1.1", "last tenth of many calls over the first"),
        *race_learned.FIGURES,
    )

    def run(self, ctx: Context) -> None:
        jobs = list(self._jobs(ctx))
        for done, (key, job) in enumerate(jobs):
            ctx.progress(done, len(jobs), key)
            if ctx.saved(key) is None:
                row = job()
                ctx.row(row, key=key)
                for bad in ("crashed", "stuck"):
                    if row.get(bad) and row["what"] != "plain" and row["what"] != "seed":
                        ctx.note(f"{key}: {row[bad]}")
        self._harness(ctx)
        self._laps(ctx)
        self._cases(ctx)
        self._learned(ctx)
        self._same_scans(ctx)
        self._plan_times(ctx)
        race_learned.figures(ctx)

    def _jobs(self, ctx: Context) -> Iterator[Job]:
        quick, data = ctx.quick, ctx.data
        here = [name for name in EVANS if (data / "tracks_evans" / f"{name}.yaml").is_file()]
        own = [str(seed) for seed in (SEEDS[1:2] if quick else SEEDS)]
        for name in [n for n in here if n in race_runs.PUBLISHED_S][: 1 if quick else 3]:
            for linear in (True, False):
                yield f"plain {name} {linear}", lambda n=name, t=linear: race_runs.plain(n, data, t)
        for name in here if not quick else here[:1]:
            yield f"first {name}", lambda n=name: {**race_runs.laps(n, "f1tenth", 1, data), "what": "first"}
        for car in ("f1tenth", "tt02d"):
            for name in [*(here if not quick else []), *own]:
                count = 3 if quick else 20
                yield f"{car} {name}", lambda n=name, c=car, k=count: race_runs.laps(n, c, k, data, learn=True)
        for name in [*(here if not quick else []), *own]:
            yield f"reactive {name}", lambda n=name: race_runs.laps(n, "f1tenth", 3, data, what="reactive")
        for name in ["aut"] if "aut" in here and not quick else own[:1]:
            for planner in ("ftg", "baseline"):
                yield f"seed {planner} {name}", lambda n=name, p=planner: race_runs.seed_rules(n, data, p)
        tracks = [*(here if not quick else []), *own]
        for seed in range(4 if quick else 500):
            yield f"random {seed}", lambda s=seed: race_runs.random_lap(s, tracks, data)
        for seed in range(6 if quick else 200):
            name = own[seed % len(own)]
            yield (
                f"wall {seed}",
                lambda s=seed, n=name: {
                    "what": "wall",
                    **race_cases.nose_to_wall(race_runs.ground(n, data), F1TENTH, s),
                },
            )
        for seed in range(6 if quick else 300):
            yield (
                f"box {seed}",
                lambda s=seed: {"what": "box", **race_cases.appearing_box(F1TENTH, s, 8.0, Conditions())},
            )
        yield from race_learned.jobs(quick, tracks, data)

    # ----------------------------------------------------------------------------------------------- figures

    def _harness(self, ctx: Context) -> None:
        for linear, name in ((True, "harness_off_share"), (False, "circle_off_share")):
            rows = [r for r in ctx.rows.all if r["what"] == "plain" and r["linear_tyres"] is linear]
            off = [abs(r["laps_s"][0] / race_runs.PUBLISHED_S[r["track"]] - 1.0) for r in rows if r["laps_s"]]
            lost = [f"{r['track']}: {r['crashed'] or r['stuck']}" for r in rows if not r["laps_s"]]
            why = "; ".join(lost) if lost else "the published tracks are absent" if not rows else None
            ctx.figure(name, None if why else max(off), runs=len(rows), why=why)

    def _laps(self, ctx: Context) -> None:
        rows = ctx.rows.all
        counted = [r for r in rows if r["what"] not in ("plain", "seed", "ab")]
        ctx.figure("collisions", sum(bool(r.get("crashed")) for r in counted), runs=len(counted))
        ctx.figure("stuck", sum(bool(r.get("stuck")) for r in counted), runs=len(counted))
        ctx.figure("unfinished", sum(bool(r.get("unfinished")) for r in counted), runs=len(counted))
        first = {r["track"]: r for r in rows if r["what"] == "first"}
        published = {"aut": 19.10, **race_runs.PUBLISHED_S}
        for name in EVANS:
            row = first.get(name)
            lap = row["laps_s"][0] if row and row["laps_s"] else None
            why = None if lap else "not driven in the quick sample" if row is None else row["crashed"] or row["stuck"]
            ctx.figure(f"lap_s_{name}", lap, baseline=published[name], why=why)
        driven = [r for r in rows if r["what"] == "first" or (r["what"] == "laps" and r["track"] in EVANS)]
        driven = [r for r in driven if r.get("car", "f1tenth") == "f1tenth"]
        if driven:
            ctx.figure("over_grip_share", max(r["over_grip_share"] for r in driven), runs=len(driven))
        f1 = [r for r in rows if r["what"] == "laps" and r["car"] == "f1tenth"]
        tt = [r for r in rows if r["what"] == "laps" and r["car"] == "tt02d"]
        ctx.figure("clearance_m", min(r["clearance_m"] for r in f1), runs=len(f1))
        ctx.figure("steer_rate_radps", median(r["steer_rate_radps"] for r in f1), runs=len(f1))
        for name, cars, take in (("limit_ratio", f1, median), ("tt02d_limit_ratio", tt, max)):
            ratios = [median(r["laps_s"][1:]) / r["limit_s"][0] for r in cars if len(r["laps_s"]) > 1]
            lost = len(ratios) < len(cars)
            ctx.figure(
                name, take(ratios) if ratios else None, runs=len(ratios), why=None if ratios else "no lap was finished"
            )
            if lost:
                ctx.note(
                    f"{name}: {len(cars) - len(ratios)} of {len(cars)} tracks not counted, see collisions and stuck"
                )

    def _learned(self, ctx: Context) -> None:
        """Lap 3 of both, track by track."""
        rows = ctx.rows.all
        plain = {r["track"]: r for r in rows if r["what"] == "reactive"}
        gains: dict[str, float] = {}
        for row in rows:
            other = plain.get(row["track"]) if row["what"] == "laps" and row["car"] == "f1tenth" else None
            if other is None:
                continue
            if len(row["laps_s"]) < 3 or len(other["laps_s"]) < 3:
                ctx.note(f"lap3_gain: {row['track']} not counted, see collisions and stuck")
                continue
            gains[row["track"]] = other["laps_s"][2] / row["laps_s"][2] - 1.0
        told = ", ".join(f"{name} {gain:.3f}" for name, gain in gains.items())
        why = None if gains else "no track was driven three times round by both"
        ctx.figure("lap3_gain", min(gains.values(), default=None), runs=len(gains), why=why)
        if gains:
            ctx.note(f"lap3_gain: median {median(gains.values()):.3f}; {told}")
        learned = [r for r in rows if r["what"] == "laps" and r.get("line")]
        if learned:
            ctx.figure("line_share", min(r["line"]["share"] for r in learned), runs=len(learned))
            ctx.figure("perceptors_us_p50", median(r["line"]["perceptors_us"][0] for r in learned), runs=len(learned))
            ctx.figure("solve_s", max(max(r["line"]["solve_s"], default=0.0) for r in learned), runs=len(learned))

    def _cases(self, ctx: Context) -> None:
        rows = ctx.rows.all
        laps = [r for r in rows if r["what"] == "random"]
        ratios = [r["laps_s"][0] / r["limit_s"] for r in laps if r["laps_s"]]
        ctx.figure("random_ratio_worst", max(ratios, default=math.inf), runs=len(laps))
        noses = [r for r in rows if r["what"] == "wall"]
        ctx.figure("walls_left_alone", sum(bool(r["crashed"] or r["s"] is None) for r in noses), runs=len(noses))
        boxes = [r for r in rows if r["what"] == "box"]
        ctx.figure("box_contacts", sum(bool(r["crashed"]) for r in boxes), runs=len(boxes))
        seed = [r for r in rows if r["what"] == "seed" and r["planner"] == "ftg" and r["track"] == "aut"]
        lap = seed[0]["laps_s"][0] if seed and seed[0]["laps_s"] else None
        why = "not in the quick sample" if not seed else seed[0]["crashed"] or seed[0]["stuck"] or "not within 400 s"
        ctx.figure("seed_lap_s_aut", lap, why=None if lap else why)

    def _same_scans(self, ctx: Context) -> None:
        """A drive of the race planner is recorded, and its scans given to the seed's two planners."""
        seen = _recorded(ctx.data, 200 if ctx.quick else 1000)
        asked = {}
        for planner in ("ftg", "baseline"):
            driver = Behaving(F1TENTH, profile="seed_safe", planner=planner, recover=False)
            commands = [driver(*one) for one in seen]
            asked[planner] = commands
            stops = sum(c is None or c.speed_mps == 0.0 for c in commands) / len(commands)
            mean = float(np.mean([c.speed_mps for c in commands if c is not None]))
            ctx.row({"what": "ab", "planner": planner, "mean_mps": mean, "stop_share": stops}, key=f"ab {planner}")
        ftg, base = (
            float(np.mean([c.speed_mps for c in asked[name] if c is not None])) for name in ("ftg", "baseline")
        )
        why = None if base > 0.0 else "the baseline stands"
        ctx.figure("ab_ftg_over_baseline", None if why else ftg / base, runs=len(seen), why=why)

    def _plan_times(self, ctx: Context) -> None:
        """Both planners on the same scans in turn; CPU time of this thread, since the machine is shared."""
        seen = _recorded(ctx.data, 400)
        ours, theirs = Behaving(F1TENTH), PlainFollowTheGap()
        rounds = 3 if ctx.quick else 10
        took_plain: list[float] = []
        gc.collect()
        for turn in range(rounds + 1):
            if turn == 1:
                ours.took_us.clear()
                took_plain.clear()
            for scan, odometry, now_ns in seen:
                ours(scan, odometry, now_ns)
                begin = time.thread_time_ns()
                theirs(scan, odometry, now_ns)
                took_plain.append((time.thread_time_ns() - begin) / 1e3)
        runs = len(ours.took_us)
        for name, q in (("plan_us_p50", 50), ("plan_us_p99", 99)):
            value, plain = float(np.percentile(ours.took_us, q)), float(np.percentile(took_plain, q))
            ctx.figure(name, value, baseline=plain, runs=runs)
        calls = 5_000 if ctx.quick else 1_000_000
        tenth = calls // 10
        ours.took_us.clear()
        medians: list[float] = []
        for call in range(calls):
            ours(*seen[call % len(seen)])
            if (call + 1) % tenth == 0:
                medians.append(median(ours.took_us))
                ours.took_us.clear()
        ctx.figure("plan_growth", medians[-1] / medians[0], runs=calls)

    def plot(self, axes: Any, rows: Sequence[Mapping[str, Any]]) -> None:
        """The longest drive of the first track: its path by speed; and where anything crashed on it."""
        drawn = [row for row in rows if row.get("path")]
        row = drawn[0]
        track = _track(row["track"])
        x0, y0 = track.origin_m
        high, wide = (n * track.resolution_m for n in track.occupied.shape)
        axes.imshow(track.occupied, origin="lower", cmap="gray_r", extent=(x0, x0 + wide, y0, y0 + high), alpha=0.4)
        path = np.array(row["path"])
        points = axes.scatter(path[:, 0], path[:, 1], c=path[:, 2], s=4, cmap="viridis")
        axes.figure.colorbar(points, label="m/s")
        for other in drawn:
            if other["track"] == row["track"] and other["crashed"]:
                axes.plot(other["path"][-1][0], other["path"][-1][1], "rx", markersize=10)
        axes.set_aspect("equal")
        axes.set_title(
            f"{row['track']}: {row['car']}, first lap {row['laps_s'][0] if row['laps_s'] else math.nan:.2f} s"
        )


def _track(name: str) -> Any:
    from benches.harness import _data_folder

    return evans(name, _data_folder()) if name in EVANS else procedural(int(name))


def _recorded(data: Path, count: int) -> list[tuple[LidarScan, Odometry, int]]:
    """Scans of one drive on a procedural track, with what the wheels told."""
    seen: list[tuple[LidarScan, Odometry, int]] = []
    driver = Behaving(F1TENTH)

    def record(scan: LidarScan, odometry: Odometry, now_ns: int) -> Any:
        seen.append((scan, odometry, now_ns))
        return driver(scan, odometry, now_ns)

    Race(Ground(procedural(SEEDS[1])), F1TENTH, Conditions()).drive(record, 9, limit_s=count / 40.0)
    return seen[:count]


BENCH = RaceBench()
