"""Pure checks of the computer itself: Python, packages, plugins, supply, heat and room for recordings."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from robotd.setup.doctor.facts import Health
from robotd.setup.doctor.faults import found
from robotd.setup.doctor.findings import Finding

OLDEST, NEWEST = (3, 11), (3, 13)
LEAST_FREE_MB = 500
RIVALS: Mapping[str, tuple[str, str]] = {
    "opencv-python": ("opencv-python-headless", "both install the module cv2, and the later one breaks the other"),
    "opencv-contrib-python": ("opencv-python-headless", "both install the module cv2"),
    "serial": ("pyserial", "both install a module named serial; only that of pyserial can open a port"),
}
"""Distributions that must not stand beside one of ours: name to (ours, why)."""
EXTRAS: Mapping[str, str] = {"serialx": "serialx", "matplotlib": "plot"}
"""Modules that come with an extra of robotd."""


def check_python(version: tuple[int, int, int]) -> Finding:
    """Whether this Python is one that robotd is tested with."""
    said = ".".join(map(str, version))
    if version[:2] < OLDEST:
        return found("python too old", "python", version=said)
    if version[:2] > NEWEST:
        return found("python untested", "python", version=said)
    return Finding("good", "python", f"Python {said}")


def check_packages(requirements: Sequence[str], versions: Mapping[str, str]) -> list[Finding]:
    """Missing, too old and rival packages. versions: of the required ones and of the rivals, where installed."""
    findings: list[Finding] = []
    for line in requirements:
        match = re.match(r"\s*([A-Za-z0-9._-]+)\s*(?:\[[^]]*\])?\s*\(?([^;)]*)", line)
        if match is None:
            continue
        name, wanted = match[1], match[2].strip()
        if name not in versions:
            findings.append(found("package missing", "packages", name=name, wanted=wanted))
        elif not satisfies(versions[name], wanted):
            findings.append(found("package too old", "packages", name=name, have=versions[name], wanted=wanted))
    for rival, (ours, why) in RIVALS.items():
        if rival in versions:
            findings.append(found("rival package", "packages", rival=rival, name=ours, why=why))
    if not findings:
        findings.append(Finding("good", "packages", f"all {len(requirements)} are installed"))
    return findings


def required_names(requirements: Sequence[str]) -> list[str]:
    """The distributions of requirement lines, and the rivals of ours."""
    named = (re.match(r"[A-Za-z0-9._-]+", line.strip()) for line in requirements)
    return [*(match[0] for match in named if match), *RIVALS]


def satisfies(version: str, wanted: str) -> bool:
    """Whether a version lies in a range such as `>=2.3,<3`; only its leading numbers count, other clauses pass."""
    have = _numbers(version)
    for clause in filter(None, (part.strip() for part in wanted.split(","))):
        match = re.match(r"(>=|<=|==|!=|>|<)\s*([0-9][0-9.]*)\Z", clause)
        if match is None:
            continue
        limit = _numbers(match[2])
        length = max(len(have), len(limit))
        a, b = have + (0,) * (length - len(have)), limit + (0,) * (length - len(limit))
        holds = {">=": a >= b, "<=": a <= b, "==": a == b, "!=": a != b, ">": a > b, "<": a < b}
        if not holds[match[1]]:
            return False
    return True


def _numbers(version: str) -> tuple[int, ...]:
    match = re.match(r"[0-9]+(?:\.[0-9]+)*", version)
    return tuple(int(part) for part in match[0].split(".")) if match else ()


def check_plugins(plugins: Sequence[tuple[str, str, Exception | None]]) -> list[Finding]:
    """Entry points that cannot be imported."""
    broken = [
        import_fault(f"{group}: {name}", error, "cannot be imported: ")
        for group, name, error in plugins
        if error is not None
    ]
    return broken or [Finding("good", "plugins", f"all {len(plugins)} can be imported")]


def import_fault(subject: str, error: Exception, before: str = "") -> Finding:
    """What an error of importing or loading means. before: how the cause begins."""
    words = before + (str(error) or type(error).__name__)
    missing = (error.name or "").partition(".")[0] if isinstance(error, ImportError) else ""
    if missing in EXTRAS:
        return found("extra missing", subject, words=words, extra=EXTRAS[missing])
    if isinstance(error, ModuleNotFoundError) and missing and not missing.startswith("robotd"):
        return found("module missing", subject, words=words, module=missing)
    return found("plugin broken", subject, words=words)


def check_health(health: Health) -> list[Finding]:
    """A weak supply, heat, a full disk; where none of them is known to be there, nothing is said."""
    findings: list[Finding] = []
    if health.weak_now:
        findings.append(found("under-voltage now", "computer"))
    elif health.weak_before:
        findings.append(found("under-voltage before", "computer"))
    if health.celsius is not None:
        findings.append(found("too hot", "computer", celsius=round(health.celsius)))
    if health.free_mb is not None and health.free_mb < LEAST_FREE_MB:
        findings.append(found("disk nearly full", "computer", free_mb=health.free_mb))
    return findings
