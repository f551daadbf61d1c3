"""Registry, shipped files and the schema."""

from __future__ import annotations

import copy
import subprocess
import sys
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import config_plugins as fake
import pytest

from robotd.setup.load import schema
from robotd.setup.problems import ConfigError
from robotd.setup.registry import GROUPS, PluginError, Registry, installed
from robotd.setup.resources import find_config, find_shipped, shipped


def test_listing_imports_nothing() -> None:
    registry = Registry([EntryPoint("x", "no_such_module_at_all:X", GROUPS["devices"])])
    assert registry.names("devices") == ("x",)
    assert [p.name for p in registry.plugins()] == ["x"]


def test_installed_names_their_distribution() -> None:
    found = {(p.group, p.name): p for p in installed()}
    world = found["robotd.devices", "flat_world"]
    assert world.distribution == "robotd" and world.version and world.target == "robotd_devices.sim:FlatWorld"


def test_two_distributions_with_one_name_are_refused() -> None:
    points = [EntryPoint("page", f"config_plugins:{name}", GROUPS["bridges"]) for name in ("Page", "Other")]
    with pytest.raises(PluginError, match="installed twice: config_plugins:Other and config_plugins:Page"):
        Registry(points).load("bridges", "page")


def test_a_class_of_the_wrong_kind_is_refused() -> None:
    points = [EntryPoint("page", "config_plugins:Lidar", GROUPS["bridges"])]
    with pytest.raises(PluginError, match="is not a Bridge"):
        Registry(points).load("bridges", "page")


def test_whatever_an_import_raises_becomes_a_plugin_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "cfg_broken_plugin.py").write_text("raise RuntimeError('no board')\n")
    monkeypatch.syspath_prepend(tmp_path)
    registry = Registry([EntryPoint("broken", "cfg_broken_plugin:X", GROUPS["devices"])])
    with pytest.raises(PluginError, match="cannot be imported: RuntimeError: no board"):
        registry.load("devices", "broken")


def test_configs_are_found_by_path_and_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert find_config("jetbot.yaml") == shipped("configs")["jetbot.yaml"] == find_config("jetbot")
    (tmp_path / "jetbot.yaml").touch()
    assert find_config("jetbot.yaml") == Path("jetbot.yaml"), "a file that is there comes before a shipped one"
    assert find_shipped("maps", "line_track") is not None
    with pytest.raises(ConfigError, match=r"jetbt\.yaml: there is no such file; did you mean 'jetbot\.yaml'\?"):
        find_config("jetbt.yaml")
    with pytest.raises(ConfigError, match="there is no such file"):
        find_config("elsewhere/jetbot.yaml")
    with pytest.raises(ConfigError, match="is a folder"):
        find_config(tmp_path)


def test_schema_describes_every_installed_plugin() -> None:
    made = schema(fake.registry())
    assert made["additionalProperties"] is False
    follow = made["$defs"]["behaviours.follow"]
    assert follow["properties"]["range_max_m"] == {
        "type": "number", "minimum": 0.3, "maximum": 12.0, "default": 3.0,
        "title": "Range Max M", "description": "How far it looks.",
    }  # fmt: skip
    assert {"use", "priority", "start", "goal", "timeout_s"} <= set(follow["properties"])
    assert follow["required"] == ["priority"]
    assert "distance_m" in follow["properties"]["goal"]["properties"]
    assert made["$defs"]["perception.person"]["required"] == ["model"]
    assert "map" in made["$defs"]["simulation.fake_room"]["properties"]
    assert "fake_room" not in made["properties"]["devices"]["properties"], "a world is no device"
    assert "Left out" in made["properties"]["bridges"]["description"], "one bridge cannot be imported"


def test_schema_has_no_dangling_references() -> None:
    made = schema(fake.registry())

    def references(node: Any) -> list[str]:
        if isinstance(node, dict):
            own = [node["$ref"]] if isinstance(node.get("$ref"), str) else []
            return own + [r for value in node.values() for r in references(value)]
        return [r for value in node for r in references(value)] if isinstance(node, list) else []

    found = references(copy.deepcopy(made))
    assert found
    assert {r.removeprefix("#/$defs/") for r in found} <= set(made["$defs"])


def test_reading_a_config_needs_nothing_heavy() -> None:
    code = (
        "import sys; import robotd.setup.load; heavy = 'cv2 onnxruntime networkx scipy aiohttp mcap serial'.split(); "
        "print([m for m in heavy if m in sys.modules])"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert ran.stdout.strip() == "[]"
