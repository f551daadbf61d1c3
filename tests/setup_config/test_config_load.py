"""A whole file: every mistake at its place with its mend, all at once, and what comes out of a good one."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import config_plugins as fake
import pytest

from robotd.engine.parts import Parts
from robotd.setup.load import check_file, load_config, parts_from_merged
from robotd.setup.problems import ConfigError, Problem
from robotd.world.kinematics import Ackermann, Differential, Mecanum

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def write(tmp_path: Path) -> Any:
    (tmp_path / "model.onnx").touch()

    def to(text: str = fake.FILE) -> Path:
        path = tmp_path / "robot.yaml"
        path.write_text(text)
        return path

    return to


def changed(old: str, new: str) -> str:
    assert fake.FILE.count(old) >= 1, old
    return fake.FILE.replace(old, new, 1)


def check(path: Path, **more: Any) -> list[Problem]:
    return check_file(path, registry=fake.registry(), **more)


# what is replaced, by what, and the one problem: place, path, piece of the message, hint
MISTAKES = [
    ("range_max_m: 4", "range_max_cm: 400", "24:5", "behaviours.follow.range_max_cm", "unknown key",
     "did you mean 'range_max_m' (metres; 400 cm is 4 m)?"),
    ("range_max_m: 4", "rnage_max_m: 4", "24:5", "behaviours.follow.rnage_max_m", "unknown key",
     "did you mean 'range_max_m'?"),
    ("range_max_m: 4", 'range_max_m: "4"', "24:18", "behaviours.follow.range_max_m",
     "is the text '4' (expected a number)", "write it without quotes: 4"),
    ("range_max_m: 4", "range_max_m: 400", "24:18", "behaviours.follow.range_max_m", "is 400 (expected 0.3 to 12)",
     "another unit? 400 mm is 0.4 m, 400 cm is 4 m"),
    ("range_max_m: 4", "range_max_m: true", "24:18", "behaviours.follow.range_max_m",
     "is true (expected a number)", ""),
    ("range_max_m: 4", "range_max_m:", "24:5", "behaviours.follow.range_max_m", "is empty (expected a number)", ""),
    ("range_max_m: 4", "range_max_m: [4]", "24:18", "behaviours.follow.range_max_m", "is a list of 1", ""),
    ("range_max_m: 4", "range_max_m: 4\n    range_max_m: 5", "25:5", "behaviours.follow.range_max_m", "duplicate key",
     "remove one of them"),
    ("range_max_m: 4", "window: 2.5", "24:13", "behaviours.follow.window", "is 2.5 (expected a whole number)", ""),
    ("range_max_m: 4", "careful: yes", "24:14", "behaviours.follow.careful",
     "is the text 'yes' (expected true or false)", "write true (this is YAML 1.2)"),
    ("range_max_m: 4", "careful: 'false'", "24:14", "behaviours.follow.careful",
     "is the text 'false' (expected true or false)", "write it without quotes: false"),
    ("range_max_m: 4", "side: lft", "24:11", "behaviours.follow.side", "is the text 'lft' (expected 'left' or 'right')",
     "did you mean 'left'?"),
    ("range_max_m: 4", "pitch_rad: 20", "24:16", "behaviours.follow.pitch_rad", "is 20 (expected -1.6 to 1.6)",
     "another unit? 20 deg is 0.349066 rad"),
    ("range_max_m: 4", "pace: fast", "24:11", "behaviours.follow.pace",
     "is the text 'fast' (expected a number or a list)", ""),
    ("range_max_m: 4", "shape: {width_m: 3}", "24:5", "behaviours.follow.shape.height_m", "is missing", ""),
    ("range_max_m: 4", "keep_m: 9", "21:5", "behaviours.follow", "keep_m must not be more than range_max_m", ""),
    ("radius_m: 0.5", "radius_cm: 50", "26:22", "behaviours.follow.zones[0].radius_cm", "unknown key",
     "did you mean 'radius_m' (metres; 50 cm is 0.5 m)?"),
    ("radius_m: 0.5", "radius_m: 50", "26:32", "behaviours.follow.zones[0].radius_m",
     "is 50 (expected more than 0, at most 5)", ""),
    ("priority: 10", "prioritty: 10", "21:5", "behaviours.follow.prioritty", "unknown key",
     "did you mean 'priority'?"),
    ("    priority: 10\n", "", "20:3", "behaviours.follow.priority", "is missing (who drives", ""),
    ("priority: 10", "priority: high", "21:15", "behaviours.follow.priority", "is the text 'high'", ""),
    ("distance_m: 1.2", "distance_m: -1", "23:24", "behaviours.follow.goal.distance_m", "is -1 (expected", ""),
    ("distance_m: 1.2", "dist_m: 1", "23:12", "behaviours.follow.goal.dist_m", "unknown key", "distance_m"),
    ("use: fake_lidar", "uze: fake_lidar", "10:5", "devices.lidar.uze", "unknown key", "did you mean 'use'?"),
    ("use: fake_lidar", "use: fake_lydar", "10:10", "devices.lidar.use", "no device named 'fake_lydar'",
     "did you mean 'fake_lidar'?"),
    ("    use: fake_lidar\n", "", "9:3", "devices.lidar", "no device named 'lidar'", ""),
    ("use: fake_lidar", "use: person", "10:10", "devices.lidar.use", "no device named 'person'",
     "'person' is a perceptor and belongs under `perception:`"),
    ("use: fake_lidar", "use: needs_more", "10:10", "devices.lidar.use",
     "there is no module 'config_plugins_missing_module'", "install what it needs"),
    ("use: fake_lidar", "use: fake_room", "9:3", "devices.lidar", "Room is a simulated world",
     "under `simulation: {use: ...}`"),
    ("use: fake_lidar", "use: 3", "10:10", "devices.lidar.use", "is 3 (expected text)", "put it in quotes"),
    ("use: fake_motors", "use: fake_motors\n    as: foo", "15:9", "devices.motors.as",
     "publishes Odometry and Battery", "write as: {Odometry: foo}"),
    ("use: fake_motors", "use: fake_motors\n    as: {Odometri: x}", "15:10", "devices.motors.as.Odometri",
     "publishes no Odometri", "did you mean 'Odometry'?"),
    ("use: fake_lidar", "use: fake_lidar\n    as: Rear", "11:9", "devices.lidar.as", "'Rear' is not a topic", ""),
    ("model: model.onnx", "model: gone.onnx", "18:12", "perception.person.model", "there is no file", ""),
    ("model: model.onnx", "model: model.onnx\n    labels: [model.onnx, gone.txt]", "19:26",
     "perception.person.labels[1]", "there is no file", ""),
    ("behaviours:", "behaviors:", "19:1", "behaviors", "unknown section", "did you mean 'behaviours'?"),
    ("guard:\n  zones:", "zones:", "27:1", "zones", "unknown section", "it belongs under `guard:`"),
    ("act_hz: 50", "follow: {}", "35:1", "follow", "unknown section", "it belongs under `behaviours:`"),
    ("act_hz: 50", "act_hz: 5000", "35:9", "act_hz", "is 5000 (expected 5 to 500)", ""),
    ("act_hz: 50", "act_khz: 0.05", "35:1", "act_khz", "unknown section", "did you mean 'act_hz'"),
    ("margin_m: 0.05", "margin_cm: 5", "29:35", "guard.zones.stop.margin_cm", "unknown key",
     "did you mean 'margin_m' (metres; 5 cm is 0.05 m)?"),
    ("type: differential", "type: diferential", "3:22", "robot.kinematics.type", "is the text 'diferential'",
     "did you mean 'differential'?"),
    ("type: differential", "tipe: differential", "3:16", "robot.kinematics.tipe", "unknown key",
     "did you mean 'type'?"),
    ("devices:", "device:", "8:1", "device", "unknown section", "did you mean 'devices'?"),
    ("robot:", "Robot:", "1:1", "Robot", "unknown section", "did you mean 'robot'?"),
    ("simulation:", "simulator:", "36:1", "simulator", "unknown section", "did you mean 'simulation'?"),
    ("type: differential, ", "", "3:3", "robot.kinematics.type", "is missing", ""),
    ("track_m: 0.12", "track_cm: 12", "3:36", "robot.kinematics.track_cm", "unknown key",
     "did you mean 'track_m' (metres; 12 cm is 0.12 m)?"),
    ("[0.1, 0.07], [0.1, -0.07], [-0.1, -0.07], [-0.1, 0.07]", "[0, 0], [1, 1], [2, 2]", "4:16",
     "robot.footprint_m", "a footprint needs three corners that span an area", ""),
    ("[0.1, 0.07], ", "[0.1], ", "4:17", "robot.footprint_m[0][1]", "is missing", ""),
    ("lidar: {x_m", "lidor: {x_m", "6:5", "robot.mounts.lidor", "there is no device of this name",
     "did you mean 'lidar'?"),
    ("seed: 3", "map: line_trac", "38:8", "simulation.map", "there is no file 'line_trac'",
     "did you mean 'line_track'?"),
    ("seed: 3", "sead: 3", "38:3", "simulation.sead", "unknown key", "did you mean 'seed'?"),
    ("use: fake_room", "use: fake_rom", "37:8", "simulation.use", "no world named 'fake_rom'",
     "did you mean 'fake_room'?"),
    ("use: fake_room", "use: fake_lidar", "37:8", "simulation.use", "Lidar is a device, not a simulated world", ""),
    ("lidar: {beams", "lidr: {beams", "40:5", "simulation.devices.lidr", "there is no device of this name",
     "did you mean 'lidar'?"),
    ("beams: 90", "beam: 90", "40:13", "simulation.devices.lidar.beam", "unknown key", "did you mean 'beams'?"),
    ("port: 8081", "port: 80810", "33:16", "bridges.page.port", "is 80810 (expected 1 to 65535)", ""),
    ("page: {port", "no_such_class: {port", "33:3", "bridges.no_such_class", "cannot be imported: AttributeError",
     "mend the plugin"),
    ("page: {port: 8081}", "page: 8081", "33:9", "bridges.page", "is 8081 (expected a mapping", ""),
    ("page: {port", "Page: {port", "33:3", "bridges.Page", "no bridge named 'Page'", "did you mean 'page'?"),
    ("  follow:\n", "  hidden: {priority: 1}\n  follow:\n", "20:3", "behaviours.hidden",
     "Hidden has a parameter 'start'", ""),
    ("  follow:\n", "  race: {priority: 10}\n  follow:\n", "22:15", "behaviours.follow.priority",
     "10 is also the priority of race; a tie has no winner", ""),
    ("  follow:\n", "  race: {priority: 1}\n  follow:\n", "20:3", "behaviours.race", "emits Steer", ""),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "place", "path", "words", "hint"), MISTAKES)
def test_each_mistake_is_placed_and_mended(
    write: Any, old: str, new: str, place: str, path: str, words: str, hint: str
) -> None:
    file = write(changed(old, new))
    problems = check(file)
    found = next((p for p in problems if p.path == path and words in p.message), None)
    assert found is not None, "\n".join(map(str, problems))
    assert f"{found.line}:{found.column}" == place
    assert hint in found.hint
    assert str(found).startswith(f"{file}:{place}: {path}: {found.message}")


ALONE = [row for row in MISTAKES if row[3] not in ("zones", "behaviours.race")]


@pytest.mark.parametrize(("old", "new", "place", "path", "words", "hint"), ALONE)
def test_one_mistake_makes_one_problem(
    write: Any, old: str, new: str, place: str, path: str, words: str, hint: str
) -> None:
    problems = check(write(changed(old, new)))
    # a behaviour that the base cannot serve shows beside the tie that the row is about
    others = [p for p in problems if p.path != path and "emits Steer" not in p.message]
    assert others == []


def test_all_problems_are_told_in_the_order_of_the_file(write: Any) -> None:
    text = fake.FILE
    for old, new in (
        ("track_m: 0.12", "track_m: 12"),
        ("use: fake_motors", "use: fake_motors\n    gain: 3"),
        ("model: model.onnx", "model: gone.onnx"),
        ("range_max_m: 4", "range_max_m: x\n    range_max_m: 4"),
        ("sources: [lidar_scan], margin_m: 0.05", "sources: [scan], margin_m: 0.05"),
        ("port: 8081", "prt: 8081"),
        ("seed: 3", "seed: -3"),
    ):
        assert old in text
        text = text.replace(old, new, 1)
    with pytest.raises(ConfigError) as caught:
        load_config(write(text), registry=fake.registry(), whole=True)
    problems = caught.value.problems
    assert [(p.path, p.line) for p in problems] == [
        ("robot.kinematics.track_m", 3),
        ("devices.motors.gain", 15),
        ("perception.person.model", 19),
        ("behaviours.follow.range_max_m", 25),
        ("behaviours.follow.range_max_m", 26),
        ("guard.zones.stop.sources", 31),
        ("bridges.page.prt", 35),
        ("simulation.seed", 40),
    ]
    assert len(str(caught.value).splitlines()) == 8


def test_flow_is_checked_beside_refused_parameters(write: Any) -> None:
    """A refused lidar still publishes scans; only its pace is unknown."""
    wrong = changed("range_max_m: 8", "rate_hz: 1\n    range_max_cm: 800")
    assert [p.path for p in check(write(wrong))] == ["devices.lidar.range_max_cm"]
    slow = check(write(changed("range_max_m: 8", "rate_hz: 1")))
    assert {"perception.person", "behaviours.follow", "guard.scan_within_s"} == {p.path for p in slow}
    assert all("1.5 periods" in p.message for p in slow)


def test_a_good_file_becomes_parts(write: Any) -> None:
    loaded = load_config(write(), registry=fake.registry())
    parts = loaded.parts
    assert [(p.name, p.cls, type(p.config)) for p in parts.devices] == [
        ("lidar", fake.Lidar, fake.LidarConfig),
        ("motors", fake.Motors, fake.MotorConfig),
    ]
    (follow,) = parts.behaviours
    assert follow.priority == 10 and follow.start and follow.goal == fake.FollowGoal(distance_m=1.2)
    assert follow.config == fake.FollowConfig(range_max_m=4.0, zones=(fake.Zone(name="door", radius_m=0.5),))
    assert parts.robot.kinematics == Differential(track_m=0.12)
    assert parts.robot.mount("lidar").z_m == 0.1 and parts.robot.limits.vx_mps == 0.4
    assert parts.world is None and not parts.arm_at_start and parts.act_hz == 50.0
    assert loaded.source_text == fake.FILE and loaded.recorder.frames == "none"


def test_files_count_from_the_config(write: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    file = write()
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    (part,) = load_config(file, registry=fake.registry()).parts.perceptors
    assert part.config == fake.PersonConfig(model=tmp_path / "model.onnx")


def test_a_map_is_a_file_beside_the_config_or_a_shipped_name(write: Any, tmp_path: Path) -> None:
    def room(text: str) -> Any:
        world = load_config(write(changed("seed: 3", text)), sim=True, registry=fake.registry()).parts.world
        assert world is not None
        return world.config

    assert room("map: line_track") == fake.RoomConfig(map="line_track")
    (tmp_path / "mine.yaml").touch()
    assert room("map: mine.yaml") == fake.RoomConfig(map=str(tmp_path / "mine.yaml"))


# ----------------------------------------------------------------------------------------------- simulation


def test_sim_replaces_each_device_by_its_twin(write: Any) -> None:
    parts = load_config(write(), sim=True, registry=fake.registry()).parts
    assert [(p.name, p.cls) for p in parts.devices] == [("lidar", fake.SimLidar), ("motors", fake.SimMotors)]
    assert parts.devices[0].config == fake.SimLidarConfig(beams=90)
    assert parts.world is not None and parts.world.config == fake.RoomConfig(seed=3)
    assert parts.arm_at_start


def test_sim_arms_itself_unless_told_not_to(write: Any) -> None:
    text = changed("  seed: 3", "  seed: 3\n  arm_at_start: false")
    assert not load_config(write(text), sim=True, registry=fake.registry()).parts.arm_at_start
    armed = changed("arm_at_start: false", "arm_at_start: true")
    assert load_config(write(armed), registry=fake.registry()).parts.arm_at_start


def test_renames_stay_with_the_twin(write: Any) -> None:
    text = changed("use: fake_motors", "use: fake_motors\n    as: {Odometry: wheels, Battery: pack}")
    real = load_config(write(text), registry=fake.registry()).parts.devices[1]
    twin = load_config(write(text), sim=True, registry=fake.registry()).parts.devices[1]
    assert dict(real.topics) == {"Odometry": "wheels", "Battery": "pack"}
    assert dict(twin.topics) == {"Odometry": "wheels"}, "the twin publishes no battery"


def test_a_device_without_a_twin_is_refused_by_name(write: Any) -> None:
    text = changed("    use: fake_motors\n    gains: [1.0, 0.98]", "    use: fake_servo")
    (problem,) = [p for p in check(write(text), sim=True) if "twin" in p.message]
    assert (problem.path, problem.line) == ("devices.motors", 13)


def test_the_file_may_name_another_twin(write: Any) -> None:
    text = changed("    lidar: {beams: 90}", "    lidar: {use: fake_lidar, port: /dev/null}")
    loaded = load_config(write(text), sim=True, registry=fake.registry())
    assert loaded.parts.devices[0].cls is fake.Lidar
    assert parts_from_merged(loaded.merged, sim=True, registry=fake.registry()).devices == loaded.parts.devices
    assert load_config(write(text), registry=fake.registry()).parts.devices[0].config != loaded.parts.devices[0].config


@pytest.mark.parametrize(
    ("entry", "path", "message"),
    [
        ("{use: fake_lidr, beams: 90}", "simulation.devices.lidar.use", "fake_lidr"),
        ("{use: fake_lidar, prt: /dev/null}", "simulation.devices.lidar.prt", "unknown key"),
    ],
)
def test_another_twin_is_checked_like_the_first(write: Any, entry: str, path: str, message: str) -> None:
    problems = check(write(changed("    lidar: {beams: 90}", f"    lidar: {entry}")), sim=True)
    assert [p for p in problems if p.path == path and message in p.message], problems


def test_sim_needs_its_section(write: Any) -> None:
    text = fake.FILE.partition("simulation:")[0]
    assert check(write(text)) == []
    (problem,) = check(write(text), sim=True)
    assert "section `simulation` is missing" in problem.message


def test_a_real_run_imports_no_twin_and_no_world(write: Any) -> None:
    from robotd.setup.registry import Registry

    kept = [point for point in fake.points() if point.name not in ("fake_room", "fake_sim_lidar", "fake_sim_motors")]
    assert load_config(write(), registry=Registry(kept)).parts.world is None


# --------------------------------------------------------------------------------------------------- layers


def test_layers_lie_in_order(write: Any) -> None:
    env = {"ROBOTD__GUARD__LATENCY_S": "0.2", "ROBOTD__BEHAVIOURS__FOLLOW__WINDOW": "7", "ROBOTD_DATA": "x"}
    sets = ["guard.latency_s=0.3", "robot.limits.vx_mps=0.25", "bridges.page={host: 0.0.0.0}", "guard.latency_s=0.4"]
    loaded = load_config(write(), env=env, sets=sets, registry=fake.registry())
    parts = loaded.parts
    assert parts.guard.latency_s == 0.4 and parts.robot.limits.vx_mps == 0.25
    (follow,), (page,) = parts.behaviours, parts.bridges
    assert isinstance(follow.config, fake.FollowConfig) and follow.config.window == 7
    assert page.config == fake.PageConfig(host="0.0.0.0")
    assert loaded.merged["guard"]["latency_s"] == 0.4
    assert loaded.source_text == fake.FILE


def test_a_layer_can_mend_the_file(write: Any) -> None:
    broken = changed("range_max_m: 4", "range_max_m: {a: &x 1}")
    assert check(write(broken), sets=["behaviours.follow.range_max_m=4"]) != [], "the file itself is still refused"
    wrong = changed("range_max_m: 4", "range_max_m: {a: 1}")
    assert check(write(wrong), sets=["behaviours.follow.range_max_m=4"]) == []


@pytest.mark.parametrize(
    ("sets", "env", "said"),
    [
        (["guard.latensy_s=1"], {}, "--set guard.latensy_s: guard.latensy_s: unknown key; did you mean 'latency_s'?"),
        (["act_hz=fast"], {}, "--set act_hz: act_hz: is the text 'fast' (expected a number)"),
        (["robot.footprint_m.0.0=300"], {}, "--set robot.footprint_m.0.0: robot.footprint_m[0][0]: is 300"),
        (["robot.footprint_m.9.0=0"], {}, "cannot set robot.footprint_m.9.0: robot.footprint_m has no '9' in it"),
        (["act_hz.x=3"], {}, "--set act_hz.x: cannot set act_hz.x: act_hz has no 'x' in it"),
        (["a..b=3"], {}, "--set a..b: names no place"),
        (["act_hz"], {}, "--set act_hz: has no value"),
        (["act_hz=[1"], {}, "--set act_hz: is not YAML"),
        (["act_hz=&a 1"], {}, "--set act_hz: anchor &a"),
        ([], {"ROBOTD__ACT_HZ": "'50'"}, "ROBOTD__ACT_HZ: act_hz: is the text '50'"),
        ([], {"ROBOTD__DEVICES__LIDAR__RANGE_MAX_CM": "300"},
         "ROBOTD__DEVICES__LIDAR__RANGE_MAX_CM: devices.lidar.range_max_cm: unknown key; did you mean 'range_max_m' "
         "(metres; 300 cm is 3 m)?"),
        ([], {"ROBOTD__ROBOT____X": "1"}, "ROBOTD__ROBOT____X: names no place"),
        ([], {"ROBOTD__OPERATOR__ARM_AT_START": "yes"}, "write true (this is YAML 1.2)"),
    ],
)  # fmt: skip
def test_a_wrong_layer_is_named(write: Any, sets: list[str], env: dict[str, str], said: str) -> None:
    (problem,) = check(write(), sets=sets, env=env)
    assert said in str(problem)
    assert problem.line is None


def test_variables_find_names_in_any_case(write: Any) -> None:
    text = changed("use: fake_motors", "use: fake_motors\n    as: {Odometry: wheels}")
    loaded = load_config(write(text), env={"ROBOTD__DEVICES__MOTORS__AS__ODOMETRY": "w"}, registry=fake.registry())
    assert dict(loaded.parts.devices[1].topics) == {"Odometry": "w"}


# --------------------------------------------------------------------------------------------- round trip


@pytest.mark.parametrize("sim", [False, True])
def test_merged_survives_json_and_makes_the_same_parts(write: Any, sim: bool) -> None:
    loaded = load_config(write(), sim=sim, sets=["guard.latency_s=0.15"], registry=fake.registry())
    again: Parts = parts_from_merged(json.loads(json.dumps(loaded.merged)), sim, registry=fake.registry())
    assert again == loaded.parts


def test_merged_says_what_is_wrong_without_lines(write: Any) -> None:
    merged = load_config(write(), registry=fake.registry()).merged
    merged["behaviours"]["follow"]["window"] = 0
    with pytest.raises(ConfigError, match=r"the recorded config:1:1: behaviours\.follow\.window|window: is 0"):
        parts_from_merged(merged, registry=fake.registry())


# ---------------------------------------------------------------------------------------------- odd files


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "is empty (expected sections"),
        ("- a\n", "is a list of 1 (expected sections"),
        ("just text\n", "is the text 'just text'"),
        ("devices: {}\n", "section `robot` is missing"),
        ("robot:\n  name: x\n  kinematics: [\n", "is not YAML"),
    ],
)
def test_odd_files(write: Any, text: str, said: str) -> None:
    assert any(said in p.message for p in check(write(text)))


def test_empty_sections_and_entries_are_empty_mappings(write: Any) -> None:
    text = changed("  page: {port: 8081}", "  page:").replace("recorder: {frames: none}", "recorder:")
    assert load_config(write(text), registry=fake.registry()).parts.bridges[0].config == fake.PageConfig()


@pytest.mark.parametrize(
    ("kinematics", "expected"),
    [
        ("{type: mecanum, wheelbase_m: 0.2, track_m: 0.3, wheel_radius_m: 0.05}", Mecanum(0.2, 0.3, 0.05)),
        ("{type: ackermann, wheelbase_m: 0.257, track_m: 0.19, max_steering_rad: 0.4}", Ackermann(0.257, 0.19, 0.4)),
    ],
)
def test_other_bases(write: Any, kinematics: str, expected: object) -> None:
    text = changed("{type: differential, track_m: 0.12}", kinematics)
    assert load_config(write(text), registry=fake.registry()).parts.robot.kinematics == expected


def test_a_misspelt_file_beside_others_is_told_by_its_neighbour(tmp_path: Path) -> None:
    text = (ROOT / "configs" / "f1tenth.yaml").read_text().replace("track_03.yaml", "track_03.yamx")
    (tmp_path / "configs").mkdir()
    (tmp_path / "maps").symlink_to(ROOT / "maps")
    (tmp_path / "configs" / "robot.yaml").write_text(text)
    (problem,) = check_file(tmp_path / "configs" / "robot.yaml", sim=True)
    assert problem.path == "simulation.map"
    assert "did you mean '../maps/tracks/track_03.yaml'?" in problem.hint
