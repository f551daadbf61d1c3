"""What is wrong with a config: every problem with its place, printed together in the order of the file."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TypeAlias

Path: TypeAlias = tuple[str | int, ...]
"""Where a value stands in the config: keys of mappings and indices of lists, from the top."""


def dotted(path: Path) -> str:
    """A path as people read it: `behaviours.vfh_follow.range_max_m`, `robot.footprint_m[1]`."""
    text = ""
    for step in path:
        text += f"[{step}]" if isinstance(step, int) else f".{step}" if text else step
    return text


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing that is wrong.

    `file` names the source: the file as the user gave it, `--set a.b`, or the environment variable. `line` and
    `column` count from 1 and are None where the source has none. `hint` is the way to mend it.
    """

    file: str
    line: int | None
    column: int | None
    path: str
    message: str
    hint: str = ""

    def __str__(self) -> str:
        place = self.file if self.line is None else f"{self.file}:{self.line}:{self.column or 1}"
        text = f"{place}: {self.path}: {self.message}" if self.path else f"{place}: {self.message}"
        return f"{text}; {self.hint}" if self.hint else text


class ConfigError(Exception):
    """The config cannot be used (exit code 78). Its text has one line for each problem, sorted by place."""

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems: tuple[Problem, ...] = in_order(problems)
        super().__init__("\n".join(map(str, self.problems)))


def in_order(problems: Iterable[Problem]) -> tuple[Problem, ...]:
    """Without repetitions; the file's problems first, by line and column, then those of other sources."""
    return tuple(
        sorted(
            dict.fromkeys(problems),
            key=lambda p: (p.line is None, p.file, p.line or 0, p.column or 0),
        )
    )
