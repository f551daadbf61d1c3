"""YAML as robotd reads it: core scalars, places, and what is refused."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotd.setup.yaml_source import MAX_BYTES, read_yaml, scalar


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-3", 0.001),
        ("0123", 123),
        ("0o17", 15),
        ("0x1F", 31),
        ("12:30:45", "12:30:45"),
        ("1_000", "1_000"),
        ("NO", "NO"),
        ("yes", "yes"),
        ("off", "off"),
        ("True", True),
        ("false", False),
        ("tRue", "tRue"),
        ("~", None),
        ("", None),
        ("null", None),
        ("-5", -5),
        ("+.5", 0.5),
        ("5.", 5.0),
        ("-1.5E+3", -1500.0),
        ("2025-01-02", "2025-01-02"),
        (".", "."),
        ("1e", "1e"),
        ("0b11", "0b11"),
    ],
)
def test_scalars_follow_the_core_schema(text: str, value: Any) -> None:
    assert scalar(text) == value
    assert type(scalar(text)) is type(value)


def test_quoted_scalars_are_text() -> None:
    assert read_yaml("a: '1'\nb: \"true\"\nc: |\n  5\n", "f").data == {"a": "1", "b": "true", "c": "5\n"}


def test_every_key_and_value_has_its_place() -> None:
    source = read_yaml("robot:\n  limits: {vx_mps: 0.4}\n  corners:\n    - [1, 2]\n", "f")
    places = {path: (place.line, place.column) for path, place in source.keys.items()}
    assert places == {
        ("robot",): (1, 1),
        ("robot", "limits"): (2, 3),
        ("robot", "limits", "vx_mps"): (2, 12),
        ("robot", "corners"): (3, 3),
    }
    assert (source.values[("robot", "corners", 0, 1)].line, source.values[("robot", "corners", 0, 1)].column) == (4, 11)
    missing = source.key_place(("robot", "limits", "wz_radps"))
    assert (missing.line, missing.column) == (2, 3)


@pytest.mark.parametrize(
    ("text", "line", "column", "words"),
    [
        ("a: 1\nb: 2\na: 3\n", 3, 1, "duplicate key, it stands on line 1"),
        ("a: {x: 1, x: 2}\n", 1, 11, "duplicate"),
        ("a: &n 1\n", 1, 4, "anchor &n"),
        ("a: &n 1\nb: *n\n", 2, 4, "alias *n"),
        ("a: !!float 1\n", 1, 4, "tag !!float"),
        ("a: !python/object:os.system x\n", 1, 4, "tag !python/object"),
        ("a: .inf\n", 1, 4, "not a finite number"),
        ("a: -.INF\n", 1, 4, "not a finite number"),
        ("a: .nan\n", 1, 4, "not a finite number"),
        ("a: 1e999\n", 1, 4, "not a finite number"),
        ("a: 99999999999999999999\n", 1, 4, "beyond 64 bits"),
        ("a: " + "9" * 9000 + "\n", 1, 4, "beyond 64 bits"),
        ("1: a\n", 1, 1, "is not text"),
        ("true: a\n", 1, 1, "is not text"),
        ("? [a, b]\n: 1\n", 1, 3, "is not text"),
        ("a: 1\n---\nb: 1\n", 2, 1, "second document"),
        ("a:\n\tb: 1\n", 2, 1, "not YAML"),
        ("a: b: 1\n", 1, 5, "not YAML"),
        ("a: [1, 2\n", 2, 1, "not YAML"),
        ("a: " + "[" * 40 + "\n", 1, 28, "nested deeper"),
        ("a: \x07\n", 1, 4, "not YAML"),
        ("x" * (MAX_BYTES + 1), 1, 1, "larger than"),
    ],
)
def test_what_is_refused_has_its_place(text: str, line: int, column: int, words: str) -> None:
    first = next(p for p in read_yaml(text, "f").problems if words in p.message)
    assert (first.line, first.column) == (line, column)


def test_bytes_that_are_not_utf8_are_placed() -> None:
    (problem,) = read_yaml(b"a: 1\nb: \xff\n", "f").problems
    assert (problem.line, problem.column, problem.message) == (2, 4, "is not UTF-8 text")


def test_alias_bomb_ends_at_once() -> None:
    rows = ["a0: &a0 [x, x]"] + [f"a{i}: &a{i} [*a{i - 1}, *a{i - 1}]" for i in range(1, 200)]
    source = read_yaml("\n".join(rows), "f")
    assert len(source.problems) == 200 + 2 * 199


def test_reading_goes_on_after_what_is_refused() -> None:
    source = read_yaml("a: 1\na: 2\nb: &x 3\nc: *x\nd: 4\n", "f")
    assert [p.line for p in source.problems] == [2, 3, 4]
    assert source.data == {"a": 1, "b": 3, "c": None, "d": 4}
    assert source.is_spoiled(("c", "deeper")) and not source.is_spoiled(("d",))


@given(st.binary(max_size=200) | st.text(max_size=200))
def test_no_input_raises(text: bytes | str) -> None:
    source = read_yaml(text, "f")
    assert source.complete or source.problems


_plain = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**60), 2**60)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(st.characters(codec="utf-8", categories=["L", "N", "P", "Zs"]), max_size=12),
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.text("abcdefg_", min_size=1, max_size=6), inner, max_size=4)
    ),
    max_leaves=12,
)


@given(st.dictionaries(st.text("abcdefg_", min_size=1, max_size=6), _plain, max_size=5))
def test_json_is_read_as_what_it_says(data: dict[str, Any]) -> None:
    import json

    source = read_yaml(json.dumps(data, ensure_ascii=False), "f")
    assert source.problems == [] and source.data == data
