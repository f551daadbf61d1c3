"""Mutants and valid variants of configs, made from a seed, each with what must come of it."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

from ruamel.yaml import YAML

from benches.config_sites import Path, Site, Truth, is_flow, reserved, sites
from robotd.setup.registry import Registry

SEED = 20_260
KINDS = (
    "unknown key",
    "misspelt key",
    "wrong unit",
    "wrong type",
    "duplicate key",
    "out of range",
    "missing file",
    "tie",
)
_FAMILIES = (
    ("m", "cm", "mm"),
    ("s", "ms"),
    ("rad", "deg"),
    ("mps", "kmh", "cmps"),
    ("radps", "degps"),
    ("mps2", "cmps2"),
    ("radps2", "degps2"),
    ("hz", "khz"),
)
_SCALE = {
    ("m", "cm"): 100.0, ("m", "mm"): 1e3, ("s", "ms"): 1e3, ("ms", "s"): 1e-3, ("rad", "deg"): 57.29578,
    ("mps", "kmh"): 3.6, ("mps", "cmps"): 100.0, ("radps", "degps"): 57.29578, ("mps2", "cmps2"): 100.0,
    ("radps2", "degps2"): 57.29578, ("hz", "khz"): 1e-3,
}  # fmt: skip
_STRANGERS = ("favourite_colour", "moon_phase", "remarks", "wheel_count", "quiet_hours", "lucky_number")
_FILE_KEYS = ("map", "track")


@dataclass(frozen=True, slots=True)
class Base:
    """A good config and what is known about it."""

    name: str
    text: str
    sites: tuple[Site, ...]
    truth: Truth

    @staticmethod
    def of(name: str, text: str, registry: Registry) -> Base:
        """Read a good config."""
        data = YAML(typ="safe", pure=True).load(text)
        return Base(name, text, tuple(sites(text)), Truth(data, registry))


@dataclass(frozen=True, slots=True)
class Mutant:
    """A config with one mistake. `hint` must stand in the mend that is offered; empty where there is none."""

    base: str
    kind: str
    text: str
    edit: str
    place: tuple[int, int]
    path: Path
    hint: str = ""


@dataclass(frozen=True, slots=True)
class Variant:
    """A good config. `same`: it says just what its base says."""

    base: str
    text: str
    edits: tuple[str, ...]
    same: bool
    sim: bool
    sets: tuple[str, ...] = field(default=())


def mutant(bases: list[Base], index: int) -> Mutant:
    """The mutant of a number: kinds and bases take turns, the rest follows from the seed."""
    rng = random.Random(f"{SEED} mutant {index}")
    kind = KINDS[index % len(KINDS)]
    make = _MAKERS[kind]
    order = index // len(KINDS)
    for attempt in range(2000):
        # a base that has no place for this kind of mistake passes the turn on
        base = bases[(order + attempt // 100) % len(bases)]
        made = make(rng, base)
        if made is not None:
            return made
    raise RuntimeError(f"none of {[b.name for b in bases]} has a place for: {kind}")


# --------------------------------------------------------------------------------------------------- mutants


def _put(text: str, start: int, end: int, new: str) -> str:
    return text[:start] + new + text[end:]


def _keyed(base: Base) -> list[Site]:
    return [site for site in base.sites if site.key_at >= 0]


def _insert(base: Base, before: Site, pair: str) -> str | None:
    """`pair` as a new first neighbour of a key; None where there is no room for it."""
    if before.flow:
        return _put(base.text, before.key_at, before.key_at, f"{pair}, ")
    if before.own_line:
        indent = " " * (before.key_place[1] - 1)
        return _put(base.text, before.key_at, before.key_at, f"{pair}\n{indent}")
    return None


def _unknown(rng: random.Random, base: Base) -> Mutant | None:
    site = rng.choice(_keyed(base))
    if base.truth.keys(site.path[:-1]) is None:
        return None
    word = rng.choice(_STRANGERS)
    text = _insert(base, site, f"{word}: {rng.choice(('3', 'true', 'blue', '[1, 2]'))}")
    if text is None:
        return None
    return Mutant(base.name, KINDS[0], text, f"+ {word}", site.key_place, (*site.path[:-1], word))


def _misspelt(rng: random.Random, base: Base) -> Mutant | None:
    site = rng.choice(_keyed(base))
    known = base.truth.keys(site.path[:-1])
    key = site.key
    if known is None or key not in known or len(key) < 4:
        return None
    i = rng.randrange(len(key) - 1)
    word = rng.choice(
        (
            key[:i] + key[i + 1 :],
            key[:i] + key[i] + key[i:],
            key[:i] + key[i + 1] + key[i] + key[i + 2 :],
            key[:i] + rng.choice("aeiortnsl") + key[i + 1 :],
            key[:i] + rng.choice("aeiortnsl") + key[i:],
        )
    )
    # where the slip is as near to another key, nobody can know what was meant
    least = _edits(word, key)
    if word == key or word in known or any(_edits(word, k) <= least for k in known if k != key):
        return None
    text = _put(base.text, site.key_at, site.key_end, word)
    return Mutant(base.name, KINDS[1], text, f"{key} -> {word}", site.key_place, (*site.path[:-1], word), f"'{key}'")


def _unit(rng: random.Random, base: Base) -> Mutant | None:
    site = rng.choice(_keyed(base))
    known = base.truth.keys(site.path[:-1])
    stem, _, unit = site.key.rpartition("_")
    others = [u for family in _FAMILIES if unit in family for u in (*family, "") if u != unit]
    if known is None or site.key not in known or not stem or not others:
        return None
    other = rng.choice(others)
    word = f"{stem}_{other}" if other else stem
    if word in known:
        return None
    text = base.text
    try:
        number = float(text[site.at : site.end])
    except ValueError:
        pass
    else:
        text = _put(text, site.at, site.end, f"{number * _SCALE.get((unit, other), 1.0):g}")
    text = _put(text, site.key_at, site.key_end, word)
    edit = f"{site.key} -> {word}"
    return Mutant(base.name, KINDS[2], text, edit, site.key_place, (*site.path[:-1], word), f"'{site.key}'")


def _type(rng: random.Random, base: Base) -> Mutant | None:
    site = rng.choice(base.sites)
    schema = base.truth.of(site.path)
    if schema is None or site.path[-1] == "as" or (site.kind != "scalar" and not is_flow(site, base.text)):
        return None
    old = base.text[site.at : site.end]
    choices: dict[str, tuple[tuple[str, str], ...]] = {
        "number": ((f"'{old}'", old), ("true", ""), (f"[{old}]", ""), (f"{old} m", old), ("far", "")),
        "integer": ((f"'{old}'", old), ("true", ""), ("2.5", ""), (f"[{old}]", ""), ("many", "")),
        "boolean": (("yes", "true"), ("off", "false"), (f"'{old}'", old), ("1", "")),
        "string": (("3", ""), ("true", ""), ("[a]", ""), ("2.5", "")),
        "array": (("3", ""), ("text", ""), ("true", "")),
    }
    options = choices.get(str(schema.get("type", "")))
    if options is None:
        return None
    new, hint = rng.choice(options)
    text = _put(base.text, site.at, site.end, new)
    return Mutant(base.name, KINDS[3], text, f"{site.key}: {old} -> {new}", site.place, site.path, hint)


def _duplicate(rng: random.Random, base: Base) -> Mutant | None:
    site = rng.choice(_keyed(base))
    whole = site.kind == "scalar" or is_flow(site, base.text)
    pair = base.text[site.key_at : site.end] if whole else f"{site.key}: {{}}"
    text = _insert(base, site, pair)
    if text is None or "\n" in pair:
        return None
    line, column = site.key_place
    place = (line, column + len(pair) + 2) if site.flow else (line + 1, column)
    return Mutant(base.name, KINDS[4], text, f"{site.key} twice", place, site.path)


def _range(rng: random.Random, base: Base) -> Mutant | None:
    site = rng.choice(base.sites)
    schema = base.truth.of(site.path)
    if schema is None or site.kind != "scalar" or schema.get("type") not in ("number", "integer"):
        return None
    beyond: list[float] = []
    if "minimum" in schema:
        beyond += [schema["minimum"] - 1, schema["minimum"] - 1000]
    if "maximum" in schema:
        beyond += [schema["maximum"] + 1, schema["maximum"] * 10 + 10]
    if "exclusiveMinimum" in schema:
        beyond += [schema["exclusiveMinimum"], schema["exclusiveMinimum"] - 1]
    if not beyond:
        return None
    value = rng.choice(beyond)
    new = f"{int(value)}" if schema["type"] == "integer" or float(value).is_integer() else f"{value:.6g}"
    text = _put(base.text, site.at, site.end, new)
    return Mutant(base.name, KINDS[5], text, f"{site.key}: {new}", site.place, site.path)


def _file(rng: random.Random, base: Base) -> Mutant | None:
    site = rng.choice(base.sites)
    schema = base.truth.of(site.path)
    named = site.key in _FILE_KEYS or (schema is not None and schema.get("format") == "file-path")
    if not named or schema is None or site.kind != "scalar":
        return None
    old = base.text[site.at : site.end]
    slip = old[:-1] + "x" if site.key in _FILE_KEYS and len(old) > 4 else ""
    new = rng.choice(
        [f"gone_{rng.randrange(1000)}.yaml", f"models/{rng.randrange(1000)}.onnx", *([slip] if slip else [])]
    )
    hint = f"'{old}'" if new == slip else ""
    text = _put(base.text, site.at, site.end, new)
    return Mutant(base.name, KINDS[6], text, f"{site.key}: {new}", site.place, site.path, hint)


def _tie(rng: random.Random, base: Base) -> Mutant | None:
    found = [site for site in base.sites if site.path[:1] == ("behaviours",) and site.path[2:] == ("priority",)]
    if len(found) < 2:
        return None
    value = str(rng.randrange(-1000, 1001))
    text = base.text
    for site in sorted(found, key=lambda s: -s.at)[:2]:
        text = _put(text, site.at, site.end, value)
    later = max(found, key=lambda s: s.at)
    return Mutant(base.name, KINDS[7], text, f"both priorities {value}", later.place, later.path)


_MAKERS: dict[str, Callable[[random.Random, Base], Mutant | None]] = dict(
    zip(KINDS, (_unknown, _misspelt, _unit, _type, _duplicate, _range, _file, _tie), strict=True)
)


def _edits(a: str, b: str) -> int:
    """Levenshtein's distance; two swapped letters count as one edit when they are the only difference."""
    if len(a) == len(b):
        apart = [i for i in range(len(a)) if a[i] != b[i]]
        if len(apart) == 2 and apart[1] == apart[0] + 1 and a[apart[0]] == b[apart[1]] and a[apart[1]] == b[apart[0]]:
            return 1
    row = list(range(len(b) + 1))
    for i, x in enumerate(a, 1):
        row, above = [i], row
        for j, y in enumerate(b, 1):
            row.append(min(above[j] + 1, row[j - 1] + 1, above[j - 1] + (x != y)))
    return row[-1]


