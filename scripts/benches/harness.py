"""What all measurements share: figures with targets, rows that survive an interruption, progress, one form of output.

A measurement is a module of this folder with `BENCH = MyBench()`:

    class MyBench(Bench):
        name = "mine"
        figures = (Figure("lookup_us_p50", "us", "<= 3", "one lookup"),)

        def run(self, ctx: Context) -> None:
            for seed in ctx.each(range(20 if ctx.quick else 500)):
                if ctx.saved(f"seed {seed}") is None:
                    ctx.row({"us": time_lookups(seed)}, key=f"seed {seed}")
            us = [row["us"] for row in ctx.rows.all]
            ctx.figure("lookup_us_p50", median(us), baseline=time_plain_dict(), runs=len(us))

Exit codes: 0 all was measured (a missed target is a result, not a failure), 64 wrong command line, 70 a measurement
failed, 130 interrupted.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib
import json
import math
import operator
import os
import platform
import sys
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Sized
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, TextIO, TypeVar

ROOT = Path(__file__).resolve().parents[2]
ItemT = TypeVar("ItemT")
_COMPARE: dict[str, Callable[[float, float], bool]] = {"<=": operator.le, ">=": operator.ge, "=": operator.eq}
_NOT_A_BENCH = ("__init__", "__main__", "harness")


@dataclass(frozen=True, slots=True)
class Figure:
    """One number that a bench promises. `target`: `<= 1.3`, `>= 500`, `= 0`, or empty where it is only printed."""

    name: str
    unit: str
    target: str = ""
    about: str = ""

    def met(self, value: float | None) -> bool | None:
        """Whether a value meets the target; None where there is no target. What was not measured does not meet it."""
        if not self.target:
            return None
        sign, _, bound = self.target.partition(" ")
        return value is not None and _COMPARE[sign](value, float(bound))


@dataclass(frozen=True, slots=True)
class Measured:
    """What was found for one figure. `why`: why there is no value."""

    value: float | None
    unit: str
    baseline: float | None = None
    runs: int = 0
    why: str | None = None

    def as_json(self) -> dict[str, Any]:
        """As it stands in the output."""
        return {
            "value": self.value, "unit": self.unit, "baseline": self.baseline, "runs": self.runs, "why": self.why,
        }  # fmt: skip


class Bench:
    """One measurement."""

    name: ClassVar[str]
    about: ClassVar[str] = ""
    figures: ClassVar[tuple[Figure, ...]] = ()

    def run(self, ctx: Context) -> None:
        """Measure and report every figure through `ctx`."""
        raise NotImplementedError

    def plot(self, axes: Any, rows: Sequence[Mapping[str, Any]]) -> None:
        """Draw the rows on matplotlib axes; called with `--plot`."""
        axes.set_title(f"{self.name}: {len(rows)} rows")


class Rows:
    """Rows of one bench on disk, one JSON object a line; without a folder they live in memory only.

    A file that an interrupted run of the very same code left behind is taken up again; one of a finished run, or of
    other code, is begun anew.
    """

    def __init__(self, name: str, folder: Path | None, fingerprint: str, say: Callable[[str], None]) -> None:
        self.all: list[dict[str, Any]] = []
        self._by_key: dict[str, dict[str, Any]] = {}
        self._file: TextIO | None = None
        if folder is None:
            return
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / f"{name}.jsonl"
        for key, row in _unfinished(path, fingerprint, say):
            self._keep(key, row)
        if self.all:
            say(f"{path}: {len(self.all)} rows of an interrupted run are taken up")
        # written anew, so that a line that was cut off is gone
        part = path.with_suffix(".part")
        with part.open("w", encoding="utf-8") as file:
            file.write(json.dumps({"bench": name, "fingerprint": fingerprint}) + "\n")
            file.writelines(json.dumps({"key": key, "row": row}) + "\n" for key, row in self._by_key.items())
        part.replace(path)
        self._file = path.open("a", encoding="utf-8")

    def saved(self, key: str) -> dict[str, Any] | None:
        """The row of a key, where it was measured already."""
        return self._by_key.get(key)

    def add(self, key: str, row: dict[str, Any]) -> None:
        """Keep a row; it is on disk when this returns."""
        self._keep(key, row)
        if self._file is not None:
            self._file.write(json.dumps({"key": key, "row": row}) + "\n")
            self._file.flush()

    def close(self, finished: bool) -> None:
        """The run ended; a finished one is not taken up again."""
        if self._file is not None:
            if finished:
                self._file.write(json.dumps({"finished": True}) + "\n")
            self._file.close()

    def _keep(self, key: str, row: dict[str, Any]) -> None:
        if key in self._by_key:
            raise ValueError(f"two rows have the key {key!r}")
        self._by_key[key] = row
        self.all.append(row)


def _unfinished(path: Path, fingerprint: str, say: Callable[[str], None]) -> Iterator[tuple[str, dict[str, Any]]]:
    if not path.is_file():
        return
    lines: list[dict[str, Any]] = []
    for text in path.read_text(encoding="utf-8").splitlines():
        try:
            lines.append(json.loads(text))
        except ValueError:
            break  # cut off in the middle of a line
    if not lines or any("finished" in line for line in lines):
        return
    if lines[0].get("fingerprint") != fingerprint:
        say(f"{path}: rows of other code are not taken up; beginning anew")
        return
    yield from ((line["key"], line["row"]) for line in lines[1:])


@dataclass(slots=True)
class Context:
    """A bench's hold on its run. `data`: the folder of test data; `quick`: the small sample is wanted."""

    bench: Bench
    quick: bool
    data: Path
    rows: Rows
    say: Callable[[str], None]
    found: dict[str, Measured] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    _told_at: float = 0.0

    def figure(
        self,
        name: str,
        value: float | None,
        unit: str = "",
        *,
        baseline: float | None = None,
        runs: int = 1,
        why: str | None = None,
    ) -> None:
        """Report a figure; no value needs a reason. Raises ValueError for a figure that the bench did not declare."""
        declared = {figure.name: figure for figure in self.bench.figures}
        if name not in declared:
            raise ValueError(f"{self.bench.name} declares no figure {name!r}")
        if unit and unit != declared[name].unit:
            raise ValueError(f"{name} is declared in {declared[name].unit!r}, not {unit!r}")
        if value is not None and not math.isfinite(value):
            value, why = None, f"the result is {value}"
        if value is None and not why:
            raise ValueError(f"{name} has no value and no reason")
        self.found[name] = Measured(
            None if value is None else float(value),
            declared[name].unit,
            None if baseline is None or not math.isfinite(baseline) else float(baseline),
            runs,
            why,
        )

    def note(self, text: str) -> None:
        """Something that a reader of the figures must know (scheduling class, what was left out)."""
        self.notes.append(text)

    def row(self, row: dict[str, Any], *, key: str | None = None) -> dict[str, Any]:
        """Keep one result. With a `key` (unique in the bench) an interrupted run finds it again by `saved`."""
        self.rows.add(key if key is not None else f"#{len(self.rows.all)}", row)
        return row

    def saved(self, key: str) -> dict[str, Any] | None:
        """The row that an interrupted run left behind under a key."""
        return self.rows.saved(key)

    def each(self, items: Iterable[ItemT], what: str = "") -> Iterator[ItemT]:
        """The items, one by one, with progress."""
        total = len(items) if isinstance(items, Sized) else None
        for count, item in enumerate(items):
            self.progress(count, total, what)
            yield item

    def progress(self, done: int, total: int | None = None, what: str = "") -> None:
        """Say how far it is, at most every two seconds."""
        now = time.monotonic()
        if now - self._told_at >= 2.0:
            self._told_at = now
            of = f" of {total}" if total is not None else ""
            self.say(f"{self.bench.name}: {what + ' ' if what else ''}{done}{of}")


