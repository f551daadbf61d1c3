"""`scripts/bench devices`: damaged lidar streams, the cost of reading, serial lines in and out of a whole runtime."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

from benches import devices_estop, devices_integrity, devices_parse, devices_replug, devices_serial
from benches.harness import Bench, Context, Figure


class Devices(Bench):
    """Lidars without a runtime, then serial devices within a whole one."""

    name: ClassVar[str] = "devices"
    about: ClassVar[str] = "damaged streams, the cost of reading, stops and returns on serial lines"
    figures: ClassVar[tuple[Figure, ...]] = (
        Figure("corrupt_accepted", "", "= 0", "packets that a flip, drop, insertion, burst or repetition made"),
        Figure("good_lost_per_fault", "packets", "<= 1.1", "the one that was hit included; worst protocol and kind"),
        Figure("multibyte_over_theory", "x", "<= 1.5", "two bytes of a packet changed, over 1 in 256"),
        Figure("legacy_wrong_per_fault", "nodes", "<= 0.6", "RPLIDAR nodes have no check; worst kind"),
        Figure("parse_us_per_sample_legacy", "us", "<= 4", "bytes to scans, beside pyrplidar's decoding"),
        Figure("parse_us_per_sample_capsule", "us", "<= 1", "bytes to scans, beside pyrplidar's decoding"),
        Figure("serial_over_bare_reader_p50", "x", "<= 1.4", "serial in to serial out through the runtime"),
        Figure("serial_over_c_p50", "x", "", "the same over a C robot"),
        Figure("estop_ms_p99", "ms", "<= 2", "from e-stop to its bytes on a full, stuck port"),
        Figure("replug_failures", "", "= 0", "200 cycles a serial device"),
    )

    def run(self, ctx: Context) -> None:
        devices_parse.measure(ctx)
        devices_integrity.measure_nodes(ctx)
        devices_integrity.measure(ctx)
        devices_serial.measure(ctx)
        devices_estop.measure(ctx)
        devices_replug.measure(ctx)

    def plot(self, axes: Any, rows: Sequence[Mapping[str, Any]]) -> None:
        parsed = [row for row in rows if row.get("what") == "parse"]
        names = [f"{row['model']} {row['answer']}" for row in parsed]
        axes.barh(names, [row["peer_us"] or 0.0 for row in parsed], color="lightgrey", label="pyrplidar")
        axes.barh(names, [row["us"] for row in parsed], height=0.4, label="robotd")
        axes.set_xlabel("CPU microseconds a sample")
        axes.legend()


BENCH = Devices()
