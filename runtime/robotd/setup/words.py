"""Which key was meant: by edit distance and by unit, so that `range_max_cm` leads to `range_max_m` and says why."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit as a key's last word. `factor` turns a value into the family's own unit."""

    family: str
    factor: float
    name: str


_DEG = math.pi / 180.0
UNITS: dict[str, Unit] = {
    suffix: Unit(family, factor, name)
    for family, units in {
        "length": (
            ("m", 1.0, "metres"),
            ("dm", 0.1, "decimetres"),
            ("cm", 0.01, "centimetres"),
            ("mm", 1e-3, "millimetres"),
            ("um", 1e-6, "micrometres"),
            ("km", 1e3, "kilometres"),
            ("inch", 0.0254, "inches"),
            ("ft", 0.3048, "feet"),
        ),
        "time": (
            ("s", 1.0, "seconds"),
            ("sec", 1.0, "seconds"),
            ("ms", 1e-3, "milliseconds"),
            ("us", 1e-6, "microseconds"),
            ("ns", 1e-9, "nanoseconds"),
            ("min", 60.0, "minutes"),
        ),
        "angle": (("rad", 1.0, "radians"), ("deg", _DEG, "degrees"), ("degrees", _DEG, "degrees")),
        "speed": (
            ("mps", 1.0, "metres per second"),
            ("cmps", 0.01, "centimetres per second"),
            ("mmps", 1e-3, "millimetres per second"),
            ("kmh", 1.0 / 3.6, "kilometres per hour"),
            ("kph", 1.0 / 3.6, "kilometres per hour"),
            ("mph", 0.44704, "miles per hour"),
        ),
        "turn rate": (
            ("radps", 1.0, "radians per second"),
            ("degps", _DEG, "degrees per second"),
            ("dps", _DEG, "degrees per second"),
            ("rpm", math.tau / 60.0, "turns per minute"),
        ),
        "acceleration": (
            ("mps2", 1.0, "metres per second squared"),
            ("cmps2", 0.01, "centimetres per second squared"),
            ("mmps2", 1e-3, "millimetres per second squared"),
        ),
        "turn acceleration": (
            ("radps2", 1.0, "radians per second squared"),
            ("degps2", _DEG, "degrees per second squared"),
        ),
        "rate": (
            ("hz", 1.0, "hertz"),
            ("khz", 1e3, "kilohertz"),
            ("mhz", 1e6, "megahertz"),
            ("fps", 1.0, "frames per second"),
        ),
        "voltage": (("v", 1.0, "volts"), ("mv", 1e-3, "millivolts")),
        "current": (("a", 1.0, "amperes"), ("ma", 1e-3, "milliamperes")),
        "mass": (("kg", 1.0, "kilograms"), ("g", 1e-3, "grams")),
        "pixels": (("px", 1.0, "pixels"), ("pixels", 1.0, "pixels")),
    }.items()
    for suffix, factor, name in units
}
_AMOUNT = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*([A-Za-z/°²2]*)\s*\Z")
_SIGNS = {"°": "deg", "m/s": "mps", "km/h": "kmh", "rad/s": "radps", "m/s2": "mps2", "m/s²": "mps2"}


def unit_of(key: str) -> tuple[str, str]:
    """The key without its unit, and the unit's suffix; the suffix is empty where the key names no unit."""
    stem, _, last = key.rpartition("_")
    return (stem, last) if stem and last in UNITS else (key, "")


def distance(a: str, b: str) -> int:
    """Edits between two words: insert, delete, replace, swap neighbours (optimal string alignment)."""
    before: list[int] = []
    row = list(range(len(b) + 1))
    for i, x in enumerate(a, 1):
        earlier, before, row = before, row, [i]
        for j, y in enumerate(b, 1):
            best = min(before[j] + 1, row[j - 1] + 1, before[j - 1] + (x != y))
            if earlier and j > 1 and x == b[j - 2] and a[i - 2] == y:
                best = min(best, earlier[j - 2] + 1)
            row.append(best)
    return row[-1]


