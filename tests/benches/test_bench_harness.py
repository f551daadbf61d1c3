"""The harness: figures against targets, rows that survive, one JSON object as the last line."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "scripts"))

from benches.harness import Bench, Context, Figure, Rows, measure, names, result, table  # noqa: E402

from benches import harness  # noqa: E402  # scripts/ is no package of the distribution


class Squares(Bench):
    name = "squares"
    about = "for the tests"
    figures = (
        Figure("sum", "m", "= 30"),
        Figure("mean_us", "us", "<= 5"),
        Figure("printed", "s"),
        Figure("never", "", ">= 1"),
    )
    stop_at: int | None = None

    def run(self, ctx: Context) -> None:
        for i in ctx.each(range(5)):
            if i == self.stop_at:
                raise KeyboardInterrupt
            if ctx.saved(f"square {i}") is None:
                ctx.row({"square": i * i}, key=f"square {i}")
        ctx.figure("sum", sum(row["square"] for row in ctx.rows.all), "m", runs=5)
        ctx.figure("mean_us", 6.0, baseline=2.0, runs=5)
        ctx.figure("printed", float("inf"))
        ctx.note("a remark")


def context(bench: Bench, folder: Path | None = None, code: str = "code", said: list[str] | None = None) -> Context:
    say = (said if said is not None else []).append
    return Context(bench, False, Path("data"), Rows(bench.name, folder, code, say), say)


@pytest.mark.parametrize(
    ("target", "value", "met"),
    [
        ("<= 1.3", 1.3, True),
        ("<= 1.3", 1.31, False),
        (">= 500", 499.0, False),
        ("= 0", 0.0, True),
        ("= 1.0", 0.999, False),
        ("<= 1", None, False),
        ("", 5.0, None),
    ],
)
def test_targets(target: str, value: float | None, met: bool | None) -> None:
    assert Figure("f", "s", target).met(value) is met


def test_the_object_has_every_declared_figure() -> None:
    ctx = context(Squares())
    assert measure(ctx.bench, ctx)
    made = json.loads(json.dumps(result(ctx), allow_nan=False))
    assert list(made) == ["bench", "quick", "figures", "rows"]
    assert made["figures"] == {
        "sum": {"value": 30.0, "unit": "m", "baseline": None, "runs": 5, "why": None},
        "mean_us": {"value": 6.0, "unit": "us", "baseline": 2.0, "runs": 5, "why": None},
        "printed": {"value": None, "unit": "s", "baseline": None, "runs": 1, "why": "the result is inf"},
        "never": {"value": None, "unit": "", "baseline": None, "runs": 0, "why": "not measured"},
    }
    assert made["rows"] == [{"square": i * i} for i in range(5)] + [{"note": "a remark"}]


def test_the_table_says_pass_and_red() -> None:
    ctx = context(Squares())
    measure(ctx.bench, ctx)
    words = {line.split()[0]: line.split()[-1] for line in table(ctx)[2:6]}
    assert words == {"sum": "PASS", "mean_us": "RED", "printed": "-", "never": "RED"}


def test_a_failure_is_told_and_leaves_no_figure_out(capsys: pytest.CaptureFixture[str]) -> None:
    class Broken(Squares):
        def run(self, ctx: Context) -> None:
            ctx.figure("sum", 3)
            raise RuntimeError("no lidar")

    ctx = context(Broken())
    assert not measure(ctx.bench, ctx)
    assert ctx.found["sum"].value == 3.0
    assert ctx.found["never"].why == "the measurement failed: RuntimeError: no lidar"
    assert "no lidar" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "value", "unit", "why", "words"),
    [
        ("other", 1.0, "", None, "declares no figure"),
        ("sum", 1.0, "s", None, "declared in 'm'"),
        ("sum", None, "", None, "no value and no reason"),
    ],
)
def test_wrong_reports_are_refused(name: str, value: float | None, unit: str, why: str | None, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        context(Squares()).figure(name, value, unit, why=why)


def test_an_interrupted_run_is_taken_up(tmp_path: Path) -> None:
    first = Squares()
    first.stop_at = 3
    ctx = context(first, tmp_path)
    with pytest.raises(KeyboardInterrupt):
        measure(first, ctx)
    ctx.rows.close(finished=False)
    with (tmp_path / "squares.jsonl").open("a") as file:
        file.write('{"key": "square 3", "ro')  # the power went out

    said: list[str] = []
    again = context(Squares(), tmp_path, said=said)
    assert [row["square"] for row in again.rows.all] == [0, 1, 4]
    assert "3 rows of an interrupted run" in said[0]
    assert measure(again.bench, again)
    again.rows.close(finished=True)
    assert again.found["sum"].value == 30.0

    anew = context(Squares(), tmp_path)
    anew.rows.close(finished=False)
    assert anew.rows.all == [], "a finished run is begun anew"


def test_rows_of_other_code_are_not_mixed_in(tmp_path: Path) -> None:
    ctx = context(Squares(), tmp_path, "one")
    ctx.row({"square": 0}, key="square 0")
    ctx.rows.close(finished=False)
    said: list[str] = []
    other = context(Squares(), tmp_path, "two", said)
    other.rows.close(finished=False)
    assert other.rows.all == []
    assert "other code" in said[0]


def test_two_rows_with_one_key_are_refused() -> None:
    ctx = context(Squares())
    ctx.row({}, key="a")
    with pytest.raises(ValueError, match="two rows have the key"):
        ctx.row({}, key="a")


def test_the_fingerprint_follows_the_code(tmp_path: Path) -> None:
    (tmp_path / "runtime").mkdir()
    code = tmp_path / "runtime" / "a.py"
    code.write_text("a = 1\n")
    before = harness.fingerprint(tmp_path)
    assert harness.fingerprint(tmp_path) == before
    code.write_text("a = 2\n")
    assert harness.fingerprint(tmp_path) != before


def test_all_puts_the_bench_before_each_figure() -> None:
    ctx = context(Squares())
    measure(ctx.bench, ctx)
    joined = harness._joined([result(ctx)], quick=True)
    assert joined["figures"]["squares.sum"]["value"] == 30.0
    assert joined["rows"][0] == {"bench": "squares", "square": 0}


def start(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(ROOT / "scripts" / "bench"), *words],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
        env=os.environ,
    )


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (("nothing",), 64, "no bench 'nothing'; there is"),
        ((), 64, "NAME"),
        (("config", "--fast"), 64, "--fast"),
        (("--help",), 0, "--quick"),
    ],
)
def test_command_lines(words: tuple[str, ...], code: int, said: str) -> None:
    ran = start(*words)
    assert ran.returncode == code
    assert said in ran.stdout + ran.stderr


def test_every_bench_has_figures_of_its_own() -> None:
    import importlib

    assert "config" in names()
    for name in names():
        bench: Any = importlib.import_module(f"benches.{name}").BENCH
        assert bench.name == name and bench.figures
        assert all(f.met(0.0) in (True, False, None) for f in bench.figures)