# -------------------------------------------------------------------------------------------------- variants


def variant(bases: list[Base], index: int) -> Variant:
    """The good variant of a number: one to four harmless changes."""
    rng = random.Random(f"{SEED} variant {index}")
    base = bases[index % len(bases)]
    text, same = base.text, True
    edits: list[str] = []
    sets: tuple[str, ...] = ()
    for name in rng.sample(sorted(_CHANGES), k=rng.randint(1, 4)):
        change, keeps = _CHANGES[name]
        now = Base.of(base.name, text, base.truth.registry)
        changed = next((c for c in (change(rng, now) for _ in range(60)) if c is not None), None)
        if changed is not None:
            text, same = changed, same and keeps
            edits.append(name)
    if rng.random() < 0.3:
        sets = _layer(rng, base)
        same = False if sets else same
    for ending in ("crlf", "bom", "document marks"):
        if rng.random() < 0.15:
            edits.append(ending)
            if ending == "crlf":
                text = text.replace("\n", "\r\n")
            elif ending == "bom":
                text = "\ufeff" + text.removeprefix("\ufeff")
            elif not text.startswith("\ufeff"):
                text = f"---\n{text}...\n"
    return Variant(base.name, text, tuple(edits), same, rng.random() < 0.5, sets)


def _numbers(base: Base, *, whole: bool | None = None) -> Iterator[tuple[Site, dict[str, Any], float]]:
    for site in base.sites:
        schema = base.truth.of(site.path) if site.kind == "scalar" else None
        if schema is None or schema.get("type") not in ("number", "integer"):
            continue
        if whole is None or (schema["type"] == "integer") == whole:
            try:
                yield site, schema, float(base.text[site.at : site.end])
            except ValueError:
                continue


