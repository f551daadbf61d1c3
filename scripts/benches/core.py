"""`scripts/bench core`: what the runtime costs and how punctual it is, each beside a plain program in the same run."""

from __future__ import annotations

import gc
import os
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

from benches import core_memory, core_time, core_turn
from benches.harness import Bench, Context, Figure


class Core(Bench):
    """The rows of the core, in the order of the time they take."""

    name: ClassVar[str] = "core"
    about: ClassVar[str] = "the runtime beside the same functions called by hand"
    figures: ClassVar[tuple[Figure, ...]] = (
        Figure("scan_to_command_ratio_p50", "x", "<= 1.3", "whole runtime over the same functions in one task"),
        Figure("scan_to_command_over_min_p50", "x", "", "over a bare min() of the scan"),
        Figure("frame_to_scan_ratio_p50", "x", "<= 1.2", "640x480 frame to command over scan to command"),
        Figure("tick_late_over_nanosleep_p99", "x", "<= 2.5", "act tick over a clock_nanosleep thread"),
        Figure("tick_late_busy_ms_p99", "ms", "<= 10", "with onnxruntime and cv2 busy"),
        Figure("staleness_excess_p99", "periods", "<= 1.05", "age of the frame behind a command, less compute"),
        Figure("sim_seconds_per_second", "s/s", ">= 500", "virtual time, 40 Hz scan and 20 Hz behaviour"),
        Figure("rss_lidar_robot_mb", "MB", "<= 50", "resident memory, no bridges, no recorder"),
        Figure("rss_with_page_mb", "MB", "<= 80", "resident memory with the page"),
    )

    def run(self, ctx: Context) -> None:
        ctx.note(f"scheduling: ordinary (SCHED_OTHER, nice {os.nice(0)})")
        for step in (
            core_turn.measure,
            core_time.measure_tick,
            core_time.measure_staleness,
            core_time.measure_sim,
            core_memory.measure,
        ):
            ctx.progress(0, None, step.__name__)
            step(ctx)
            gc.unfreeze()

    def plot(self, axes: Any, rows: Sequence[Mapping[str, Any]]) -> None:
        turn = next(row for row in rows if row.get("what") == "turn")
        names = [name for name in turn if name.endswith("_us_p50")]
        axes.barh([name.removesuffix("_us_p50") for name in names], [turn[name] for name in names])
        axes.set_xlabel("microseconds, median")
        axes.set_title("from bytes or publication to the encoded command")


BENCH = Core()
