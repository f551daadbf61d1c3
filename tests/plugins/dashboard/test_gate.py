"""Who may talk to the page: names of the robot, pages of strangers, the token."""

from __future__ import annotations

import pytest

from robotd_plugins.bridges.dashboard.gate import Gate

HERE = Gate(loopback=True)
ABROAD = Gate(loopback=False, names=frozenset({"jetbot", "jetbot.local"}), token="a token of some length")


@pytest.mark.parametrize(
    ("gate", "host", "origin"),
    [
        (HERE, "127.0.0.1:8765", None),
        (HERE, "localhost:8765", "http://localhost:8765"),
        (HERE, "LocalHost:8765", "http://localhost:8765"),
        (HERE, "localhost", "http://localhost"),
        (HERE, "[::1]:8765", "http://[::1]:8765"),
        (HERE, "localhost:9000", "http://localhost:9000"),  # ssh -L 9000:localhost:8765
        (ABROAD, "192.168.7.20:8765", "http://192.168.7.20:8765"),
        (ABROAD, "jetbot.local:8765", "http://jetbot.local:8765"),
        (ABROAD, "JETBOT:8765", "http://jetbot:8765"),
        (ABROAD, "jetbot", "https://jetbot"),  # behind a proxy that speaks TLS
    ],
)
def test_lets_in(gate: Gate, host: str, origin: str | None) -> None:
    assert gate.refusal(host, origin) == ""


@pytest.mark.parametrize(
    ("gate", "host", "origin", "why"),
    [
        (HERE, None, None, "no valid Host"),
        (HERE, "", None, "no valid Host"),
        (HERE, "[::1", None, "no valid Host"),
        # a name of somebody else that was pointed at this machine
        (HERE, "evil.example:8765", "http://evil.example:8765", "no name of this robot"),
        (HERE, "localhost.evil.example", None, "no name of this robot"),
        (HERE, "192.168.7.20:8765", None, "no name of this robot"),
        (HERE, "evil@evil.example", None, "no name of this robot"),
        (ABROAD, "evil.example", "http://evil.example", "no name of this robot"),
        # a page of somebody else that asks this machine
        (HERE, "127.0.0.1:8765", "http://evil.example", "another site"),
        (HERE, "127.0.0.1:8765", "http://127.0.0.1:8766", "another site"),
        (HERE, "127.0.0.1:8765", "http://localhost:8765", "another site"),
        (HERE, "127.0.0.1:8765", "null", "another site"),
        (HERE, "127.0.0.1:8765", "", "another site"),
        (HERE, "127.0.0.1:8765", "http://[", "another site"),
        (ABROAD, "192.168.7.20:8765", "http://192.168.7.21:8765", "another site"),
    ],
)
def test_turns_away(gate: Gate, host: str | None, origin: str | None, why: str) -> None:
    assert why in gate.refusal(host, origin)


def test_without_a_token_everybody_sees() -> None:
    assert HERE.is_pass(None)


@pytest.mark.parametrize("cookie", [None, "", "a token of some length", "0" * 64, "ü", HERE.pass_value])
def test_a_wrong_pass_sees_nothing(cookie: str | None) -> None:
    assert not ABROAD.is_pass(cookie)


def test_the_right_token_gets_a_pass_that_does_not_show_it() -> None:
    assert ABROAD.is_token("a token of some length") and not ABROAD.is_token("another") and not ABROAD.is_token("ü")
    assert ABROAD.is_pass(ABROAD.pass_value)
    assert "token" not in ABROAD.pass_value