def _nudged(rng: random.Random, base: Base) -> str | None:
    site, schema, value = rng.choice(list(_numbers(base, whole=False)))
    new = float(f"{value * rng.uniform(0.98, 1.02):.5g}")
    inside = schema.get("minimum", new) <= new <= schema.get("maximum", new)
    return _put(base.text, site.at, site.end, repr(new)) if inside else None


def _respelt_number(rng: random.Random, base: Base) -> str | None:
    site, schema, value = rng.choice(list(_numbers(base)))
    if schema["type"] == "integer":
        new = rng.choice((f"+{int(value)}", f"0x{int(value):x}", f"0o{int(value):o}")) if value >= 0 else ""
    else:
        new = rng.choice((f"{value:.10e}", f"{value:.9f}", f"{int(value)}" if value.is_integer() else ""))
    return _put(base.text, site.at, site.end, new) if new and float(value) == _value(new) else None


def _value(text: str) -> float:
    return float(int(text, 0)) if text.startswith(("0x", "0o")) else float(text)


def _quoted_text(rng: random.Random, base: Base) -> str | None:
    site = rng.choice(base.sites)
    schema = base.truth.of(site.path) if site.kind == "scalar" else None
    old = base.text[site.at : site.end]
    if schema is None or schema.get("type") != "string" or old[:1] in "'\"":
        return None
    return _put(base.text, site.at, site.end, rng.choice((f"'{old}'", f'"{old}"')))


