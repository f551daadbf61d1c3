"""`scripts/bench route`: the shipped JetBot drives random mapped floors from start to goal, by rendered pictures."""

from __future__ import annotations

import multiprocessing
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from statistics import median
from typing import Any

from benches.harness import Bench, Context, Figure
from benches.route_runs import names_of, run_one, scene
from robotd_devices.sim.route import route_from

FIRST = 20261126
"""Sets these worlds apart from those that anything was tuned on."""
RUNS = {"own": 200, "mujoco": 50}
QUICK = {"own": 6, "mujoco": 2}
TRACK_M = 0.059
"""Half the distance between the wheels: farther off the tape's middle, a wheel has crossed it."""
_WORKERS = 2
_DRAWN = 9


class Route(Bench):
    """Own pictures and MuJoCo's; every run's world follows from its number."""

    name = "route"
    about = "mapped routes on random floors (3x3 to 8x8), rendered pictures, wheels up to 15 % wrong, 10 % frames lost"
    figures = (
        Figure("complete_share", "", ">= 0.99", "SUCCEEDED, and truly within 0.15 m of the goal"),
        Figure("off_track", "runs", "= 0", "the tape's middle was not between the wheels all the time"),
        Figure("phantom_or_missed_per_1000", "", "= 0", "nodes announced against nodes truly passed, per 1,000 edges"),
        Figure("mujoco_complete_share", "", ">= 0.98", "the same on MuJoCo's pictures"),
        Figure("realtime_factor", "s/s", ">= 10", "simulated over processor seconds of a run, median, own pictures"),
    )

    def run(self, ctx: Context) -> None:
        jobs = [(kind, at) for kind, count in (QUICK if ctx.quick else RUNS).items() for at in range(count)]
        todo = [job for job in jobs if ctx.saved(f"{job[0]} {job[1]}") is None]
        # a worker process each, made anew: nothing is inherited, nothing is shared
        spawn = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(_WORKERS, mp_context=spawn) as pool:
            running = [pool.submit(run_one, kind, at, FIRST) for kind, at in todo]
            try:
                for done, future in enumerate(as_completed(running)):
                    row = future.result()
                    ctx.row(row, key=row["run"])
                    ctx.progress(len(jobs) - len(todo) + done + 1, len(jobs), "runs")
            finally:
                pool.shutdown(wait=False, cancel_futures=True)
        self._report(ctx)

    def _report(self, ctx: Context) -> None:
        own, mujoco = ([row for row in ctx.rows.all if row["renderer"] == kind] for kind in RUNS)
        every = [*own, *mujoco]
        edges = sum(row["edges"] for row in own)
        wrong = sum(row["phantom"] + row["missed"] for row in own)
        ctx.figure("complete_share", sum(row["complete"] for row in own) / len(own), runs=len(own))
        ctx.figure("off_track", sum(row["off_max_m"] > TRACK_M for row in own), runs=len(own))
        ctx.figure("phantom_or_missed_per_1000", 1000.0 * wrong / edges, runs=edges)
        ctx.figure("mujoco_complete_share", sum(row["complete"] for row in mujoco) / len(mujoco), runs=len(mujoco))
        ctx.figure("realtime_factor", median(row["sim_s"] / row["cpu_s"] for row in own), runs=len(own))
        wall = median(row["sim_s"] / row["wall_s"] for row in own)
        ctx.note(
            f"a run is one thread; {_WORKERS} at a time and whatever else ran here: {wall:.1f} by the wall's clock"
        )
        ctx.note(f"farthest off the tape's middle: {max(row['off_max_m'] for row in every):.3f} m")
        theirs = sum(row["phantom"] + row["missed"] for row in mujoco)
        ctx.note(f"MuJoCo: {sum(row['edges'] for row in mujoco)} edges, {theirs} nodes phantom or missed")
        bad = [row for row in every if _why(row)]
        for row in bad[:20]:
            ctx.note(f"{row['run']}: {_why(row)}")
        if len(bad) > 20:
            ctx.note(f"and {len(bad) - 20} more: {names_of(bad[20:])}")

    def plot(self, axes: Any, rows: Sequence[Mapping[str, Any]]) -> None:
        """The true ways of some runs over their tape, failures first and in red."""
        drawn = sorted(rows, key=lambda row: (not _why(row), -row["edges"]))[:_DRAWN]
        figure, across = axes.figure, 3
        axes.set_axis_off()
        figure.set_size_inches(12, 12)
        for at, row in enumerate(drawn):
            part = figure.add_subplot(across, across, at + 1)
            kind, number = row["run"].split()
            world = scene(kind, int(number), FIRST)
            for tape in route_from(world.route).tape_m(world.pitch_m, 0.05):
                part.plot(tape[:, 0], tape[:, 1], color="0.8", linewidth=4.0, zorder=1)
            why = _why(row)
            xs, ys = zip(*row["way_m"], strict=True)
            part.plot(xs, ys, color="#d0413c" if why else "#2d6cb5", linewidth=1.0, zorder=2)
            part.plot(xs[0], ys[0], "o", color="#4c9f70", zorder=3)
            part.plot(xs[-1], ys[-1], "x" if why else "*", color="#d0413c" if why else "#4c9f70", zorder=3)
            part.set_title(f"{row['run']}: {why or 'reached'}"[:60], fontsize=7)
            part.set_aspect("equal")
            part.set_axis_off()


def _why(row: Mapping[str, Any]) -> str:
    """What went wrong in a run; empty: nothing."""
    told = [] if row["complete"] else [f"{row['outcome']} ({row['off_goal_m']:.2f} m from the goal)"]
    if row["off_max_m"] > TRACK_M:
        told.append(f"{row['off_max_m']:.3f} m off the tape")
    if row["phantom"] or row["missed"]:
        told.append(f"{row['phantom']} phantom and {row['missed']} missed nodes")
    return ", ".join(told)


BENCH = Route()
