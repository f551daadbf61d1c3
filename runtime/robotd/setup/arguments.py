"""Values on the command line: text in, what it means or argparse.ArgumentTypeError out."""

from __future__ import annotations

import argparse
import math


def _number(text: str, least: float, what: str, *, above: bool = False) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or value < least or (above and value == least):
        raise argparse.ArgumentTypeError(f"expected {what}, got {text!r}")
    return value


def seconds(text: str) -> float:
    """A number above 0."""
    return _number(text, 0.0, "seconds above 0", above=True)


def speed(text: str) -> float:
    """A pace above 0; `max` is infinite."""
    return math.inf if text == "max" else _number(text, 0.0, "a factor above 0 such as 2.5, or max", above=True)


def tolerance(text: str) -> float:
    """A number of 0 or more."""
    return _number(text, 0.0, "a difference of 0 or more")


def assignment(text: str) -> str:
    """`path=value`, as it was given."""
    key, equals, _ = text.partition("=")
    if not equals or not key.strip():
        raise argparse.ArgumentTypeError(f"expected path=value such as guard.latency_s=0.2, got {text!r}")
    return text