def _quoted_key(rng: random.Random, base: Base) -> str | None:
    site = rng.choice(_keyed(base))
    return _put(base.text, site.key_at, site.key_end, f'"{site.key}"') if base.text[site.key_at] not in "'\"" else None


def _respelt_bool(rng: random.Random, base: Base) -> str | None:
    site = rng.choice(base.sites)
    old = base.text[site.at : site.end]
    if site.kind != "scalar" or old not in ("true", "false"):
        return None
    return _put(base.text, site.at, site.end, rng.choice((old.title(), old.upper())))


def _comment(rng: random.Random, base: Base) -> str | None:
    lines = base.text.split("\n")
    at = rng.randrange(len(lines))
    added = rng.choice(("# a remark: with a colon, [and] {more}", "", "      # indented"))
    return "\n".join([*lines[:at], added, *lines[at:]])


def _other_order(rng: random.Random, base: Base) -> str | None:
    starts = [site.key_at for site in base.sites if len(site.path) == 1]
    head = base.text[: starts[0]]
    chunks = [base.text[a:b] for a, b in zip(starts, [*starts[1:], len(base.text)], strict=True)]
    rng.shuffle(chunks)
    return head + "".join(chunk if chunk.endswith("\n") else f"{chunk}\n" for chunk in chunks)


def _default_spelt_out(rng: random.Random, base: Base) -> str | None:
    site = rng.choice(_keyed(base))
    parent = base.truth.of(site.path[:-1]) if len(site.path) > 1 else None
    present = {s.path[-1] for s in base.sites if s.path[:-1] == site.path[:-1]}
    if parent is None or base.truth.keys(site.path[:-1]) is None:
        return None
    absent = [
        (key, inner["default"])
        for key, inner in parent["properties"].items()
        if key not in present and isinstance(inner.get("default"), bool | int | float)
    ]
    if not absent:
        return None
    key, default = rng.choice(absent)
    return _insert(base, site, f"{key}: {str(default).lower()}")


def _default_left_out(rng: random.Random, base: Base) -> str | None:
    site = rng.choice(_keyed(base))
    schema = base.truth.of(site.path)
    droppable = site.path[:2] in (("robot", "limits"), ("robot", "name")) or site.path[0] in ("recorder", "simulation")
    if schema is None or "default" not in schema or not droppable or site.flow or not site.own_line:
        return None
    if site.kind != "scalar" or reserved(site.path) or site.key in ("use", "vy_mps"):
        return None
    line_start, line_end = base.text.rfind("\n", 0, site.key_at), base.text.find("\n", site.key_at)
    siblings = [s for s in base.sites if s.path[:-1] == site.path[:-1]]
    return base.text[:line_start] + base.text[line_end:] if len(siblings) > 1 else None


def _layer(rng: random.Random, base: Base) -> tuple[str, ...]:
    chosen = [site for site, _, _ in _numbers(base) if all(isinstance(step, str) for step in site.path)]
    site = rng.choice(chosen)
    return (f"{'.'.join(map(str, site.path))}={base.text[site.at : site.end]}",)


_CHANGES: dict[str, tuple[Callable[[random.Random, Base], str | None], bool]] = {
    "a number nudged": (_nudged, False),
    "a number spelt otherwise": (_respelt_number, True),
    "text in quotes": (_quoted_text, True),
    "a key in quotes": (_quoted_key, True),
    "a bool spelt otherwise": (_respelt_bool, True),
    "a comment": (_comment, True),
    "sections in another order": (_other_order, True),
    "a default spelt out": (_default_spelt_out, True),
    "a default left out": (_default_left_out, False),
}
