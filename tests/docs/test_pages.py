"""README and docs keep their promises: links lead somewhere, the commands are just those, YAML examples are YAML."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from robotd.setup.yaml_source import read_yaml

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
NAMES = [str(page.relative_to(ROOT)) for page in PAGES]

_LINK = re.compile(r"\]\(([^)\s]+)\)")
_FENCE = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)


def anchors(page: Path) -> set[str]:
    """The anchors that a forge makes of a page's headings."""
    headings = re.findall(r"^#+ (.+)$", _FENCE.sub("", page.read_text()), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("name", NAMES)
def test_links_lead_somewhere(name: str) -> None:
    page = ROOT / name
    for link in _LINK.findall(_FENCE.sub("", page.read_text())):
        if "://" in link or link.startswith("mailto:"):
            continue
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        assert target.exists(), link
        assert target.is_relative_to(ROOT), link
        if anchor:
            assert anchor in anchors(target), link


@pytest.mark.parametrize("name", NAMES)
def test_yaml_examples_are_yaml(name: str) -> None:
    for text in re.findall(r"^```yaml\n(.*?)^```$", (ROOT / name).read_text(), flags=re.MULTILINE | re.DOTALL):
        assert read_yaml(text, name).problems == []


def test_readme_has_the_two_commands() -> None:
    lines = [line.strip() for line in (ROOT / "README.md").read_text().splitlines()]
    assert [line for line in lines if line.startswith("./scripts/")] == [
        "./scripts/robotd --config configs/jetbot.yaml --sim",
        "./scripts/test",
    ]


def test_continuous_integration_runs_the_readme_command() -> None:
    assert (ROOT / ".ci" / "run").read_text().splitlines()[-1] == 'exec ./scripts/test "$@"'
