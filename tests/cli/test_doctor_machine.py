"""The doctor, the computer itself: Python, packages, plugins, supply."""

from __future__ import annotations

import pytest

from robotd.setup.doctor.facts import Health
from robotd.setup.doctor.findings import exit_code
from robotd.setup.doctor.machine import check_health, check_packages, check_plugins, check_python, satisfies


@pytest.mark.parametrize(
    ("version", "level", "code"),
    [
        ((3, 10, 14), "error", 69),
        ((3, 11, 0), "good", 0),
        ((3, 13, 5), "good", 0),
        ((3, 14, 0), "warning", 0),
        ((4, 0, 0), "warning", 0),
    ],
)
def test_python(version: tuple[int, int, int], level: str, code: int) -> None:
    finding = check_python(version)
    assert (finding.level, finding.code) == (level, code)


@pytest.mark.parametrize(
    ("health", "faults"),
    [
        (Health(), []),
        (Health(free_mb=10_000), []),
        (Health(weak_now=True, weak_before=True), [("under-voltage now", 69)]),
        (Health(weak_before=True), [("under-voltage before", 0)]),
        (Health(celsius=86.2), [("too hot", 0)]),
        (Health(free_mb=499), [("disk nearly full", 0)]),
    ],
)
def test_the_computer(health: Health, faults: list[tuple[str, int]]) -> None:
    assert [(finding.fault, finding.code) for finding in check_health(health)] == faults


@pytest.mark.parametrize(
    ("required", "have", "code", "words"),
    [
        ([], {}, 0, "all 0 are installed"),
        (["numpy>=2.0"], {"numpy": "2.1"}, 0, "all 1 are installed"),
        (["numpy>=2.0"], {}, 69, "numpy is not installed -> pip install 'numpy>=2.0'"),
        (["numpy>=2.0"], {"numpy": "1.26.4"}, 69, "numpy 1.26.4 is installed, >=2.0 is needed"),
        (["aiomqtt<3,>=2.3"], {"aiomqtt": "3.0"}, 69, "aiomqtt 3.0 is installed, <3,>=2.3 is needed"),
        (['numpy[x] (>=2.0); python_version > "3"'], {"numpy": "2.0"}, 0, "all 1"),
        ([], {"opencv-python": "4.10"}, 0, "opencv-python stands beside opencv-python-headless"),
        ([], {"serial": "0.0.97"}, 0, "pip uninstall -y serial pyserial && pip install pyserial"),
    ],
)
def test_packages(required: list[str], have: dict[str, str], code: int, words: str) -> None:
    findings = check_packages(required, have)
    assert exit_code(findings) == code
    assert words in " ".join(f"{finding.cause} -> {finding.mend}" for finding in findings)


@pytest.mark.parametrize(
    ("version", "wanted", "holds"),
    [
        ("2.0", ">=2.0", True),
        ("2", ">=2.0.0", True),
        ("1.9.9", ">=2", False),
        ("2.3.1", ">=2.3,<3", True),
        ("3.0rc1", ">=2.3,<3", False),
        ("1.0", "==1.0.0", True),
        ("1.0", "!=1", False),
        ("1.0", ">1", False),
        ("1.0.1", ">1", True),
        ("1.0", "<=1", True),
        ("1.0", "~=9.0", True),
        ("1.0", "", True),
    ],
)
def test_satisfies(version: str, wanted: str, holds: bool) -> None:
    assert satisfies(version, wanted) is holds


@pytest.mark.parametrize(
    ("error", "code", "mend"),
    [
        (None, 0, ""),
        (ModuleNotFoundError("No module named 'cv2'", name="cv2"), 69, "pip install cv2"),
        (ModuleNotFoundError("No module named 'serialx'", name="serialx.core"), 69, "pip install 'robotd[serialx]'"),
        (AttributeError("no class Ld19"), 69, "`robotd plugins` says which one it is"),
        (SyntaxError(), 69, "install its distribution again"),
    ],
)
def test_plugins(error: Exception | None, code: int, mend: str) -> None:
    findings = check_plugins([("robotd.devices", "ld19", error)])
    assert exit_code(findings) == code
    assert mend in findings[0].mend
