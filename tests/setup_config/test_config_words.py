"""Which key was meant: spelling and units."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotd.setup.words import as_number, distance, meant_key, nearest, other_unit, suggestion

KEYS = ("range_max_m", "range_min_m", "speed_mps", "timeout_s", "rate_hz", "pitch_rad", "window", "use", "as", "port")


@pytest.mark.parametrize(
    ("word", "value", "expected"),
    [
        ("range_max_cm", 300, "did you mean 'range_max_m' (metres; 300 cm is 3 m)?"),
        ("range_max_mm", 2500.0, "did you mean 'range_max_m' (metres; 2500 mm is 2.5 m)?"),
        ("range_max", 3, "did you mean 'range_max_m' (metres)?"),
        ("range_max_m_", 3, "did you mean 'range_max_m' (metres)?"),
        ("rnage_max_cm", 300, "did you mean 'range_max_m' (metres; 300 cm is 3 m)?"),
        ("rangeMaxM", 3, "did you mean 'range_max_m'?"),
        ("range-max-m", 3, "did you mean 'range_max_m'?"),
        ("range_mim_m", 3, "did you mean 'range_min_m'?"),
        ("speed_kmh", 3.6, "did you mean 'speed_mps' (metres per second; 3.6 kmh is 1 mps)?"),
        ("timeout_ms", 500, "did you mean 'timeout_s' (seconds; 500 ms is 0.5 s)?"),
        ("pitch_deg", 180, "did you mean 'pitch_rad' (radians; 180 deg is 3.14159 rad)?"),
        ("rate_fps", "x", "did you mean 'rate_hz' (hertz)?"),
        ("widnow", 3, "did you mean 'window'?"),
        ("uze", "x", "did you mean 'use'?"),
        ("Port", "x", "did you mean 'port'?"),
    ],
)
def test_the_key_that_was_meant(word: str, value: object, expected: str) -> None:
    assert suggestion(word, KEYS, value) == expected


def test_what_is_far_from_everything_gets_the_list() -> None:
    assert meant_key("colour", KEYS) is None
    assert suggestion("colour", ("use", "as")) == "known: use, as"
    assert suggestion("colour", ()) == ""


@pytest.mark.parametrize(
    ("text", "key", "hint"),
    [
        ("0.3", "range_max_m", "write it without quotes: 0.3"),
        ("30 cm", "range_max_m", "write the number alone, in metres: 0.3"),
        ("30cm", "range_max_m", "write the number alone, in metres: 0.3"),
        ("5 km/h", "speed_mps", "write the number alone, in metres per second: 1.38889"),
        ("90°", "pitch_rad", "write the number alone, in radians: 1.5708"),
        ("3 parsecs", "range_max_m", "write the number alone: 3"),
        ("0,3", "range_max_m", "write a decimal point: 0.3"),
        ("far", "range_max_m", ""),
    ],
)
def test_text_in_place_of_a_number(text: str, key: str, hint: str) -> None:
    assert as_number(text, key) == hint


def test_a_number_in_another_unit_is_recognised_only_where_it_fits() -> None:
    assert other_unit(20.0, "pitch_rad", -1.6, 1.6) == "another unit? 20 deg is 0.349066 rad"
    assert other_unit(400.0, "range_max_m", 0.3, 12.0) == "another unit? 400 mm is 0.4 m, 400 cm is 4 m"
    assert other_unit(9e9, "range_max_m", 0.3, 12.0) == ""
    assert other_unit(0.1, "range_max_m", 0.3, 12.0) == ""


@given(st.text("abc_", max_size=8), st.text("abc_", max_size=8))
def test_distance_is_symmetric_and_bounded(a: str, b: str) -> None:
    assert distance(a, b) == distance(b, a)
    assert (distance(a, b) == 0) == (a == b)
    assert abs(len(a) - len(b)) <= distance(a, b) <= max(len(a), len(b))


@given(
    st.sampled_from([k for k in KEYS if len(k) > 5]), st.integers(0, 50), st.sampled_from(["drop", "double", "swap"])
)
def test_one_slip_is_always_understood(key: str, at: int, how: str) -> None:
    i = at % (len(key) - 1)
    slip = {"drop": key[:i] + key[i + 1 :], "double": key[:i] + key[i] + key[i:]}.get(
        how, key[:i] + key[i + 1] + key[i] + key[i + 2 :]
    )
    assert nearest(slip, KEYS) == key
