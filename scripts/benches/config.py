"""`scripts/bench config`: wrong configs are refused at the right place with the right mend, good ones pass, soon."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from importlib.metadata import entry_points
from pathlib import Path
from statistics import median
from typing import Any

from benches.config_cases import Base, Mutant, Variant, mutant, variant
from benches.config_robots import BASES, FILES, POINTS
from benches.harness import ROOT, Bench, Context, Figure
from robotd.engine.parts import Parts
from robotd.setup.load import load_config
from robotd.setup.problems import ConfigError, dotted
from robotd.setup.registry import GROUPS, Registry

SHIPPED = ROOT / "configs"


class Bases:
    """The configs that are mutated: those of this folder and the shipped ones, each known to be good."""

    def __init__(self, folder: Path, shipped: Sequence[Path]) -> None:
        installed = [point for group in GROUPS.values() for point in entry_points(group=group)]
        self.registry = Registry([*POINTS, *installed])
        # laid out as the checkout is, so that a shipped config finds what it names beside its own folder
        self.folder = folder / "configs"
        self.folder.mkdir()
        (folder / "maps").symlink_to(ROOT / "maps")
        for name in FILES:
            (self.folder / name).touch()
        self.all: list[Base] = []
        self._parts: dict[tuple[str, bool], Parts] = {}
        for name, text in [*BASES.items(), *((file.stem, file.read_text(encoding="utf-8")) for file in shipped)]:
            for sim in (False, True):
                self._parts[name, sim] = self.load(text, sim=sim)
            self.all.append(Base.of(name, text, self.registry))

    def load(self, text: str, *, sim: bool = False, sets: Sequence[str] = ()) -> Parts:
        """The parts of a config text; raises ConfigError."""
        file = self.folder / "robot.yaml"
        file.write_bytes(text.encode())
        return load_config(file, sim=sim, sets=sets, registry=self.registry, whole=True).parts

    def original(self, name: str, *, sim: bool) -> Parts:
        """The parts of an unchanged base."""
        return self._parts[name, sim]


def judge_mutant(bases: Bases, case: Mutant) -> dict[str, Any]:
    """One row: refused at the right place with the right mend, or harmless, or wrong."""
    row: dict[str, Any] = {"mutant": case.kind, "base": case.base, "edit": case.edit}
    told: list[str] = []
    outcomes: list[str] = []
    for sim in (False, True):
        try:
            parts = bases.load(case.text, sim=sim)
        except ConfigError as error:
            told = [str(problem) for problem in error.problems]
            right = any(
                (p.line, p.column) == case.place
                and p.path == dotted(case.path)
                and case.hint in f"{p.message} {p.hint}"
                for p in error.problems
            )
            outcomes.append("refused" if right else "refused wrongly")
        else:
            outcomes.append("harmless" if parts == bases.original(case.base, sim=sim) else "accepted")
    row["outcome"] = outcomes[0] if outcomes[0] == outcomes[1] else " / ".join(outcomes)
    row["good"] = set(outcomes) <= {"refused", "harmless"}
    if not row["good"]:
        row |= {"expected": f"{case.place[0]}:{case.place[1]}: {dotted(case.path)} {case.hint}", "told": told[:5]}
    return row


def judge_variant(bases: Bases, case: Variant) -> dict[str, Any]:
    """One row: accepted, and equal to its base where it must be."""
    row: dict[str, Any] = {"variant": ", ".join(case.edits) or "unchanged", "base": case.base, "sim": case.sim}
    try:
        parts = bases.load(case.text, sim=case.sim, sets=case.sets)
    except ConfigError as error:
        return row | {"good": False, "told": [str(problem) for problem in error.problems[:5]]}
    if case.same and parts != bases.original(case.base, sim=case.sim):
        return row | {"good": False, "told": ["accepted, but it means something else"]}
    return row | {"good": True}


def seconds(command: Sequence[str]) -> float:
    """Wall time of a whole process. Raises RuntimeError with its output where it fails."""
    env = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    began = time.perf_counter()
    ran = subprocess.run(command, capture_output=True, text=True, timeout=60, env=env, check=False)
    took = time.perf_counter() - began
    if ran.returncode != 0:
        raise RuntimeError(f"{' '.join(command)} left with {ran.returncode}: {(ran.stdout + ran.stderr).strip()[:300]}")
    return took


class ConfigBench(Bench):
    name = "config"
    about = "robotd check as a process; mutated configs refused, valid variants accepted"
    figures = (
        Figure("check_seconds", "s", "<= 0.5", "whole process `robotd check configs/jetbot.yaml`, median"),
        Figure("mutants_refused_share", "", "= 1.0", "refused at the right place with the right mend, or harmless"),
        Figure("valid_accepted_share", "", "= 1.0", "variants accepted, and equal where they must be"),
    )

    def run(self, ctx: Context) -> None:
        self._check(ctx, 7 if ctx.quick else 31)
        with tempfile.TemporaryDirectory() as folder:
            try:
                bases = Bases(Path(folder), sorted(SHIPPED.glob("*.yaml")))
            except ConfigError as error:
                for figure in ("mutants_refused_share", "valid_accepted_share"):
                    ctx.figure(figure, None, runs=0, why=f"a shipped config is refused: {error.problems[0]}")
                return
            mutants, variants = (120, 80) if ctx.quick else (300, 200)
            for i in ctx.each(range(mutants), "mutants"):
                if ctx.saved(f"mutant {i}") is None:
                    ctx.row(judge_mutant(bases, mutant(bases.all, i)), key=f"mutant {i}")
            for i in ctx.each(range(variants), "variants"):
                if ctx.saved(f"variant {i}") is None:
                    ctx.row(judge_variant(bases, variant(bases.all, i)), key=f"variant {i}")
        for kind, figure in (("mutant", "mutants_refused_share"), ("variant", "valid_accepted_share")):
            good = [bool(row["good"]) for row in ctx.rows.all if kind in row]
            ctx.figure(figure, sum(good) / len(good), runs=len(good))
        harmless = sum(row.get("outcome") == "harmless" for row in ctx.rows.all)
        wrong = [row for row in ctx.rows.all if row.get("good") is False]
        ctx.note(f"{harmless} of the mutants are harmless: they parse to the very same parts")
        for row in wrong[:10]:
            ctx.note(f"wrong: {row}")

    def _check(self, ctx: Context, runs: int) -> None:
        check = [sys.executable, "-m", "robotd.cli", "check", str(SHIPPED / "jetbot.yaml")]
        script = Path(sys.executable).with_name("robotd")
        if script.is_file():
            check = [str(script), *check[3:]]
        plain = [sys.executable, "-c", "import numpy, pydantic; pydantic.BaseModel"]
        try:
            # the first run writes byte code, as on any machine after its first start
            seconds(check)
            for i in ctx.each(range(runs), "checks"):
                if ctx.saved(f"check {i}") is None:
                    ctx.row({"check_s": seconds(check), "imports_s": seconds(plain)}, key=f"check {i}")
        except RuntimeError as error:
            ctx.figure("check_seconds", None, runs=0, why=str(error))
            return
        rows = [row for row in ctx.rows.all if "check_s" in row]
        took, imports = (median(row[key] for row in rows) for key in ("check_s", "imports_s"))
        ctx.figure("check_seconds", took, baseline=imports, runs=len(rows))
        ctx.note("baseline of check_seconds: a process that imports numpy and pydantic and ends")

    def plot(self, axes: Any, rows: Sequence[Mapping[str, Any]]) -> None:
        checks = [row for row in rows if "check_s" in row]
        for key, label in (("imports_s", "numpy and pydantic alone"), ("check_s", "robotd check")):
            axes.hist([row[key] for row in checks], bins=20, alpha=0.7, label=label)
        axes.axvline(0.5, color="red", label="target")
        axes.set_xlabel("seconds of the whole process")
        axes.legend()


BENCH = ConfigBench()
