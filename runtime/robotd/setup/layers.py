"""Lays environment variables and `--set` over what a file says; each value keeps the name of where it came from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from robotd.setup.problems import Path, Problem
from robotd.setup.yaml_source import Place, Source, read_yaml

PREFIX = "ROBOTD__"


def lay_over(source: Source, env: Mapping[str, str] | None = None, sets: Sequence[str] = ()) -> None:
    """Change `source` in place: first `ROBOTD__A__B` by name, then each `a.b=value` in the order given.

    Values are YAML; names of variables are read in lower case. What cannot be applied becomes a problem of `source`.
    """
    for name in sorted(env or ()):
        if name.startswith(PREFIX) and env is not None:
            _assign(source, name.removeprefix(PREFIX).split("__"), env[name], name, any_case=True)
    for text in sets:
        dotted_path, equals, value = text.partition("=")
        origin = f"--set {dotted_path}"
        if not equals:
            source.problems.append(
                Problem(origin, None, None, "", "has no value", f"write --set {dotted_path or 'a.b'}=VALUE")
            )
            continue
        _assign(source, dotted_path.strip().split("."), value, origin, any_case=False)


def _assign(source: Source, steps: Sequence[str], text: str, origin: str, *, any_case: bool) -> None:
    place = Place(origin)
    if not all(steps):
        source.problems.append(place.problem((), "names no place in the config", "for example guard.latency_s"))
        return
    given = read_yaml(text, origin)
    if given.problems:
        source.problems += [Problem(origin, None, None, p.path, p.message, p.hint) for p in given.problems]
        return
    if source.data is None:
        source.data = {}
    node: Any = source.data
    path: Path = ()
    for depth, word in enumerate(steps):
        step = _step(node, word, any_case)
        if step is None:
            above = ".".join(steps[:depth]) or "the config"
            source.problems.append(place.problem((), f"cannot set {'.'.join(steps)}: {above} has no {word!r} in it"))
            return
        path = (*path, step)
        if depth == len(steps) - 1:
            _forget(source, path)
            node[step] = given.data
            source.keys[path] = source.values[path] = place
            for inner in given.values:
                source.values[(*path, *inner)] = place
            for inner in given.keys:
                source.keys[(*path, *inner)] = place
            return
        if isinstance(node, dict) and node.get(step) is None:
            node[step] = {}
            source.keys.setdefault(path, place)
            source.values[path] = place
        node = node[step]


def _step(node: Any, word: str, any_case: bool) -> str | int | None:
    """The key or index in `node` that a word means; None where there can be none."""
    if isinstance(node, list):
        return int(word) if word.isdecimal() and int(word) < len(node) else None
    if not isinstance(node, dict):
        return None
    if not any_case:
        return word
    return next((key for key in node if key.lower() == word.lower()), word.lower())


def _forget(source: Source, path: Path) -> None:
    for places in (source.keys, source.values):
        for known in [p for p in places if p[: len(path)] == path]:
            del places[known]
    source.spoiled = {p for p in source.spoiled if p[: len(path)] != path}
