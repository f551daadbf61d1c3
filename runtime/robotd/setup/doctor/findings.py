"""What the doctor says: findings with their cause, mend and exit code, and the lines that people read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

from robotd.engine.logs import printable
from robotd.setup.exit_codes import OK

Level: TypeAlias = Literal["good", "note", "warning", "error"]


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was looked at. `code`: exit code that it calls for, 0 unless it is an error.

    fault: the name of its row in `robotd.setup.doctor.faults`, empty where nothing is wrong.
    """

    level: Level
    subject: str
    cause: str
    mend: str = ""
    code: int = OK
    fault: str = ""


def exit_code(findings: Sequence[Finding]) -> int:
    """78 where the config is wrong, else 77, 75, 70, 69 in this order (docs/cli.md), else 0."""
    return max((finding.code for finding in findings), default=OK)


def report(findings: Sequence[Finding]) -> list[str]:
    """Lines for people: level, subject, cause, and the mend below it."""
    width = max((len(finding.subject) for finding in findings), default=0)
    lines: list[str] = []
    for finding in findings:
        lines.append(f"{finding.level:<8} {finding.subject:<{width}}  {printable(finding.cause)}")
        if finding.mend:
            lines.append(f"{'':<8} {'':<{width}}  -> {printable(finding.mend)}")
    errors = sum(finding.level == "error" for finding in findings)
    warnings = sum(finding.level == "warning" for finding in findings)
    counted = f"{errors} error{'s' * (errors != 1)}, {warnings} warning{'s' * (warnings != 1)}"
    return [*lines, "", counted if errors or warnings else "nothing stands in the way"]