# ------------------------------------------------------------------------------------------------- running


def names() -> list[str]:
    """Benches of this folder."""
    folder = Path(__file__).parent
    return sorted(
        file.stem for file in folder.glob("*.py") if file.stem not in _NOT_A_BENCH and "BENCH = " in file.read_text()
    )


def fingerprint(root: Path = ROOT) -> str:
    """Changes when any code that may be measured changes."""
    digest = hashlib.sha256()
    for shelf in ("runtime", "plugins", "devices", "scripts/benches", "configs", "maps"):
        for file in sorted((root / shelf).rglob("*")):
            if file.suffix in (".py", ".yaml", ".json"):
                digest.update(str(file.relative_to(root)).encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


def measure(bench: Bench, ctx: Context) -> bool:
    """Run one bench; False where it failed. Every declared figure has an entry afterwards."""
    why, good = "not measured", True
    try:
        bench.run(ctx)
    except Exception as error:
        traceback.print_exc(file=sys.stderr)
        why, good = f"the measurement failed: {type(error).__name__}: {error}", False
    for figure in bench.figures:
        ctx.found.setdefault(figure.name, Measured(None, figure.unit, why=why))
    return good


def result(ctx: Context) -> dict[str, Any]:
    """The object of `--json`."""
    return {
        "bench": ctx.bench.name,
        "quick": ctx.quick,
        "figures": {f.name: ctx.found[f.name].as_json() for f in ctx.bench.figures},
        "rows": [*ctx.rows.all, *({"note": note} for note in ctx.notes)],
    }


def table(ctx: Context) -> list[str]:
    """The figures for people: value, baseline, target, and PASS or RED."""
    lines = [f"{ctx.bench.name}{' (quick)' if ctx.quick else ''}: {ctx.bench.about}"]
    cells = [("figure", "value", "baseline", "runs", "target", "")]
    for figure in ctx.bench.figures:
        found = ctx.found[figure.name]
        value = "none" if found.value is None else f"{found.value:.4g} {found.unit}".strip()
        baseline = "" if found.baseline is None else f"{found.baseline:.4g}"
        met = figure.met(found.value)
        verdict = "" if met is None else "PASS" if met else "RED"
        cells.append((figure.name, value, baseline, str(found.runs), figure.target or "-", verdict))
    widths = [max(len(row[i]) for row in cells) for i in range(6)]
    lines += ["  " + "  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)).rstrip() for row in cells]
    lines += [f"  {name}: {found.why}" for name, found in ctx.found.items() if found.why]
    return lines + [f"  note: {note}" for note in ctx.notes]


def machine() -> str:
    """Where it was measured."""
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else math.nan
    return (
        f"{platform.python_implementation()} {platform.python_version()}, {platform.system()} {platform.machine()}, "
        f"{os.cpu_count()} cores, load {load:.1f}"
    )


def _data_folder() -> Path:
    return Path(os.environ.get("ROBOTD_DATA", ROOT.parent / "shared" / "data"))


def parse(argv: Sequence[str]) -> argparse.Namespace:
    """The command line; leaves with 64 for a wrong one."""
    parser = argparse.ArgumentParser(prog="scripts/bench", description=__doc__.split("\n")[0] if __doc__ else "")
    known = names()
    parser.add_argument("name", metavar="NAME", help=f"{', '.join(known)}, or all")
    parser.add_argument("--json", action="store_true", help="print one JSON object as the last line")
    parser.add_argument("--quick", action="store_true", help="the small sample: within a minute, nothing is saved")
    parser.add_argument("--plot", action="store_true", help="draw the rows as PNG beside them")
    parser.add_argument("--data", type=Path, default=_data_folder(), help="test data (default: shared/data)")
    parser.add_argument("--rows", type=Path, default=Path("bench-rows"), help="where rows go (default: bench-rows)")
    # argparse would leave with 2
    parser.exit_on_error = False
    try:
        args = parser.parse_args(argv)
    except argparse.ArgumentError as error:
        print(f"scripts/bench: {error}", file=sys.stderr)
        raise SystemExit(64) from error
    except SystemExit as error:
        raise SystemExit(64 if error.code else 0) from error
    if args.name != "all" and args.name not in known:
        print(f"scripts/bench: no bench {args.name!r}; there is {', '.join(known)}, all", file=sys.stderr)
        raise SystemExit(64)
    return args


def _plot(ctx: Context, folder: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    folder.mkdir(parents=True, exist_ok=True)
    figure, axes = pyplot.subplots(figsize=(8, 5))
    ctx.bench.plot(axes, ctx.rows.all)
    path = folder / f"{ctx.bench.name}{'-quick' if ctx.quick else ''}.png"
    figure.savefig(path, dpi=120)
    pyplot.close(figure)
    ctx.say(f"drew {path}")


def main(argv: Sequence[str]) -> int:
    """Run what the command line asks for; returns the exit code."""
    args = parse(argv)

    def say(text: str) -> None:
        print(text, file=sys.stderr, flush=True)

    results, good, code = [], True, fingerprint()
    print(machine())
    for name in names() if args.name == "all" else [args.name]:
        bench: Bench = importlib.import_module(f"benches.{name}").BENCH
        rows = Rows(name, None if args.quick else args.rows, code, say)
        ctx = Context(bench, args.quick, args.data, rows, say)
        finished = False
        try:
            finished = measure(bench, ctx)
        except KeyboardInterrupt:
            say(f"{name}: interrupted" + ("" if args.quick else "; the same command takes it up again"))
            return 130
        finally:
            rows.close(finished)
        good = good and finished
        print("\n".join(table(ctx)), flush=True)
        if args.plot:
            _plot(ctx, args.rows)
        results.append(result(ctx))
    if args.json:
        print(json.dumps(results[0] if args.name != "all" else _joined(results, args.quick)))
    return 0 if good else 70


def _joined(results: Sequence[dict[str, Any]], quick: bool) -> dict[str, Any]:
    return {
        "bench": "all",
        "quick": quick,
        "figures": {f"{r['bench']}.{name}": figure for r in results for name, figure in r["figures"].items()},
        "rows": [{"bench": r["bench"], **row} for r in results for row in r["rows"]],
    }
