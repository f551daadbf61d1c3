"""Messages of a page, and parameters of the bridge: what is taken, what is refused."""

from __future__ import annotations

import json

import pytest
from pydantic import ValidationError

from robotd_plugins.bridges.dashboard import DashboardConfig
from robotd_plugins.bridges.dashboard.asking import Ask, Garbage, parse


@pytest.mark.parametrize(
    ("text", "ask"),
    [
        ('{"do":"estop","id":4}', Ask(do="estop", id=4)),
        ('{"do":"beat","n":12}', Ask(do="beat", n=12)),
        (
            '{"do":"start","id":1,"behaviour":"route","goal":{"node":7}}',
            Ask(do="start", id=1, behaviour="route", goal={"node": 7}),
        ),
        ('{"do":"look","camera":null}', Ask(do="look")),
    ],
)
def test_what_a_page_sends(text: str, ask: Ask) -> None:
    assert parse(text) == ask


@pytest.mark.parametrize(
    "text",
    [
        "",
        "null",
        "[]",
        "{}",
        '"estop"',
        '{"do":"fly"}',
        '{"do":"estop","id":-1}',
        '{"do":"estop","id":"4"}',
        '{"do":"estop","id":1.5}',
        '{"do":"estop","id":NaN}',
        '{"do":"estop","id":99999999999999999999}',
        '{"do":"start","behaviour":7}',
        '{"do":"start","behaviour":"' + "x" * 101 + '"}',
        '{"do":"start","goal":[1]}',
        '{"do":"estop","and":"more"}',
        '{"do":"estop"}{"do":"estop"}',
        '{"do":"start","goal":' + '{"a":' * 1000 + "1" + "}" * 1000 + "}",
        "[" * 4000,
        json.dumps({"do": "estop"})[:-1],
    ],
)
def test_garbage(text: str) -> None:
    with pytest.raises(Garbage):
        parse(text)


@pytest.mark.parametrize("host", ["127.0.0.1", "127.1.2.3", "::1", "localhost"])
def test_this_machine_alone_needs_no_token(host: str) -> None:
    assert DashboardConfig(host=host).loopback


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.7.20", "jetbot.local", "localhost.example"])
def test_other_machines_need_a_token(host: str) -> None:
    with pytest.raises(ValidationError, match="set a token of at least 16"):
        DashboardConfig(host=host)
    with pytest.raises(ValidationError, match="at least 16"):
        DashboardConfig.model_validate({"host": host, "token": "short"})
    config = DashboardConfig.model_validate({"host": host, "token": "a token of some length"})
    assert not config.loopback
    assert "some length" not in repr(config) + config.model_dump_json()
