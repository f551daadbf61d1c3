"""A small sample of `scripts/bench config`: wrong configs refused at the right place, good ones accepted."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "scripts"))

from benches.config import SHIPPED, Bases, judge_mutant, judge_variant  # scripts/ is no package
from benches.config_cases import KINDS, mutant, variant


@pytest.fixture(scope="module")
def bases(tmp_path_factory: pytest.TempPathFactory) -> Bases:
    return Bases(tmp_path_factory.mktemp("configs"), sorted(SHIPPED.glob("*.yaml")))


@pytest.mark.parametrize("kind", KINDS)
def test_mutants_are_refused_at_their_place(bases: Bases, kind: str) -> None:
    first = KINDS.index(kind)
    rows = [judge_mutant(bases, mutant(bases.all, first + len(KINDS) * i)) for i in range(6)]
    assert [row for row in rows if not row["good"]] == []


def test_variants_are_accepted(bases: Bases) -> None:
    rows = [judge_variant(bases, variant(bases.all, i)) for i in range(24)]
    assert [row for row in rows if not row["good"]] == []


def test_the_judge_is_not_blind(bases: Bases) -> None:
    """A problem at another place, with another mend, or none at all is a failure."""
    case = mutant(bases.all, KINDS.index("misspelt key"))
    line, column = case.place
    assert not judge_mutant(bases, replace(case, place=(line + 1, column)))["good"]
    assert not judge_mutant(bases, replace(case, hint="'another_key'"))["good"]
    base = bases.all[0]
    harmless = replace(case, base=base.name, text=base.text)
    assert judge_mutant(bases, harmless)["outcome"] == "harmless"
    other = replace(harmless, text=base.text.replace("track_m: 0.26", "track_m: 0.27"))
    assert judge_mutant(bases, other)["outcome"] == "accepted"


def test_cases_follow_from_their_number(bases: Bases) -> None:
    assert mutant(bases.all, 17) == mutant(bases.all, 17)
    assert variant(bases.all, 17) == variant(bases.all, 17)
