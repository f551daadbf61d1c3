"""Finds the configs and maps that robotd ships, in an installed wheel and in a checkout alike."""

from __future__ import annotations

from pathlib import Path

from robotd.setup.problems import ConfigError, Problem
from robotd.setup.words import nearest

_PACKAGE = Path(__file__).resolve().parents[1]


def shelf(kind: str) -> Path | None:
    """The folder of shipped files of a kind (`configs`, `maps`); None where this installation ships none.

    The wheel carries them as package data, an editable installation has them at the top of the checkout.
    """
    for folder in (_PACKAGE / "_data" / kind, _PACKAGE.parents[1] / kind):
        if folder.is_dir():
            return folder
    return None


def shipped(kind: str, suffix: str = ".yaml") -> dict[str, Path]:
    """File name to path of the shipped files of a kind with this suffix, sorted by name."""
    folder = shelf(kind)
    return {} if folder is None else {file.name: file for file in sorted(folder.glob(f"*{suffix}"))}


def find_shipped(kind: str, name: str, suffix: str = ".yaml") -> Path | None:
    """A shipped file by name, with or without its suffix; None where there is none."""
    files = shipped(kind, suffix)
    return files.get(name) or files.get(f"{name}{suffix}")


def find_config(name: str | Path) -> Path:
    """A config by path, or by the name of a shipped one. Raises ConfigError naming the shipped ones."""
    given = Path(name).expanduser()
    if given.is_file():
        return given
    if given.name == str(name):
        found = find_shipped("configs", given.name)
        if found is not None:
            return found
    if given.is_dir():
        raise ConfigError([Problem(str(name), None, None, "", "is a folder", "name the file in it")])
    names = list(shipped("configs"))
    near = nearest(given.name, names)
    hint = f"did you mean '{near}'?" if near else f"shipped configs: {', '.join(names)}" if names else ""
    raise ConfigError([Problem(str(name), None, None, "", "there is no such file", hint)])