def nearest(word: str, known: Iterable[str]) -> str | None:
    """The known word that was most likely meant; None where nothing is near."""
    plain = _plain(word)
    best: tuple[float, str] | None = None
    for candidate in known:
        other = _plain(candidate)
        if plain == other:
            return candidate
        edits = float(distance(plain, other))
        if min(len(plain), len(other)) >= 3 and (other.startswith(plain) or plain.startswith(other)):
            edits = min(edits, 1.5)
        if edits <= max(1.0, min(len(plain), len(other)) / 3.0 + 0.7) and (best is None or edits < best[0]):
            best = (edits, candidate)
    return best[1] if best is not None else None


def meant_key(word: str, known: Sequence[str]) -> str | None:
    """The valid key that was most likely meant: the same quantity in another unit comes before a near spelling."""
    stem, unit = unit_of(_plain(word))
    same = [key for key in known if unit_of(key)[0] == stem and key != word]
    in_family = [key for key in same if unit and unit_of(key)[1] and _family(key) == UNITS[unit].family]
    if in_family or same:
        return (in_family or same)[0]
    direct = nearest(word, known)
    if direct is not None and distance(_plain(word), _plain(direct)) <= 1:
        return direct
    if unit:
        family = {unit_of(key)[0]: key for key in known if unit_of(key)[1] and _family(key) == UNITS[unit].family}
        stem_meant = nearest(stem, family)
        if stem_meant is not None:
            return family[stem_meant]
    return direct


def suggestion(word: str, known: Sequence[str], value: object = None) -> str:
    """`did you mean 'range_max_m' (metres; 300 cm is 3 m)?`, or the list of what there is, or nothing."""
    key = meant_key(word, known)
    if key is None:
        return f"known: {', '.join(known)}" if 0 < len(known) <= 16 else ""
    _, given = unit_of(_plain(word))
    _, wanted = unit_of(key)
    if not wanted or given == wanted:
        return f"did you mean '{key}'?"
    note = UNITS[wanted].name
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if given and number and UNITS[given].family == UNITS[wanted].family:
        note += f"; {value:g} {given} is {_convert(float(str(value)), given, wanted):g} {wanted}"
    return f"did you mean '{key}' ({note})?"


def as_number(text: str, key: str) -> str:
    """A hint for text that stands where a number belongs: quotes, a unit behind the number, a decimal comma."""
    match = _AMOUNT.match(text)
    if match is None:
        if re.fullmatch(r"\s*[-+]?\d+,\d+\s*", text):
            return f"write a decimal point: {text.strip().replace(',', '.')}"
        return ""
    amount, unit = float(match[1]), _SIGNS.get(match[2], match[2])
    _, wanted = unit_of(key)
    if not unit:
        return f"write it without quotes: {match[1]}"
    if wanted and unit in UNITS and UNITS[unit].family == UNITS[wanted].family:
        return f"write the number alone, in {UNITS[wanted].name}: {_convert(amount, unit, wanted):g}"
    return f"write the number alone: {match[1]}"


def other_unit(value: float, key: str, low: float, high: float) -> str:
    """A hint for a number outside [low, high] that lies inside when read in a usual wrong unit."""
    _, wanted = unit_of(key)
    usual = {"m": ("mm", "cm"), "rad": ("deg",), "s": ("ms",), "mps": ("kmh", "mmps"), "radps": ("degps",)}
    read = [(given, _convert(value, given, wanted)) for given in usual.get(wanted, ())]
    fitting = [f"{value:g} {given} is {x:g} {wanted}" for given, x in read if low <= x <= high and abs(value) >= 1.0]
    return f"another unit? {', '.join(fitting)}" if fitting else ""


def _convert(value: float, given: str, wanted: str) -> float:
    return value * UNITS[given].factor / UNITS[wanted].factor


def _family(key: str) -> str:
    return UNITS[unit_of(key)[1]].family


def _plain(word: str) -> str:
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", word).replace("-", "_").replace(" ", "_").lower()
